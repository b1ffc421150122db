//! Figures from a made-up run whose every number is known.

use super::frames::{FrameRow, csv, rows};
use super::stats::Stats;
use super::summary::summarise;
use super::{SceneFacts, report, table, trace};
use crate::record::{ClockEstimate, NodeRecord, PhaseRecord, RunRecord};
use protocol::id::{FrameIndex, Seat};
use protocol::schedule::{Phase, Role, SEATS, last_phase, receivers, role};
use protocol::settings::{BackendChoice, Cull, PictureSize, Residency, RunSettings, Schedule};
use protocol::sun::Sun;
use protocol::telemetry::{
    Audit, BackendInfo, CullCounts, DrawCounts, IoCounts, LinkBytes, Missing, PhaseReport,
    WorkReport,
};

const MS: u64 = 1_000_000;
/// Nodes' clocks run behind the coordinator's by so much, times seat + 1.
const BEHIND: i64 = 7 * MS as i64;
/// Length of a phase.
const PHASE: u64 = 10 * MS;
/// Bytes of a visible set on the socket.
const SET: u64 = 50;

fn record(schedule: Schedule, frames: u32) -> RunRecord {
    let settings = RunSettings {
        scene_path: "a<b>.occ".into(),
        scene_digest: [0; 32],
        size: PictureSize { width: 4, height: 2 },
        lod_px: 1.0,
        sun: Sun::default(),
        cull: Cull::Queries,
        schedule,
        backend: BackendChoice::Cpu,
        frames,
        audit_every: 2,
        items_every: 2,
        memory: None,
        residency: Residency::Exact,
        prefetch: true,
        far: protocol::settings::Far::Off,
        far_cubes: 8,
        far_triangles: None,
        pictures_dir: None,
    };
    let node = |seat: Seat| NodeRecord {
        seat,
        pid: 100 + u32::from(seat.0),
        backend: BackendInfo { name: "cpu".into(), driver: "none".into() },
        clock: ClockEstimate {
            offset: BEHIND * i64::from(seat.0 + 1),
            error: 5,
            round_trip_p50: 10,
        },
    };
    let mut sent = [[0u64; 3]; 3];
    let phases = (-1..=last_phase(schedule, frames).0)
        .map(|i| {
            let start = 1000 * MS + (i + 1) as u64 * PHASE;
            let mut report_of =
                |seat: Seat| (seat, report(&mut sent, schedule, seat, Phase(i), frames, start));
            PhaseRecord {
                phase: Phase(i),
                started: start,
                ended: start + PHASE,
                reports: SEATS.map(&mut report_of).to_vec(),
                control_sent: (i + 2) as u64 * 300,
            }
        })
        .collect();
    RunRecord { settings, processes: 3, nodes: SEATS.map(node).to_vec(), phases }
}

/// HC works 1..4 ms into a phase, OR and RVG 4..8 ms, and the set is on its way for half a millisecond.
fn report(
    sent: &mut [[u64; 3]; 3],
    schedule: Schedule,
    seat: Seat,
    phase: Phase,
    frames: u32,
    start: u64,
) -> PhaseReport {
    let at = |micros: u64| (start + micros * 1000) as i64 - BEHIND * i64::from(seat.0 + 1);
    let at = |micros: u64| u64::try_from(at(micros)).unwrap();
    let work = role(schedule, seat, phase, frames).map(|(role, frame)| {
        let culls = role == Role::HardwareCull;
        if culls {
            receivers(schedule, frame).iter().for_each(|to| sent[seat.index()][to.index()] += SET);
        }
        let (started, finished) = if culls { (at(1000), at(4000)) } else { (at(4000), at(8000)) };
        let even_picture = role == Role::RenderVisibleGeometry && frame.0 % 2 == 0;
        WorkReport {
            role,
            frame,
            phase_received: at(100),
            started,
            finished,
            visible_sent: culls.then(|| at(3000)),
            visible_received: (!culls).then(|| at(3500)),
            cull: culls.then(|| cull(frame)),
            draw: (!culls).then(|| DrawCounts {
                hlods: 30,
                triangles: 600,
                far_triangles: 200,
                hlods_with_pixels: even_picture.then_some(20),
                picture_hash: Some(u64::from(frame.0)),
                audit: even_picture.then_some(Audit { differing_pixels: u64::from(frame.0) }),
                measuring_ns: if even_picture { MS } else { 0 },
                missing: Missing { replaced: frame.0, holes: 0, error_px: 0.5 },
            }),
        }
    });
    PhaseReport {
        phase,
        work,
        sent: SEATS.map(|to| LinkBytes { to, bytes: sent[seat.index()][to.index()] }).to_vec(),
        sent_control: 100 * (phase.0 + 2) as u64,
        io: IoCounts { hits: 2, misses: 1, stall_ns: MS, bytes_read: 10, ..IoCounts::default() },
        peak_rss: 1000 + u64::from(seat.0),
        peak_resident: 10,
    }
}

