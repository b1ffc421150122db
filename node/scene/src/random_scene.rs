//! Seeded scenes for tests: a complete tree over small meshes of the kinds that are hard to cull,
//! of all classes, some textured.

use crate::backend::cpu::CpuBackend;
use crate::backend::{Backend, Upload, upload_textures};
use crate::occludee::Rules;
use bytemuck::Zeroable;
use geometry::bounds::Aabb;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::mesh::vertices_of;
use protocol::format::texture::mips;
use protocol::format::vertex::Layout;
use protocol::format::{
    Blob, Class, Hlod, Level, NONE, Part, SceneInfo, Skeleton, Texture, TexturedVertex, Transform,
    Vertex, Wrap,
};
use protocol::id::BlobId;
use protocol::settings::PictureSize;
use rand::{Rng, SeedableRng, rngs::StdRng};

/// Children of an inner hlod.
const FANOUT: usize = 4;
/// Grid steps along a mesh.
const GRID: u32 = 1 << 12;

/// A skeleton with its geometry.
pub(crate) struct RandomScene {
    pub(crate) skeleton: Skeleton,
    blob_bytes: Vec<Vec<u8>>,
    textures: Vec<(Texture, Vec<u8>)>,
    pub(crate) rng: StdRng,
    pub(crate) scale: f64,
}

impl RandomScene {
    /// A scene some `scale` across, with `FANOUT^depth` leaves. All coordinates are multiples of
    /// `scale * 2^-20`, `scale` being a power of two.
    pub(crate) fn new(seed: u64, depth: u32, scale: f64) -> Self {
        let info = SceneInfo::zeroed();
        let skeleton = Skeleton {
            info,
            hlods: vec![],
            levels: vec![],
            parts: vec![],
            blobs: vec![],
            transforms: vec![],
            textures: vec![],
            texture_lists: vec![],
            view_cells: vec![],
            cubes: vec![],
        };
        let mut rng = StdRng::seed_from_u64(seed);
        let textures = [8, 32].map(|side| texture(&mut rng, side)).into();
        let mut scene = Self { skeleton, blob_bytes: vec![], textures, rng, scale };
        let inner = (FANOUT.pow(depth) - 1) / (FANOUT - 1);
        let count = inner + FANOUT.pow(depth);
        scene.skeleton.hlods = (0..count)
            .map(|id| Hlod {
                parent: if id == 0 { NONE } else { ((id - 1) / FANOUT) as u32 },
                first_child: if id < inner { (id * FANOUT + 1) as u32 } else { 0 },
                child_count: if id < inner { FANOUT as u32 } else { 0 },
                object: NONE,
                ..Hlod::zeroed()
            })
            .collect();
        for id in (0..count).rev() {
            if id < inner { scene.stand_in(id) } else { scene.leaf(id) }
        }
        scene
    }

    /// A backend that holds all meshes.
    pub(crate) fn backend(&self, size: PictureSize, rules: &Rules) -> CpuBackend {
        let mut backend = CpuBackend::with_rules(size, rules);
        let textures: Vec<_> = self.textures.iter().map(|(t, bytes)| (*t, &bytes[..])).collect();
        assert_eq!(upload_textures(&mut backend, &textures).unwrap(), Upload::Done);
        for (id, (blob, bytes)) in self.skeleton.blobs.iter().zip(&self.blob_bytes).enumerate() {
            let upload = backend.upload(BlobId(id as u32), blob, bytes).unwrap();
            assert_eq!(upload, Upload::Done);
        }
        backend
    }

    /// A camera in or around the scene, often inside a box.
    pub(crate) fn camera(&mut self) -> Camera {
        let (rng, scale) = (&mut self.rng, self.scale);
        let mut point = |reach: f64| -> [f64; 3] {
            std::array::from_fn(|_| rng.random_range(-reach..reach) * scale)
        };
        let (eye, target) = (point(0.8), point(0.4));
        let up = if self.rng.random() { [0.0, 1.0, 0.0] } else { [0.3, 0.2, 0.9] };
        let near = self.scale * 10f64.powf(self.rng.random_range(-4.0..-1.0));
        Camera::look_at(eye, target, up, self.rng.random_range(20.0..110.0), near).unwrap()
    }

