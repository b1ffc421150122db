use super::*;
use bytemuck::Zeroable;
use geometry::bounds::Aabb;
use geometry::hausdorff::{Goal, directed, sampled};
use geometry::mesh::{Mesh, MeshVertex};
use glam::{DVec3, Vec3};
use protocol::format::{Class, Part, SceneInfo, SceneWriter, Tables, Transform, Vertex, Vertices};
use tempfile::TempDir;

/// Grid steps between neighbours of the finest patch.
const SPACING: u32 = 16;
/// Quads along its side.
const SIDE: u32 = 16;
const STEP: f64 = 1.0 / 64.0;

/// A wavy patch: every `stride`th vertex of the finest.
fn patch(stride: u32) -> (Vec<Vertex>, Vec<u16>) {
    let side = SIDE / stride;
    let mut vertices = Vec::new();
    let mut indices = Vec::new();
    for i in 0..=side {
        for j in 0..=side {
            let (x, y) = (f64::from(i * stride), f64::from(j * stride));
            let height = 100.0 + 40.0 * ((x * 0.45).sin() + (y * 0.35).cos());
            let grid = [i * stride * SPACING, j * stride * SPACING, height as u32];
            vertices.push(Vertex { position: Vertex::pack_position(grid), normal: 0, color: !0 });
            if i < side && j < side {
                let at = |di: u32, dj: u32| ((i + di) * (side + 1) + j + dj) as u16;
                indices.extend([at(0, 0), at(1, 0), at(0, 1), at(1, 0), at(1, 1), at(0, 1)]);
            }
        }
    }
    (vertices, indices)
}

/// Two patches side by side, the second an instance, with coarser levels; below a root whose only
/// level shows both coarser still. `factor` goes on each error, `by` moves everything.
struct Scene {
    second: Transform,
    by: f64,
    /// On the error of the root, of the first leaf's coarser level, of the second's.
    factors: [f64; 3],
}

impl Scene {
    fn plain() -> Self {
        // A quarter turn about z, twice as large.
        let linear = [[0.0, 2.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 0.0, 2.0]];
        let second = Transform { linear, translation: [20.0, 0.0, 1.0] };
        Self { second, by: 0.0, factors: [1.0; 3] }
    }

    /// The file, and the true errors of root, first and second leaf, each within 1% above.
    fn write(mut self) -> (TempDir, Store, [f64; 3]) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.occ");
        let mut writer = SceneWriter::create(&path).unwrap();
        let patches = [1, 2, 4].map(patch);
        // The instance's mesh lies where it is made, the other in the scene.
        let blobs = [[self.by; 3], [0.0; 3]].map(|origin| {
            [0, 1, 2].map(|k| {
                let (vertices, indices) = &patches[k];
                let classes = Class::OpaqueDouble.all(indices.len() as u32 / 3);
                let blob = Vertices::Plain(vertices);
                writer.add_blob(origin, STEP, blob, indices, classes).unwrap().0
            })
        });
        self.second.translation.iter_mut().for_each(|t| *t += self.by);
        let part = |leaf: usize, detail: usize| Part {
            blob: blobs[leaf][detail],
            transform: if leaf == 0 { NONE } else { 0 },
        };
        let parts: Vec<Part> = [(0, 2), (1, 2), (0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(leaf, detail)| part(leaf, detail))
            .to_vec();
        let mesh = |leaf: usize, detail: usize| {
            let placement = if leaf == 0 { Transform::IDENTITY } else { self.second };
            let origin = DVec3::splat(if leaf == 0 { self.by } else { 0.0 });
            let (vertices, indices) = &patches[detail];
            let place = |v: &Vertex| {
                let p = origin + DVec3::from_array(v.grid().map(f64::from)) * STEP;
                MeshVertex::plain(placement.apply(p.to_array()).into(), Vec3::Z, [0; 4])
            };
            let triangles = indices.chunks_exact(3);
            Mesh {
                vertices: vertices.iter().map(place).collect(),
                triangles: triangles.map(|t| [0, 1, 2].map(|k| u32::from(t[k]))).collect(),
            }
        };
        let both = |detail| {
            let mut mesh_of_both = mesh(0, detail);
            mesh_of_both.append(&mesh(1, detail));
            mesh_of_both
        };
        let truth = [(both(2), both(0)), (mesh(0, 1), mesh(0, 0)), (mesh(1, 1), mesh(1, 0))]
            .map(|(coarse, fine)| error(&coarse, &fine));
        let [root_error, first_error, second_error] = [0, 1, 2].map(|k| truth[k] * self.factors[k]);
        let counts = [512, 128, 32];
        let level = |error, first_part, part_count, triangles| Level {
            error,
            first_part,
            part_count,
            triangles,
            longest_edge: 1e3,
        };
        let levels = vec![
            level(root_error, 0, 2, 2 * counts[2]),
            level(0.0, 2, 1, counts[0]),
            level(first_error, 3, 1, counts[1]),
            level(0.0, 4, 1, counts[0]),
            level(second_error, 5, 1, counts[1]),
        ];
        let boxed = |mesh: Mesh, hlod: Hlod| {
            let Aabb { min, max } = mesh.bounds().grown(1e-6);
            Hlod { min: min.to_array(), max: max.to_array(), ..hlod }
        };
        let leaf = Hlod { parent: 0, level_count: 2, source_triangles: 512, ..Hlod::zeroed() };
        let root = Hlod {
            parent: NONE,
            first_child: 1,
            child_count: 2,
            level_count: 1,
            object: NONE,
            source_triangles: 1024,
            ..leaf
        };
        let hlods = vec![
            boxed(both(0), root),
            boxed(mesh(0, 0), Hlod { first_level: 1, ..leaf }),
            boxed(mesh(1, 0), Hlod { first_level: 3, ..leaf }),
        ];
        let info = SceneInfo {
            up: [0.0, 0.0, 1.0],
            source_triangles: 1024,
            unique_triangles: 512,
            objects: 1,
            ..SceneInfo::zeroed()
        };
        let transforms = vec![self.second];
        let tables = Tables { info, hlods, levels, parts, transforms, ..Tables::default() };
        writer.finish(tables).unwrap();
        let store = Store::open(&path).unwrap();
        (folder, store, truth)
    }
}

