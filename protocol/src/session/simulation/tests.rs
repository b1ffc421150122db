//! What a run promises, whatever the network does.

use super::*;
use crate::session::{PEER_TIMEOUT, PHASE_LIMIT};

const SCHEDULES: [Schedule; 2] = [Schedule::Switch, Schedule::Rotate];

fn run(schedule: Schedule, frames: u32, seed: u64, fault: Fault) -> Simulation {
    Simulation::new(schedule, frames, seed, fault).run()
}

fn assert_complete(simulation: &Simulation, frames: u32) {
    assert!(simulation.endings.iter().all(|end| end == &Some(Ok(()))), "{:?}", simulation.endings);
    assert_eq!(simulation.rendered, (0..frames).map(FrameIndex).collect::<Vec<_>>());
    let mut hashed: Vec<u64> = simulation
        .trace
        .iter()
        .filter_map(|output| match output {
            CoordinatorOutput::Picture { frame, hash, .. } => {
                assert_eq!(*hash, u64::from(frame.0));
                Some(*hash)
            }
            _ => None,
        })
        .collect();
    hashed.sort_unstable();
    assert_eq!(hashed, (0..u64::from(frames)).collect::<Vec<_>>(), "no hash is lost");
}

/// The coordinator and every node that still lives have failed, and the coordinator names `name`.
fn assert_failed(simulation: &Simulation, name: &str, context: &str) {
    let Some(Err((_, reason))) = &simulation.endings[COORDINATOR] else {
        panic!("{context}: {:?}", simulation.endings);
    };
    assert!(reason.contains(name), "{context}: {reason}");
    let failed = simulation.endings[..3].iter().filter(|end| matches!(end, Some(Err(_)))).count();
    assert!(failed >= 2, "{context}: {:?}", simulation.endings);
}

#[test]
fn every_frame_is_drawn_once_with_its_set_whatever_the_network_does() {
    for schedule in SCHEDULES {
        for frames in [1, 2, 3, 4, 12] {
            for seed in 0..20 {
                let simulation = run(schedule, frames, seed, Fault::None);
                assert_complete(&simulation, frames);
                assert_eq!(simulation.whole_sets_wanted, 0);
            }
        }
    }
}

#[test]
fn a_seed_repeats_a_run() {
    for schedule in SCHEDULES {
        let traces = [0, 0, 1].map(|seed| run(schedule, 6, seed, Fault::None).trace);
        assert_eq!(traces[0], traces[1]);
        assert_ne!(traces[0], traces[2]);
    }
}

#[test]
fn reports_say_what_changed_and_what_it_cost() {
    let simulation = run(Schedule::Switch, 9, 0, Fault::None);
    let cull = |frame: u32| {
        let reports = simulation.trace.iter().filter_map(|output| match output {
            CoordinatorOutput::Report { report, .. } => report.work,
            _ => None,
        });
        let mut culls = reports.filter(|work| work.frame == FrameIndex(frame));
        culls.find_map(|work| work.cull).unwrap()
    };
    let counts = |frame| (cull(frame).visible, cull(frame).leaving, cull(frame).entering);
    assert_eq!((counts(0), cull(0).ids_full), ((400, 0, 400), 1600));
    assert_eq!((cull(1).leaving, cull(1).entering), (0, 0));
    assert_eq!((cull(1).ids_delta_bits, cull(1).ids_sent), (0, 0));
    assert!(cull(2).leaving > 0 && cull(2).leaving == cull(2).entering);
    assert!(cull(2).ids_bound_bits > 0.0);
    assert!(f64::from(cull(2).ids_delta_bits) >= cull(2).ids_bound_bits);
    assert_eq!(counts(3), (0, 400, 0));
}

#[test]
fn clocks_are_found_within_the_error_that_is_stated() {
    let simulation = run(Schedule::Switch, 1, 3, Fault::None);
    let mut clocks = 0;
    for output in &simulation.trace {
        if let CoordinatorOutput::Clock { seat, offset, error, .. } = output {
            let node = simulation.node_of_seat[seat];
            let truth = simulation.now as i64 - simulation.clock(node) as i64;
            assert!(truth.abs_diff(*offset) <= *error, "{truth} {offset} {error}");
            assert!(*error < 2 * MS);
            clocks += 1;
        }
    }
    assert_eq!(clocks, 3);
}

