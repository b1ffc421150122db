//! Memory is an input: under any cap the pictures are those of all memory, and the cap holds.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use std::path::Path;
use support::{Run, Scene, backends, fail, occluster, succeed, text};

/// Bytes of the scene's meshes.
fn geometry_bytes(scene: &Scene) -> u64 {
    let output = succeed(&["inspect", text(&scene.occ), "--json"]);
    let inspected: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let bytes = &inspected["bytes"];
    bytes["vertices"].as_u64().unwrap() + bytes["indices"].as_u64().unwrap()
}

/// Bytes of the scene's skeleton, which are held whatever is drawn.
fn skeleton_bytes(scene: &Scene) -> u64 {
    let scene = protocol::format::read_skeleton(&scene.occ).unwrap();
    scene.skeleton.resident_bytes()
}

/// Assets that had to be waited for after the first frame, before which nothing can be foreseen.
fn misses_after_the_first(run: &Run) -> u64 {
    run.column("io_misses")[1..].iter().map(|count| count.parse::<u64>().unwrap()).sum()
}

/// No drawing took in more than 16 MiB of what it did not need, and some took in something.
fn assert_besides(run: &Run, what: &str) {
    let besides = run.column("io_besides");
    for (frame, bytes) in besides.iter().enumerate() {
        let bytes: u64 = bytes.parse().unwrap();
        assert!(bytes <= 16 << 20, "{what}: {bytes} bytes besides in frame {frame}");
    }
}

fn replay(scene: &Scene, name: &str, path: &Path, options: &[&str]) -> Run {
    let mut all = vec!["--path", text(path), "--size", "161x97"];
    all.extend(options);
    scene.replay(name, &all)
}

fn assert_within(run: &Run, cap: u64, what: &str) {
    for peak in run.summary["memory"]["peak_resident"].as_array().unwrap() {
        let peak = peak.as_u64().unwrap();
        assert!(peak <= cap, "{what}: {peak} of {cap} bytes");
    }
}

#[test]
fn under_any_cap_the_pictures_are_the_same_and_the_cap_holds() {
    let scene = Scene::synth("plant", 200_000);
    let (geometry, skeleton) = (geometry_bytes(&scene), skeleton_bytes(&scene));
    for backend in backends() {
        for kind in ["walk", "orbit", "zoom"] {
            let path = scene.path(kind, 12);
            let of = |name: &str, options: &[&str]| {
                let mut all = vec!["--backend", backend];
                all.extend(options);
                replay(&scene, &format!("{backend}-{kind}-{name}"), &path, &all)
            };
            let whole = of("whole", &["--prefetch", "off"]);
            let mut misses = 0;
            for (share, prefetch) in [(2, "on"), (4, "on"), (10, "on"), (10, "off")] {
                let cap = skeleton + (geometry / share).max(2 << 20);
                let name = format!("{share}-{prefetch}");
                let run = of(&name, &["--memory", &cap.to_string(), "--prefetch", prefetch]);
                assert_eq!(run.hashes(), whole.hashes(), "{backend} {kind} {name}");
                assert_within(&run, cap, &name);
                assert_besides(&run, &name);
                assert_eq!(run.number("/stand_ins/frames"), 0.0);
                assert_eq!(run.number("/memory/cap"), cap as f64);
                if prefetch == "off" {
                    assert_eq!(run.number("/io/prefetched"), 0.0);
                    let without = misses_after_the_first(&run);
                    assert!(2 * misses < without, "{backend} {kind}: {misses} of {without}");
                }
                misses = misses_after_the_first(&run);
            }
        }
    }
}

#[test]
fn a_frame_that_does_not_fit_is_drawn_in_parts() {
    let scene = Scene::synth("plant", 200_000);
    let path = scene.path("orbit", 3);
    for backend in backends() {
        let of = |name: &str, memory: &[&str]| {
            let mut options = vec!["--backend", backend, "--lod", "0", "--cull", "off"];
            options.extend(memory);
            replay(&scene, &format!("{backend}-{name}"), &path, &options)
        };
        let whole = of("whole", &[]);
        let cap = skeleton_bytes(&scene) + (2 << 20);
        let parts = of("parts", &["--memory", &cap.to_string()]);
        assert_eq!(parts.hashes(), whole.hashes(), "{backend}");
        assert_within(&parts, cap, backend);
        // Each frame reads what the one before had to give up.
        let read = parts.number("/io/bytes_read");
        assert!(read > 2.0 * f64::from(2 << 20), "{read}");
    }
}

