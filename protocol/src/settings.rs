//! What a run is told once, before its first phase: the same on every node.

use crate::sun::Sun;
use serde::{Deserialize, Serialize};

/// Which renderer a node uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackendChoice {
    /// A GPU, else a software Vulkan driver, else the CPU backend.
    #[default]
    Auto,
    /// A graphics driver, hardware or software; an error where there is none.
    Gpu,
    /// The embedded z-buffer rasteriser.
    Cpu,
}

/// How hidden hlods are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cull {
    /// One hardware occlusion query a box (paper 004, section 4.2).
    #[default]
    Queries,
    /// One instanced draw of all boxes whose fragments store `visible[id]`.
    Boxes,
    /// Everything in the frustum is drawn.
    Off,
}

/// Who does what in a phase; see [`crate::schedule`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Paper 004, section 4.3: two seats swap OR and HC, the third always draws.
    #[default]
    Switch,
    /// All three seats change role every frame: a picture is drawn where its visible set was found.
    Rotate,
}

/// What a frame promises where its geometry is not in memory yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Residency {
    /// It waits: the picture is the one that all memory in the world would give, bit for bit.
    #[default]
    Exact,
    /// It never waits: the nearest ancestor that is there stands in, and the error is logged.
    Deadline,
}

/// What stands in for what is far of a view cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Far {
    /// Nothing: all is drawn as geometry.
    #[default]
    Off,
    /// Textured depth meshes, one sample a cell, skins kept: what paper 000 compares itself with.
    Tdm,
    /// Incremental textured depth meshes (paper 000).
    Itdm,
}

/// Cubes drawn of a cell where nothing else is said.
pub const FAR_CUBES: u32 = 8;

/// What an audit holds a picture against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AuditAgainst {
    /// What the frustum holds of the front: finds what occlusion culling lost.
    #[default]
    Front,
    /// The whole cut, in the frustum or not, and its levels against `lod_px`: finds a wrong front or frustum,
    /// too.
    Scene,
}

/// Picture size in pixels, each side 1..=16384.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PictureSize {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

/// Everything a node needs to know of a run, sent in the welcome message.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// Scene file, as the node is to open it, in the words of [`crate::path_text`].
    pub scene_path: String,
    /// Digest of the whole file ([`crate::format::Digest`]); a node with another scene is refused.
    pub scene_digest: [u8; 32],
    /// Picture size.
    pub size: PictureSize,
    /// Pixels by which a point may be seen away from its place, anywhere in the picture; 0 draws the original
    /// geometry.
    pub lod_px: f64,
    /// What lights the scene.
    pub sun: Sun,
    /// How hidden hlods are found.
    pub cull: Cull,
    /// Who does what in a phase.
    pub schedule: Schedule,
    /// Which renderer.
    pub backend: BackendChoice,
    /// Number of pictures.
    pub frames: u32,
    /// Audit every n-th frame; 0 never.
    pub audit_every: u32,
    /// What it is held against.
    pub audit_against: AuditAgainst,
    /// Count hlods with a visible pixel (item buffer) every n-th frame; 0 never.
    pub items_every: u32,
    /// Most bytes a node takes for geometry and textures, buffers on their way included; none leaves
    /// it to the node: an eighth of its machine's memory.
    pub memory: Option<u64>,
    /// What a frame promises where geometry is missing.
    pub residency: Residency,
    /// Geometry is read before it is needed.
    pub prefetch: bool,
    /// What stands in for what is far, in the view cells that have it.
    pub far: Far,
    /// Cubes of a cell that are drawn at most.
    pub far_cubes: u32,
    /// Triangles of cubes in the frustum that are drawn at most.
    pub far_triangles: Option<u64>,
    /// Folder that receives `000000.png ...`, in the words of [`crate::path_text`]; none writes no pictures.
    pub pictures_dir: Option<String>,
}