#[test]
fn a_wrong_base_is_mended_by_the_whole_set() {
    for schedule in SCHEDULES {
        for (seat, frame) in (0..3).flat_map(|seat| (3..9).map(move |frame| (seat, frame))) {
            let mut wanted = 0;
            for seed in 0..3 {
                let simulation = run(schedule, 10, seed, Fault::Corrupts { seat, frame });
                assert_complete(&simulation, 10);
                wanted += simulation.whole_sets_wanted;
            }
            // The base of frame 4 is empty anyway in `switch`, as is that of frame 6 in `rotate`; in
            // `rotate` the seat that draws neither sends nor receives.
            let is_empty = schedule::delta_base(schedule, FrameIndex(frame)) == Some(FrameIndex(3));
            let draws = schedule == Schedule::Rotate && (u32::from(seat) + 1) % 3 == frame % 3;
            assert_eq!(wanted > 0, !is_empty && !draws, "{schedule:?} seat {seat} frame {frame}");
        }
    }
}

#[test]
fn the_loss_of_any_peer_at_any_step_ends_all_and_names_it() {
    for schedule in SCHEDULES {
        let whole = run(schedule, 4, 1, Fault::None).steps;
        let bye = 40;
        for seat in 0..3 {
            for after in (0..whole - bye).step_by(3) {
                for in_flight_lost in [false, true] {
                    let fault = Fault::Dies { seat, after, in_flight_lost };
                    let simulation = run(schedule, 4, 1, fault);
                    assert_failed(&simulation, &format!("seat {seat}"), &format!("{fault:?}"));
                }
            }
        }
    }
}

#[test]
fn a_node_that_hangs_is_given_up_and_named() {
    for seat in 0..3 {
        let fault = Fault::Hangs { seat, after: 350 };
        let simulation = run(Schedule::Switch, 12, 2, fault);
        assert_failed(&simulation, &format!("seat {seat} has been silent"), "hang");
        assert!(simulation.now >= PEER_TIMEOUT);
    }
}

/// HC, OR and RVG alike; who waits for the visible set of a stalled HC is not blamed.
#[test]
fn a_render_thread_that_hangs_is_named_with_its_work_and_for_how_long() {
    for schedule in SCHEDULES {
        for seat in 0..3 {
            for frame in 0..6 {
                let simulation = run(schedule, 12, 4, Fault::Stalls { seat, frame });
                if simulation.now < PHASE_LIMIT {
                    // Not this seat's frame.
                    assert_complete(&simulation, 12);
                    continue;
                }
                let context = format!("{schedule:?} seat {seat} frame {frame}");
                assert_failed(&simulation, &format!("seat {seat} has been at "), &context);
                let Some(Err((kind, reason))) = &simulation.endings[COORDINATOR] else { panic!() };
                assert_eq!(*kind, FailureKind::Unavailable);
                assert!(reason.contains(&format!("({frame}) for 6")), "{context}: {reason}");
                assert_eq!(reason.matches("seat ").count(), 1, "{context}: {reason}");
            }
        }
    }
    let stalled =
        [0, 1, 2].map(|seat| run(Schedule::Switch, 12, 4, Fault::Stalls { seat, frame: 3 }));
    let ends = stalled.map(|simulation| simulation.now >= PHASE_LIMIT);
    assert_eq!(ends, [false, true, true], "frame 3 is seat 1's to cull and seat 2's to draw");
}

#[test]
fn a_picture_that_is_never_hashed_is_not_waited_for_for_ever() {
    for frame in [0, 4] {
        let simulation = run(Schedule::Switch, 5, 6, Fault::LosesHash { seat: 2, frame });
        let Some(Err((kind, reason))) = &simulation.endings[COORDINATOR] else { panic!() };
        assert_eq!(*kind, FailureKind::Unavailable);
        assert!(reason.starts_with("seat 2 has 1 pictures not hashed"), "{reason}");
        assert!(simulation.now >= PHASE_LIMIT);
    }
}

#[test]
fn a_cut_between_two_nodes_alone_is_found() {
    for seats in [[0, 1], [1, 2], [0, 2]] {
        let fault = Fault::Cut { seats, after: 350 };
        let simulation = run(Schedule::Switch, 12, 3, fault);
        let Some(Err((kind, reason))) = &simulation.endings[COORDINATOR] else { panic!() };
        assert_eq!(*kind, FailureKind::Unavailable);
        assert!(seats.iter().all(|seat| reason.contains(&format!("seat {seat}"))), "{reason}");
    }
}
