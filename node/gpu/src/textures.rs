//! Textures in device memory: all mips of all that are there, side by side on the pages of one array.
//!
//! The array is made once, as large as the room that was set apart; textures come and go in it. A list says
//! where the mips of each lie; an entry of one that is gone says anything, and no mesh that names it is drawn.

use crate::device::Device;
use crate::squares::{Place, Squares};
use crate::staging::Staging;
use protocol::format::Texture;
use protocol::format::texture::mip_bytes;
use scene::backend::{
    BackendError, Upload, list_bytes, page_side, stored_bytes, stored_mips, stored_shape,
    texture_room,
};
use shaders::mirror::TextureRecord;
use wgpu::BufferBindingType::Storage;

/// The bind group of textured pipelines; nothing is made before the first.
pub(crate) struct Textures {
    layout: wgpu::BindGroupLayout,
    /// Stands where no texture is declared and yet one might be read.
    nothing: Option<wgpu::BindGroup>,
    declared: Option<Declared>,
}

/// All textures of a scene, of which some are there.
struct Declared {
    textures: Vec<Texture>,
    records: Vec<TextureRecord>,
    pages: wgpu::Texture,
    places: wgpu::Buffer,
    group: wgpu::BindGroup,
    bytes: u64,
    free: Squares,
    /// By index, where the mips of a texture that is there begin on the curve of [`Squares`].
    held: Vec<Option<Vec<u64>>>,
}

/// What textures that are to be declared will take.
pub(crate) struct Arranged {
    records: Vec<TextureRecord>,
    /// Mips of all of them.
    places: usize,
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
        Self { layout, nothing: None, declared: None }
    }

    /// Layout of group 1 of textured pipelines.
    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// Group 1 of textured pipelines.
    pub(crate) fn group(&mut self, device: &Device) -> &wgpu::BindGroup {
        let Self { layout, nothing, declared } = self;
        match declared {
            Some(declared) => &declared.group,
            None => nothing.get_or_insert_with(|| {
                let [records, places] = ["texture records", "texture places"]
                    .map(|label| list(device, label, buffer_bytes(0), &[]));
                bind(device, layout, &records, &places, &pages(device, 1, 1))
            }),
        }
    }

    /// Bytes of the pages and the lists.
    pub(crate) fn held_bytes(&self) -> u64 {
        self.declared.as_ref().map_or(0, |declared| declared.bytes)
    }

    /// Makes empty pages for textures, which are so arranged, in place of any before: those are gone from
    /// the device's memory when the new ones come.
    ///
    /// Errors: `Device`.
    pub(crate) fn declare(
        &mut self,
        device: &Device,
        textures: &[Texture],
        arranged: Arranged,
    ) -> Result<(), BackendError> {
        if self.declared.take().is_some() {
            // Writes that were not submitted use them, too.
            device.queue.submit([]);
            device.wait_for(None)?;
        }
        if textures.is_empty() {
            return Ok(());
        }
        let bytes = arranged.bytes();
        let Arranged { records, places, page_side, pages: count } = arranged;
        let places_bytes = buffer_bytes(size_of::<u32>() * places);
        let places = list(device, "texture places", places_bytes, &[]);
        let content = bytemuck::cast_slice(&records);
        let list = list(device, "texture records", buffer_bytes(content.len()), content);
        let pages = pages(device, page_side, count.max(1));
        self.declared = Some(Declared {
            group: bind(device, &self.layout, &list, &places, &pages),
            textures: textures.to_vec(),
            held: vec![None; records.len()],
            records,
            pages,
            places,
            bytes,
            free: Squares::new(page_side, count),
        });
        Ok(())
    }

    /// Copies a texture to the device, unless it is there.
    ///
    /// Errors: `Device`, also for bytes that are no texture.
    pub(crate) fn upload(
        &mut self,
        device: &Device,
        staging: &mut Staging,
        index: u32,
        bytes: &[u8],
    ) -> Result<Upload, BackendError> {
        let declared = self.declared.as_mut().expect("a texture is declared before it comes");
        let Declared { textures, records, pages, places, free, held, .. } = declared;
        let (_, _, mips) = stored_mips(&textures[index as usize], bytes)?;
        let held = &mut held[index as usize];
        if held.is_some() {
            return Ok(Upload::Done);
        }
        let TextureRecord { first_place, side, .. } = records[index as usize];
        let mut taken = Vec::new();
        for mip in sides(side) {
            match free.take(mip) {
                Some(at) => taken.push(at),
                None => {
                    give_back(free, side, &taken);
                    return Ok(Upload::Full);
                }
            }
        }
        let at: Vec<Place> = taken.iter().map(|&at| free.place(at)).collect();
        let packed: Vec<u32> = at.iter().map(|place| place.packed()).collect();
        let start = u64::from(first_place) * size_of::<u32>() as u64;
        device.queue.write_buffer(places, start, bytemuck::cast_slice(&packed));
        write(device, pages, side, &at, mips);
        staging.wrote(device, mips.len() as u64)?;
        *held = Some(taken);
        Ok(Upload::Done)
    }

    /// Frees the places of a texture; nothing happens if it is not there. What is written there from now on
    /// comes after the work that was submitted.
    pub(crate) fn evict(&mut self, index: u32) {
        let Some(declared) = &mut self.declared else { return };
        if let Some(taken) = declared.held[index as usize].take() {
            give_back(&mut declared.free, declared.records[index as usize].side, &taken);
        }
    }
}