fn cull(frame: FrameIndex) -> CullCounts {
    CullCounts {
        front: 100,
        in_frustum: 60,
        queries: 50,
        visible: 30,
        source_triangles_in_frustum: 9000,
        changed: frame.0,
        ids_delta: 2 * frame.0,
        ids_full: 120,
    }
}

fn facts() -> SceneFacts {
    SceneFacts {
        path: "a<b>.occ".into(),
        hlods: 1000,
        triangles: 9000,
        objects: 3,
        digest: "00".into(),
        near: Stats::of([0.5]),
    }
}

#[test]
fn a_switch_frame_is_measured_on_one_clock() {
    let record = record(Schedule::Switch, 5);
    let rows = rows(&record, 1000);
    assert_eq!(rows.len(), 5);
    let row = &rows[3];
    let times = [row.hc_ms, row.or_ms, row.rvg_ms, row.camera_to_picture_ms, row.frame_ms];
    assert_eq!(times, [3.0, 4.0, 4.0, 18.0, 10.0]);
    assert_eq!((row.hc_to_rvg_ms, row.hc_to_or_ms), (Some(0.5), Some(0.5)));
    assert_eq!((row.hc_to_or_bytes, row.hc_to_rvg_bytes, row.control_bytes), (SET, SET, 600));
    assert_eq!((row.ids_delta, row.ids_full, row.changed), (6, 120, 3));
    assert_eq!(row.paper_formula, 24.0 + 1.5 + 366.0);
    assert!((row.entropy_bound - (1000.0f64 * 999.0 * 998.0 / 6.0).log2() / 8.0).abs() < 1e-9);
    assert_eq!((row.io_hits, row.io_misses, row.io_stall_ms, row.io_bytes_read), (6, 3, 1.0, 30));
    assert!(!row.measured && rows[2].measured);
    assert_eq!(rows[2].frame_ms, 8.0, "without the millisecond of measuring and its report");
    assert_eq!(rows[4].hc_to_or_ms, None, "there is no frame after the last");
}

#[test]
fn a_rotating_frame_is_drawn_a_phase_later_where_it_was_culled() {
    let rows = rows(&record(Schedule::Rotate, 5), 1000);
    assert_eq!(rows.len(), 5);
    let row = &rows[3];
    assert_eq!((row.camera_to_picture_ms, row.frame_ms), (28.0, 10.0));
    assert_eq!((row.hc_to_rvg_ms, row.hc_to_or_ms), (None, Some(0.5)));
    assert_eq!((row.hc_to_or_bytes, row.hc_to_rvg_bytes), (SET, 0));
}

#[test]
fn the_summary_counts_what_was_measured_and_where() {
    let record = record(Schedule::Switch, 5);
    let summary = summarise(&record, &facts(), &rows(&record, 1000));
    assert_eq!(
        (summary.frames, summary.processes, summary.pids.clone()),
        (5, 3, vec![100, 101, 102])
    );
    assert_eq!(summary.frame_ms.mean, 10.0, "of the frames without measuring");
    assert_eq!((summary.culling.efficiency, summary.culling.efficiency_frames), (Some(1.5), 3));
    let audit = &summary.audit;
    assert_eq!((audit.frames, audit.differing_frames, audit.differing_pixels), (3, 2, 6));
    assert_eq!((summary.bandwidth.ids_delta, summary.bandwidth.ids_full), (4.0, 120.0));
    assert_eq!(summary.triangles.source_in_frustum.mean, 9000.0);
    assert_eq!(summary.memory.peak_rss, [1000, 1001, 1002]);
    let missing = &summary.stand_ins;
    assert_eq!((missing.frames, missing.replaced, missing.error_px), (4, 10, 0.5));
    assert_eq!(summary.backend.name, "cpu");

    let one =
        summarise(&RunRecord { processes: 1, ..record.clone() }, &facts(), &rows(&record, 1000));
    assert_eq!((one.memory.peak_rss, one.memory.peak_resident), (vec![1002], vec![30]));
}

#[test]
fn the_files_hold_every_frame_and_no_markup_of_the_scene() {
    let record = record(Schedule::Switch, 5);
    let rows = rows(&record, 1000);
    let summary = summarise(&record, &facts(), &rows);
    let text = String::from_utf8(csv(&rows)).unwrap();
    assert_eq!(text.lines().count(), 6);
    assert!(text.starts_with("frame,frame_ms,measured,camera_to_picture_ms,"), "{text}");
    let trace: serde_json::Value = serde_json::from_str(&trace::trace(&record)).unwrap();
    let names: Vec<&str> = trace["traceEvents"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|e| e["name"].as_str())
        .collect();
    for expected in ["phase -1", "OR(0)", "HC(4)", "RVG(4)"] {
        assert!(names.contains(&expected), "{expected}: {names:?}");
    }
    let html = report::html(&summary, &rows, std::path::Path::new("no such folder"));
    assert!(html.contains("a&lt;b&gt;.occ") && !html.contains("a<b>"));
    assert!(table::table(&summary).contains("6 differing pixels in 3 frames"));
    assert!(csv(&[FrameRow::default()]).len() > 100);
}
