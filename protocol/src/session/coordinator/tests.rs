//! Who is let in, and what ends a run.

use super::*;
use crate::settings::{AuditAgainst, BackendChoice, Cull, PictureSize, Residency, Schedule};
use crate::sun::Sun;

const TOKEN: Token = Token([4; 32]);

fn coordinator() -> Coordinator {
    coordinator_with(Policy::default())
}

fn coordinator_with(policy: Policy) -> Coordinator {
    let settings = RunSettings {
        scene_path: "plant.occ".into(),
        scene_digest: [1; 32],
        size: PictureSize { width: 8, height: 8 },
        lod_px: 1.0,
        sun: Sun::default(),
        cull: Cull::Queries,
        schedule: Schedule::Switch,
        backend: BackendChoice::Auto,
        frames: 1,
        audit_every: 0,
        audit_against: AuditAgainst::Front,
        items_every: 0,
        memory: None,
        residency: Residency::Exact,
        prefetch: true,
        far: crate::settings::Far::Off,
        far_cubes: 8,
        far_triangles: None,
        pictures_dir: None,
    };
    let camera = Camera::look_at([0.0; 3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], 60.0, 0.1).unwrap();
    let mut coordinator = Coordinator::new(0, TOKEN, settings, vec![camera], policy);
    (0..5).for_each(|link| coordinator.handle_connected(0, LinkId(link)));
    coordinator
}

fn hello(version: u32, token: Token) -> Message {
    Message::Hello { version, token, peer_address: "h:1".into(), pid: 6 }
}

fn outputs(coordinator: &mut Coordinator) -> Vec<Output> {
    std::iter::from_fn(|| coordinator.poll_output()).collect()
}

/// All three seats taken, nothing left to do.
fn seated() -> Coordinator {
    seated_with(Policy::default())
}

fn seated_with(policy: Policy) -> Coordinator {
    let mut coordinator = coordinator_with(policy);
    for link in 0..3 {
        coordinator.handle_message(0, LinkId(link), hello(WIRE_VERSION, TOKEN));
    }
    outputs(&mut coordinator);
    coordinator
}

fn failure(outputs: &[Output]) -> Option<(FailureKind, &str)> {
    outputs.iter().find_map(|output| match output {
        Output::Failed { kind, reason } => Some((*kind, reason.as_str())),
        _ => None,
    })
}

#[test]
fn a_stranger_is_hung_up_on_and_told_nothing() {
    for message in [hello(WIRE_VERSION, Token([0; 32])), hello(0, Token([0; 32])), Message::Bye] {
        let mut coordinator = coordinator();
        coordinator.handle_message(0, LinkId(2), message);
        let outputs = outputs(&mut coordinator);
        assert!(matches!(outputs[..], [Output::Close { link: LinkId(2), .. }]), "{outputs:?}");
    }
}

#[test]
fn another_version_with_the_token_is_told_and_ends_the_run() {
    let mut coordinator = coordinator();
    coordinator.handle_message(0, LinkId(0), hello(WIRE_VERSION, TOKEN));
    outputs(&mut coordinator);
    coordinator.handle_message(0, LinkId(1), hello(WIRE_VERSION + 1, TOKEN));
    let outputs = outputs(&mut coordinator);
    for link in [LinkId(0), LinkId(1)] {
        let told = |output: &&Output| matches!(output, Output::Send { to, message: Message::Failed { .. } } if *to == link);
        assert_eq!(outputs.iter().filter(told).count(), 1, "{link:?}");
    }
    let (kind, reason) = failure(&outputs).unwrap();
    assert_eq!(kind, FailureKind::Protocol);
    let own = format!("version {WIRE_VERSION}");
    assert!(reason.contains("process 6") && reason.contains(&own), "{reason}");
}

#[test]
fn a_fourth_node_is_refused_and_the_run_goes_on() {
    let mut coordinator = seated();
    coordinator.handle_message(0, LinkId(3), hello(WIRE_VERSION, TOKEN));
    let outputs = outputs(&mut coordinator);
    let [
        Output::Send { to: LinkId(3), message: Message::Failed { kind, .. } },
        Output::Close { .. },
    ] = &outputs[..]
    else {
        panic!("{outputs:?}");
    };
    assert_eq!(*kind, FailureKind::NotAllowed);
}

#[test]
fn a_link_that_says_nothing_is_closed_after_ten_seconds() {
    let mut coordinator = seated();
    coordinator.handle_timeout(HELLO_TIMEOUT - 1);
    let closed = |outputs: &[Output]| {
        outputs.iter().filter(|output| matches!(output, Output::Close { .. })).count()
    };
    assert_eq!(closed(&outputs(&mut coordinator)), 0);
    coordinator.handle_timeout(HELLO_TIMEOUT);
    assert_eq!(closed(&outputs(&mut coordinator)), 2);
    coordinator.handle_message(HELLO_TIMEOUT, LinkId(3), hello(WIRE_VERSION, TOKEN));
    assert_eq!(outputs(&mut coordinator), []);
}

#[test]
fn another_scene_is_not_allowed() {
    let mut coordinator = seated();
    let backend = BackendInfo { name: "cpu".into(), driver: String::new() };
    coordinator.handle_message(0, LinkId(1), Message::Ready { scene_digest: [2; 32], backend });
    let outputs = outputs(&mut coordinator);
    assert_eq!(failure(&outputs).map(|(kind, _)| kind), Some(FailureKind::NotAllowed));
}