fn error(coarse: &Mesh, fine: &Mesh) -> f64 {
    let goal = Goal { enough: 0.0, slack: 0.01, budget: 1_000_000 };
    let out = directed(coarse, &Surface::new(fine), &goal);
    out.upper.max(directed(fine, &Surface::new(coarse), &goal).upper)
}

fn check(scene: Scene) -> Result<Deep, DeepError> {
    let (_folder, store, _) = scene.write();
    crate::verify::verify(&store).unwrap();
    deep(&store, &Effort::default())
}

#[test]
fn a_scene_of_the_original_alone_has_nothing_to_measure() {
    let slack = slack_of([].iter(), 0.0);
    assert_eq!(slack, Slack::default());
    let (_folder, store) = crate::fixture::store();
    // Its root says half a unit and strays by five.
    let error = deep(&store, &Effort::default()).unwrap_err();
    let DeepError::Beyond { hlod, level, stored, violations, levels, .. } = error else {
        panic!("{error}")
    };
    assert_eq!((hlod.0, level, stored, violations, levels), (0, 0, 0.5, 1, 1));
}

#[test]
fn true_errors_pass_wherever_the_scene_lies_and_have_little_slack() {
    for by in [0.0, -1e4, 1e7] {
        let deep = check(Scene { by, ..Scene::plain() }).unwrap();
        assert_eq!((deep.hlods, deep.levels, deep.originals), (3, 3, 2));
        assert_eq!((deep.slack.levels, deep.slack.exact), (3, 0));
        assert!(deep.slack.max < 1.1 && deep.slack.median >= 1.0 - 1e-6, "{deep:?}");
        assert!(deep.samples > 2000, "{deep:?}");
        let levels: Vec<u64> = deep.depths.iter().map(|slack| slack.levels).collect();
        assert_eq!(levels, [1, 2]);
    }
}

#[test]
fn the_first_false_error_is_named_with_what_was_found() {
    for by in [0.0, 1e7] {
        for (factors, first, count) in [
            ([1.0, 1.0, 0.85], (2, 1), 1),
            ([1.0, 0.85, 1.0], (1, 1), 1),
            ([0.85, 1.0, 1.0], (0, 0), 1),
            ([1.0, 0.5, 0.5], (1, 1), 2),
        ] {
            let (_folder, store, truth) = Scene { by, factors, ..Scene::plain() }.write();
            let error = deep(&store, &Effort::default()).unwrap_err();
            let DeepError::Beyond { hlod, level, stored, found, violations, .. } = error else {
                panic!("{error}")
            };
            assert_eq!(((hlod.0, level), violations), (first, count));
            let [truth, factor] = [truth[hlod.index()], factors[hlod.index()]];
            assert!((stored - truth * factor).abs() < 1e-12);
            assert!(found > stored && found <= truth * (1.0 + 1e-6), "{found} {truth}");
        }
    }
}

