//! Textures in device memory: one array a side, and where in them each texture lies.

use crate::device::Device;
use crate::staging::Staging;
use protocol::format::texture::mip_bytes;
use scene::backend::{BackendError, LARGEST_STORED_SIDE, TextureUpload, stored_mips};
use shaders::mirror::TextureRecord;

/// Side of the first array, and of each further one twice that of the one before. Smaller textures lie
/// in the lower mips of the first.
const FIRST_SIDE: u32 = 16;
const ARRAYS: usize = (LARGEST_STORED_SIDE / FIRST_SIDE).ilog2() as usize + 1;

/// The bind group of textured pipelines; nothing is made before the first.
pub(crate) struct Textures {
    layout: wgpu::BindGroupLayout,
    group: Option<wgpu::BindGroup>,
    /// Of what was uploaded.
    bytes: u64,
}

/// Where textures will lie.
pub(crate) struct Arranged {
    records: Vec<TextureRecord>,
    /// Of each array.
    layers: [u32; ARRAYS],
}

impl Textures {
    /// None yet.
    pub(crate) fn new(device: &Device) -> Self {
        let entry = |(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let records = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only: true },
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let array = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: false },
            view_dimension: wgpu::TextureViewDimension::D2Array,
            multisampled: false,
        };
        let types = std::iter::once(records).chain([array; ARRAYS]);
        let entries: Vec<_> = (0..).zip(types).map(entry).collect();
        let layout = device.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("textures"),
            entries: &entries,
        });
        Self { layout, group: None, bytes: 0 }
    }

    /// Layout of group 1 of textured pipelines.
    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// Group 1 of textured pipelines.
    pub(crate) fn group(&mut self, device: &Device) -> &wgpu::BindGroup {
        let layout = &self.layout;
        self.group.get_or_insert_with(|| {
            let arrays = [0; ARRAYS].map(|_| array(device, 1, 1));
            bind(device, layout, &[], &arrays)
        })
    }

    /// Bytes of what was uploaded.
    pub(crate) fn held_bytes(&self) -> u64 {
        self.bytes
    }

    /// Copies all textures, which are so arranged, to the device, in place of any before: those are gone
    /// from its memory when the first of these comes.
    ///
    /// Errors: `Device`.
    pub(crate) fn upload(
        &mut self,
        device: &Device,
        staging: &mut Staging,
        arranged: Arranged,
        textures: &[TextureUpload<'_>],
    ) -> Result<(), BackendError> {
        if self.group.take().is_some() {
            device.wait_for(None)?;
        }
        self.bytes = arranged.bytes();
        let arrays: [wgpu::Texture; ARRAYS] =
            std::array::from_fn(|i| array(device, arranged.side(i), arranged.layers[i].max(1)));
        for (record, (texture, bytes)) in arranged.records.iter().zip(textures) {
            let (_, _, mips) = stored_mips(texture, bytes)?;
            write(device, &arrays[record.array as usize], record, mips);
            staging.wrote(device, mips.len() as u64)?;
        }
        self.group = Some(bind(device, &self.layout, &arranged.records, &arrays));
        Ok(())
    }
}

impl Arranged {
    /// Finds a place for each.
    ///
    /// Errors: `Device` for bytes that are no texture, `Unsupported` for more than an array holds.
    pub(crate) fn new(
        device: &Device,
        textures: &[TextureUpload<'_>],
    ) -> Result<Self, BackendError> {
        let mut records = Vec::with_capacity(textures.len());
        let mut layers = [0u32; ARRAYS];
        for (texture, bytes) in textures {
            let (side, [across, down], _) = stored_mips(texture, bytes)?;
            let array = side.max(FIRST_SIDE) / FIRST_SIDE;
            let array = array.ilog2();
            let layer = &mut layers[array as usize];
            records.push(TextureRecord {
                array,
                layer: *layer,
                first_level: ((FIRST_SIDE << array) / side).ilog2(),
                side,
                wrap_across: across as u32,
                wrap_down: down as u32,
            });
            *layer += 1;
        }
        let limit = device.limits.max_texture_array_layers;
        if let Some((array, count)) = layers.iter().enumerate().find(|&(_, &count)| count > limit) {
            let side = FIRST_SIDE << array;
            let reason = format!("{count} textures of side {side}; an array holds {limit}");
            return Err(device.unsupported(reason));
        }
        Ok(Self { records, layers })
    }

    /// Bytes of the arrays and the records.
    pub(crate) fn bytes(&self) -> u64 {
        let array = |i: usize| u64::from(self.layers[i].max(1)) * mip_bytes(self.side(i));
        record_bytes(&self.records) + (0..ARRAYS).map(array).sum::<u64>()
    }

    /// Side of an array; one without a texture has a pixel, for something must be bound.
    fn side(&self, array: usize) -> u32 {
        if self.layers[array] == 0 { 1 } else { FIRST_SIDE << array }
    }
}

/// Bytes of the buffer for these; a binding is not empty.
fn record_bytes(records: &[TextureRecord]) -> u64 {
    size_of_val(records).max(size_of::<TextureRecord>()) as u64
}

/// Writes all mips of one texture.
fn write(device: &Device, array: &wgpu::Texture, record: &TextureRecord, mips: &[u8]) {
    let mut rest = mips;
    for mip in 0..=record.side.ilog2() {
        let side = record.side >> mip;
        let (pixels, after) = rest.split_at((mip_bytes(side) - mip_bytes(side / 2)) as usize);
        rest = after;
        device.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: array,
                mip_level: record.first_level + mip,
                origin: wgpu::Origin3d { x: 0, y: 0, z: record.layer },
                aspect: wgpu::TextureAspect::All,
            },
            pixels,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(4 * side),
                rows_per_image: Some(side),
            },
            wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 },
        );
    }
}

/// An array of so many textures with all their mips.
fn array(device: &Device, side: u32, layers: u32) -> wgpu::Texture {
    device.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("textures"),
        size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: layers },
        mip_level_count: side.ilog2() + 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        // Decodes before the shader filters.
        format: wgpu::TextureFormat::Rgba8UnormSrgb,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

fn bind(
    device: &Device,
    layout: &wgpu::BindGroupLayout,
    records: &[TextureRecord],
    arrays: &[wgpu::Texture; ARRAYS],
) -> wgpu::BindGroup {
    let bytes = bytemuck::cast_slice(records);
    let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("texture records"),
        size: record_bytes(records),
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    if !bytes.is_empty() {
        device.queue.write_buffer(&buffer, 0, bytes);
    }
    let views = arrays.each_ref().map(|array| {
        array.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        })
    });
    let views = views.iter().map(wgpu::BindingResource::TextureView);
    let resources = std::iter::once(buffer.as_entire_binding()).chain(views);
    let entries: Vec<_> = (0..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
        .collect();
    device.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("textures"),
        layout,
        entries: &entries,
    })
}
