use super::*;
use crate::progress::Silent;
use crate::source::{SourceMesh, SourceObject};
use geometry::bounds::Aabb;
use glam::{DAffine3, DQuat, DVec3};
use protocol::format::{Hlod, Level, SceneFile, Skeleton, check, parse, read_blob};
use protocol::id::HlodId;
use std::fs::File;

fn object(mesh: usize, world_from_mesh: DAffine3) -> SourceObject {
    SourceObject { name: format!("object of {mesh}"), mesh, world_from_mesh }
}

fn source(meshes: Vec<SourceMesh>, objects: Vec<SourceObject>) -> Source {
    Source { meshes, objects, up: [0.0, 1.0, 0.0], ..Source::default() }
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

struct Baked {
    _folder: tempfile::TempDir,
    path: PathBuf,
    summary: Summary,
    scene: SceneFile,
}

fn baked(source: &Source, options: &Options) -> Baked {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let summary = bake_source(source, "made up", &path, options, &Silent).unwrap();
    let scene = parse(&std::fs::read(&path).unwrap()).unwrap();
    let baked = Baked { _folder: folder, path, summary, scene };
    baked.walk();
    baked
}

impl Baked {
    fn skeleton(&self) -> &Skeleton {
        &self.scene.skeleton
    }

    /// World triangles of a level as a reader decodes them.
    fn triangles(&self, level: &Level) -> Vec<[DVec3; 3]> {
        let file = File::open(&self.path).unwrap();
        let part = self.skeleton().parts_of(level)[0];
        let id = protocol::id::BlobId(part.blob);
        let bytes = read_blob(&file, &self.scene, id).unwrap();
        let blob = self.skeleton().blob(id);
        let transform = self.skeleton().transform_of(&part);
        let (vertices, rest) = bytes.split_at(16 * blob.vertices as usize);
        let positions: Vec<DVec3> = vertices
            .chunks(16)
            .map(|chunk| {
                let word = |i: usize| u32::from_le_bytes(chunk[4 * i..][..4].try_into().unwrap());
                let vertex = protocol::format::Vertex {
                    position: [word(0), word(1)],
                    normal: word(2),
                    color: word(3),
                };
                let grid = vertex.grid();
                let p = std::array::from_fn(|k| blob.origin[k] + blob.step * f64::from(grid[k]));
                DVec3::from_array(transform.apply(p))
            })
            .collect();
        let indices: Vec<usize> = rest[..6 * blob.triangles as usize]
            .chunks(2)
            .map(|two| usize::from(u16::from_le_bytes([two[0], two[1]])))
            .collect();
        indices.chunks(3).map(|t| [positions[t[0]], positions[t[1]], positions[t[2]]]).collect()
    }

    /// Everything a reader relies on: rules of the format, boxes around all decoded levels, strictly
    /// growing errors.
    fn walk(&self) {
        let skeleton = self.skeleton();
        check(skeleton).unwrap();
        for hlod in &skeleton.hlods {
            let bounds = Aabb { min: hlod.min.into(), max: hlod.max.into() };
            for level in skeleton.levels_of(hlod) {
                assert!(level.error > 0.0);
                let decoded = Aabb::of(self.triangles(level).into_iter().flatten());
                assert!(bounds.contains(&decoded), "{bounds:?} {decoded:?}");
            }
            let errors = skeleton.levels_of(hlod).windows(2);
            errors.for_each(|pair| {
                assert!(pair[0].error < pair[1].error && pair[0].triangles > pair[1].triangles);
            });
        }
    }

    fn leaves(&self) -> impl Iterator<Item = (HlodId, &Hlod)> {
        let hlods = self.skeleton().hlods.iter().enumerate();
        hlods.filter(|(_, h)| h.child_count == 0).map(|(i, h)| (HlodId(i as u32), h))
    }
}

#[test]
fn an_empty_scene_is_refused_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let point = mesh_of(vec![[1e7; 3]; 3], vec![[0, 1, 2]]);
    let nothing = mesh_of(Vec::new(), Vec::new());
    let flattened = source(vec![triangle(1.0)], vec![object(0, DAffine3::from_scale(DVec3::ZERO))]);
    for empty in [
        Source::default(),
        source(vec![nothing.clone()], vec![object(0, DAffine3::IDENTITY)]),
        source(vec![point], vec![object(0, DAffine3::IDENTITY); 2]),
        flattened,
    ] {
        let error =
            bake_source(&empty, "void.glb", &path, &Options::default(), &Silent).unwrap_err();
        assert_eq!(error.exit_code(), 65);
        assert!(error.to_string().contains("void.glb"), "{error}");
        assert!(empty.meshes.is_empty() || error.to_string().contains("made up"), "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let missing = bake(&[folder.path().join("no.glb")], &path, &Options::default(), &Silent);
    assert_eq!(missing.unwrap_err().exit_code(), 66);
    // One empty mesh beside a good one is a note.
    let mixed = source(
        vec![nothing, triangle(1.0)],
        vec![object(0, DAffine3::IDENTITY), object(1, DAffine3::IDENTITY)],
    );
    let mixed = baked(&mixed, &Options::default());
    assert_eq!(mixed.summary.notes.len(), 1);
    assert_eq!(mixed.leaves().next().unwrap().1.object, 1);
}

#[test]
fn one_triangle_is_a_leaf_at_the_root_at_any_scale_and_distance() {
    for (size, offset) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e7), (1e-3, -1e7)] {
        let place = DAffine3::from_translation(DVec3::splat(offset));
        let one = baked(&source(vec![triangle(size)], vec![object(0, place)]), &Options::default());
        let skeleton = one.skeleton();
        assert_eq!((skeleton.hlods.len(), skeleton.levels.len()), (1, 1));
        let level = &skeleton.levels[0];
        let [a, b, c] = one.triangles(level)[0];
        let size = f64::from(size);
        let wanted = [DVec3::ZERO, DVec3::X * size, DVec3::Y * size].map(|p| p + offset);
        for (decoded, wanted) in [a, b, c].into_iter().zip(wanted) {
            assert!(decoded.distance(wanted) <= level.error, "{decoded} {wanted}");
        }
        assert!(level.error <= size * 1e-4, "{size} {offset} {}", level.error);
    }
}

