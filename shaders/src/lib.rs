//! The WGSL sources and the Rust mirrors of their structs.
//!
//! WGSL has no include, so each source here is the shared text followed by the pass's own. A test
//! parses and validates all of them and compares every mirror with what the parser read.

pub mod mirror;

macro_rules! source {
    ($($file:literal),+) => {
        concat!($(include_str!(concat!("../", $file)), "\n"),+)
    };
}

/// A source that draws meshes, as a driver takes it. `guards`: the driver may make undefined depth, and its
/// fragments are dropped.
pub fn for_meshes(source: &str, guards: bool) -> String {
    let guard =
        if guards { include_str!("../guard.wgsl") } else { include_str!("../no_guard.wgsl") };
    format!("{guard}\n{source}")
}

/// Occluders, depth alone: entry points `vertex_main`, and `fragment_guard` for drivers to be guarded.
/// This one and the six that follow are for [`for_meshes`].
pub const DEPTH: &str = source!("frame.wgsl", "mesh.wgsl", "depth.wgsl");
/// Pictures of plain meshes: entry points `vertex_main`; `fragment_main` and `fragment_blend` for colours,
/// `fragment_normal`.
pub const SHADE: &str = source!("frame.wgsl", "mesh.wgsl", "light.wgsl", "shade.wgsl");
/// Pictures of textured meshes: the same entry points.
pub const SHADE_TEXTURED: &str =
    source!("frame.wgsl", "mesh.wgsl", "light.wgsl", "texture.wgsl", "shade_textured.wgsl");
/// Pictures of meshes with holes: entry points `fragment_mask` for colours and `fragment_mask_normal` beside
/// those of [`SHADE_TEXTURED`].
pub const SHADE_MASK: &str = source!(
    "frame.wgsl",
    "mesh.wgsl",
    "light.wgsl",
    "texture.wgsl",
    "shade_textured.wgsl",
    "shade_mask.wgsl"
);
/// Item ids of meshes with holes: entry points `vertex_main`, `fragment_main`.
pub const ITEMS_MASK: &str = source!("frame.wgsl", "mesh.wgsl", "texture.wgsl", "items_mask.wgsl");
/// Item ids: entry points `vertex_main`, `fragment_main`.
pub const ITEMS: &str = source!("frame.wgsl", "mesh.wgsl", "items.wgsl");
/// Projected blobs in all passes: entry points `vertex_main`; `fragment_main` for colours as they are stored;
/// `vertex_relit` and `fragment_relit` for colours under another sun, of a blob with normals; `fragment_normal`, `fragment_items`, and `fragment_guard` for drivers to be guarded.
pub const PROJECTED: &str = source!("frame.wgsl", "mesh.wgsl", "light.wgsl", "projected.wgsl");
/// Boxes as occlusion queries, entry point `query_vertex`: depth alone, a list of
/// [`BOX_VERTICES`] vertices an instance.
pub const BOX_QUERY: &str = source!("frame.wgsl", "box.wgsl", "box_query.wgsl");
/// Boxes that mark themselves, entry points `mark_vertex`, `mark_fragment`. It needs the early depth
/// test, which not every device has, and so is a module of its own.
pub const BOX_MARK: &str = source!("frame.wgsl", "box.wgsl", "box_mark.wgsl");

/// Vertices of the three faces of a box that can be turned to the eye, two triangles each.
pub const BOX_VERTICES: u32 = 18;
