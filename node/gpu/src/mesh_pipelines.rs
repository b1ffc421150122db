//! Pipelines that draw meshes: one a pass, class, vertex layout and turn, compiled at first need.
//!
//! What a scene does not hold costs nothing: no pipeline of a scene without textures binds one, and only
//! what has holes gives up the early depth test. On drivers that need the guard all do.

use crate::device::Device;
use crate::pipelines::{Recipe, attributes, compile};
use crate::targets::{COLOR_FORMAT, ITEMS_FORMAT};
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
    /// Colour and depth.
    Picture,
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
    textured: bool,
}

impl Key {
    /// For triangles of a class. `mirrored`: the placement turns corners the other way.
    pub(crate) fn new(into: Into, class: Class, textured: bool, mirrored: bool) -> Self {
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
        Self { into, kind, faces, textured }
    }

    /// Its shader reads textures.
    pub(crate) fn binds_textures(self) -> bool {
        match self.into {
            Into::Depth => false,
            Into::Picture => self.textured,
            Into::Items => self.kind == Kind::Mask,
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

    /// The pipeline of `key`. `groups`: the layouts of the uniform's group and of the textures'.
    pub(crate) fn get(
        &mut self,
        device: &wgpu::Device,
        groups: [&wgpu::BindGroupLayout; 2],
        key: Key,
    ) -> wgpu::RenderPipeline {
        let sound = self.sound;
        self.compiled.entry(key).or_insert_with(|| made(device, groups, key, sound)).clone()
    }
}

fn made(
    device: &wgpu::Device,
    groups: [&wgpu::BindGroupLayout; 2],
    key: Key,
    sound: Soundness,
) -> wgpu::RenderPipeline {
    let (source, fragment) = match (key.into, key.kind, key.textured) {
        (Into::Depth, ..) => (shaders::DEPTH, sound.guards.then_some("fragment_guard")),
        (Into::Picture, Kind::Mask, _) => (shaders::SHADE_MASK, Some("fragment_mask")),
        (Into::Picture, Kind::Opaque, true) => (shaders::SHADE_TEXTURED, Some("fragment_main")),
        (Into::Picture, Kind::Opaque, false) => (shaders::SHADE, Some("fragment_main")),
        (Into::Picture, Kind::Blend, true) => (shaders::SHADE_TEXTURED, Some("fragment_blend")),
        (Into::Picture, Kind::Blend, false) => (shaders::SHADE, Some("fragment_blend")),
        (Into::Items, Kind::Mask, _) => (shaders::ITEMS_MASK, Some("fragment_main")),
        (Into::Items, ..) => (shaders::ITEMS, Some("fragment_main")),
    };
    let target = match key.into {
        Into::Depth => None,
        Into::Picture => Some(COLOR_FORMAT),
        Into::Items => Some(ITEMS_FORMAT),
    };
    let blends = key.kind == Kind::Blend;
    // The sky is opaque, and stays so under whatever is laid over it.
    let over = wgpu::BlendState {
        color: wgpu::BlendState::ALPHA_BLENDING.color,
        alpha: wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::Zero,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Add,
        },
    };
    let layout = if key.textured { Layout::Textured } else { Layout::Plain };
    let mut of_vertex = attributes(Vertex::FIRST_LOCATION, Vertex::FIELDS, 0);
    if key.binds_textures() {
        let after = size_of::<Vertex>() as u64;
        of_vertex.extend(attributes(Texturing::FIRST_LOCATION, Texturing::FIELDS, after));
    }
    let of_instance = attributes(Instance::FIRST_LOCATION, Instance::FIELDS, 0);
    let buffers = [
        Some(wgpu::VertexBufferLayout {
            array_stride: layout.vertex_bytes() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &of_vertex,
        }),
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Instance>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &of_instance,
        }),
    ];
    let [frame, textures] = groups.map(Some);
    let both = [frame, textures];
    let recipe = Recipe {
        label: &format!("{key:?}"),
        source: &shaders::for_meshes(source, sound.guards),
        vertex: "vertex_main",
        fragment,
        target: target.map(|format| wgpu::ColorTargetState {
            blend: (blends && key.into == Into::Picture).then_some(over),
            ..wgpu::ColorTargetState::from(format)
        }),
        groups: if key.binds_textures() { &both } else { &both[..1] },
        buffers: &buffers,
        cull: (key.faces != Faces::Both).then_some(wgpu::Face::Back),
        front: if key.faces == Faces::Clockwise { FrontFace::Cw } else { FrontFace::Ccw },
        depth_write: !blends,
        bias_px: sound.bias_px,
        compare: CompareFunction::GreaterEqual,
    };
    compile(device, &recipe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_meshes_bind_no_texture() {
        for class in Class::ALL {
            for into in [Into::Depth, Into::Picture, Into::Items] {
                let bound = Key::new(into, class, false, false).binds_textures();
                assert_eq!(bound, into == Into::Items && class.is_mask());
            }
            assert!(Key::new(Into::Picture, class, true, false).binds_textures());
            assert!(!Key::new(Into::Depth, class, true, false).binds_textures());
        }
    }

    #[test]
    fn a_mirror_turns_single_sided_faces_alone() {
        for class in Class::ALL {
            let keys = [false, true].map(|mirrored| Key::new(Into::Depth, class, true, mirrored));
            assert_eq!(keys[0] == keys[1], !class.is_single_sided(), "{class:?}");
        }
    }
}
