//! Golden bytes, limits, and any damage.

use super::*;
use crate::camera::Camera;
use crate::id::{FrameIndex, HlodId, Seat};
use crate::message::{FailureKind, PeerAddress, Token, WIRE_VERSION};
use crate::schedule::{Phase, Role};
use crate::settings::{BackendChoice, Cull, PictureSize, Residency, RunSettings, Schedule};
use crate::sun::Sun;
use crate::telemetry::{
    Audit, BackendInfo, CullCounts, DrawCounts, IoCounts, LinkBytes, PhaseReport, WorkReport,
};
use crate::visible::DeltaChunk;
use proptest::prelude::*;

fn camera() -> Camera {
    Camera::look_at([1.0, 2.0, 3.0], [1.0, 2.0, -9.0], [0.0, 1.0, 0.0], 60.0, 0.1).unwrap()
}

/// Whence the light comes in the examples.
const SUN: [f64; 3] = [0.5, -2.0, 7.0];

/// One of every kind, with every optional part present.
fn examples() -> Vec<Message> {
    let token = Token([7; 32]);
    let reason = "scene.occ: page 3 is damaged; bake it again".to_owned();
    let settings = RunSettings {
        scene_path: "/tmp/plant.occ".into(),
        scene_digest: [3; 32],
        size: PictureSize { width: 640, height: 360 },
        lod_px: 1.0,
        sun: Sun::try_from(SUN).unwrap(),
        cull: Cull::Boxes,
        schedule: Schedule::Rotate,
        backend: BackendChoice::Cpu,
        frames: 120,
        audit_every: 1,
        audit_against: crate::settings::AuditAgainst::Scene,
        items_every: 10,
        memory: Some(64 << 20),
        residency: Residency::Deadline,
        prefetch: true,
        far: crate::settings::Far::Itdm,
        far_cubes: 3,
        far_triangles: Some(7_000),
        pictures_dir: Some("out".into()),
    };
    let peers = (0..3)
        .map(|i| PeerAddress { seat: Seat(i), address: format!("127.0.0.1:500{i}") })
        .collect();
    let backend = BackendInfo { name: "gpu".into(), driver: "llvmpipe".into() };
    let work = WorkReport {
        role: Role::HardwareCull,
        frame: FrameIndex(4),
        phase_received: 1,
        started: 2,
        finished: 3,
        visible_sent: Some(4),
        visible_received: Some(5),
        cull: Some(CullCounts { queries: 9, ..CullCounts::default() }),
        draw: Some(DrawCounts {
            hlods_with_pixels: Some(1),
            front: Some(3),
            audit: Some(Audit { differing_pixels: 0, unknown_pixels: 1, front_faults: 2 }),
            ..DrawCounts::default()
        }),
    };
    let report = PhaseReport {
        phase: Phase(4),
        work: Some(work),
        sent: vec![LinkBytes { to: Seat(0), bytes: 10 }, LinkBytes { to: Seat(2), bytes: 11 }],
        sent_control: 12,
        io: IoCounts::default(),
        peak_rss: 13,
        peak_resident: 14,
    };
    vec![
        Message::Hello { version: WIRE_VERSION, token, peer_address: "[::1]:9".into(), pid: 77 },
        Message::PeerHello { version: WIRE_VERSION, token, seat: Seat(1) },
        Message::Failed { kind: FailureKind::BadData, reason },
        Message::Welcome { seat: Seat(2), peers, settings },
        Message::Ready { scene_digest: [3; 32], backend },
        Message::Ping { sequence: 1, sent: 2 },
        Message::Pong { sequence: 1, sent: 2, answered: 3 },
        Message::Phase { phase: Phase::FIRST, next_camera: Some(camera()) },
        Message::Delta {
            frame: FrameIndex(4),
            base: Some(FrameIndex(3)),
            chunk: DeltaChunk { through: HlodId(9), leaving: 1, entering: 1, code: vec![1, 2, 3] },
        },
        Message::EndOfFrame { frame: FrameIndex(4), visible: 5, checksum: 6 },
        Message::WantFull { frame: FrameIndex(4) },
        Message::PhaseDone(report),
        Message::Finish,
        Message::Bye,
        Message::PictureHash { frame: FrameIndex(4), hash: 5, hashing: 6 },
    ]
}

