//! What a run promises, whatever the network does.

use super::*;
use crate::session::PEER_TIMEOUT;

const SCHEDULES: [Schedule; 2] = [Schedule::Switch, Schedule::Rotate];

fn run(schedule: Schedule, frames: u32, seed: u64, fault: Fault) -> Simulation {
    Simulation::new(schedule, frames, seed, fault).run()
}

fn assert_complete(simulation: &Simulation, frames: u32) {
    assert!(simulation.endings.iter().all(|end| end == &Some(Ok(()))), "{:?}", simulation.endings);
    assert_eq!(simulation.rendered, (0..frames).map(FrameIndex).collect::<Vec<_>>());
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
    assert_eq!((cull(0).visible, cull(0).changed, cull(0).ids_full), (400, 400, 1600));
    assert_eq!((cull(1).changed, cull(1).ids_delta), (0, 0));
    assert!(cull(2).changed > 0 && cull(2).ids_delta > 0);
    assert_eq!((cull(3).visible, cull(3).changed), (0, 400));
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

#[test]
fn a_cut_between_two_nodes_alone_is_found() {
    for seats in [[0, 1], [1, 2], [0, 2]] {
        let fault = Fault::Cut { seats, after: 350 };
        let simulation = run(Schedule::Switch, 12, 2, fault);
        let Some(Err((kind, reason))) = &simulation.endings[COORDINATOR] else { panic!() };
        assert_eq!(*kind, FailureKind::Unavailable);
        assert!(seats.iter().all(|seat| reason.contains(&format!("seat {seat}"))), "{reason}");
    }
}
