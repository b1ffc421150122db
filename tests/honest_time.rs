//! The times of the log are what they are called: frames fill the run, work is in its frame, and what was
//! measured is known.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use serde_json::Value;
use support::{Run, Scene, text};

/// A column of numbers; where a frame has none, 0.
fn numbers(run: &Run, column: &str) -> Vec<f64> {
    run.column(column).iter().map(|value| value.parse().unwrap_or(0.0)).collect()
}

/// Milliseconds from the start of the first phase to the end of the last, and the sum of the phases, by the
/// trace.
fn phases(run: &Run) -> (f64, f64) {
    let trace = std::fs::read_to_string(run.out.join("trace.json")).unwrap();
    let trace: Value = serde_json::from_str(&trace).unwrap();
    let is_phase = |event: &&Value| {
        event["ph"] == "X" && event["name"].as_str().unwrap().starts_with("phase ")
    };
    let events = trace["traceEvents"].as_array().unwrap().iter().filter(is_phase);
    let spans: Vec<(f64, f64)> = events
        .map(|event| (event["ts"].as_f64().unwrap(), event["dur"].as_f64().unwrap()))
        .collect();
    let (first, last) = (spans[0], spans[spans.len() - 1]);
    ((last.0 + last.1 - first.0) / 1e3, spans.iter().map(|(_, length)| length).sum::<f64>() / 1e3)
}

#[test]
fn frame_times_fill_the_run_and_hold_their_work() {
    let scene = Scene::synth("plant", 200_000);
    let walk = scene.path("walk", 40);
    for schedule in ["switch", "rotate"] {
        for processes in ["1", "3"] {
            let what = format!("{schedule} {processes}");
            let options = ["--backend", "cpu", "--size", "256x256", "--path", text(&walk)];
            let rig = ["--schedule", schedule, "--processes", processes];
            let run = scene.replay(&what, &[&options[..], &rig].concat());

            let frame = numbers(&run, "frame_ms");
            let sum: f64 = frame.iter().sum();
            let (span, phases) = phases(&run);
            assert!((sum - span).abs() <= 1e-6 * span, "{what}: frames {sum}, run {span}");
            assert!((phases - span).abs() <= 1e-6 * span, "{what}: phases {phases}, run {span}");
            assert!((run.number("/span_ms") - span).abs() <= 1e-6 * span);
            assert!(numbers(&run, "lead_in_ms")[0] == run.number("/lead_in_ms"), "{what}");

            let work = numbers(&run, "work_ms");
            let parts =
                ["measuring_ms", "hand_over_ms", "lead_in_ms"].map(|part| numbers(&run, part));
            for i in 0..40 {
                assert!(
                    0.0 < work[i] && work[i] <= frame[i],
                    "{what}: {i}: {} {}",
                    work[i],
                    frame[i]
                );
                for part in &parts {
                    assert!(part[i] <= frame[i], "{what}: {i}: {} {}", part[i], frame[i]);
                }
            }
            assert!(numbers(&run, "hashing_ms").iter().all(|&ms| ms > 0.0), "{what}");
            run.hashes();
        }
    }
}

/// With nothing asked for an item buffer is drawn every eighth frame, and no other is measured.
#[test]
fn only_what_is_measured_counts_as_measured() {
    let scene = Scene::synth("plant", 200_000);
    let walk = scene.path("walk", 24);
    let options = ["--backend", "cpu", "--size", "256x256", "--path", text(&walk)];
    let run = scene.replay("plain", &options);
    let (measured, took) = (run.column("measured"), numbers(&run, "measuring_ms"));
    for i in 0..24 {
        let expected = i % 8 == 0;
        assert_eq!(measured[i] == "true", expected, "frame {i}");
        assert_eq!(took[i] > 0.0, expected, "frame {i}: {} ms", took[i]);
        assert_eq!(run.column("with_pixels")[i].is_empty(), !expected, "frame {i}");
        // In `switch` the next frame's picture waits for it.
        assert_eq!(run.column("camera_to_picture_ms")[i].is_empty(), i % 8 == 1, "frame {i}");
    }
    assert_eq!(run.number("/unmeasured_frames"), 21.0);
    assert_eq!(run.number("/latency_ms/camera_to_picture_frames"), 21.0);
    let all = scene.replay("audited", &[&options[..], &["--audit", "every=1"]].concat());
    assert_eq!(all.number("/unmeasured_frames"), 0.0);
    assert_eq!(all.number("/latency_ms/camera_to_picture_frames"), 1.0, "frame 0 alone");
}
