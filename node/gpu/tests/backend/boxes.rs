//! Box tests: queries against marks, against pictures of the same boxes, and the inclusive depth test.

use crate::support::{
    Mesh, backend, backend_with, cube_over, items, lists, occluders, random_box, view, visible,
};
use protocol::settings::Cull;
use rand::SeedableRng;
use rand::rngs::StdRng;
use scene::backend::{Backend, BoxQuery, Completion, Draw, Part, Pass, Shading, View};
use scene::occludee::Rules;

fn scene(random: &mut StdRng, boxes: usize) -> (Vec<Draw>, Vec<BoxQuery>) {
    let walls = (0..60).map(|item| cube_over(0, item, &random_box(random, 96..400, 120))).collect();
    (walls, (0..boxes).map(|_| random_box(random, 64..2000, 60)).collect())
}

#[test]
fn queries_and_marks_give_the_same_answers() {
    let Some(mut backend) = backend(160, 120) else { return };
    let view = view(160, 120);
    Mesh::cube(0).upload(&mut backend, 0);
    for seed in 0..3 {
        let (walls, boxes) = scene(&mut StdRng::seed_from_u64(seed), 5000);
        occluders(&mut backend, view, &walls);
        let queries = visible(&mut backend, view, &boxes, Cull::Queries);
        let marks = visible(&mut backend, view, &boxes, Cull::Boxes);
        assert_eq!(queries.len(), boxes.len());
        assert_eq!(queries, marks);
        let shown = queries.iter().filter(|&&v| v).count();
        assert!((500..4500).contains(&shown), "{shown} of 5000 visible proves little");
    }
}

#[test]
fn no_box_with_a_visible_pixel_is_reported_hidden() {
    let Some(mut backend) = backend(64, 64) else { return };
    let view = view(64, 64);
    Mesh::cube(0).upload(&mut backend, 0);
    let (walls, boxes) = scene(&mut StdRng::seed_from_u64(11), 200);
    occluders(&mut backend, view, &walls);
    let answers = visible(&mut backend, view, &boxes, Cull::Queries);
    let mut too_many = 0;
    for (i, (b, &answer)) in boxes.iter().zip(&answers).enumerate() {
        let mut draws = walls.clone();
        draws.push(cube_over(0, 1000, b));
        let seen = items(&mut backend, view, &draws).contains(&1000);
        assert!(answer || !seen, "box {i} {b:?} is seen");
        too_many += usize::from(answer && !seen);
    }
    assert!(too_many <= 2, "{too_many} of 200 boxes are reported visible and never seen");
}

/// One pixel whose ray runs along `axis`, towards its sign, and meets `(u, v)` on the two other axes at
/// distance 2.
fn ray(axis: usize, sign: f32, u: f32, v: f32) -> View {
    let mut columns = [[0.0; 4]; 4];
    columns[axis] = [-u * 0.5 * sign, -v * 0.5 * sign, 0.0, sign];
    columns[(axis + 1) % 3][0] = 1.0;
    columns[(axis + 2) % 3][1] = 1.0;
    columns[3] = view(1, 1).clip_from_eye[3];
    View { clip_from_eye: columns, ..view(1, 1) }
}

/// A box along `axis` from one distance to another, and `half` as wide on both sides.
fn slab(axis: usize, sign: f32, distances: [f32; 2], half: f32) -> BoxQuery {
    let mut b = BoxQuery { min: [-half; 3], max: [half; 3] };
    let ends = distances.map(|distance| distance * sign);
    (b.min[axis], b.max[axis]) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    b
}

#[test]
fn every_corner_of_every_face_counts() {
    let Some(mut backend) = backend(1, 1) else { return };
    Mesh::cube(0).upload(&mut backend, 0);
    for (axis, sign) in [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (2, -1.0), (2, 1.0)] {
        let tested = slab(axis, sign, [2.0, 3.0], 0.5);
        // Between the front face and the back one: the front face alone is in sight. Then before both.
        for (wall, expected) in [([2.0625, 2.5], true), ([1.5, 1.75], false)] {
            let wall = cube_over(0, 0, &slab(axis, sign, wall, 8.0));
            for (u, v) in [(0.4, 0.3), (-0.4, 0.3), (0.4, -0.3), (-0.4, -0.3)] {
                let view = ray(axis, sign, u, v);
                occluders(&mut backend, view, &[wall]);
                for method in [Cull::Queries, Cull::Boxes] {
                    let answers = visible(&mut backend, view, &[tested], method);
                    assert_eq!(answers, [expected], "axis {axis} {sign} at {u} {v} {method:?}");
                }
            }
        }
    }
}

#[test]
fn an_exclusive_depth_test_hides_an_occluder_by_itself() {
    let own = BoxQuery { min: [-0.5, -0.5, -3.0], max: [0.5, 0.5, -2.0] };
    for inclusive in [true, false] {
        let rules = Rules { depth_test_inclusive: inclusive, ..Rules::default() };
        let Some(mut backend) = backend_with(65, 65, &rules) else { return };
        Mesh::cube(0).upload(&mut backend, 0);
        occluders(&mut backend, view(65, 65), &[cube_over(0, 0, &own)]);
        for method in [Cull::Queries, Cull::Boxes] {
            let answers = visible(&mut backend, view(65, 65), &[own], method);
            assert_eq!(answers, [inclusive], "{method:?}");
        }
    }
}

#[test]
fn answers_stream_in_order_and_depth_stays_as_it_is() {
    let Some(mut backend) = backend(64, 64) else { return };
    let view = view(64, 64);
    Mesh::cube(0).upload(&mut backend, 0);
    let (walls, boxes) = scene(&mut StdRng::seed_from_u64(5), 9000);
    let query = Pass::QueryBoxes { view, boxes, method: Cull::Queries };
    // Two tests around a picture, all submitted before the first poll.
    let part = Part::WHOLE;
    let pass = Pass::Occluders { view, draws: walls.clone(), adds: false, part };
    let occluders = backend.submit(pass).unwrap();
    let first = backend.submit(query.clone()).unwrap();
    let shade = Pass::Shade {
        view,
        shading: Shading::default(),
        draws: lists(&walls[..1]),
        with_depth: false,
        part,
    };
    let picture = backend.submit(shade).unwrap();
    let second = backend.submit(query).unwrap();
    let mut completions = Vec::new();
    while completions.len() < 8 {
        backend.poll(&mut completions).unwrap();
    }
    let mut answers = [Vec::new(), Vec::new()];
    let mut order = Vec::new();
    for completion in completions {
        match completion {
            Completion::Occluders { ticket } => order.push((ticket, 0, true)),
            Completion::Picture { ticket, picture } => {
                assert_eq!(picture.depth, None);
                order.push((ticket, 0, true));
            }
            Completion::Boxes { ticket, first: at, visible, last } => {
                order.push((ticket, at, last));
                answers[usize::from(ticket == second)].extend(visible);
            }
            Completion::Items { .. } => panic!("no items were asked for"),
        }
    }
    let parts = |ticket| [(ticket, 0, false), (ticket, 4096, false), (ticket, 8192, true)];
    let mut expected = vec![(occluders, 0, true)];
    expected.extend(parts(first));
    expected.push((picture, 0, true));
    expected.extend(parts(second));
    assert_eq!(order, expected);
    assert_eq!(answers[0].len(), 9000);
    assert_eq!(answers[0], answers[1]);
}