    fn grid_point(&mut self, within: f64) -> [f64; 3] {
        std::array::from_fn(|_| {
            let steps = f64::from(1u32 << 20) * within;
            self.rng.random_range(-steps..steps).floor() / f64::from(1u32 << 20) * self.scale
        })
    }

    fn leaf(&mut self, id: usize) {
        let step = self.scale / f64::from(1 << self.rng.random_range(14..18));
        let origin = self.grid_point(0.5);
        let blob = self.mesh(origin, step);
        let placement = if self.rng.random_bool(0.3) { self.placement() } else { NONE };
        let mut fine = vec![Part { blob, transform: placement }];
        let mut bounds = self.bounds_of(&fine[0]);
        // Some leaves hold two objects, some the same mesh twice.
        if self.rng.random_bool(0.3) {
            let blob = if self.rng.random() { blob } else { self.mesh(origin, step) };
            let second = Part { blob, transform: self.placement() };
            bounds = bounds.union(self.bounds_of(&second));
            fine.push(second);
        }
        let coarse = self.mesh(bounds.min.to_array(), step_within(&bounds, self.scale));
        let coarse = Part { blob: coarse, transform: NONE };
        let bounds = bounds.union(self.bounds_of(&coarse));
        self.finish(id, bounds, vec![(0.0, fine), (self.scale * 1e-3, vec![coarse])], 100);
    }

    /// An inner hlod; the stand-in of some, a mesh within the box, is missing.
    fn stand_in(&mut self, id: usize) {
        let first = self.skeleton.hlods[id].first_child as usize;
        let children = &self.skeleton.hlods[first..first + FANOUT];
        let bounds = children.iter().fold(Aabb::EMPTY, |sum, child| {
            sum.union(Aabb { min: child.min.into(), max: child.max.into() })
        });
        let triangles = children.iter().map(|child| child.source_triangles).sum();
        let error = children
            .iter()
            .flat_map(|child| self.skeleton.levels_of(child))
            .fold(self.scale * 2e-3, |greatest, level| level.error.max(greatest));
        let mut levels = vec![];
        if self.rng.random_bool(0.7) {
            let blob = self.mesh(bounds.min.to_array(), step_within(&bounds, self.scale));
            levels.push((error * 1.5, vec![Part { blob, transform: NONE }]));
        }
        self.finish(id, bounds, levels, triangles);
    }

    /// Levels are errors with parts.
    fn finish(
        &mut self,
        id: usize,
        bounds: Aabb,
        levels: Vec<(f64, Vec<Part>)>,
        source_triangles: u64,
    ) {
        let hlod = &mut self.skeleton.hlods[id];
        (hlod.min, hlod.max) = (bounds.min.to_array(), bounds.max.to_array());
        hlod.first_level = self.skeleton.levels.len() as u32;
        hlod.level_count = levels.len() as u32;
        hlod.source_triangles = source_triangles;
        for (error, parts) in levels {
            let triangles = |part: &Part| self.skeleton.blobs[part.blob as usize].triangles;
            self.skeleton.levels.push(Level {
                error,
                first_part: self.skeleton.parts.len() as u32,
                part_count: parts.len() as u32,
                triangles: parts.iter().map(triangles).sum(),
                longest_edge: (bounds.diagonal() as f32).next_up(),
            });
            self.skeleton.parts.extend(parts);
        }
    }

    fn placement(&mut self) -> u32 {
        let axis = DVec3::from_array(self.grid_point(1.0)).normalize_or(DVec3::X);
        let rotation = glam::DQuat::from_axis_angle(axis, self.rng.random_range(0.0..6.0));
        let mirror = if self.rng.random() { -1.0 } else { 1.0 };
        let linear =
            [DVec3::X * mirror, DVec3::Y, DVec3::Z * 1.5].map(|v| (rotation * v).to_array());
        let translation = self.grid_point(0.1);
        self.skeleton.transforms.push(Transform { linear, translation });
        self.skeleton.transforms.len() as u32 - 1
    }

    fn bounds_of(&self, part: &Part) -> Aabb {
        let blob = &self.skeleton.blobs[part.blob as usize];
        let placement = self.skeleton.transform_of(part);
        Aabb::of(vertices_of(blob, &self.blob_bytes[part.blob as usize]).map(|vertex| {
            let grid = vertex.grid();
            let p = std::array::from_fn(|k| blob.origin[k] + f64::from(grid[k]) * blob.step);
            placement.apply(p).into()
        }))
    }