fn frame_of(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    bytes
}

fn decode_all(bytes: &[u8]) -> Result<Vec<Message>, CodecError> {
    let mut decoder = Decoder::new();
    decoder.push(bytes);
    let mut messages = Vec::new();
    while let Some(message) = decoder.next()? {
        messages.push(message);
    }
    Ok(messages)
}

/// A frame with a right checksum around any body.
fn frame_around(body: &[u8]) -> Vec<u8> {
    let mut frame = MAGIC.to_vec();
    frame.extend(LAYOUT_VERSION.to_le_bytes());
    frame.extend((body.len() as u32).to_le_bytes());
    let crc = checksum(&frame, body);
    frame.extend(crc.to_le_bytes());
    frame.extend(body);
    frame
}

#[test]
fn nothing_and_parts_of_a_frame_are_waited_for() {
    assert_eq!(decode_all(&[]), Ok(vec![]));
    for message in examples() {
        let frame = frame_of(&message);
        for cut in 0..frame.len() {
            assert_eq!(decode_all(&frame[..cut]), Ok(vec![]), "{message:?} cut at {cut}");
        }
    }
}

#[test]
fn every_message_arrives_byte_by_byte() {
    let bytes: Vec<u8> = examples().iter().flat_map(frame_of).collect();
    let (mut decoder, mut messages) = (Decoder::new(), Vec::new());
    for byte in bytes {
        decoder.push(&[byte]);
        messages.extend(decoder.next().unwrap());
    }
    assert_eq!(messages, examples());
    assert!(decoder.is_between_messages());
}

#[test]
fn the_layouts_that_every_version_reads_keep_their_bytes() {
    let hex = |message: &Message| {
        frame_of(message)[HEADER_BYTES..].iter().map(|b| format!("{b:02x}")).collect::<String>()
    };
    let token = Token([0xab; 32]);
    let secret = "ab".repeat(32);
    let hello = Message::Hello { version: 9, token, peer_address: "a:1".into(), pid: 258 };
    assert_eq!(hex(&hello), format!("0000000009000000{secret}0300000000000000613a3102010000"));
    let peer_hello = Message::PeerHello { version: 9, token, seat: Seat(2) };
    assert_eq!(hex(&peer_hello), format!("0100000009000000{secret}02"));
    let failed = Message::Failed { kind: FailureKind::Protocol, reason: "no".into() };
    assert_eq!(hex(&failed), "020000000500000002000000000000006e6f");
}

#[test]
fn a_whole_frame_keeps_its_bytes() {
    let frame = frame_of(&Message::WantFull { frame: FrameIndex(0x0403_0201) });
    assert_eq!(frame[..12], *b"OCCW\x01\0\0\0\x08\0\0\0");
    assert_eq!(
        frame[12..16],
        crc32c::crc32c(b"OCCW\x01\0\0\0\x08\0\0\0\x0a\0\0\0\x01\x02\x03\x04").to_le_bytes()
    );
    assert_eq!(frame[16..], *b"\x0a\0\0\0\x01\x02\x03\x04");
}

#[test]
fn a_camera_takes_at_most_the_72_bytes_of_paper_004() {
    let with = frame_of(&Message::Phase { phase: Phase(1), next_camera: Some(camera()) });
    let without = frame_of(&Message::Phase { phase: Phase(1), next_camera: None });
    assert_eq!(with.len() - without.len(), 56);
}

#[test]
fn bodies_have_the_sizes_that_the_page_states() {
    let expected = [
        ("Hello", 52 + 7),
        ("PeerHello", 41),
        ("Failed", 16 + 43),
        ("Ready", 52 + 11),
        ("Ping", 16),
        ("Pong", 24),
        ("Phase", 65),
        ("Delta", 29 + 3),
        ("EndOfFrame", 20),
        ("WantFull", 8),
        ("Finish", 4),
        ("Bye", 4),
        ("PictureHash", 24),
    ];
    let size = |message: &Message| frame_of(message).len() - HEADER_BYTES;
    let sizes: Vec<_> = examples().iter().map(|message| (message.name(), size(message))).collect();
    for row in expected {
        assert!(sizes.contains(&row), "{row:?} is not among {sizes:?}");
    }
}