#[test]
fn coincident_objects_bake() {
    let heap =
        source(vec![triangle(1.0); 300], (0..300).map(|i| object(i, DAffine3::IDENTITY)).collect());
    let heap = baked(&heap, &Options::default());
    assert_eq!(heap.leaves().count(), 300);
    assert_eq!(heap.summary.source_triangles, 300);
}

#[test]
fn a_large_object_is_split_into_pieces_that_close() {
    let place = DAffine3::from_rotation_translation(DQuat::from_rotation_z(0.3), DVec3::splat(1e7));
    let pipe = source(vec![tube(500, 24, 200.0)], vec![object(0, place)]);
    let pipe = baked(&pipe, &Options::default());
    assert!(pipe.leaves().count() >= 12);
    let steps: Vec<f64> = pipe
        .leaves()
        .map(|(_, leaf)| {
            let level = pipe.skeleton().levels_of(leaf)[0];
            pipe.skeleton().blobs[pipe.skeleton().parts_of(&level)[0].blob as usize].step
        })
        .collect();
    assert!(steps.iter().all(|&step| step == steps[0]));
    // On one grid, every inner edge of the tube still has a partner with exactly its ends.
    let mut ends: Vec<[[u64; 3]; 2]> = Vec::new();
    for (_, leaf) in pipe.leaves() {
        for t in pipe.triangles(&pipe.skeleton().levels_of(leaf)[0]) {
            let bits = t.map(|p| p.to_array().map(f64::to_bits));
            for k in 0..3 {
                let mut edge = [bits[k], bits[(k + 1) % 3]];
                edge.sort_unstable();
                ends.push(edge);
            }
        }
    }
    assert_eq!(ends.len(), 3 * 24_000);
    ends.sort_unstable();
    let single = ends.chunk_by(|a, b| a == b).filter(|same| same.len() != 2).count();
    assert_eq!(single, 2 * 24);
}

