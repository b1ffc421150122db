use super::super::cameras;
use super::super::generate::{GenerateError, PathKind, generate_within};
use super::*;
use protocol::camera::near_plane;
use protocol::format::{
    Blob, Class, Hlod, Level, NONE, Part, SceneInfo, Skeleton, Transform, Vertex,
};
use protocol::id::BlobId;
use std::convert::Infallible;

/// Coarse enough that an unoptimised build fills it quickly.
const CELLS: usize = 150_000;
const STEP: f64 = 1.0 / 1024.0;

/// Boxes as one hlod each, under one root, Z up or Y up, moved by `shift`.
fn scene(boxes: &[[[f64; 3]; 2]], up: [f64; 3], shift: f64) -> (Skeleton, Vec<Vec<u8>>) {
    let moved = |p: [f64; 3]| p.map(|c| c + shift);
    let hlod = |min: [f64; 3], max: [f64; 3]| Hlod {
        min,
        max,
        parent: 0,
        first_child: 0,
        child_count: 0,
        first_level: 0,
        level_count: 0,
        object: NONE,
        source_triangles: 12,
    };
    let low = |k: usize| boxes.iter().map(|b| b[0][k]).fold(f64::INFINITY, f64::min);
    let high = |k: usize| boxes.iter().map(|b| b[1][k]).fold(f64::NEG_INFINITY, f64::max);
    let root = Hlod {
        parent: NONE,
        first_child: 1,
        child_count: boxes.len() as u32,
        ..hlod(moved([low(0), low(1), low(2)]), moved([high(0), high(1), high(2)]))
    };
    let mut skeleton = Skeleton {
        info: SceneInfo { up, objects: boxes.len() as u32, ..SceneInfo::default() },
        hlods: vec![root],
        levels: Vec::new(),
        parts: Vec::new(),
        blobs: Vec::new(),
        transforms: Vec::new(),
        textures: Vec::new(),
        texture_lists: Vec::new(),
        view_cells: Vec::new(),
        cubes: Vec::new(),
    };
    let mut bytes = Vec::new();
    for (i, [min, max]) in boxes.iter().enumerate() {
        skeleton.hlods.push(Hlod {
            first_level: i as u32,
            level_count: 1,
            ..hlod(moved(*min), moved(*max))
        });
        let level = Level {
            error: 0.0,
            first_part: i as u32,
            part_count: 1,
            triangles: 12,
            longest_edge: 1e3,
        };
        skeleton.levels.push(level);
        skeleton.parts.push(Part { blob: i as u32, transform: NONE });
        let mut data = Vec::new();
        for corner in 0..8 {
            let grid = std::array::from_fn(|k| {
                if corner >> k & 1 == 1 { ((max[k] - min[k]) / STEP) as u32 } else { 0 }
            });
            let [a, b] = Vertex::pack_position(grid);
            [a, b, 0, 0].iter().for_each(|w| data.extend(w.to_le_bytes()));
        }
        for quad in
            [[0u16, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
        {
            for k in [0, 1, 2, 0, 2, 3] {
                data.extend(quad[k].to_le_bytes());
            }
        }
        skeleton.blobs.push(Blob {
            origin: moved(*min),
            step: STEP,
            offset: 0,
            bytes: data.len() as u64,
            vertices: 8,
            triangles: 12,
            classes: Class::OpaqueDouble.all(12),
            ..Blob::default()
        });
        bytes.push(data);
    }
    (skeleton, bytes)
}

/// Two rooms of 10 x 10 x 3 with a doorway between them and a pillar in each, Z up.
fn two_rooms() -> Vec<[[f64; 3]; 2]> {
    vec![
        [[0.0, 0.0, 0.0], [20.0, 10.0, 0.25]],
        [[0.0, 0.0, 3.0], [20.0, 10.0, 3.25]],
        [[0.0, 0.0, 0.0], [20.0, 0.25, 3.0]],
        [[0.0, 9.75, 0.0], [20.0, 10.0, 3.0]],
        [[0.0, 0.0, 0.0], [0.25, 10.0, 3.0]],
        [[19.75, 0.0, 0.0], [20.0, 10.0, 3.0]],
        [[9.875, 0.0, 0.0], [10.125, 4.0, 3.0]],
        [[9.875, 5.5, 0.0], [10.125, 10.0, 3.0]],
        [[4.0, 4.0, 0.0], [5.0, 5.0, 3.0]],
        [[15.0, 5.0, 0.0], [16.0, 6.0, 3.0]],
    ]
}

fn path(
    kind: PathKind,
    boxes: &[[[f64; 3]; 2]],
    up: [f64; 3],
    shift: f64,
    frames: u32,
    seed: u64,
) -> Vec<Pose> {
    let (skeleton, bytes) = scene(boxes, up, shift);
    let read = |id: BlobId| Ok::<_, Infallible>(&bytes[id.index()]);
    let poses = generate_within(CELLS, kind, &skeleton, read, frames, seed).unwrap();
    assert_eq!(poses.len(), frames as usize);
    let near = near_plane(&skeleton);
    assert_eq!(cameras(&poses, near).unwrap().len(), poses.len());
    poses
}

fn inside(p: [f64; 3], b: &[[f64; 3]; 2], margin: f64) -> bool {
    (0..3).all(|k| p[k] > b[0][k] - margin && p[k] < b[1][k] + margin)
}

const UP: [f64; 3] = [0.0, 0.0, 1.0];

#[test]
fn no_scene_no_frames_no_room() {
    let (mut skeleton, _) = scene(&[[[0.0; 3], [1.0; 3]]], UP, 0.0);
    let none = |_| Ok::<Vec<u8>, Infallible>(Vec::new());
    // A blob that is no mesh is an error, and only the walk reads it.
    let walked = generate_within(CELLS, PathKind::Walk, &skeleton, none, 3, 0);
    assert!(matches!(walked, Err(GenerateError::Geometry { .. })));
    assert_eq!(generate_within(CELLS, PathKind::Orbit, &skeleton, none, 0, 0).unwrap(), []);
    skeleton.hlods[0].max[1] = f64::NAN;
    let empty = generate_within(CELLS, PathKind::Orbit, &skeleton, none, 3, 0);
    assert!(matches!(empty, Err(GenerateError::EmptyScene)));
    skeleton.hlods.clear();
    assert!(matches!(
        generate_within(CELLS, PathKind::Zoom, &skeleton, none, 3, 0),
        Err(GenerateError::EmptyScene)
    ));
    // A point, and a bare plate.
    path(PathKind::Walk, &[[[2.0; 3], [2.0; 3]]], UP, 0.0, 30, 1);
    path(PathKind::Walk, &[[[0.0; 3], [50.0, 40.0, 0.0]]], UP, 0.0, 300, 1);
}

#[test]
fn a_walk_keeps_clear_of_walls_visits_both_rooms_and_stays_level() {
    let rooms = two_rooms();
    for seed in 0..3 {
        let poses = path(PathKind::Walk, &rooms, UP, 0.0, 6000, seed);
        for pose in &poses {
            assert!(inside(pose.eye, &[[0.0; 3], [20.0, 10.0, 3.25]], 0.0), "{pose:?}");
            assert!(!rooms.iter().any(|b| inside(pose.eye, b, 0.05)), "{pose:?}");
            let height = pose.eye[2] - 0.25;
            assert!((0.6..2.2).contains(&height), "{height}");
        }
        assert!(poses.iter().any(|p| p.eye[0] < 8.0) && poses.iter().any(|p| p.eye[0] > 12.0));
    }
}

#[test]
fn steps_are_even_and_turns_gentle() {
    // Long enough for the walk to turn round more than once.
    let poses = path(PathKind::Walk, &two_rooms(), UP, 0.0, 20_000, 5);
    let speed = SPEED_OF_DIAGONAL * (20.0f64 * 20.0 + 10.0 * 10.0 + 3.25 * 3.25).sqrt();
    let gaze = |p: &Pose| unit(minus(p.target, p.eye)).unwrap();
    let mut moved = 0.0;
    for pair in poses.windows(2) {
        let step = length(minus(pair[1].eye, pair[0].eye));
        moved += step;
        assert!(step <= speed * 1.001, "{step}");
        let turned = length(minus(gaze(&pair[1]), gaze(&pair[0])));
        assert!(turned < 0.05, "{turned}");
    }
    assert!(moved > 0.95 * speed * 19_999.0);
}

#[test]
fn a_pose_depends_on_its_index_and_the_seed_alone() {
    let rooms = two_rooms();
    let long = path(PathKind::Walk, &rooms, UP, 0.0, 3000, 9);
    for frames in (1..900).step_by(43) {
        let short = path(PathKind::Walk, &rooms, UP, 0.0, frames, 9);
        assert_eq!(short[..], long[..frames as usize], "{frames}");
    }
    assert_ne!(path(PathKind::Walk, &rooms, UP, 0.0, 17, 10)[..], long[..17]);
}

#[test]
fn a_scene_far_from_its_origin_and_one_that_hangs_in_the_air_are_walked_too() {
    let rooms = two_rooms();
    let moved = path(PathKind::Walk, &rooms, UP, 1e7, 500, 2);
    for pose in moved {
        let eye = pose.eye.map(|c| c - 1e7);
        assert!(!rooms.iter().any(|b| inside(eye, b, 0.01)), "{eye:?}");
    }
    // Without a floor (up along x, where the rooms are 20 high) the walk floats.
    let floating = [[[0.0, 0.0, 8.0], [2.5, 2.5, 10.5]], [[7.0, 7.0, 0.0], [9.5, 9.5, 2.5]]];
    for pose in path(PathKind::Walk, &floating, [-1.0, 0.0, 0.0], 0.0, 500, 2) {
        assert!(!floating.iter().any(|b| inside(pose.eye, b, 0.001)), "{pose:?}");
    }
}

#[test]
fn orbit_stays_outside_and_zoom_comes_near() {
    let rooms = two_rooms();
    let diagonal = (20.0f64 * 20.0 + 10.0 * 10.0 + 3.25 * 3.25).sqrt();
    let center = [10.0, 5.0, 1.625];
    for pose in path(PathKind::Orbit, &rooms, UP, 0.0, 48, 0) {
        assert!(length(minus(pose.eye, center)) > 0.5 * diagonal);
        assert!(pose.eye[2] > center[2]);
    }
    let zoom = path(PathKind::Zoom, &rooms, UP, 0.0, 48, 0);
    let distance = |p: &Pose| length(minus(p.eye, p.target));
    assert!((distance(&zoom[0]) / diagonal - 3.0).abs() < 1e-9);
    assert!(distance(&zoom[47]) < 0.05 * diagonal);
    assert!(zoom.windows(2).all(|w| distance(&w[1]) < distance(&w[0])));
    path(PathKind::Zoom, &rooms, UP, 0.0, 1, 0);
}

#[test]
fn a_longer_way_is_smoothed_to_the_same_beginning() {
    let grid = Grid::around([0.0; 3], [30.0; 3], UP, 60_000);
    let zigzag = |k: i32| [5.5 + f64::from(k) * 0.3, 5.5 + f64::from(k % 7), 6.5];
    let raw: Vec<Point> = (0..60).map(zigzag).collect();
    let whole = smooth(&grid, &raw);
    for count in [1, 13, 30, 59] {
        let part = smooth(&grid, &raw[..count]);
        assert_eq!(part[..], whole[..part.len()], "{count}");
    }
    assert!(whole.len() > 40);
}

#[test]
fn geometry_far_outside_of_the_box_is_an_error() {
    let (mut skeleton, bytes) = scene(&[[[0.0; 3], [10.0; 3]]], [0.0, 0.0, 1.0], 0.0);
    skeleton.transforms.push(Transform::IDENTITY);
    skeleton.parts[0].transform = 0;
    let walk = |skeleton: &Skeleton| {
        let read = |blob: BlobId| Ok::<_, Infallible>(&bytes[blob.index()]);
        generate_within(CELLS, PathKind::Walk, skeleton, read, 3, 1)
    };
    walk(&skeleton).unwrap();
    for far in [1e4, 1e18, 1e29, 1e301] {
        skeleton.transforms[0].linear[0][0] = far;
        assert!(matches!(walk(&skeleton), Err(GenerateError::Geometry { .. })), "{far}");
    }
}
