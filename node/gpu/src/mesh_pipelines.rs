//! Pipelines that draw meshes: one a pass, class, vertex layout and turn, compiled at first need.
//!
//! What a scene does not hold costs nothing: no pipeline of a scene without textures binds one, and only
//! what has holes gives up the early depth test. On drivers that need the guard all do.
//!
//! Projected blobs are guarded, but their depth is not moved: no box stands for them, and at infinity there
//! is nowhere to move it to.

use crate::device::Device;
use crate::pipelines::{Recipe, attributes, compile};
use crate::targets::{COLOR_FORMAT, ITEMS_FORMAT, NORMALS_FORMAT};
use protocol::format::Class;
use protocol::format::vertex::Layout;
use scene::occludee::{MESH_BIAS_PX, Rules};
use shaders::mirror::{Instance, Texturing, Vertex};
use std::collections::BTreeMap;
use wgpu::{CompareFunction, FrontFace};

/// What is drawn into.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Into {
    /// Depth alone.
    Depth,
    /// Nothing: what passes is counted, and what has holes or blends counts as opaque.
    Count,
    /// Colour and depth.
    Picture,
    /// The same under another sun than pictures of scan cubes show: those that have normals are lit again.
    Relit,
    /// Normals and depth.
    Normals,
    /// Item ids and depth.
    Items,
}

/// What a triangle does to what lies behind it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Opaque,
    Mask,
    Blend,
}

/// Which faces are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Faces {
    Both,
    CounterClockwise,
    Clockwise,
}

/// Tells one pipeline from another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Key {
    into: Into,
    kind: Kind,
    faces: Faces,
    layout: Layout,
}

/// What a pipeline's shader reads as group 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reads {
    /// It has none.
    Nothing,
    /// The scene's textures.
    Textures,
    /// The buffer the blob lies in.
    Picture,
}

/// Layouts of the groups of pipelines.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Groups<'a> {
    /// Group 0, the uniform's.
    pub(crate) frame: &'a wgpu::BindGroupLayout,
    /// Group 1 of what reads textures.
    pub(crate) textures: &'a wgpu::BindGroupLayout,
    /// Group 1 of what reads pictures.
    pub(crate) words: &'a wgpu::BindGroupLayout,
}

impl Key {
    /// For triangles of a class. `mirrored`: the placement turns corners the other way.
    pub(crate) fn new(into: Into, class: Class, layout: Layout, mirrored: bool) -> Self {
        let kind = match () {
            () if class.is_mask() => Kind::Mask,
            () if class.is_blend() => Kind::Blend,
            () => Kind::Opaque,
        };
        let faces = match (class.is_single_sided(), mirrored) {
            (false, _) => Faces::Both,
            (true, false) => Faces::CounterClockwise,
            (true, true) => Faces::Clockwise,
        };
        let into = match into {
            Into::Relit if layout != Layout::ProjectedNormals => Into::Picture,
            into => into,
        };
        Self { into, kind, faces, layout }
    }

    /// What its shader reads.
    pub(crate) fn reads(self) -> Reads {
        match (self.into, self.layout, self.kind) {
            (Into::Picture | Into::Relit, layout, _) if layout.is_projected() => Reads::Picture,
            (Into::Picture | Into::Normals, Layout::Textured, _) | (Into::Items, _, Kind::Mask) => {
                Reads::Textures
            }
            _ => Reads::Nothing,
        }
    }
}

/// What keeps the depth of geometry from leaving its box (`scene::occludee`).
#[derive(Debug, Clone, Copy)]
struct Soundness {
    bias_px: f64,
    guards: bool,
}

/// Those compiled so far.
pub(crate) struct MeshPipelines {
    sound: Soundness,
    compiled: BTreeMap<Key, wgpu::RenderPipeline>,
}

impl MeshPipelines {
    /// None yet.
    pub(crate) fn new(device: &Device, rules: &Rules) -> Self {
        let bias_px = if rules.bias { MESH_BIAS_PX } else { 0.0 };
        let sound = Soundness { bias_px, guards: rules.guard && device.needs_guard };
        Self { sound, compiled: BTreeMap::new() }
    }

    /// The pipeline of `key`.
    pub(crate) fn get(
        &mut self,
        device: &wgpu::Device,
        groups: Groups<'_>,
        key: Key,
    ) -> wgpu::RenderPipeline {
        let sound = self.sound;
        self.compiled.entry(key).or_insert_with(|| made(device, groups, key, sound)).clone()
    }
}

