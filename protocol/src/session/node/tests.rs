//! What a node refuses, and that nothing a peer says makes it panic.

use super::*;
use crate::settings::{AuditAgainst, BackendChoice, Cull, PictureSize, Residency, Schedule};
use crate::sun::Sun;
use proptest::prelude::*;

const DIGEST: [u8; 32] = [1; 32];

fn welcome(seat: u8, schedule: Schedule) -> Message {
    let settings = RunSettings {
        scene_path: "plant.occ".into(),
        scene_digest: DIGEST,
        size: PictureSize { width: 8, height: 8 },
        lod_px: 1.0,
        sun: Sun::default(),
        cull: Cull::Queries,
        schedule,
        backend: BackendChoice::Auto,
        frames: 4,
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
    let peers = (0..3).map(|i| PeerAddress { seat: Seat(i), address: "h:1".into() }).collect();
    Message::Welcome { seat: Seat(seat), peers, settings }
}

fn camera() -> Camera {
    Camera::look_at([0.0; 3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], 60.0, 0.1).unwrap()
}

fn new_node() -> Node {
    Node::new(0, Token([0; 32]), "h:1".into(), 1)
}

fn ready(seat: u8, schedule: Schedule) -> Node {
    let mut node = new_node();
    node.handle_message(0, Peer::Coordinator, welcome(seat, schedule));
    node.handle_prepared(0, DIGEST, 9, BackendInfo { name: "cpu".into(), driver: String::new() });
    outputs(&mut node);
    node
}

fn outputs(node: &mut Node) -> Vec<Output> {
    std::iter::from_fn(|| node.poll_output()).collect()
}

fn failure(node: &mut Node) -> Option<(FailureKind, String)> {
    outputs(node).into_iter().find_map(|output| match output {
        Output::Failed { kind, reason } => Some((kind, reason)),
        _ => None,
    })
}

#[test]
fn another_scene_is_refused() {
    let mut node = new_node();
    node.handle_message(0, Peer::Coordinator, welcome(0, Schedule::Switch));
    node.handle_prepared(0, [0; 32], 9, BackendInfo { name: "cpu".into(), driver: String::new() });
    assert_eq!(failure(&mut node).map(|(kind, _)| kind), Some(FailureKind::NotAllowed));
}

#[test]
fn messages_out_of_turn_name_who_sent_them() {
    let early = Message::Phase { phase: Phase(0), next_camera: Some(camera()) };
    let blind = Message::Phase { phase: Phase::FIRST, next_camera: None };
    let nan = Camera { near: f32::NAN, ..camera() };
    let nan = Message::Phase { phase: Phase::FIRST, next_camera: Some(nan) };
    let end = Message::EndOfFrame { frame: FrameIndex(0), visible: 0, checksum: 0 };
    let coordinator = Peer::Coordinator;
    for (from, message) in [
        (coordinator, early),
        (coordinator, blind),
        (coordinator, nan),
        (coordinator, Message::Finish),
        (coordinator, welcome(0, Schedule::Switch)),
        (coordinator, end.clone()),
        (Peer::Seat(Seat(1)), end),
        (Peer::Seat(Seat(1)), Message::WantFull { frame: FrameIndex(0) }),
        (Peer::Seat(Seat(1)), Message::Finish),
    ] {
        let mut node = ready(0, Schedule::Switch);
        let name = message.name();
        node.handle_message(0, from, message);
        let (kind, reason) = failure(&mut node).unwrap_or_else(|| panic!("{name} was accepted"));
        assert_eq!(kind, FailureKind::Protocol);
        assert!(reason.starts_with(&from.to_string()), "{reason}");
    }
}

#[test]
fn a_lost_peer_is_named_once_the_coordinator_has_had_its_say() {
    let mut node = ready(0, Schedule::Switch);
    node.handle_disconnect(5, Peer::Seat(Seat(2)));
    assert_eq!(failure(&mut node), None);
    let at = node.poll_timeout().unwrap();
    node.handle_timeout(at);
    let (kind, reason) = failure(&mut node).unwrap();
    assert_eq!(kind, FailureKind::Unavailable);
    assert!(reason.contains("seat 2"));

    let mut node = ready(0, Schedule::Switch);
    node.handle_disconnect(5, Peer::Seat(Seat(2)));
    let told = Message::failed(FailureKind::BadData, "seat 2: page 3 is damaged");
    node.handle_message(6, Peer::Coordinator, told);
    assert_eq!(failure(&mut node).map(|(kind, _)| kind), Some(FailureKind::BadData));
}

#[test]
fn a_coordinator_that_is_gone_or_silent_ends_the_node() {
    let mut node = new_node();
    node.handle_disconnect(0, Peer::Coordinator);
    assert!(failure(&mut node).unwrap().1.contains("coordinator"));
    let mut node = new_node();
    node.handle_timeout(PEER_TIMEOUT - 1);
    assert_eq!(failure(&mut node), None);
    node.handle_timeout(PEER_TIMEOUT);
    assert!(failure(&mut node).unwrap().1.contains("silent"));
}

#[test]
fn a_change_that_comes_before_its_phase_is_kept() {
    // Seat 2 draws frame 0; seat 0 has culled it before seat 2 hears of the phase.
    let mut node = ready(2, Schedule::Switch);
    let first = Message::Phase { phase: Phase::FIRST, next_camera: Some(camera()) };
    node.handle_message(1, Peer::Coordinator, first);
    let empty = VisibleSet::default();
    let end = Message::EndOfFrame { frame: FrameIndex(0), visible: 0, checksum: empty.checksum() };
    node.handle_message(2, Peer::Seat(Seat(0)), end);
    outputs(&mut node);
    let next = Message::Phase { phase: Phase(0), next_camera: Some(camera()) };
    node.handle_message(3, Peer::Coordinator, next);
    let outputs = outputs(&mut node);
    assert!(matches!(outputs[..], [Output::Render { frame: FrameIndex(0), .. }]), "{outputs:?}");
}

#[test]
fn leave_is_taken_when_the_last_picture_is_hashed() {
    let mut node = ready(2, Schedule::Switch);
    for phase in -1..4 {
        let phase = Phase(phase);
        let next_camera = (phase.0 < 3).then(camera);
        let frame = FrameIndex(phase.0.max(0) as u32);
        node.handle_message(1, Peer::Coordinator, Message::Phase { phase, next_camera });
        if phase != Phase::FIRST {
            let checksum = VisibleSet::default().checksum();
            let end = Message::EndOfFrame { frame, visible: 0, checksum };
            node.handle_message(1, Peer::Seat(Seat((phase.0 % 2) as u8)), end);
            node.handle_rendered(1, frame, WorkTimes::default(), DrawCounts::default());
        }
    }
    (0..3).for_each(|frame| node.handle_hashed(1, FrameIndex(frame), 7, 3));
    node.handle_message(2, Peer::Coordinator, Message::Finish);
    let is_bye = |output: &Output| matches!(output, Output::Send { message: Message::Bye, .. });
    assert!(!outputs(&mut node).iter().any(is_bye), "the picture of frame 3 is not hashed");
    node.handle_hashed(3, FrameIndex(3), 7, 3);
    let last = outputs(&mut node);
    assert!(matches!(last[..], [Output::Send { message: Message::PictureHash { .. }, .. }, _, _]));
    assert!(is_bye(&last[1]) && last[2] == Output::Finished, "{last:?}");
}

fn any_message() -> impl Strategy<Value = Message> {
    let frame = (0u32..6).prop_map(FrameIndex);
    let base = proptest::option::of((0u32..6).prop_map(FrameIndex));
    let code = (0u32..10, 0u16..3, 0u16..3, proptest::collection::vec(any::<u8>(), 0..4));
    let end =
        (frame.clone(), 0u32..3, prop_oneof![Just(VisibleSet::default().checksum()), any::<u64>()]);
    prop_oneof![
        (-2i32..6, any::<bool>()).prop_map(|(phase, path)| Message::Phase {
            phase: Phase(phase),
            next_camera: path.then(camera),
        }),
        (frame.clone(), base, code).prop_map(
            |(frame, base, (through, leaving, entering, code))| {
                let chunk = DeltaChunk { through: HlodId(through), leaving, entering, code };
                Message::Delta { frame, base, chunk }
            }
        ),
        end.prop_map(|(frame, visible, checksum)| {
            Message::EndOfFrame { frame, visible, checksum }
        }),
        frame.prop_map(|frame| Message::WantFull { frame }),
        Just(Message::Finish),
        Just(Message::Ping { sequence: 0, sent: 0 }),
    ]
}

proptest! {
    /// The phases come in order and the work is done at once, so that the run goes on while peers
    /// say anything at all.
    #[test]
    fn nothing_a_peer_says_makes_a_node_panic(
        seat in 0u8..3,
        is_rotate: bool,
        said in proptest::collection::vec((0u8..4, any_message()), 0..40),
    ) {
        let schedule = if is_rotate { Schedule::Rotate } else { Schedule::Switch };
        let mut node = ready(seat, schedule);
        let mut next = -1;
        for (from, message) in said {
            let from = if from == 3 { Peer::Coordinator } else { Peer::Seat(Seat(from)) };
            let message = match message {
                Message::Phase { .. } => {
                    next += 1;
                    let phase = Phase(next - 1);
                    Message::Phase { phase, next_camera: (next < 4).then(camera) }
                }
                other => other,
            };
            let is_phase = matches!(message, Message::Phase { .. });
            node.handle_message(1, if is_phase { Peer::Coordinator } else { from }, message);
            while let Some(output) = node.poll_output() {
                let times = WorkTimes::default();
                match output {
                    Output::Occlude { frame, .. } => {
                        node.handle_occluded(1, frame, times, DrawCounts::default());
                    }
                    Output::Cull { frame, .. } => {
                        node.handle_culled_part(1, frame, HlodId(frame.0), &[HlodId(frame.0)]);
                        node.handle_culled(1, frame, times, CullCounts::default());
                    }
                    Output::Render { frame, .. } => {
                        node.handle_hashed(1, frame, 7, 3);
                        node.handle_rendered(1, frame, times, DrawCounts::default());
                    }
                    _ => {}
                }
            }
        }
    }
}
