//! Culling on and off give the same bits, frame by frame, wherever the camera stands.
//!
//! The whole walks, orbits, zooms and rough paths over all scenes, in release: `cargo test --release --test
//! no_pixel_lost -- --ignored`.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use support::{REAL_SCENES, Run, Scene, backends, real_scene, rough_path, text};

const KINDS: [&str; 3] = ["walk", "orbit", "zoom"];

/// Replays with every frame audited.
fn audited(scene: &Scene, backend: &str, path: &Path, size: &str, cull: &str) -> Run {
    audited_as(scene, backend, path, size, cull, &[])
}

/// The same with more options.
fn audited_as(
    scene: &Scene,
    backend: &str,
    path: &Path,
    size: &str,
    cull: &str,
    more: &[&str],
) -> Run {
    let name = format!(
        "{backend}-{}-{size}-{cull}{}",
        path.file_stem().unwrap().to_str().unwrap(),
        more.concat()
    );
    let options = [
        "--backend",
        backend,
        "--path",
        text(path),
        "--size",
        size,
        "--cull",
        cull,
        "--audit",
        "every=1",
    ];
    let run = scene.replay(&name, &[&options[..], more].concat());
    run.assert_audited(&format!("{} {name}", scene.occ.display()));
    run
}

/// Every other frame of a walk and of an orbit in turn: each frame is a jump across the scene.
fn jumps(scene: &Scene, frames: u32) -> PathBuf {
    let lines = |kind| std::fs::read_to_string(scene.path(kind, frames)).unwrap();
    let (walk, orbit) = (lines("walk"), lines("orbit"));
    let mut text = walk.lines().next().unwrap().to_owned();
    for (a, b) in walk.lines().skip(1).zip(orbit.lines().skip(1)) {
        let _ = write!(text, "\n{a}\n{b}");
    }
    let path = scene.file("jumps.csv");
    std::fs::write(&path, text + "\n").unwrap();
    path
}

#[test]
fn generated_scenes_keep_every_pixel() {
    for (kind, triangles) in [("plant", 200_000), ("pipes", 200_000)] {
        let scene = Scene::synth(kind, triangles);
        for backend in backends() {
            let mut culled_something = false;
            for path in KINDS.map(|kind| scene.path(kind, 8)) {
                let run = audited(&scene, backend, &path, "161x97", "queries");
                culled_something |=
                    run.number("/culling/visible") < run.number("/culling/in_frustum");
            }
            audited(&scene, backend, &jumps(&scene, 4), "97x161", "boxes");
            assert!(culled_something, "{kind}: an audit of nothing culled says nothing");
        }
    }
}

#[test]
fn the_whole_scene_without_frustum_and_front_shows_no_more() {
    let scene = Scene::synth("plant", 200_000);
    let path = jumps(&scene, 3);
    for backend in backends() {
        for (lod, memory) in [("0", "1GiB"), ("1", "1GiB"), ("0", "3MiB")] {
            let more = ["--audit-against", "scene", "--lod", lod, "--memory", memory];
            let run = audited_as(&scene, backend, &path, "161x97", "queries", &more);
            let [front, held] =
                ["/culling/front", "/culling/in_frustum"].map(|key| run.number(key));
            assert!(held < front, "all is in the frustum: a weak test");
        }
    }
}

#[test]
fn real_scenes_keep_every_pixel() {
    for glb in REAL_SCENES.into_iter().filter_map(real_scene) {
        let scene = Scene::bake(&glb);
        for backend in backends() {
            for path in KINDS.map(|kind| scene.path(kind, 3)) {
                audited(&scene, backend, &path, "121x75", "queries");
            }
        }
    }
}

#[test]
#[ignore = "the whole sweep, minutes: run it in release"]
fn whole_walks_orbits_and_zooms_keep_every_pixel() {
    let generated =
        [("plant", 1_000_000), ("pipes", 1_000_000)].map(|(kind, n)| (kind, Scene::synth(kind, n)));
    let real = REAL_SCENES.into_iter().chain(["hall_long_parts"]);
    let real = real.filter_map(|name| Some((name, Scene::bake(&real_scene(name)?))));
    for (name, scene) in generated.into_iter().chain(real) {
        for backend in backends() {
            let [walk, orbit, zoom] = KINDS.map(|kind| scene.path(kind, 120));
            let runs = [
                (walk, "320x200", "queries"),
                (scene.path_by_seed("walk", 120, 2), "200x320", "boxes"),
                (orbit, "333x101", "queries"),
                (zoom, "320x200", "queries"),
                (jumps(&scene, 30), "101x333", "boxes"),
            ];
            let rough = [11, 12].map(|seed| {
                let made = || scene.path_by_seed("wander", 120, seed);
                (rough_path(name, seed).unwrap_or_else(made), "320x200", "queries")
            });
            for (path, size, cull) in runs.into_iter().chain(rough) {
                let run = audited(&scene, backend, &path, size, cull);
                let (visible, frustum) =
                    (run.number("/culling/visible"), run.number("/culling/in_frustum"));
                println!(
                    "{name} {backend} {} {size} {cull}: {} frames, 0 differing pixels, {visible:.0} of {frustum:.0} visible",
                    path.file_stem().unwrap().to_str().unwrap(),
                    run.rows.len()
                );
            }
        }
    }
}