#[test]
fn with_a_deadline_nothing_is_waited_for_and_the_error_is_told() {
    let scene = Scene::synth("plant", 200_000);
    let cap = skeleton_bytes(&scene) + (geometry_bytes(&scene) / 10).max(3 << 20);
    for backend in backends() {
        let path = scene.path("walk", 24);
        let memory = cap.to_string();
        let mut options =
            vec!["--backend", backend, "--residency", "deadline", "--memory", &memory];
        // What is read ahead is not late.
        options.extend(["--prefetch", "off"]);
        let run = replay(&scene, &format!("{backend}-deadline"), &path, &options);
        assert_within(&run, cap, backend);
        assert_eq!(run.number("/io/waits"), 0.0, "{}", run.summary["io"]);
        assert_besides(&run, backend);
        assert_eq!(run.number("/stand_ins/holes"), 0.0);
        assert!(run.number("/stand_ins/replaced") > 0.0, "nothing was ever late: a weak test");
        let exact = replay(&scene, &format!("{backend}-exact"), &path, &["--backend", backend]);
        let (late, errors) = (run.column("replaced"), run.column("stand_in_error_px"));
        let mut whole = 0;
        for (frame, (shown, truth)) in run.hashes().iter().zip(exact.hashes()).enumerate() {
            if late[frame] == "0" {
                assert_eq!(errors[frame].parse(), Ok(0.0));
                assert_eq!(*shown, truth, "frame {frame} is not marked and is not exact");
                whole += 1;
            }
        }
        assert!(whole > 0, "no frame was ever whole: a weak test");
    }
}

#[test]
fn an_audit_beside_a_deadline_takes_no_stand_in_for_a_lost_pixel() {
    let scene = Scene::synth("plant", 200_000);
    let cap = skeleton_bytes(&scene) + (geometry_bytes(&scene) / 10).max(3 << 20);
    let cap = cap.to_string();
    for backend in backends() {
        for against in ["front", "scene"] {
            let mut options = vec!["--backend", backend, "--residency", "deadline"];
            options.extend(["--memory", &cap, "--prefetch", "off"]);
            options.extend(["--audit", "every=1", "--audit-against", against]);
            let name = format!("{backend}-{against}-audited");
            let run = replay(&scene, &name, &scene.path("walk", 24), &options);
            run.assert_audited(&name);
            assert!(run.number("/stand_ins/replaced") > 0.0, "nothing was ever late: a weak test");
            let unknown = run.column("unknown_pixels");
            let frames = unknown.iter().zip(run.column("replaced"));
            for (&unknown, replaced) in frames {
                assert!(unknown == "0" || replaced != "0");
            }
            // Something is compared even where something stands in.
            let all = 161.0 * 97.0 * run.rows.len() as f64;
            assert!(run.number("/audit/unknown_pixels") < 0.9 * all, "{}", run.summary["audit"]);
        }
    }
}

#[test]
fn of_a_scene_that_fits_only_what_is_near_is_read() {
    let scene = Scene::synth("plant", 200_000);
    let (geometry, path) = (geometry_bytes(&scene), scene.path("walk", 12));
    for backend in backends() {
        let run = replay(&scene, &format!("{backend}-fits"), &path, &["--backend", backend]);
        let io = |name: &str| run.number(&format!("/io/{name}"));
        let read = io("bytes_read");
        let used = read - io("prefetched") + io("prefetched_used");
        // Three nodes: each would read all of it.
        assert!(read < 1.5 * geometry as f64, "{read} bytes of 3 * {geometry}");
        assert!(io("evicted") == 0.0 && used > 0.0, "{used} used of {read}");
        assert_besides(&run, backend);
    }
}

#[test]
fn too_little_memory_is_refused_with_what_is_needed() {
    let scene = Scene::synth("plant", 20_000);
    let options = ["replay", text(&scene.occ), "--frames", "2", "--memory", "1KiB"];
    fail(&options, 78, "--memory allows 1024 bytes a node, and this scene needs at least ");
    fail(&options, 78, "its skeleton takes ");
}

#[test]
fn a_damaged_mesh_is_named_and_something_coarser_is_shown() {
    let scene = Scene::synth("plant", 100_000);
    let path = scene.path("walk", 6);
    let whole = replay(&scene, "whole", &path, &["--backend", "cpu"]);
    // One byte of every mesh that lies in the first half of the file.
    let mut bytes = std::fs::read(&scene.occ).unwrap();
    for at in (448..bytes.len() / 2).step_by(1 << 12) {
        bytes[at] ^= 0x10;
    }
    let damaged = scene.file("damaged.occ");
    std::fs::write(&damaged, bytes).unwrap();
    let out = scene.file("out");
    for extra in [&[][..], &["--residency", "deadline"]] {
        let mut options = vec![
            "replay",
            text(&damaged),
            "--path",
            text(&path),
            "--size",
            "161x97",
            "--backend",
            "cpu",
        ];
        options.extend(["--out", text(&out)]);
        options.extend(extra);
        let output = occluster().args(&options).output().unwrap();
        assert_eq!(output.status.code(), Some(65));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains("damaged.occ: blob ") && said.contains("is damaged"), "{said}");
        let run = Run::read(&out);
        assert_eq!(run.rows.len(), whole.rows.len(), "all frames are shown");
        assert!(run.number("/io/faults") > 0.0 && run.number("/stand_ins/frames") > 0.0);
    }
}