#[test]
fn skewed_and_mirrored_instances_are_measured_as_they_are_placed() {
    let linear = [[-0.5, 0.3, 0.0], [1.0, 2.0, 0.5], [0.0, 0.0, 3.0]];
    let second = Transform { linear, translation: [-30.0, 5.0, 2.0] };
    assert!(check(Scene { second, ..Scene::plain() }).is_ok());
    let wrong = Scene { second, factors: [1.0, 1.0, 0.8], ..Scene::plain() };
    assert!(matches!(check(wrong), Err(DeepError::Beyond { hlod: HlodId(2), .. })));
}

#[test]
fn the_farthest_sample_is_what_a_search_of_everything_finds_at_any_cache_size() {
    let linear = [[0.0, 1.0, 0.2], [-1.0, 0.0, 0.0], [0.1, 0.0, 1.0]];
    let overlapping = Transform { linear, translation: [3.0, 1.0, 0.5] };
    let (_folder, store, _) = Scene { second: overlapping, ..Scene::plain() }.write();
    let mut all = Vec::new();
    each_leaf_below_root(&store, |triangles| all.extend(triangles));
    let all = Surface::of_triangles(all.into_iter());
    let near = |i: u32| {
        let t = f64::from(i);
        DVec3::new((t * 0.73).sin() * 4.0, (t * 0.31).cos() * 4.0, (t * 0.17).sin() * 3.0) + 2.0
    };
    for limit in [0, 1 << 30] {
        let leaves = Leaves::new(&store, limit);
        // One at a time each sample counts, together only the farthest.
        let runs = (0..300).map(|i| i..i + 1).chain((0..30).map(|i| i * 100..i * 100 + 100));
        for run in runs {
            let samples: Vec<DVec3> = run.map(near).collect();
            let truth = samples.iter().map(|p| all.distance(*p, 0.0, &mut 0)).fold(0.0, f64::max);
            let (found, _) = leaves.farthest(HlodId(0), &samples).unwrap();
            assert!((found - truth).abs() < 1e-12, "{found} {truth}");
        }
        assert_eq!(leaves.bytes() > 0, limit > 0);
    }
}

fn each_leaf_below_root(store: &Store, mut call: impl FnMut(Vec<[DVec3; 3]>)) {
    let skeleton = store.skeleton();
    leaves::each_leaf_below(skeleton, HlodId(0), |leaf| {
        let level = &skeleton.levels_of(skeleton.hlod(leaf))[0];
        call(leaves::placed(store, level).unwrap().triangles);
    });
}

#[test]
fn thread_counts_and_caches_change_nothing() {
    let (_folder, store, _) = Scene::plain().write();
    let run = |threads: usize, cache_bytes: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| deep(&store, &Effort { cache_bytes, samples: 700 })).unwrap()
    };
    let alone = run(1, 1 << 30);
    assert_eq!(alone, run(3, 0));
    assert!(alone.samples <= 3 * 2 * 700);
}

#[test]
fn the_stored_truth_agrees_with_dense_samples() {
    let (_folder, store, truth) = Scene::plain().write();
    let of = |hlod: usize, level: usize| {
        let levels = store.skeleton().levels_of(&store.skeleton().hlods[hlod]);
        leaves::placed(&store, &levels[level]).unwrap().triangles
    };
    let mesh = |triangles: &[[DVec3; 3]]| Mesh {
        vertices: triangles
            .iter()
            .flatten()
            .map(|p| MeshVertex::plain(*p, Vec3::Z, [0; 4]))
            .collect(),
        triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    };
    let (fine, coarse) = (mesh(&of(2, 0)), mesh(&of(2, 1)));
    let seen =
        sampled(&fine, &Surface::new(&coarse), 12).max(sampled(&coarse, &Surface::new(&fine), 24));
    assert!(seen <= truth[2] && truth[2] < seen * 1.05, "{seen} {truth:?}");
}
