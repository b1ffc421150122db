//! Only the change of the visible set travels, coded at the least bits that its model allows.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use support::{REAL_SCENES, Run, Scene, real_scene, text};

/// Bytes of the code and of its bound over a whole path. No frame's code is below its bound, which is worked
/// out here from the counts alone.
fn code_and_bound(run: &Run, what: &str) -> (f64, f64) {
    let hlods = run.number("/scene/hlods");
    let column = |name: &str| -> Vec<f64> {
        run.column(name).iter().map(|value| value.parse().unwrap()).collect()
    };
    let (code, sent) = (column("ids_delta"), column("ids_sent"));
    let (leaving, entering) = (column("leaving"), column("entering"));
    let (visible, stated) = (column("visible"), column("entropy_bound"));
    let (mut sum, mut before) = ([0.0; 2], 0.0);
    for frame in 0..code.len() {
        let plain = choices(before, leaving[frame]) + choices(hlods - before, entering[frame]);
        // A change of more than 512 ids is cut, and each part has a bound of its own.
        if leaving[frame] + entering[frame] < 512.0 {
            assert!((plain / 8.0 - stated[frame]).abs() < 1e-6, "{what} frame {frame}: {plain}");
        }
        assert!(code[frame] >= stated[frame], "{what} frame {frame}: below its bound");
        assert!(
            sent[frame] >= code[frame],
            "{what} frame {frame}: sent in fewer bytes than it has"
        );
        assert_eq!(before - leaving[frame] + entering[frame], visible[frame], "{what} {frame}");
        before = visible[frame];
        sum = [sum[0] + code[frame], sum[1] + stated[frame]];
    }
    println!(
        "{what}: {:.2} bytes a frame, bound {:.2}, {:.4}; as sent {:.2}",
        sum[0] / code.len() as f64,
        sum[1] / code.len() as f64,
        sum[0] / sum[1],
        sent.iter().sum::<f64>() / code.len() as f64,
    );
    (sum[0], sum[1])
}

/// log2 C(among, chosen).
fn choices(among: f64, chosen: f64) -> f64 {
    (0..chosen as u32).map(|i| ((among - f64::from(i)) / f64::from(i + 1)).log2()).sum()
}

const SMALL: [&str; 4] = ["--backend", "cpu", "--size", "256x256"];

/// A frame pays up to two bits beyond the bound. A walk in a plant changes two ids a frame, so that is up to a
/// tenth of it there.
#[test]
fn deltas_along_a_walk_stay_near_the_entropy_bound() {
    let scene = Scene::synth("plant", 300_000);
    let walk = scene.path("walk", 60);
    let run = scene.replay("run", &[&SMALL[..], &["--path", text(&walk)]].concat());
    let (code, bound) = code_and_bound(&run, "plant");
    assert!(bound > 0.0, "the visible set changes");
    assert!(code <= 1.1 * bound, "{code} {bound}");
    let mean = |key: &str| run.number(&format!("/bandwidth/{key}"));
    assert!(mean("ids_delta") * 10.0 <= mean("ids_full"), "{}", run.summary["bandwidth"]);
    // An end of the frame is 36 bytes, and 37 beside its counts and code go with a chunk, 33 with the first
    // frame's, which has no base.
    let chunks = run.column("changed").iter().filter(|&&changed| changed != "0").count() as f64;
    let framing = 36.0 + (37.0 * chunks - 4.0) / run.number("/frames");
    for way in ["hc_to_or/mean", "hc_to_rvg/mean"] {
        let least = mean("ids_sent") + framing;
        assert!(mean(way) >= least - 1e-9, "{way}: {least}, {}", run.summary["bandwidth"]);
        assert!(mean(way) <= least + 10.0, "{way} carries something else: {least}");
    }
}

/// Whole rough paths through real scenes, where much changes with every frame.
#[test]
#[ignore = "bakes the real scenes"]
fn deltas_along_rough_paths_are_within_a_twentieth_of_the_bound() {
    for name in REAL_SCENES.into_iter().chain(["hall_long_parts"]) {
        let Some(glb) = real_scene(name) else { continue };
        let scene = Scene::bake(&glb);
        for seed in [11, 12] {
            let path = glb.with_file_name(format!("paths/{name}-{seed}.csv"));
            let named = format!("{name}-{seed}");
            let run = scene.replay(&named, &[&SMALL[..], &["--path", text(&path)]].concat());
            let (code, bound) = code_and_bound(&run, &named);
            assert!(code <= 1.05 * bound, "{named}: {code} {bound}");
        }
    }
}
