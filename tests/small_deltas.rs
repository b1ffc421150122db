//! Only the change of the visible set travels, coded close to the bound that any code has.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use support::{Scene, text};

#[test]
fn deltas_along_a_walk_stay_near_the_entropy_bound() {
    let scene = Scene::synth("plant", 300_000);
    let walk = scene.path("walk", 60);
    let run =
        scene.replay("run", &["--backend", "cpu", "--size", "256x256", "--path", text(&walk)]);
    let mean = |key: &str| run.number(&format!("/bandwidth/{key}"));
    assert!(mean("entropy_bound") > 0.0, "the visible set changes");
    assert!(mean("ids_delta") <= 1.2 * mean("entropy_bound"), "{}", run.summary["bandwidth"]);
    assert!(mean("ids_delta") * 10.0 <= mean("ids_full"), "{}", run.summary["bandwidth"]);
    assert!(mean("hc_to_or/mean") >= mean("ids_delta"), "the socket carries at least the ids");
    assert!(mean("hc_to_rvg/mean") >= mean("ids_delta"), "the socket carries at least the ids");
}
