//! Figures from a made-up run whose every number is known. Its records are such as nodes send: every picture
//! is handed over and hashed, but measured is every second one alone. `tests/honest_time.rs` holds real
//! runs against the same.

use super::frames::{FrameRow, csv, rows};
use super::stats::Stats;
use super::summary::summarise;
use super::{SceneFacts, report, table, trace};
use crate::record::{ClockEstimate, NodeRecord, PhaseRecord, PictureRecord, RunRecord};
use protocol::id::{FrameIndex, Seat};
use protocol::schedule::{Phase, Role, SEATS, last_phase, receivers, role};
use protocol::settings::{
    AuditAgainst, BackendChoice, Cull, PictureSize, Residency, RunSettings, Schedule,
};
use protocol::sun::Sun;
use protocol::telemetry::{
    Audit, BackendInfo, CullCounts, DrawCounts, IoCounts, LinkBytes, Missing, PhaseReport,
    WorkReport,
};

const MS: u64 = 1_000_000;
/// Nodes' clocks run behind the coordinator's by so much, times seat + 1.
const BEHIND: i64 = 7 * MS as i64;
/// Length of a phase in which nothing is measured: 8 ms of work, reports, the next broadcast.
const PHASE: u64 = 10 * MS;
/// What measuring adds to a phase.
const MEASURING: u64 = 3 * MS;
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
        audit_against: AuditAgainst::Front,
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
    let mut start = 1000 * MS;
    let phases = (-1..=last_phase(schedule, frames).0)
        .map(|i| {
            let started = start;
            let mut report_of =
                |seat: Seat| (seat, report(&mut sent, schedule, seat, Phase(i), frames, started));
            let reports = SEATS.map(&mut report_of).to_vec();
            let draws = reports.iter().filter_map(|(_, report)| report.work?.draw);
            start += PHASE + draws.map(|draw| draw.measuring_ns).sum::<u64>();
            let control_sent = (i + 2) as u64 * 300;
            PhaseRecord { phase: Phase(i), started, ended: start, reports, control_sent }
        })
        .collect();
    let picture =
        |frame: u32| (FrameIndex(frame), PictureRecord { hash: u64::from(frame), hashing: MS / 2 });
    RunRecord {
        settings,
        processes: 3,
        memory_cap: Some(64 << 20),
        nodes: SEATS.map(node).to_vec(),
        phases,
        pictures: (0..frames).map(picture).collect(),
    }
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
                front: even_picture.then_some(100 + frame.0),
                audit: even_picture.then_some(Audit {
                    differing_pixels: u64::from(frame.0),
                    unknown_pixels: 7,
                    front_faults: frame.0 / 4,
                }),
                measuring_ns: if even_picture { MEASURING } else { 0 },
                hand_over_ns: if role == Role::RenderVisibleGeometry { MS / 4 } else { 0 },
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
        in_frustum: 60,
        queries: 50,
        mesh_queries: 4,
        triangles: 300,
        at_eye: 2,
        untested: 1,
        // Not the same in every frame: a quotient of sums is no mean of quotients.
        visible: 30 + 10 * (frame.0 % 4),
        source_triangles_in_frustum: 9000,
        leaving: frame.0,
        entering: 1,
        ids_delta_bits: 12 * frame.0,
        ids_bound_bits: 11.0 * f64::from(frame.0),
        ids_sent: 8 + 2 * frame.0,
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
    let rows = rows(&record);
    assert_eq!(rows.len(), 5);
    let row = &rows[3];
    let times = [row.hc_ms, row.or_ms, row.rvg_ms, row.frame_ms, row.work_ms];
    assert_eq!(times, [3.0, 4.0, 4.0, 10.0, 8.0]);
    assert_eq!([row.measuring_ms, row.hand_over_ms, row.hashing_ms], [0.0, 0.25, 0.5]);
    assert_eq!((row.hc_to_rvg_ms, row.hc_to_or_ms), (Some(0.5), Some(0.5)));
    assert_eq!((row.hc_to_or_bytes, row.hc_to_rvg_bytes, row.control_bytes), (SET, SET, 600));
    assert_eq!((row.ids_delta, row.ids_sent, row.ids_full), (4.5, 14, 120));
    assert_eq!((row.changed, row.leaving, row.entering), (4, 3, 1));
    assert_eq!(row.paper_formula, 32.0 + 2.0 + 366.0);
    assert_eq!(row.entropy_bound, 33.0 / 8.0);
    assert_eq!((row.io_hits, row.io_misses, row.io_stall_ms, row.io_bytes_read), (6, 3, 1.0, 30));
    assert!(!row.measured && rows[2].measured);
    let times = [rows[2].frame_ms, rows[2].work_ms, rows[2].measuring_ms];
    assert_eq!(times, [13.0, 8.0, 3.0], "measuring is in the frame and not in its work");
    assert_eq!(rows[4].hc_to_or_ms, None, "there is no frame after the last");
}

