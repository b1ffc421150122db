//! Whole bakes. Here is what the promises share: made-up meshes, and a reader of what was written.

mod degenerate;
mod inputs;
mod resume;
mod seams;
mod strays;
mod whole;

use super::*;
use crate::progress::Silent;
use crate::source::{SourceMesh, SourceObject, Surface};
use ::scene::deep::{Deep, Effort, deep};
use ::scene::store::Store;
use ::scene::verify::verify;
use glam::{DAffine3, DVec3};
use protocol::format::mesh::vertices_of;
use protocol::format::{Hlod, Level, Skeleton};
use protocol::id::{BlobId, HlodId};
use std::sync::Arc;

fn object(mesh: usize, world_from_mesh: DAffine3) -> SourceObject {
    SourceObject { name: format!("object of {mesh}"), mesh, world_from_mesh }
}

/// A scene to hand over.
#[derive(Default)]
struct Source {
    meshes: Vec<SourceMesh>,
    objects: Vec<SourceObject>,
}

fn source(meshes: Vec<SourceMesh>, objects: Vec<SourceObject>) -> Source {
    Source { meshes, objects }
}

/// Every mesh once, where it is.
fn once(meshes: Vec<SourceMesh>) -> Source {
    let objects = (0..meshes.len()).map(|mesh| object(mesh, DAffine3::IDENTITY)).collect();
    Source { meshes, objects }
}

/// A mesh of one colour, its normals all upwards.
fn mesh_of(positions: Vec<[f32; 3]>, indices: Vec<[u32; 3]>) -> SourceMesh {
    let count = positions.len();
    SourceMesh {
        name: "made up".into(),
        normals: vec![[0.0, 1.0, 0.0]; count],
        colors: vec![[200, 100, 50, 255]; count],
        positions,
        indices,
        ..SourceMesh::default()
    }
}

fn triangle(size: f32) -> SourceMesh {
    mesh_of(vec![[0.0; 3], [size, 0.0, 0.0], [0.0, size, 0.0]], vec![[0, 1, 2]])
}

/// A tube along x, radius 1, of `2 * rings * sectors` triangles with shared vertices.
fn tube(rings: u32, sectors: u32, length: f32) -> SourceMesh {
    let mut mesh = SourceMesh { name: "tube".into(), ..SourceMesh::default() };
    for ring in 0..=rings {
        for sector in 0..sectors {
            let (s, c) = (std::f32::consts::TAU * sector as f32 / sectors as f32).sin_cos();
            mesh.positions.push([length * ring as f32 / rings as f32, c, s]);
            mesh.normals.push([0.0, c, s]);
            mesh.colors.push([90, 120, 200, 255]);
        }
    }
    for ring in 0..rings {
        for sector in 0..sectors {
            let at = |r: u32, s: u32| r * sectors + s % sectors;
            let (a, b) = (at(ring, sector), at(ring, sector + 1));
            let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
            mesh.indices.extend([[a, c, b], [b, c, d]]);
        }
    }
    mesh
}

/// A wavy sheet of `2 * side * side` triangles with shared vertices, a unit between them.
fn terrain(side: u32) -> SourceMesh {
    let at = |i: u32| {
        let (x, z) = ((i % (side + 1)) as f32, (i / (side + 1)) as f32);
        [x, 3.0 * (x * 0.21).sin() + 2.0 * (z * 0.17).cos() + 0.3 * (x * z * 0.05).sin(), z]
    };
    let quad = |i: u32| {
        let a = i % side + i / side * (side + 1);
        [[a, a + side + 1, a + 1], [a + 1, a + side + 1, a + side + 2]]
    };
    let positions = (0..(side + 1) * (side + 1)).map(at).collect();
    mesh_of(positions, (0..side * side).flat_map(quad).collect())
}

/// Bakes a scene that is handed over.
fn bake_source(source: &Source, output: &Path, options: &Options) -> Result<Summary, BakeError> {
    let fill = |sink: &mut dyn Sink| {
        source.meshes.iter().try_for_each(|mesh| sink.mesh(mesh.clone()))?;
        Ok(Imported {
            objects: source.objects.clone(),
            surfaces: vec![Surface::PLAIN],
            up: [0.0, 1.0, 0.0],
            notes: Vec::new(),
        })
    };
    bake_scene(fill, "void.glb", output, options, &Silent)
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A scene file that holds all that a reader relies on.
struct Baked {
    folder: tempfile::TempDir,
    summary: Summary,
    store: Store,
    /// What `verify --deep` found.
    deep: Deep,
}

fn baked(source: &Source, options: &Options) -> Baked {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let summary = bake_source(source, &path, options).unwrap();
    assert_eq!(names(folder.path()), ["scene.occ"]);
    let store = Store::open(&path).unwrap();
    let deep = sound(&store);
    Baked { folder, summary, store, deep }
}

/// Every checksum, every rule of the format, every vertex in its box, every error true as far as some
/// samples tell, and strictly growing.
fn sound(store: &Store) -> Deep {
    verify(store).unwrap();
    let skeleton = store.skeleton();
    for hlod in &skeleton.hlods {
        let levels = skeleton.levels_of(hlod);
        assert!(levels.iter().all(|level| level.error > 0.0));
        for pair in levels.windows(2) {
            assert!(pair[0].error < pair[1].error && pair[0].triangles > pair[1].triangles);
        }
    }
    deep(store, &Effort { samples: 500, ..Effort::default() }).unwrap()
}

impl Baked {
    fn path(&self) -> PathBuf {
        self.folder.path().join("scene.occ")
    }

    fn skeleton(&self) -> &Arc<Skeleton> {
        self.store.skeleton()
    }

    /// World positions of a blob's vertices as a reader decodes them.
    fn positions(&self, part: &format::Part) -> Vec<DVec3> {
        let id = BlobId(part.blob);
        let blob = self.skeleton().blob(id);
        let transform = self.skeleton().transform_of(part);
        vertices_of(blob, &self.store.load_blob(id).unwrap())
            .map(|vertex| {
                let grid = vertex.grid();
                let p = std::array::from_fn(|k| blob.origin[k] + blob.step * f64::from(grid[k]));
                DVec3::from_array(transform.apply(p))
            })
            .collect()
    }

    /// World triangles of a level.
    fn triangles(&self, level: &Level) -> Vec<[DVec3; 3]> {
        let mut triangles = Vec::new();
        for part in self.skeleton().parts_of(level) {
            let positions = self.positions(part);
            let id = BlobId(part.blob);
            let blob = self.skeleton().blob(id);
            let indices = &self.store.load_blob(id).unwrap()[blob.vertex_bytes()..];
            let indices: Vec<usize> = indices[..6 * blob.triangles as usize]
                .chunks(2)
                .map(|two| usize::from(u16::from_le_bytes([two[0], two[1]])))
                .collect();
            triangles.extend(indices.chunks(3).map(|t| [t[0], t[1], t[2]].map(|i| positions[i])));
        }
        triangles
    }

    fn leaves(&self) -> impl Iterator<Item = (HlodId, &Hlod)> {
        let hlods = self.skeleton().hlods.iter().enumerate();
        hlods.filter(|(_, h)| h.child_count == 0).map(|(i, h)| (HlodId(i as u32), h))
    }

    /// Triangles of all leaves' finest levels.
    fn original_triangles(&self) -> u64 {
        let finest = self.leaves().map(|(_, leaf)| self.skeleton().levels_of(leaf)[0].triangles);
        finest.map(u64::from).sum()
    }
}
