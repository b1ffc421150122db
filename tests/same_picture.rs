//! Three processes give the pictures that one gives, `rotate` those of `switch`, a second replay those
//! of the first, on every backend.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use support::{Scene, backends, text};

#[test]
fn pictures_do_not_depend_on_processes_schedule_or_repetition() {
    let scene = Scene::synth("plant", 200_000);
    let walk = scene.path("walk", 12);
    for backend in backends() {
        let replay = |name: &str, options: &[&str]| {
            let mut all = vec!["--backend", backend, "--size", "200x120", "--path", text(&walk)];
            all.extend(options);
            scene.replay(&format!("{backend}-{name}"), &all)
        };
        let three = replay("three", &["--processes", "3"]);
        let expected = three.hashes();
        assert_eq!(expected.len(), 12);
        assert!(
            expected.iter().collect::<std::collections::BTreeSet<_>>().len() > 6,
            "the walk moves"
        );
        assert_eq!(replay("again", &["--processes", "3"]).hashes(), expected, "{backend}: again");
        assert_eq!(
            replay("one", &["--processes", "1"]).hashes(),
            expected,
            "{backend}: one process"
        );
        assert_eq!(
            replay("rotate", &["--schedule", "rotate"]).hashes(),
            expected,
            "{backend}: rotate"
        );
        let rotate_one = replay("rotate-one", &["--schedule", "rotate", "--processes", "1"]);
        assert_eq!(rotate_one.hashes(), expected, "{backend}: rotate in one process");
        assert_eq!(replay("boxes", &["--cull", "boxes"]).hashes(), expected, "{backend}: boxes");
        assert_eq!(replay("off", &["--cull", "off"]).hashes(), expected, "{backend}: no culling");
        assert_eq!(three.summary["pids"].as_array().unwrap().len(), 3);
        assert_eq!(rotate_one.summary["pids"].as_array().unwrap().len(), 1);
    }
}
