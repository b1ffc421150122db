//! Textures in device memory: all mips of all textures side by side on the pages of one array.

use crate::device::Device;
use crate::staging::Staging;
use protocol::format::texture::mip_bytes;
use scene::backend::{BackendError, LARGEST_STORED_SIDE, TextureUpload, stored_mips};
use shaders::mirror::TextureRecord;
use wgpu::BufferBindingType::Storage;

/// Pages are as small as the largest texture lets them be, so that little of the last is left empty, but
/// not so many as this.
const MANY_PAGES: u64 = 256;

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
    /// Of all mips of all of them.
    places: Vec<Place>,
    page_side: u32,
    pages: u32,
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
        Self { layout, group: None, bytes: 0 }
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
        let pages = pages(device, arranged.page_side, arranged.pages);
        for (record, (texture, bytes)) in arranged.records.iter().zip(textures) {
            let (_, _, mips) = stored_mips(texture, bytes)?;
            write(
                device,
                &pages,
                record.side,
                &arranged.places[record.first_place as usize..],
                mips,
            );
            staging.wrote(device, mips.len() as u64)?;
        }
        let places: Vec<u32> = arranged.places.iter().map(|place| place.packed()).collect();
        self.group = Some(bind(device, &self.layout, &arranged.records, &places, &pages));
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
        let page_side = page_side(&sides);
        let (places, count) = placed(&sides, page_side);
        let limit = device.limits.max_texture_array_layers.min(1 << 12);
        if count > limit {
            let reason = format!("{count} pages of textures; an array holds {limit}");
            return Err(device.unsupported(reason));
        }
        Ok(Self { records, places, page_side, pages: count.max(1) })
    }

    /// Bytes of the pages and the lists.
    pub(crate) fn bytes(&self) -> u64 {
        buffer_bytes(size_of_val(&self.records[..]))
            + buffer_bytes(size_of::<u32>() * self.places.len())
            + u64::from(self.pages) * u64::from(self.page_side).pow(2) * 4
    }
}

/// Bytes of the buffer for a list; a binding is not empty.
fn buffer_bytes(list: usize) -> u64 {
    list.max(size_of::<TextureRecord>()) as u64
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

/// Side of the pages for squares of these sides.
fn page_side(sides: &[u32]) -> u32 {
    let area: u64 = sides.iter().map(|&side| u64::from(side).pow(2)).sum();
    let mut page = sides.iter().copied().max().unwrap_or(1);
    while page < LARGEST_STORED_SIDE && area.div_ceil(u64::from(page).pow(2)) > MANY_PAGES {
        page *= 2;
    }
    page
}

/// Places for squares of these sides, powers of two up to a page's, and the number of pages.
///
/// Large ones go first, along the curve that fills a square quarter by quarter (Morton 1966): what lies
/// before each is then a multiple of its own area, so it finds a whole quarter, and none is wasted.
fn placed(sides: &[u32], page_side: u32) -> (Vec<Place>, u32) {
    let mut order: Vec<usize> = (0..sides.len()).collect();
    order.sort_by_key(|&index| std::cmp::Reverse(sides[index]));
    let mut places = vec![Place::default(); sides.len()];
    let page = u64::from(page_side).pow(2);
    let mut used = 0u64;
    for index in order {
        let within = used % page;
        let every_other_bit = |from: u32| {
            (0..page_side.ilog2()).fold(0, |sum, bit| sum | (within >> (2 * bit + from) & 1) << bit)
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
            size: buffer_bytes(bytes.len()),
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
        assert_eq!((placed(&[], 1), page_side(&[])), ((vec![], 0), 1));
        assert_eq!((placed(&[64; 2], 64).1, page_side(&[64, 64, 32])), (2, 64));
        assert_eq!((page_side(&[64; 257]), page_side(&[1024; 999])), (128, 1024));
        let chains = [1024, 1, 512, 64, 512, 2, 256, 1024];
        let sides: Vec<u32> = chains
            .iter()
            .flat_map(|side: &u32| (0..=side.ilog2()).map(move |m| side >> m))
            .collect();
        let page_side = page_side(&sides);
        let (places, pages) = placed(&sides, page_side);
        let mut taken = HashSet::new();
        for (place, &side) in places.iter().zip(&sides) {
            assert!(place.x % side == 0 && place.y % side == 0, "{place:?} {side}");
            assert!(
                place.x + side <= page_side && place.y + side <= page_side && place.page < pages
            );
            for y in place.y..place.y + side {
                assert!((place.x..place.x + side).all(|x| taken.insert((x, y, place.page))));
            }
        }
        assert_eq!(taken.len().div_ceil(page_side.pow(2) as usize), pages as usize);
    }

    #[test]
    fn a_place_keeps_its_parts_apart() {
        let last = Place { x: 1023, y: 1023, page: 4095 };
        assert_eq!(last.packed(), u32::MAX);
        assert_eq!(Place { x: 1, y: 2, page: 3 }.packed(), 1 | 2 << 10 | 3 << 20);
    }
}
