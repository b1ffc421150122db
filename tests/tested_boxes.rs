//! What is drawn was tested, and most of it is seen, wherever the eye is: in walls, among parts as long as
//! the scene, in a view that has just changed.
//!
//! The whole rough paths over all scenes, in release: `cargo test --release --test tested_boxes -- --ignored
//! --nocapture`, a quarter of an hour.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use std::path::{Path, PathBuf};
use support::{CPU, REAL_SCENES, Run, Scene, backends, real_scene, rough_path, text};

/// Most hlods drawn for one with a pixel, as sums over a path.
const MOST_DRAWN: f64 = 1.5;
/// Most of the visible set that may be untested on the GPU backend, where the eye is neither in the box nor
/// by it; the CPU backend tests all.
const MOST_UNTESTED: f64 = 0.03;

fn audited(scene: &Scene, backend: &str, path: &Path, size: &str) -> Run {
    let stem = path.file_stem().unwrap().to_str().unwrap();
    let options = ["--backend", backend, "--path", text(path), "--size", size];
    let options = [&options[..], &["--audit", "every=1"]].concat();
    let run = scene.replay(&format!("{backend}-{stem}"), &options);
    run.assert_audited(&format!("{backend} {}", path.display()));
    run
}

/// Drawn over seen, the untested share of the visible set, and the share that the eye is in or by.
fn shares(run: &Run) -> [f64; 3] {
    let of = |name: &str| run.number(&format!("/culling/{name}"));
    [of("efficiency"), of("untested") / of("visible"), of("at_eye") / of("visible")]
}

fn assert_tested(run: &Run, backend: &str, what: &str) {
    let [drawn, untested, _] = shares(run);
    let most_untested = if backend == CPU { 0.0 } else { MOST_UNTESTED };
    assert!(
        untested <= most_untested,
        "{backend} {what}: {untested} of what is visible is untested"
    );
    assert!(drawn <= MOST_DRAWN, "{backend} {what}: {drawn} hlods are drawn for one that is seen");
}

#[test]
fn on_a_way_through_everything_what_is_drawn_was_tested_and_is_mostly_seen() {
    let scene = match real_scene("hall_long_parts") {
        Some(glb) => Scene::bake(&glb),
        None => Scene::synth("pipes", 200_000),
    };
    let path = scene.path_by_seed("wander", 48, 11);
    for backend in backends() {
        let run = audited(&scene, backend, &path, "256x256");
        assert_tested(&run, backend, "hall");
        // The view comes out of things, so that there is something to look at twice.
        assert!(run.column("triangles_hc").iter().any(|&count| count != "0"), "{backend}");
    }
}

#[test]
#[ignore = "all scenes and paths at full length: run it in release"]
fn on_all_rough_paths_what_is_drawn_was_tested_and_is_mostly_seen() {
    let real = REAL_SCENES.into_iter().chain(["hall_long_parts"]);
    let real = real.filter_map(|name| Some((name, Scene::bake(&real_scene(name)?))));
    let plant = std::iter::once_with(|| ("plant", Scene::synth("plant", 12_700_000)));

    for (name, scene) in real.chain(plant) {
        let rough = |seed| {
            rough_path(name, seed).unwrap_or_else(|| scene.path_by_seed("wander", 120, seed))
        };
        let paths: [PathBuf; 3] = [scene.path("walk", 120), rough(11), rough(12)];
        for backend in backends() {
            for path in &paths {
                let run = audited(&scene, backend, path, "512x512");
                let [drawn, untested, at_eye] = shares(&run);
                println!(
                    "{name} {backend} {}: {} frames, 0 differing pixels, drawn / seen {drawn:.2}, untested \
                     {:.2}%, at the eye {:.2}%",
                    path.file_stem().unwrap().to_str().unwrap(),
                    run.rows.len(),
                    untested * 100.0,
                    at_eye * 100.0,
                );
                assert_tested(&run, backend, &format!("{name} {}", path.display()));
            }
        }
    }
}
