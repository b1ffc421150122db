//! Faces of scan cubes, and both backends to draw them with.

use crate::support::{Mesh, backend, draw, items, picture, vertex, view};
use protocol::format::vertex::Layout;
use protocol::format::{Blob, Class, Vertex, projected};
use protocol::id::{BlobId, HlodId};
use rand::Rng;
use rand::rngs::StdRng;
use scene::backend::cpu::CpuBackend;
use scene::backend::{Backend, Draw, Picture, Shading, Upload};

pub(crate) const SIDE: u32 = 64;
pub(crate) const ACROSS: usize = (SIDE / projected::TILE) as usize;
/// Pixels of the views' sides: those of a face seen from its sample.
pub(crate) const VIEW: u32 = SIDE;
pub(crate) const PIXELS: usize = (VIEW * VIEW) as usize;
/// Grid units of a face's side.
pub(crate) const FULL: u32 = SIDE * projected::SUBPIXELS;
/// Disparity of a grid unit.
pub(crate) const STEP: f64 = 1.0 / 65536.0;

pub(crate) type Tile = [[u8; 8]; 16];

/// A face before it is a blob.
pub(crate) struct Face {
    /// Place in the picture and disparity, in grid units.
    pub(crate) corners: Vec<[u32; 3]>,
    /// Of which some are stored.
    pub(crate) tiles: Vec<Option<Tile>>,
    /// Of each of them, if it has any.
    pub(crate) normals: Option<Vec<Tile>>,
}

impl Face {
    /// Triangles, a noisy picture of all tiles.
    pub(crate) fn new(random: &mut StdRng, corners: Vec<[u32; 3]>) -> Self {
        let tiles = (0..ACROSS * ACROSS).map(|_| Some(random.random::<[u64; 16]>()));
        let tiles = tiles.map(|tile| tile.map(|blocks| blocks.map(u64::to_le_bytes))).collect();
        Self { corners, tiles, normals: None }
    }

    /// The same with noisy normals.
    pub(crate) fn with_normals(self, random: &mut StdRng) -> Self {
        let normals = self.tiles.iter().map(|_| random.random::<[u64; 16]>().map(u64::to_le_bytes));
        Self { normals: Some(normals.collect()), ..self }
    }

    /// The whole of it; disparity changes by `slope` over a side, downwards.
    pub(crate) fn whole(random: &mut StdRng, disparity: f64, slope: f64) -> Self {
        let corner = |u: u32, v: u32| {
            let at = disparity + slope * f64::from(v);
            [u * FULL, v * FULL, (at / STEP) as u32]
        };
        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        Self::new(random, vec![a, c, b, b, c, d])
    }

    pub(crate) fn blob(&self) -> (Blob, Vec<u8>) {
        let mut bytes = Vec::new();
        for &corner in &self.corners {
            bytes.extend_from_slice(bytemuck::cast_slice(&Vertex::pack_position(corner)));
        }
        let count = self.corners.len() as u32;
        bytes.extend((0..count as u16).flat_map(u16::to_le_bytes));
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        let mut stored = 0u32;
        for tile in &self.tiles {
            stored += u32::from(tile.is_some());
            let entry = if tile.is_some() { stored } else { 0 };
            bytes.extend(entry.to_le_bytes());
        }
        bytes.extend(self.tiles.iter().flatten().flatten().flatten());
        let of_stored = self.normals.iter().flatten().zip(&self.tiles);
        let of_stored =
            of_stored.filter(|(_, tile)| tile.is_some()).flat_map(|(normals, _)| normals);
        bytes.extend(of_stored.flatten());
        let layout = match self.normals {
            Some(_) => Layout::ProjectedNormals,
            None => Layout::Projected,
        };
        let blob = Blob {
            vertices: count,
            triangles: count / 3,
            classes: Class::OpaqueDouble.all(count / 3),
            layout: layout as u32,
            image: [SIDE, stored],
            ..Blob::default()
        };
        (blob, bytes)
    }

    pub(crate) fn upload(&self, backend: &mut impl Backend, id: u32) -> Upload {
        let (blob, bytes) = self.blob();
        backend.upload(BlobId(id), &blob, &bytes).expect("a sound blob")
    }
}

/// A point of a face that looks along -z from a sample at `c`, y up.
pub(crate) fn point(c: [f64; 3], [u, v, disparity]: [u32; 3]) -> [f64; 3] {
    let across = |at: u32| 2.0 * f64::from(at) / f64::from(FULL) - 1.0;
    let z = 1.0 / (f64::from(disparity) * STEP);
    [c[0] + z * across(u), c[1] - z * across(v), c[2] - z]
}

/// Such a face, drawn as blob `id`; the eye is the origin.
pub(crate) fn seen(id: u32, c: [f64; 3]) -> Draw {
    let unit = (2.0 / f64::from(FULL)) as f32;
    Draw {
        blob: BlobId(id),
        item: HlodId(id),
        linear: [[unit, 0.0, 0.0], [0.0, -unit, 0.0], c.map(|c| (c * STEP) as f32)],
        offset: [-1.0, 1.0, -1.0],
        distance: 1.0,
        disparity_step: STEP as f32,
    }
}

/// An ordinary triangle through three points, of blob `blob`.
pub(crate) fn plain(blob: u32, item: u32, [a, b, c]: [[f64; 3]; 3]) -> Draw {
    let side = |to: [f64; 3]| std::array::from_fn(|k| (to[k] - a[k]) as f32);
    let mut made = draw(blob, item, [0.0; 3], a.map(|c| c as f32));
    (made.linear[0], made.linear[1]) = (side(b), side(c));
    made
}

/// The mesh of [`plain`].
pub(crate) fn corner() -> Mesh {
    let vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]].map(|at| vertex(at, [0.0, 0.0, 1.0], !0));
    Mesh { vertices: vertices.to_vec(), indices: vec![0, 1, 2] }
}

/// The rasteriser, and the driver where there is one.
pub(crate) struct Both {
    pub(crate) cpu: CpuBackend,
    pub(crate) gpu: Option<gpu::WgpuBackend>,
}

impl Both {
    pub(crate) fn new() -> Self {
        Self { cpu: CpuBackend::new(view(VIEW, VIEW).size), gpu: backend(VIEW, VIEW) }
    }

    pub(crate) fn face(&mut self, id: u32, face: &Face) {
        assert_eq!(face.upload(&mut self.cpu, id), Upload::Done);
        if let Some(gpu) = &mut self.gpu {
            assert_eq!(face.upload(gpu, id), Upload::Done);
        }
    }

    pub(crate) fn mesh(&mut self, id: u32, mesh: &Mesh) {
        mesh.upload(&mut self.cpu, id);
        if let Some(gpu) = &mut self.gpu {
            mesh.upload(gpu, id);
        }
    }

    /// What each makes of the draws.
    pub(crate) fn shade(&mut self, draws: &[Draw]) -> Vec<Picture> {
        self.pictures(Shading::default(), draws)
    }

    pub(crate) fn pictures(&mut self, shading: Shading, draws: &[Draw]) -> Vec<Picture> {
        let view = view(VIEW, VIEW);
        let mut pictures = vec![picture(&mut self.cpu, view, shading, draws)];
        pictures.extend(self.gpu.as_mut().map(|gpu| picture(gpu, view, shading, draws)));
        pictures
    }

    pub(crate) fn items(&mut self, draws: &[Draw]) -> Vec<Vec<u32>> {
        let view = view(VIEW, VIEW);
        let mut all = vec![items(&mut self.cpu, view, draws)];
        all.extend(self.gpu.as_mut().map(|gpu| items(gpu, view, draws)));
        all
    }
}