fn made(
    device: &wgpu::Device,
    groups: Groups<'_>,
    key: Key,
    sound: Soundness,
) -> wgpu::RenderPipeline {
    let of_patch = |fragment| (shaders::PROJECTED, fragment);
    let (source, fragment) = match (key.into, key.kind, key.layout) {
        (Into::Depth | Into::Count, _, Layout::Projected | Layout::ProjectedNormals) => {
            of_patch(sound.guards.then_some("fragment_guard"))
        }
        (Into::Picture, _, Layout::Projected | Layout::ProjectedNormals) => {
            of_patch(Some("fragment_main"))
        }
        (Into::Normals, _, Layout::Projected | Layout::ProjectedNormals) => {
            of_patch(Some("fragment_normal"))
        }
        (Into::Items, _, Layout::Projected | Layout::ProjectedNormals) => {
            of_patch(Some("fragment_items"))
        }
        (Into::Relit, ..) => of_patch(Some("fragment_relit")),
        (Into::Depth | Into::Count, ..) => {
            (shaders::DEPTH, sound.guards.then_some("fragment_guard"))
        }
        (Into::Picture, Kind::Mask, _) => (shaders::SHADE_MASK, Some("fragment_mask")),
        (Into::Picture, Kind::Opaque, Layout::Textured) => {
            (shaders::SHADE_TEXTURED, Some("fragment_main"))
        }
        (Into::Picture, Kind::Opaque, Layout::Plain) => (shaders::SHADE, Some("fragment_main")),
        (Into::Picture, Kind::Blend, Layout::Textured) => {
            (shaders::SHADE_TEXTURED, Some("fragment_blend"))
        }
        (Into::Picture, Kind::Blend, Layout::Plain) => (shaders::SHADE, Some("fragment_blend")),
        (Into::Normals, Kind::Mask, _) => (shaders::SHADE_MASK, Some("fragment_mask_normal")),
        (Into::Normals, _, Layout::Textured) => (shaders::SHADE_TEXTURED, Some("fragment_normal")),
        (Into::Normals, _, Layout::Plain) => (shaders::SHADE, Some("fragment_normal")),
        (Into::Items, Kind::Mask, _) => (shaders::ITEMS_MASK, Some("fragment_main")),
        (Into::Items, ..) => (shaders::ITEMS, Some("fragment_main")),
    };
    let target = match key.into {
        Into::Depth | Into::Count => None,
        Into::Picture | Into::Relit => Some(COLOR_FORMAT),
        Into::Normals => Some(NORMALS_FORMAT),
        Into::Items => Some(ITEMS_FORMAT),
    };
    let blends = key.kind == Kind::Blend;
    let writes = !blends && key.into != Into::Count;
    // The sky is opaque, and stays so under whatever is laid over it.
    let over = wgpu::BlendState {
        color: wgpu::BlendState::ALPHA_BLENDING.color,
        alpha: wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::Zero,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Add,
        },
    };
    let fields = match key.layout {
        Layout::Plain | Layout::Textured => Vertex::FIELDS,
        // The position alone.
        Layout::Projected | Layout::ProjectedNormals => &Vertex::FIELDS[..1],
    };
    let mut of_vertex = attributes(Vertex::FIRST_LOCATION, fields, 0);
    if key.reads() == Reads::Textures {
        let after = size_of::<Vertex>() as u64;
        of_vertex.extend(attributes(Texturing::FIRST_LOCATION, Texturing::FIELDS, after));
    }
    let of_instance = attributes(Instance::FIRST_LOCATION, Instance::FIELDS, 0);
    let buffers = [
        Some(wgpu::VertexBufferLayout {
            array_stride: key.layout.vertex_bytes() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &of_vertex,
        }),
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Instance>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &of_instance,
        }),
    ];
    let groups = match key.reads() {
        Reads::Nothing => &[Some(groups.frame)][..],
        Reads::Textures => &[Some(groups.frame), Some(groups.textures)],
        Reads::Picture => &[Some(groups.frame), Some(groups.words)],
    };
    let recipe = Recipe {
        label: &format!("{key:?}"),
        source: &shaders::for_meshes(source, sound.guards),
        vertex: if key.into == Into::Relit { "vertex_relit" } else { "vertex_main" },
        fragment,
        target: target.map(|format| wgpu::ColorTargetState {
            blend: (blends && key.into == Into::Picture).then_some(over),
            ..wgpu::ColorTargetState::from(format)
        }),
        groups,
        buffers: &buffers,
        cull: (key.faces != Faces::Both).then_some(wgpu::Face::Back),
        front: if key.faces == Faces::Clockwise { FrontFace::Cw } else { FrontFace::Ccw },
        depth_write: writes,
        bias_px: if key.layout.is_projected() { 0.0 } else { sound.bias_px },
        compare: CompareFunction::GreaterEqual,
    };
    compile(device, &recipe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_meshes_read_nothing() {
        for class in Class::ALL {
            for into in [Into::Depth, Into::Count, Into::Picture, Into::Normals, Into::Items] {
                let reads = Key::new(into, class, Layout::Plain, false).reads();
                let masked = into == Into::Items && class.is_mask();
                assert_eq!(reads, if masked { Reads::Textures } else { Reads::Nothing });
            }
            let reads = |into| Key::new(into, class, Layout::Textured, false).reads();
            assert_eq!(reads(Into::Picture), Reads::Textures);
            assert_eq!(reads(Into::Depth), Reads::Nothing);
        }
    }

    #[test]
    fn pictures_of_projected_blobs_alone_read_them() {
        for layout in [Layout::Projected, Layout::ProjectedNormals] {
            let reads = |into| Key::new(into, Class::OpaqueDouble, layout, false).reads();
            let others = [Into::Depth, Into::Items, Into::Normals].map(reads);
            assert_eq!(others, [Reads::Nothing; 3]);
            assert_eq!([Into::Picture, Into::Relit].map(reads), [Reads::Picture; 2]);
        }
    }

    #[test]
    fn only_what_has_normals_is_lit_again() {
        let key = |into, layout| Key::new(into, Class::OpaqueDouble, layout, false);
        for layout in [Layout::Plain, Layout::Textured, Layout::Projected] {
            assert_eq!(key(Into::Relit, layout), key(Into::Picture, layout));
        }
        let layout = Layout::ProjectedNormals;
        assert_ne!(key(Into::Relit, layout), key(Into::Picture, layout));
    }

    #[test]
    fn a_mirror_turns_single_sided_faces_alone() {
        for class in Class::ALL {
            let keys = [false, true]
                .map(|mirrored| Key::new(Into::Depth, class, Layout::Textured, mirrored));
            assert_eq!(keys[0] == keys[1], !class.is_single_sided(), "{class:?}");
        }
    }
}