/// What follows when seat 2 draws with another driver than the others.
fn mixed_seats(policy: Policy) -> Vec<Output> {
    let mut coordinator = seated_with(policy);
    for (link, driver) in [(0, "vega"), (1, "vega"), (2, "llvmpipe")] {
        let backend = BackendInfo { name: "gpu".into(), driver: driver.into() };
        let ready = Message::Ready { scene_digest: [1; 32], backend };
        coordinator.handle_message(0, LinkId(link), ready);
    }
    outputs(&mut coordinator)
}

#[test]
fn seats_with_different_renderers_are_refused_unless_that_is_wanted() {
    let refused = mixed_seats(Policy::default());
    let (kind, reason) = failure(&refused).unwrap();
    assert_eq!(kind, FailureKind::NotAllowed);
    for said in ["seat 0 with gpu (vega)", "seat 2 with gpu (llvmpipe)", "--mixed"] {
        assert!(reason.contains(said), "{reason}");
    }
    let wanted = mixed_seats(Policy { mixed: true, ..Policy::default() });
    assert_eq!(failure(&wanted), None);
    let pinged =
        |output: &&Output| matches!(output, Output::Send { message: Message::Ping { .. }, .. });
    assert_eq!(wanted.iter().filter(pinged).count(), 3, "the run goes on");
}

/// Phase -1 under way, in which seat 0 makes the depth of frame 0.
fn running() -> Coordinator {
    let mut coordinator = seated();
    for link in 0..3 {
        let backend = BackendInfo { name: "cpu".into(), driver: String::new() };
        let ready = Message::Ready { scene_digest: [1; 32], backend };
        coordinator.handle_message(0, LinkId(link), ready);
    }
    let mut pings: VecDeque<Output> = outputs(&mut coordinator).into();
    while let Some(output) = pings.pop_front() {
        if let Output::Send { to, message: Message::Ping { sequence, sent } } = output {
            let pong = Message::Pong { sequence, sent, answered: 0 };
            coordinator.handle_message(0, to, pong);
            pings.extend(outputs(&mut coordinator));
        }
    }
    assert_eq!(coordinator.stage, Stage::Running(Phase::FIRST));
    coordinator
}

#[test]
fn pictures_are_hashed_once_and_by_who_draws_them() {
    let hash = |frame| Message::PictureHash { frame: FrameIndex(frame), hash: 1, hashing: 2 };
    // Frame 0 is drawn by seat 2, in the phase after this one.
    for (link, frame) in [(0, 0), (2, 0), (2, 1)] {
        let mut coordinator = running();
        coordinator.handle_message(0, LinkId(link), hash(frame));
        let outputs = outputs(&mut coordinator);
        assert_eq!(failure(&outputs).map(|(kind, _)| kind), Some(FailureKind::Protocol));
    }
    let mut coordinator = running();
    coordinator.stage = Stage::Finishing;
    coordinator.handle_message(0, LinkId(2), hash(0));
    let [Output::Picture { frame: FrameIndex(0), .. }] = outputs(&mut coordinator)[..] else {
        panic!("a hash of its own in its time")
    };
    coordinator.handle_message(0, LinkId(2), hash(0));
    assert!(failure(&outputs(&mut coordinator)).is_some());
}

#[test]
fn nobody_takes_leave_before_its_pictures_are_hashed() {
    let mut coordinator = running();
    coordinator.stage = Stage::Finishing;
    coordinator.handle_message(0, LinkId(0), Message::Bye);
    assert_eq!(failure(&outputs(&mut coordinator)), None, "seat 0 draws no picture");
    coordinator.handle_message(0, LinkId(2), Message::Bye);
    let outputs = outputs(&mut coordinator);
    let (_, reason) = failure(&outputs).unwrap();
    assert!(reason.starts_with("seat 2") && reason.contains("frame 0"), "{reason}");
}

#[test]
fn a_node_s_failure_keeps_its_kind_and_reaches_the_others() {
    let mut coordinator = seated();
    let reason = "x".repeat(100_000);
    let failed = Message::Failed { kind: FailureKind::BadData, reason };
    coordinator.handle_message(0, LinkId(2), failed);
    let outputs = outputs(&mut coordinator);
    let (kind, reason) = failure(&outputs).unwrap();
    assert_eq!(kind, FailureKind::BadData);
    assert!(reason.starts_with("seat 2: xxx"));
    for output in &outputs[..2] {
        let Output::Send { to, message: Message::Failed { reason, .. } } = output else {
            panic!("{output:?}");
        };
        assert!(*to != LinkId(2) && reason.len() < 3000);
    }
}

#[test]
fn nodes_that_speak_out_of_turn_end_the_run() {
    let pong = Message::Pong { sequence: 1, sent: 0, answered: 0 };
    for message in [Message::Bye, Message::Finish, hello(WIRE_VERSION, TOKEN), pong] {
        let mut coordinator = seated();
        coordinator.handle_message(0, LinkId(1), message);
        let outputs = outputs(&mut coordinator);
        let (kind, reason) = failure(&outputs).unwrap();
        assert_eq!(kind, FailureKind::Protocol);
        assert!(reason.starts_with("seat 1"), "{reason}");
    }
}

#[test]
fn quiet_nodes_are_pinged_and_given_up_in_the_end() {
    let mut coordinator = seated();
    assert_eq!(coordinator.poll_timeout(), Some(HEARTBEAT));
    coordinator.handle_timeout(HEARTBEAT);
    let pings = outputs(&mut coordinator);
    assert_eq!(pings.len(), 3);
    assert!(
        pings.iter().all(|ping| matches!(ping, Output::Send { message: Message::Ping { .. }, .. }))
    );
    coordinator.handle_timeout(PEER_TIMEOUT);
    let outputs = outputs(&mut coordinator);
    assert_eq!(failure(&outputs).map(|(kind, _)| kind), Some(FailureKind::Unavailable));
    assert_eq!(coordinator.poll_timeout(), None);
}