    /// What triangles are made of: most meshes are opaque, some textured, some of all classes at once.
    fn surfaces(&mut self, triangles: u32) -> (Layout, [u32; Class::COUNT]) {
        let layout = if self.rng.random_bool(0.3) { Layout::Textured } else { Layout::Plain };
        let mut classes = Class::OpaqueDouble.all(triangles);
        if self.rng.random_bool(0.4) {
            classes = [0; Class::COUNT];
            for _ in 0..triangles {
                let class = Class::ALL[self.rng.random_range(0..Class::COUNT)];
                let plain_mask = class.is_mask() && layout == Layout::Plain;
                let class = if plain_mask { Class::BlendDouble } else { class };
                classes[class as usize] += 1;
            }
        }
        (layout, classes)
    }

    /// A block, whose faces lie in those of its box; a plate, whose box is flat; loose triangles; or
    /// long thin ones.
    fn mesh(&mut self, origin: [f64; 3], step: f64) -> u32 {
        let rng = &mut self.rng;
        let grid: Vec<[u32; 3]>;
        let mut indices: Vec<u16>;
        match rng.random_range(0..4) {
            kind @ (0 | 1) => {
                let mut sides: [u32; 3] = std::array::from_fn(|_| rng.random_range(1..GRID));
                if kind == 1 {
                    sides[rng.random_range(0..3)] = 0;
                }
                grid = (0..8)
                    .map(|i| std::array::from_fn(|k| if i >> k & 1 == 1 { sides[k] } else { 0 }))
                    .collect();
                indices = vec![0, 2, 6, 0, 6, 4, 1, 3, 7, 1, 7, 5, 0, 1, 5, 0, 5, 4];
                indices.extend([2, 3, 7, 2, 7, 6, 0, 1, 3, 0, 3, 2, 4, 5, 7, 4, 7, 6]);
            }
            kind => {
                let count = rng.random_range(1..8u16);
                let reach = if kind == 2 { [GRID; 3] } else { [GRID, 3, 9] };
                let point = |_| std::array::from_fn(|k| rng.random_range(0..reach[k]));
                grid = (0..3 * count).map(point).collect();
                indices = (0..3 * count).collect();
            }
        }
        let (vertices, triangles) = (grid.len() as u32, indices.len() as u32 / 3);
        let (layout, classes) = self.surfaces(triangles);
        let mut bytes = Vec::new();
        for &p in &grid {
            let position = Vertex::pack_position(p);
            let color = self.rng.random();
            let plain = Vertex { position, normal: Vertex::pack_normal([0.0, 0.6, 0.8]), color };
            bytes.extend_from_slice(bytemuck::bytes_of(&plain));
            if layout == Layout::Textured {
                let texturing = TexturedVertex {
                    plain,
                    tex_coord: std::array::from_fn(|_| self.rng.random_range(-3.0..3.0)),
                    texture: [NONE, 0, 1][self.rng.random_range(0..3)],
                    cutoff: 0.4,
                };
                bytes.extend_from_slice(&bytemuck::bytes_of(&texturing)[size_of::<Vertex>()..]);
            }
        }
        bytes.extend(indices.drain(..).flat_map(u16::to_le_bytes));
        self.skeleton.blobs.push(Blob {
            origin,
            step,
            vertices,
            triangles,
            layout: layout as u32,
            classes,
            ..Blob::zeroed()
        });
        self.blob_bytes.push(bytes);
        self.skeleton.blobs.len() as u32 - 1
    }
}

/// Noise, with holes.
fn texture(rng: &mut StdRng, side: u32) -> (Texture, Vec<u8>) {
    let rgba: Vec<u8> = (0..4 * side * side).map(|_| rng.random()).collect();
    let bytes = mips(side, &rgba);
    let wrap = Wrap::pack([Wrap::Repeat, Wrap::Mirror]);
    let length = bytes.len() as u64;
    (Texture { offset: 0, bytes: length, side, wrap, crc: 0, reserved: 0 }, bytes)
}

/// A step at which a mesh at the least corner of `bounds` stays within it where it has any extent.
fn step_within(bounds: &Aabb, scale: f64) -> f64 {
    let extent = bounds.extent().min_element() / f64::from(GRID);
    let mut step = scale;
    while step > extent && step > scale * f64::EPSILON {
        step *= 0.5;
    }
    step
}
