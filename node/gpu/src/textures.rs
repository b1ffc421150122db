//! Textures in device memory: all mips of all textures side by side on the pages of one array.

use crate::device::Device;
use protocol::format::texture::mip_bytes;
use scene::backend::{BackendError, LARGEST_STORED_SIDE, TextureUpload, stored_mips};
use shaders::mirror::TextureRecord;
use wgpu::BufferBindingType::Storage;

/// Side of a page.
const PAGE_SIDE: u32 = LARGEST_STORED_SIDE;
/// Uploads between two submissions, which free the staging memory behind them.
const STAGING_BYTES: u64 = 32 << 20;

/// The bind group of textured pipelines; nothing is made before the first.
pub(crate) struct Textures {
    layout: wgpu::BindGroupLayout,
    group: Option<wgpu::BindGroup>,
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
        let list = wgpu::BindingType::Buffer {
            ty: Storage { read_only: true },
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let pages = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: false },
            view_dimension: wgpu::TextureViewDimension::D2Array,
            multisampled: false,
        };
        let entries = [(0, list), (1, list), (2, pages)].map(entry);
        let layout = device.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("textures"),
            entries: &entries,
        });
        Self { layout, group: None }
    }

    /// Layout of group 1 of textured pipelines.
    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// Group 1 of textured pipelines.
    pub(crate) fn group(&mut self, device: &Device) -> &wgpu::BindGroup {
        let layout = &self.layout;
        self.group.get_or_insert_with(|| bind(device, layout, &[], &[], &pages(device, 1, 1)))
    }

    /// Copies all textures to the device, in place of any before.
    ///
    /// Errors: `Device` for bytes that are no texture, `Unsupported` for more pages than an array holds.
    pub(crate) fn upload(
        &mut self,
        device: &Device,
        textures: &[TextureUpload<'_>],
    ) -> Result<(), BackendError> {
        let mut records = Vec::with_capacity(textures.len());
        let mut sides = Vec::new();
        for (texture, bytes) in textures {
            let (side, [across, down], _) = stored_mips(texture, bytes)?;
            records.push(TextureRecord {
                first_place: sides.len() as u32,
                side,
                wrap_across: across as u32,
                wrap_down: down as u32,
            });
            sides.extend((0..=side.ilog2()).map(|mip| side >> mip));
        }
        let (places, count) = placed(&sides);
        let limit = device.limits.max_texture_array_layers.min(1 << 12);
        if count > limit {
            let reason = format!("{count} pages of textures; an array holds {limit}");
            return Err(device.unsupported(reason));
        }
        let pages = pages(device, PAGE_SIDE, count.max(1));
        let mut staged = 0;
        for (record, (texture, bytes)) in records.iter().zip(textures) {
            let (_, _, mips) = stored_mips(texture, bytes)?;
            let first = record.first_place as usize;
            write(device, &pages, record.side, &places[first..], mips);
            staged += mips.len() as u64;
            if staged >= STAGING_BYTES {
                device.queue.submit([]);
                staged = 0;
            }
        }
        let places: Vec<u32> = places.into_iter().map(Place::packed).collect();
        self.group = Some(bind(device, &self.layout, &records, &places, &pages));
        Ok(())
    }
}

/// Where a mip lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Place {
    x: u32,
    y: u32,
    page: u32,
}

impl Place {
    /// As the shaders read it.
    fn packed(self) -> u32 {
        self.x | self.y << 10 | self.page << 20
    }
}

/// Places for squares of these sides, powers of two up to a page's, and the number of pages.
///
/// Large ones go first, along the curve that fills a square quarter by quarter (Morton 1966): what lies
/// before each is then a multiple of its own area, so it finds a whole quarter, and none is wasted.
fn placed(sides: &[u32]) -> (Vec<Place>, u32) {
    let mut order: Vec<usize> = (0..sides.len()).collect();
    order.sort_by_key(|&index| std::cmp::Reverse(sides[index]));
    let mut places = vec![Place::default(); sides.len()];
    let page = u64::from(PAGE_SIDE).pow(2);
    let mut used = 0u64;
    for index in order {
        let within = used % page;
        let every_other_bit = |from: u32| {
            (0..PAGE_SIDE.ilog2()).fold(0, |sum, bit| sum | (within >> (2 * bit + from) & 1) << bit)
        };
        let [x, y] = [0, 1].map(|from| every_other_bit(from) as u32);
        places[index] = Place { x, y, page: (used / page) as u32 };
        used += u64::from(sides[index]).pow(2);
    }
    (places, used.div_ceil(page) as u32)
}

/// Writes all mips of one texture to their places.
fn write(device: &Device, pages: &wgpu::Texture, side: u32, places: &[Place], mips: &[u8]) {
    let mut rest = mips;
    for (mip, place) in (0..=side.ilog2()).zip(places) {
        let side = side >> mip;
        let (pixels, after) = rest.split_at((mip_bytes(side) - mip_bytes(side / 2)) as usize);
        rest = after;
        device.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: pages,
                mip_level: 0,
                origin: wgpu::Origin3d { x: place.x, y: place.y, z: place.page },
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

/// An array of so many pages.
fn pages(device: &Device, side: u32, count: u32) -> wgpu::Texture {
    device.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("textures"),
        size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: count },
        mip_level_count: 1,
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
    places: &[u32],
    pages: &wgpu::Texture,
) -> wgpu::BindGroup {
    let list = |label, bytes: &[u8]| {
        let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            // A binding is not empty.
            size: bytes.len().max(size_of::<TextureRecord>()) as u64,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        if !bytes.is_empty() {
            device.queue.write_buffer(&buffer, 0, bytes);
        }
        buffer
    };
    let records = list("texture records", bytemuck::cast_slice(records));
    let places = list("texture places", bytemuck::cast_slice(places));
    let view = pages.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    });
    let resources = [
        records.as_entire_binding(),
        places.as_entire_binding(),
        wgpu::BindingResource::TextureView(&view),
    ];
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn mips_fill_pages_without_overlap_or_gap() {
        assert_eq!(placed(&[]), (vec![], 0));
        assert_eq!(placed(&[PAGE_SIDE; 2]).1, 2);
        let chains = [1024, 1, 512, 64, 512, 2, 256, 1024];
        let sides: Vec<u32> = chains
            .iter()
            .flat_map(|side: &u32| (0..=side.ilog2()).map(move |m| side >> m))
            .collect();
        let (places, pages) = placed(&sides);
        let mut taken = HashSet::new();
        for (place, &side) in places.iter().zip(&sides) {
            assert!(place.x % side == 0 && place.y % side == 0, "{place:?} {side}");
            assert!(
                place.x + side <= PAGE_SIDE && place.y + side <= PAGE_SIDE && place.page < pages
            );
            for y in place.y..place.y + side {
                assert!((place.x..place.x + side).all(|x| taken.insert((x, y, place.page))));
            }
        }
        assert_eq!(taken.len().div_ceil(PAGE_SIDE.pow(2) as usize), pages as usize);
    }

    #[test]
    fn a_place_keeps_its_parts_apart() {
        let last = Place { x: 1023, y: 1023, page: 4095 };
        assert_eq!(last.packed(), u32::MAX);
        assert_eq!(Place { x: 1, y: 2, page: 3 }.packed(), 1 | 2 << 10 | 3 << 20);
    }
}
