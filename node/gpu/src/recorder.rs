//! Recording one render pass of mesh draws.

use crate::device::Device;
use crate::draws::{self, Call};
use crate::geometry_memory::GeometryMemory;
use crate::mesh_pipelines::{Groups, Key, MeshPipelines, Reads};
use crate::pipelines::Pipelines;
use crate::targets::Target;
use crate::textures::Textures;

/// What draw calls refer to.
pub(crate) struct Recorder<'a> {
    pub(crate) device: &'a Device,
    pub(crate) pipelines: &'a Pipelines,
    pub(crate) memory: &'a GeometryMemory,
    pub(crate) meshes: &'a mut MeshPipelines,
    pub(crate) textures: &'a mut Textures,
    /// None where nothing is drawn.
    pub(crate) instances: Option<&'a wgpu::Buffer>,
}

impl Recorder<'_> {
    /// Draws the calls in their order into a colour target, with what it starts with, and a depth.
    pub(crate) fn pass(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        color: Option<(&Target, wgpu::LoadOp<wgpu::Color>)>,
        depth: wgpu::RenderPassDepthStencilAttachment<'_>,
        calls: &[(Key, Call<'_>)],
    ) {
        let pipelines = self.pipelines_of(calls);
        let color = color.map(|(target, load)| {
            Some(wgpu::RenderPassColorAttachment {
                view: &target.view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
            })
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("draws"),
            color_attachments: color.as_slice(),
            depth_stencil_attachment: Some(depth),
            ..Default::default()
        });
        let Some(instances) = self.instances else { return };
        pass.set_bind_group(0, &self.pipelines.frame_group, &[]);
        let reads_textures = calls.iter().any(|(key, _)| key.reads() == Reads::Textures);
        let textures = reads_textures.then(|| self.textures.group(self.device));
        pass.set_vertex_buffer(1, instances.slice(..));
        draws::record(&mut pass, self.memory, textures, pipelines.iter().zip(calls));
    }

    /// The pipeline of each call; neighbours mostly share theirs.
    pub(crate) fn pipelines_of(&mut self, calls: &[(Key, Call<'_>)]) -> Vec<wgpu::RenderPipeline> {
        let groups = Groups {
            frame: &self.pipelines.frame_group_layout,
            textures: self.textures.layout(),
            words: self.memory.words_layout(),
        };
        let mut found: Vec<wgpu::RenderPipeline> = Vec::with_capacity(calls.len());
        for (at, (key, _)) in calls.iter().enumerate() {
            found.push(match found.last() {
                Some(last) if calls[at - 1].0 == *key => last.clone(),
                _ => self.meshes.get(&self.device.device, groups, *key),
            });
        }
        found
    }
}
