//! What passes draw into, for one picture size.

use crate::device::Device;
use protocol::settings::PictureSize;
use scene::backend::BackendError;
use std::cell::OnceCell;
use wgpu::{TextureFormat, TextureUsages};

/// Depth, everywhere.
pub(crate) const DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32Float;
/// The picture.
pub(crate) const COLOR_FORMAT: TextureFormat = TextureFormat::Rgba8UnormSrgb;
/// Normals, whose codes are stored as they are.
pub(crate) const NORMALS_FORMAT: TextureFormat = TextureFormat::Rgba8Unorm;
/// Item ids.
pub(crate) const ITEMS_FORMAT: TextureFormat = TextureFormat::R32Uint;

/// Depth starts at infinity.
pub(crate) const NOTHING_IN_FRONT: wgpu::LoadOp<f32> = wgpu::LoadOp::Clear(0.0);

/// A texture and its only view.
pub(crate) struct Target {
    pub(crate) texture: wgpu::Texture,
    pub(crate) view: wgpu::TextureView,
}

/// All targets; those of a role that a process never takes are never made.
pub(crate) struct Targets {
    pub(crate) size: PictureSize,
    /// Made by occluder passes, tested by box passes; cleared to "nothing in front" at first.
    pub(crate) occlusion: Target,
    depth: OnceCell<Target>,
    color: OnceCell<Target>,
    normals: OnceCell<Target>,
    items: OnceCell<Target>,
    blended: OnceCell<Target>,
}

impl Targets {
    /// Targets of a size.
    ///
    /// Errors: `Unsupported` for an empty picture or one beyond the adapter's limits.
    pub(crate) fn new(device: &Device, size: PictureSize) -> Result<Self, BackendError> {
        let PictureSize { width, height } = size;
        let limit = device.limits.max_texture_dimension_2d;
        if width == 0 || height == 0 || width > limit || height > limit {
            return Err(device.unsupported(format!(
                "a picture of {width}x{height}; each side may have 1 to {limit} pixels"
            )));
        }
        let occlusion = target(device, size, DEPTH_FORMAT, TextureUsages::empty());
        clear(device, &occlusion);
        Ok(Self {
            size,
            occlusion,
            depth: OnceCell::new(),
            color: OnceCell::new(),
            normals: OnceCell::new(),
            items: OnceCell::new(),
            blended: OnceCell::new(),
        })
    }

    /// Depth of pictures and item buffers.
    pub(crate) fn depth(&self, device: &Device) -> &Target {
        self.lazy(&self.depth, device, DEPTH_FORMAT)
    }

    /// The picture.
    pub(crate) fn color(&self, device: &Device) -> &Target {
        self.lazy(&self.color, device, COLOR_FORMAT)
    }

    /// Normals.
    pub(crate) fn normals(&self, device: &Device) -> &Target {
        self.lazy(&self.normals, device, NORMALS_FORMAT)
    }

    /// Item ids.
    pub(crate) fn items(&self, device: &Device) -> &Target {
        self.lazy(&self.items, device, ITEMS_FORMAT)
    }

    /// Item ids of what blends.
    pub(crate) fn blended(&self, device: &Device) -> &Target {
        self.lazy(&self.blended, device, ITEMS_FORMAT)
    }

    fn lazy<'a>(
        &'a self,
        cell: &'a OnceCell<Target>,
        device: &Device,
        format: TextureFormat,
    ) -> &'a Target {
        cell.get_or_init(|| target(device, self.size, format, TextureUsages::COPY_SRC))
    }
}

fn target(
    device: &Device,
    size: PictureSize,
    format: TextureFormat,
    usage: TextureUsages,
) -> Target {
    let texture = device.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: extent(size),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: usage | TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    Target { texture, view }
}

/// The size as wgpu writes it.
pub(crate) fn extent(size: PictureSize) -> wgpu::Extent3d {
    wgpu::Extent3d { width: size.width, height: size.height, depth_or_array_layers: 1 }
}

/// Depth that is written and kept; `load` is what it starts with.
pub(crate) fn written_depth(
    target: &Target,
    load: wgpu::LoadOp<f32>,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view: &target.view,
        depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
        stencil_ops: None,
    }
}

/// Depth that is only read.
pub(crate) fn read_depth(target: &Target) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view: &target.view,
        depth_ops: None,
        stencil_ops: None,
    }
}

/// Boxes may be tested before the first occluder pass; all are visible then.
fn clear(device: &Device, depth: &Target) {
    let mut encoder = device.device.create_command_encoder(&Default::default());
    drop(encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        depth_stencil_attachment: Some(written_depth(depth, NOTHING_IN_FRONT)),
        ..Default::default()
    }));
    device.queue.submit([encoder.finish()]);
}