#[test]
fn foreign_bytes_other_layouts_and_long_frames_are_refused() {
    assert_eq!(decode_all(b"G"), Err(CodecError::Foreign(*b"G\0\0\0")));
    assert_eq!(decode_all(b"GET / HTTP/1.1\r\n"), Err(CodecError::Foreign(*b"GET ")));
    let mut frame = frame_of(&Message::Bye);
    frame[4] = 9;
    assert_eq!(decode_all(&frame), Err(CodecError::Layout(9)));

    let mut header = frame_of(&Message::Bye);
    header[8..12].copy_from_slice(&(MAX_BODY as u32).to_le_bytes());
    let allowed = MAX_BODY_BEFORE_HANDSHAKE;
    let mut decoder = Decoder::new();
    decoder.push(&header[..HEADER_BYTES]);
    assert_eq!(decoder.next(), Err(CodecError::TooLong { claimed: MAX_BODY, allowed }));
    decoder.handshake_done();
    assert_eq!(decoder.next(), Ok(None));
    assert!(decoder.bytes.capacity() < 100, "a claimed length must allocate nothing");
}

#[test]
fn bytes_after_a_message_and_lying_lengths_are_refused() {
    let mut body = frame_of(&Message::Bye)[HEADER_BYTES..].to_vec();
    body.push(0);
    assert!(matches!(decode_all(&frame_around(&body)), Err(CodecError::Body(_))));
    // The reason of `Failed`, and the code of `Delta`, claim far more than is there.
    for claim in [1u64 << 10, 1 << 32, u64::MAX] {
        let failed = [&[2, 0, 0, 0, 0, 0, 0, 0][..], &claim.to_le_bytes()].concat();
        assert!(matches!(decode_all(&frame_around(&failed)), Err(CodecError::Body(_))));
        let head = [8, 0, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 1, 0];
        let delta = [&head[..], &claim.to_le_bytes()].concat();
        assert!(matches!(decode_all(&frame_around(&delta)), Err(CodecError::Body(_))));
    }
}

#[test]
fn a_sun_that_stands_nowhere_is_refused() {
    let is_welcome = |message: &Message| matches!(message, Message::Welcome { .. });
    let welcome = examples().into_iter().find(is_welcome).unwrap();
    let body = &frame_of(&welcome)[HEADER_BYTES..];
    let bytes = SUN.map(f64::to_le_bytes).concat();
    let at = body.windows(24).position(|window| window == bytes).unwrap();
    for sun in [[0.0; 3], [1.0, f64::NAN, 0.0]] {
        let mut forged = body.to_vec();
        forged[at..at + 24].copy_from_slice(&sun.map(f64::to_le_bytes).concat());
        let refused = decode_all(&frame_around(&forged));
        assert!(matches!(&refused, Err(CodecError::Body(why)) if why.contains("no direction")));
    }
}

#[test]
fn every_flipped_bit_is_found() {
    for message in examples() {
        let frame = frame_of(&message);
        for bit in 0..frame.len() * 8 {
            let mut damaged = frame.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            // A longer length waits for bytes that do not come: never a message.
            assert_eq!(decode_all(&damaged).unwrap_or_default(), [], "{message:?} bit {bit}");
        }
    }
}

proptest! {
    #[test]
    fn any_bytes_are_read_without_panic(bytes: Vec<u8>) {
        let _ = decode_all(&bytes);
        let _ = decode_all(&frame_around(&bytes));
    }

    #[test]
    fn any_body_of_a_known_kind_is_read_without_panic(kind in 0u8..17, rest: Vec<u8>) {
        let body = [&[kind, 0, 0, 0][..], &rest].concat();
        if let Ok(messages) = decode_all(&frame_around(&body)) {
            prop_assert_eq!(messages.len(), 1);
        }
    }
}