#[test]
fn a_rotating_frame_is_drawn_a_phase_later_where_it_was_culled() {
    let rows = rows(&record(Schedule::Rotate, 5));
    assert_eq!(rows.len(), 5);
    let row = &rows[3];
    assert_eq!((row.frame_ms, rows[2].frame_ms), (10.0, 13.0));
    assert_eq!((row.hc_to_rvg_ms, row.hc_to_or_ms), (None, Some(0.5)));
    assert_eq!((row.hc_to_or_bytes, row.hc_to_rvg_bytes), (SET, 0));
}

/// The lead-in is frame 0's: a phase in `switch`, two in `rotate`.
#[test]
fn the_frames_times_add_up_to_the_run_s() {
    for (schedule, lead_in) in [(Schedule::Switch, 10.0), (Schedule::Rotate, 20.0)] {
        for frames in [1, 2, 5, 8] {
            let record = record(schedule, frames);
            let rows = rows(&record);
            let span = record.phases.last().unwrap().ended - record.phases[0].started;
            let sum: f64 = rows.iter().map(|row| row.frame_ms).sum();
            assert!((sum - span as f64 / 1e6).abs() < 1e-9, "{schedule:?} {frames}: {sum} {span}");
            assert_eq!(rows[0].lead_in_ms, lead_in);
            assert!(rows[1..].iter().all(|row| row.lead_in_ms == 0.0));
            assert!(rows.iter().all(|row| row.work_ms <= row.frame_ms), "{rows:?}");
            let summary = summarise(&record, &facts(), &rows);
            assert_eq!((summary.span_ms, summary.lead_in_ms), (sum, lead_in));
            assert_eq!(summary.worst[0].frame, 0, "with its lead-in");
        }
    }
}

/// In a phase between an even frame's camera and its picture nothing is measured; between an odd one's the
/// even frame before is.
#[test]
fn a_latency_holds_no_other_frame_s_measuring() {
    let switch = rows(&record(Schedule::Switch, 5));
    let latency: Vec<_> = switch.iter().map(|row| row.camera_to_picture_ms).collect();
    assert_eq!(latency, [Some(18.0), None, Some(18.0), None, Some(18.0)]);
    // Two phases lie between, and one of them has the even frame before.
    let rotate = rows(&record(Schedule::Rotate, 5));
    let latency: Vec<_> = rotate.iter().map(|row| row.camera_to_picture_ms).collect();
    assert_eq!(latency, [Some(28.0), None, None, None, None]);
    let summary = summarise(&record(Schedule::Switch, 5), &facts(), &switch);
    let latency = &summary.latency_ms;
    assert_eq!((latency.camera_to_picture.max, latency.camera_to_picture_frames), (18.0, 3));
}

/// A clock that is a little off must not make work longer than its phase.
#[test]
fn work_ends_with_its_phase_at_the_latest() {
    let mut record = record(Schedule::Switch, 2);
    for node in &mut record.nodes {
        node.clock.offset += 5 * MS as i64;
    }
    let rows = rows(&record);
    assert!(rows.iter().all(|row| row.work_ms <= row.frame_ms), "{rows:?}");
    assert_eq!(rows[1].work_ms, 10.0);
}

