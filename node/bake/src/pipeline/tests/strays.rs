//! What lies far from everything else costs only itself.

use super::*;
use std::fmt::Write;

/// Corners of a box whose sides are whole micrometres.
fn house(at: DVec3) -> Vec<[DVec3; 3]> {
    let corner = |i: u32| {
        let pick = |bit: u32, length: f64| if i >> bit & 1 == 1 { length } else { 0.0 };
        at + DVec3::new(pick(0, 9.123457), pick(1, 6.000001), pick(2, 3.271593))
    };
    let faces =
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let halves = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    halves.map(|triangle| triangle.map(corner)).collect()
}

fn obj(triangles: &[[DVec3; 3]]) -> String {
    let mut text = String::from("o building\n");
    for corner in triangles.as_flattened() {
        writeln!(text, "v {:.6} {:.6} {:.6}", corner.x, corner.y, corner.z).unwrap();
    }
    for t in 0..triangles.len() {
        writeln!(text, "f {} {} {}", 3 * t + 1, 3 * t + 2, 3 * t + 3).unwrap();
    }
    text
}

/// With a vertex that no face uses, at the end.
fn ply(triangles: &[[DVec3; 3]]) -> String {
    let count = 3 * triangles.len();
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        count + 1,
        triangles.len()
    );
    for corner in triangles.as_flattened() {
        writeln!(text, "{:.6} {:.6} {:.6}", corner.x, corner.y, corner.z).unwrap();
    }
    writeln!(text, "-7e12 3e12 0").unwrap();
    for t in 0..triangles.len() {
        writeln!(text, "3 {} {} {}", 3 * t, 3 * t + 1, 3 * t + 2).unwrap();
    }
    text
}

fn stl(triangles: &[[DVec3; 3]]) -> String {
    let mut text = String::from("solid building\n");
    for triangle in triangles {
        text += "facet normal 0 0 0\nouter loop\n";
        for corner in triangle {
            writeln!(text, "vertex {:.6} {:.6} {:.6}", corner.x, corner.y, corner.z).unwrap();
        }
        text += "endloop\nendfacet\n";
    }
    text + "endsolid building\n"
}

#[test]
fn corners_beside_strays_stay_within_the_stated_grid() {
    let at = DVec3::new(471_234.567_891, 5_412_345.234_567, 623.456_789);
    let small = |at: DVec3, size: f64| [at, at + DVec3::X * size, at + DVec3::Y * size];
    let plane = [
        [DVec3::new(-3e6, 2e6, 0.0), DVec3::new(4e6, 2e6, 0.0), DVec3::new(4e6, 9e6, 0.0)],
        [DVec3::new(-3e6, 2e6, 0.0), DVec3::new(4e6, 9e6, 0.0), DVec3::new(-3e6, 9e6, 0.0)],
    ];
    let strays: [&[[DVec3; 3]]; 4] = [
        &[small(DVec3::ZERO, 1.0)],
        &[small(DVec3::ZERO, 1e-3)],
        &[small(DVec3::ZERO, 1.0), small(2.0 * at, 1.0)],
        &plane,
    ];
    let folder = tempfile::tempdir().unwrap();
    for (number, strays) in strays.into_iter().enumerate() {
        let house = house(at);
        // In the middle of the list.
        let triangles = [&house[..6], strays, &house[6..]].concat();
        for (ending, text) in
            [("obj", obj(&triangles)), ("ply", ply(&triangles)), ("stl", stl(&triangles))]
        {
            let input = folder.path().join(format!("{number}.{ending}"));
            let output = folder.path().join(format!("{number}-{ending}.occ"));
            std::fs::write(&input, text).unwrap();
            let summary = bake(&[input], &output, &Options::default(), &Silent).unwrap();
            let store = Store::open(&output).unwrap();
            let deep = sound(&store);
            let baked = Baked { folder: tempfile::tempdir().unwrap(), summary, store, deep };

            let mut found = vec![false; house.len()];
            for (_, leaf) in baked.leaves() {
                let level = &baked.skeleton().levels_of(leaf)[0];
                for triangle in baked.triangles(level) {
                    let apart = |own: &[DVec3; 3]| {
                        (0..3).map(|k| own[k].distance(triangle[k])).fold(0.0, f64::max)
                    };
                    let is_it = |own: &&[DVec3; 3]| apart(own) <= 0.01;
                    if let Some(place) = house.iter().position(|own| is_it(&own)) {
                        assert!(level.error < 1e-3, "{number} {ending}: {}", level.error);
                        assert!(apart(&house[place]) <= level.error, "{number} {ending}");
                        found[place] = true;
                    }
                }
            }
            assert!(found.iter().all(|found| *found), "{number} {ending}: {found:?}");

            // What is rounded all the same is said.
            let says = baked.summary.notes.iter().any(|note| note.contains("are rounded by up to"));
            assert_eq!(
                says,
                strays.len() == 2 && strays[1] == plane[1],
                "{:?}",
                baked.summary.notes
            );
        }
    }
}