#[test]
fn every_level_of_a_tube_keeps_to_its_error() {
    let tube = baked(
        &source(vec![tube(100, 24, 40.0)], vec![object(0, DAffine3::IDENTITY)]),
        &Options::default(),
    );
    let skeleton = tube.skeleton();
    let mut coarsest = u32::MAX;
    for hlod in &skeleton.hlods {
        for level in skeleton.levels_of(hlod) {
            coarsest = coarsest.min(level.triangles);
            for triangle in tube.triangles(level) {
                let [a, b, c] = triangle;
                for p in [a, b, c, (a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5, (a + b + c) / 3.0] {
                    // Distance to the 24-sided prism is at most that to the circle plus its sagitta.
                    let sagitta = 1.0 - (std::f64::consts::PI / 24.0).cos();
                    let deviation = ((p.y * p.y + p.z * p.z).sqrt() - 1.0).abs() - sagitta;
                    assert!(deviation <= level.error, "{deviation} {}", level.error);
                }
            }
        }
    }
    assert!(coarsest <= 64, "{coarsest}");
}

#[test]
fn instances_share_their_meshes_and_scale_their_errors() {
    let place = |i: usize| {
        let scale = DVec3::new(1.0, if i == 3 { -2.0 } else { 1.0 }, 1.0);
        DAffine3::from_scale_rotation_translation(
            scale,
            DQuat::from_rotation_y(i as f64),
            DVec3::X * 100.0 * i as f64,
        )
    };
    let park = source(vec![tube(40, 12, 5.0)], (0..8).map(|i| object(0, place(i))).collect());
    let park = baked(&park, &Options::default());
    assert_eq!(park.leaves().count(), 8);
    assert_eq!(park.skeleton().transforms.len(), 8);
    let of = |object: u32| {
        let leaf = park.leaves().find(|(_, leaf)| leaf.object == object).unwrap().1;
        park.skeleton().levels_of(leaf)[0]
    };
    let blob = |object| park.skeleton().parts_of(&of(object))[0].blob;
    assert!((1..8).all(|object| blob(object) == blob(0)));
    let ratio = of(3).error / of(0).error;
    assert!((ratio - 2.0).abs() < 1e-6, "{ratio}");
    assert_eq!(park.summary.source_triangles, 8 * 960);
    assert_eq!(park.summary.unique_triangles, 960);
}

/// Boxes of three colours in rows, and a tube through them.
fn yard() -> Source {
    let mut meshes = vec![tube(200, 16, 120.0)];
    let mut objects = vec![object(0, DAffine3::IDENTITY)];
    for i in 0..400u32 {
        let corner = |k: u32| [(k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2 & 1) as f32];
        let faces =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let indices = faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect();
        let mut cube = mesh_of((0..8).map(corner).collect(), indices);
        cube.colors.fill([80 * (i % 3) as u8, 40, 200, 255]);
        let place = DVec3::new(f64::from(i % 20) * 3.0, f64::from(i / 20) * 3.0, f64::from(i % 7));
        objects.push(object(meshes.len(), DAffine3::from_translation(place)));
        meshes.push(cube);
    }
    source(meshes, objects)
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let bytes = |jobs| {
        let options = Options { jobs, piece_triangles: 500, ..Options::default() };
        std::fs::read(baked(&yard(), &options).path).unwrap()
    };
    let one = bytes(1);
    assert!(one == bytes(2), "two threads differ from one");
    assert!(one == bytes(5), "five threads differ from one");
}

#[test]
fn the_root_is_coarse_and_every_width_works() {
    for branching in [2, 4, 8] {
        let options = Options { branching, ..Options::default() };
        let yard = baked(&yard(), &options);
        let root = yard.skeleton().hlod(HlodId(0));
        let levels = yard.skeleton().levels_of(root);
        assert!(!levels.is_empty() && levels[0].triangles <= 4096);
        assert!(levels.last().unwrap().triangles <= 1024, "{levels:?}");
        assert_eq!(yard.summary.depths[0].hlods, 1);
        assert_eq!(yard.summary.leaves, yard.leaves().count() as u64);
        assert!(yard.summary.to_string().contains("written triangles"));
    }
}

/// Bakes the real scenes and prints what came of them: `--release -- --ignored --nocapture`.
#[test]
#[ignore = "takes minutes in a debug build; a measurement more than a test"]
fn real_scenes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: {} is absent", folder.display());
        return;
    };
    let mut scenes: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    scenes.retain(|path| path.extension().is_some_and(|extension| extension == "glb"));
    scenes.sort();
    let output = tempfile::tempdir().unwrap();
    for scene in scenes {
        let path = output.path().join("scene.occ");
        let summary =
            bake(std::slice::from_ref(&scene), &path, &Options::default(), &Silent).unwrap();
        println!("{}\n{summary}", scene.display());
        summary.depths.iter().enumerate().for_each(|(depth, row)| println!("{depth:>3} {row:?}"));
        let skeleton = parse(&std::fs::read(&path).unwrap()).unwrap().skeleton;
        check(&skeleton).unwrap();
        let root = skeleton.levels_of(skeleton.hlod(HlodId(0))).to_vec();
        println!("diagonal {:.3} root {root:?}", skeleton.diagonal());
        assert!(root[0].triangles <= 4096);
    }
}