#[test]
fn the_summary_counts_what_was_measured_and_where() {
    let record = record(Schedule::Switch, 5);
    let summary = summarise(&record, &facts(), &rows(&record));
    assert_eq!(
        (summary.frames, summary.processes, summary.pids.clone()),
        (5, 3, vec![100, 101, 102])
    );
    assert_eq!(summary.frame_ms.mean, (23.0 + 10.0 + 13.0 + 10.0 + 13.0) / 5.0, "of all frames");
    assert_eq!((summary.frame_unmeasured_ms.mean, summary.unmeasured_frames), (10.0, 2));
    assert_eq!((summary.work_ms.p50, summary.measuring_ms.max), (8.0, 3.0));
    assert!(!summary.mixed);
    let culling = &summary.culling;
    // Frames 0, 2 and 4 have an item buffer: 30, 50 and 30 drawn, 20 seen in each.
    assert_eq!((culling.efficiency, culling.efficiency_frames), (Some(110.0 / 60.0), 3));
    assert_eq!((culling.tests, culling.queries, culling.with_pixels), (54.0, 50.0, Some(20.0)));
    assert_eq!((culling.at_eye, culling.untested), (2.0, 1.0));
    let audit = &summary.audit;
    assert_eq!((audit.frames, audit.differing_frames, audit.differing_pixels), (3, 2, 6));
    assert_eq!((audit.unknown_pixels, audit.front_faults), (21, 1));
    assert_eq!(summary.culling.front, Some(102.0), "of the frames where it was counted");
    assert_eq!((summary.bandwidth.ids_delta, summary.bandwidth.ids_full), (3.0, 120.0));
    assert_eq!((summary.bandwidth.entropy_bound, summary.bandwidth.ids_sent), (2.75, 12.0));
    assert_eq!(summary.triangles.source_in_frustum.mean, 9000.0);
    assert_eq!(summary.memory.peak_rss, [1000, 1001, 1002]);
    let missing = &summary.stand_ins;
    assert_eq!((missing.frames, missing.replaced, missing.error_px), (4, 10, 0.5));
    assert_eq!(summary.backend.name, "cpu");

    let mut one = RunRecord { processes: 1, ..record.clone() };
    // Three seats cannot share 64 MiB evenly: what was given is what is stated.
    one.settings.memory = Some((64 << 20) / 3);
    let one = summarise(&one, &facts(), &rows(&record));
    assert_eq!((one.memory.peak_rss, one.memory.peak_resident), (vec![1002], vec![30]));
    assert_eq!((one.memory.cap, one.pids), (Some(64 << 20), vec![100]));
}

#[test]
fn seats_with_different_renderers_mark_the_run_and_keep_equal_pids() {
    let mut record = record(Schedule::Switch, 2);
    record.nodes[2].backend.driver = "another".into();
    // Two machines may give one number.
    record.nodes[1].pid = record.nodes[0].pid;
    let summary = summarise(&record, &facts(), &rows(&record));
    assert!(summary.mixed);
    assert_eq!(summary.backend.driver, "none, another");
    assert_eq!(summary.pids, [100, 100, 102]);
    assert!(table::table(&summary).contains("not exact"));
    let html = report::html(&summary, &rows(&record), std::path::Path::new("no such folder"));
    assert!(html.contains("not exact"));
}

#[test]
fn the_files_hold_every_frame_and_no_markup_of_the_scene() {
    let record = record(Schedule::Switch, 5);
    let rows = rows(&record);
    let summary = summarise(&record, &facts(), &rows);
    let text = String::from_utf8(csv(&rows)).unwrap();
    assert_eq!(text.lines().count(), 6);
    assert!(text.starts_with("frame,frame_ms,lead_in_ms,work_ms,measuring_ms,"), "{text}");
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
    let table = table::table(&summary);
    let audit = "6 differing pixels in 3 frames; 21 not compared, for something was not there; \
                 1 hlods are wrong on the front";
    for said in [audit, "of it, measuring", "#0 23.0 (lead-in 10.0, "] {
        assert!(table.contains(said), "{said}: {table}");
    }
    assert!(!table.contains("not exact"));
    assert!(csv(&[FrameRow::default()]).len() > 100);
}