/// Sides of the mips of a texture, the largest first.
fn sides(side: u32) -> impl Iterator<Item = u32> {
    (0..=side.ilog2()).map(move |mip| side >> mip)
}

fn give_back(free: &mut Squares, side: u32, taken: &[u64]) {
    taken.iter().zip(sides(side)).for_each(|(&at, side)| free.give_back(at, side));
}

impl Arranged {
    /// As many pages as all of them need, and as fit `room` bytes and the device's arrays.
    ///
    /// Errors: `Device` for records that no texture has.
    pub(crate) fn new(
        device: &Device,
        textures: &[Texture],
        room: u64,
    ) -> Result<Self, BackendError> {
        let mut records = Vec::with_capacity(textures.len());
        let mut places = 0;
        for texture in textures {
            let (side, [across, down]) = stored_shape(texture)?;
            records.push(TextureRecord {
                first_place: places as u32,
                side,
                wrap_across: across as u32,
                wrap_down: down as u32,
            });
            places += sides(side).count();
        }
        let page_side = page_side(textures);
        let page = u64::from(page_side).pow(2) * 4;
        let all = texture_room(textures, textures.iter().map(stored_bytes).sum());
        let pages = all.min(room).saturating_sub(list_bytes(textures)) / page;
        let limit = device.limits.max_texture_array_layers.min(1 << 12);
        Ok(Self { records, places, page_side, pages: pages.min(u64::from(limit)) as u32 })
    }

    /// Bytes of the pages and the lists.
    pub(crate) fn bytes(&self) -> u64 {
        if self.records.is_empty() {
            return 0;
        }
        buffer_bytes(size_of_val(&self.records[..]))
            + buffer_bytes(size_of::<u32>() * self.places)
            + u64::from(self.pages.max(1)) * u64::from(self.page_side).pow(2) * 4
    }
}

/// Bytes of the buffer for a list; a binding is not empty.
fn buffer_bytes(list: usize) -> u64 {
    list.max(size_of::<TextureRecord>()) as u64
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

/// A buffer of so many bytes that begins with `content`.
fn list(device: &Device, label: &str, bytes: u64, content: &[u8]) -> wgpu::Buffer {
    let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    if !content.is_empty() {
        device.queue.write_buffer(&buffer, 0, content);
    }
    buffer
}

fn bind(
    device: &Device,
    layout: &wgpu::BindGroupLayout,
    records: &wgpu::Buffer,
    places: &wgpu::Buffer,
    pages: &wgpu::Texture,
) -> wgpu::BindGroup {
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
