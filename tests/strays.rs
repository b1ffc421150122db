//! What lies kilometres away from a scene takes nothing from it: what is before the eye is drawn.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use std::fmt::Write;
use support::{Scene, fail, text};

/// Cubes with sides of two units around these places, an object each.
fn cubes(middles: &[[f64; 3]]) -> String {
    let mut obj = String::new();
    for (number, middle) in middles.iter().enumerate() {
        writeln!(obj, "o cube{number}").unwrap();
        for corner in 0..8u32 {
            let [x, y, z] = [0, 1, 2].map(|k| middle[k] + f64::from(corner >> k & 1) * 2.0 - 1.0);
            writeln!(obj, "v {x} {y} {z}").unwrap();
        }
        for [a, b, c, d] in
            [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]]
        {
            let at = 8 * number;
            writeln!(obj, "f {} {} {} {}", at + a, at + b, at + c, at + d).unwrap();
        }
    }
    obj
}

/// The scene of an OBJ, and a path of one pose whose last columns are `end`.
fn scene(obj: &str, end: [&str; 2]) -> (Scene, String) {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("scene.obj");
    std::fs::write(&source, obj).unwrap();
    let scene = Scene::bake(&source);
    let path = scene.file("path.csv");
    let header = "eye_x,eye_y,eye_z,target_x,target_y,target_z,up_x,up_y,up_z,fov_y_deg";
    let pose = "3,2,4,0,0,0,0,1,0,60";
    std::fs::write(&path, format!("{header}{}\n{pose}{}\n", end[0], end[1])).unwrap();
    let path = text(&path).to_owned();
    (scene, path)
}

#[test]
fn a_cube_before_the_eye_is_drawn_beside_a_stray() {
    for strays in [vec![], vec![[5e6, 0.0, 0.0]], vec![[3e6, -4e6, 0.0], [-3e6, 4e6, 1e6]]] {
        let (scene, path) = scene(&cubes(&[&[[0.0; 3]], &strays[..]].concat()), [""; 2]);
        for backend in support::backends() {
            let options = ["--path", &path, "--backend", backend, "--size", "64x64"];
            let more = ["--pictures", "png", "--processes", "1", "--audit", "every=1"];
            let run = scene.replay(backend, &[&options[..], &more].concat());
            run.assert_audited(backend);
            let picture = run.picture(0);
            assert_ne!(picture.get_pixel(32, 32), picture.get_pixel(0, 0), "{backend} {strays:?}");
            let near = run.number("/near/p50");
            assert!((1e-5..1e-2).contains(&near), "{near} {strays:?}");
        }
    }
}

#[test]
fn the_near_plane_is_where_flag_path_and_rig_say() {
    let (scene, path) = scene(&cubes(&[[0.0; 3]]), [",near", ",0.5"]);
    let rig = scene.file("rig.toml");
    std::fs::write(&rig, "near = 0.25\n").unwrap();
    let near = |name: &str, more: &[&str]| {
        let options = ["--path", &path, "--backend", "cpu", "--size", "8x8", "--processes", "1"];
        scene.replay(name, &[&options[..], more].concat()).number("/near/p50")
    };
    assert_eq!(near("path", &[]), 0.5);
    assert_eq!(near("rig", &["--rig", text(&rig)]), 0.25);
    assert_eq!(near("flag", &["--rig", text(&rig), "--near", "0.125"]), 0.125);
    for bad in ["0", "-1", "inf", "nan", "1e-60", "close"] {
        fail(&["replay", text(&scene.occ), &format!("--near={bad}")], 2, "--near");
    }
}
