//! `summary.json`: the figures of a run, keys fixed.

use super::SceneFacts;
use super::frames::FrameRow;
use super::stats::{Stats, mean};
use crate::record::RunRecord;
use protocol::settings::{Cull, PictureSize, Residency, Schedule};
use serde::Serialize;

/// The scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scene {
    /// Where the scene file lies.
    pub path: String,
    /// Hlods of the hierarchy.
    pub hlods: u64,
    /// Triangles of the source.
    pub triangles: u64,
    /// Objects of the source.
    pub objects: u64,
    /// Digest of the file.
    pub digest: String,
}

/// The renderer; where seats differ, all are named.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Backend {
    /// `gpu` or `cpu`.
    pub name: String,
    /// Adapter and driver.
    pub driver: String,
}

/// Milliseconds by role and way.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Latency {
    /// From the broadcast of a camera to its picture, of the frames that waited for no other frame's
    /// measuring.
    pub camera_to_picture: Stats,
    /// How many those are: with `--audit every=1` hardly any.
    pub camera_to_picture_frames: usize,
    /// HC's work.
    pub hc: Stats,
    /// OR's work.
    pub or: Stats,
    /// RVG's work.
    pub rvg: Stats,
    /// HC's end-of-frame message to the display.
    pub hc_to_rvg: Stats,
    /// HC's end-of-frame message to the next OR.
    pub hc_to_or: Stats,
}

/// Bytes a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bandwidth {
    /// On the socket.
    pub hc_to_or: Stats,
    /// On the socket.
    pub hc_to_rvg: Stats,
    /// On the sockets, both ways, all nodes.
    pub control: Stats,
    /// Code of the change of ids, bits by eight, mean.
    pub ids_delta: f64,
    /// The same in whole bytes, with counts and ends of its chunks, mean.
    pub ids_sent: f64,
    /// Plain 4-byte ids, mean.
    pub ids_full: f64,
    /// Paper 004, section 4.5, mean.
    pub paper_formula: f64,
    /// Least of `ids_delta` that the code's model allows, mean.
    pub entropy_bound: f64,
}

/// Mean counts a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Culling {
    /// Hlods on the front, in the frustum or not, over the frames with an item buffer; null where there was
    /// none.
    pub front: Option<f64>,
    /// Hlods on the front and in the frustum.
    pub in_frustum: f64,
    /// Tests made: of boxes, those of second looks included, and of meshes by their own triangles.
    pub tests: f64,
    /// Of these, of boxes.
    pub queries: f64,
    /// Hlods visible without a test, the eye being neither in their boxes nor by them.
    pub untested: f64,
    /// Hlods visible without a test, the eye being in their boxes or within a few near distances of them.
    pub at_eye: f64,
    /// Found visible.
    pub visible: f64,
    /// Hlods with a visible pixel, over the frames with an item buffer; null where there was none.
    pub with_pixels: Option<f64>,
    /// Hlods found visible over hlods with a visible pixel, both as sums over the frames with an item
    /// buffer; null where there was none, or nothing was seen.
    pub efficiency: Option<f64>,
    /// Frames with an item buffer.
    pub efficiency_frames: usize,
}

/// Triangles a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Triangles {
    /// Drawn into the picture.
    pub drawn: Stats,
    /// Of these, triangles of cubes.
    pub far: Stats,
    /// Drawn as occluders.
    pub occluders: Stats,
    /// Of the source, under the hlods in the frustum.
    pub source_in_frustum: Stats,
}

/// What the audit found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Audit {
    /// Frames audited.
    pub frames: usize,
    /// Of those, with a differing pixel.
    pub differing_frames: usize,
    /// Pixels whose colour or depth bits differ.
    pub differing_pixels: u64,
    /// Pixels of the audited pictures that say nothing: something was not there that may have hidden what
    /// differs.
    pub unknown_pixels: u64,
    /// Hlods that are not on a front as they should be; counted against the scene alone.
    pub front_faults: u64,
}

/// What of the pictures was not there in time, or at all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StandIns {
    /// Pictures with any.
    pub frames: usize,
    /// Hlods that something coarser stood for, all pictures.
    pub replaced: u64,
    /// Hlods that nothing stood for.
    pub holes: u64,
    /// Pixels by which the picture strays at most where something stood in.
    pub error_px: f64,
}

/// Meshes and textures loaded, all nodes. One that several draws share counts once a drawing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Io {
    /// There when needed.
    pub hits: u64,
    /// Read when needed.
    pub misses: u64,
    /// How often a drawing waited for one to be read.
    pub waits: u64,
    /// Sum over frames of the longest wait because of loading of any node.
    pub stall_ms: f64,
    /// Bytes read.
    pub bytes_read: u64,
    /// Bytes read before they were needed.
    pub prefetched: u64,
    /// Of those, needed later.
    pub prefetched_used: u64,
    /// Needed and not needed by the drawing before.
    pub events: u64,
    /// Of those, there in time.
    pub events_foreseen: u64,
    /// Bytes given up to make room.
    pub evicted: u64,
    /// Meshes and textures that cannot be read: something coarser was shown.
    pub faults: u64,
    /// Longest wait because of loading in one frame.
    pub stall_ms_max: f64,
    /// Most bytes that a drawing uploaded of what it did not need.
    pub besides_max: u64,
}

/// Bytes by process, in the order of `pids`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Memory {
    /// The cap a process was given; null where it was left to the nodes.
    pub cap: Option<u64>,
    /// Geometry and textures held, buffers on their way included.
    pub peak_resident: Vec<u64>,
    /// Resident set size.
    pub peak_rss: Vec<u64>,
}

/// A node's clock against the coordinator's, milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Clock {
    /// The node's seat.
    pub seat: u8,
    /// What is added to its times.
    pub offset_ms: f64,
    /// Greatest error of that.
    pub error_ms: f64,
    /// Median round trip of the pings.
    pub round_trip_ms: f64,
}

/// One of the longest frames.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstFrame {
    /// The frame.
    pub frame: u32,
    /// Its length.
    pub frame_ms: f64,
    /// Of that, the lead-in.
    pub lead_in_ms: f64,
    /// Of that, work.
    pub work_ms: f64,
    /// Of that, measuring.
    pub measuring_ms: f64,
    /// Longest wait for geometry in it.
    pub io_stall_ms: f64,
}

/// Longest frames that are named.
const WORST: usize = 5;

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The scene.
    pub scene: Scene,
    /// The renderer.
    pub backend: Backend,
    /// Picture size.
    pub size: PictureSize,
    /// 1 or 3.
    pub processes: u32,
    /// Schedule.
    pub schedule: Schedule,
    /// How hidden hlods were found.
    pub cull: Cull,
    /// Pixel error asked for.
    pub lod_px: f64,
    /// Distance of the near plane over the frames, scene units.
    pub near: Stats,
    /// Pictures.
    pub frames: usize,
    /// Seats drew with different renderers: what one finds hidden may show with another, so the
    /// pictures are not exact.
    pub mixed: bool,
    /// From the start of the first phase to the end of the last: the sum of all frames' times.
    pub span_ms: f64,
    /// Of that, before the first phase that draws a picture; it is part of frame 0.
    pub lead_in_ms: f64,
    /// From the start of a phase to the start of the next, of all frames.
    pub frame_ms: Stats,
    /// The same of the frames in which nothing was measured, however few.
    pub frame_unmeasured_ms: Stats,
    /// How many those are.
    pub unmeasured_frames: usize,
    /// From the start of a phase to the end of the last role's work in it, of all frames.
    pub work_ms: Stats,
    /// Audit, item buffer and stand-ins' error, of all frames.
    pub measuring_ms: Stats,
    /// Hashing, beside the phases.
    pub hashing_ms: Stats,
    /// Handing the picture over to be hashed and written.
    pub hand_over_ms: Stats,
    /// The longest frames, longest first.
    pub worst: Vec<WorstFrame>,
    /// Milliseconds by role and way.
    pub latency_ms: Latency,
    /// Bytes a frame.
    pub bandwidth: Bandwidth,
    /// Mean counts a frame.
    pub culling: Culling,
    /// Triangles a frame.
    pub triangles: Triangles,
    /// What the audit found.
    pub audit: Audit,
    /// Geometry loaded.
    pub io: Io,
    /// What a frame promised where geometry was missing.
    pub residency: Residency,
    /// Geometry that was missing.
    pub stand_ins: StandIns,
    /// Bytes by process.
    pub memory: Memory,
    /// Clocks by seat.
    pub clocks: Vec<Clock>,
    /// Processes that rendered.
    pub pids: Vec<u32>,
}

/// The figures of a run from its rows.
pub fn summarise(record: &RunRecord, scene: &SceneFacts, rows: &[FrameRow]) -> Summary {
    let stats = |figure: fn(&FrameRow) -> f64| Stats::of(rows.iter().map(figure));
    let average = |figure: fn(&FrameRow) -> f64| mean(rows.iter().map(figure));
    // Pictures of the first frames also load their geometry; they count like any other.
    let unmeasured = || rows.iter().filter(|row| !row.measured);
    let prompt = || rows.iter().filter_map(|row| row.camera_to_picture_ms);
    let renderers = || record.nodes.iter().map(|node| &node.backend);
    Summary {
        scene: Scene {
            path: scene.path.clone(),
            hlods: scene.hlods,
            triangles: scene.triangles,
            objects: scene.objects,
            digest: scene.digest.clone(),
        },
        backend: Backend {
            name: joined(record.nodes.iter().map(|node| node.backend.name.as_str())),
            driver: joined(record.nodes.iter().map(|node| node.backend.driver.as_str())),
        },
        size: record.settings.size,
        processes: record.processes,
        schedule: record.settings.schedule,
        cull: record.settings.cull,
        lod_px: record.settings.lod_px,
        near: scene.near,
        frames: rows.len(),
        mixed: renderers().zip(renderers().skip(1)).any(|(a, b)| a != b),
        span_ms: rows.iter().map(|row| row.frame_ms).sum(),
        lead_in_ms: rows.iter().map(|row| row.lead_in_ms).sum(),
        frame_ms: stats(|row| row.frame_ms),
        frame_unmeasured_ms: Stats::of(unmeasured().map(|row| row.frame_ms)),
        unmeasured_frames: unmeasured().count(),
        work_ms: stats(|row| row.work_ms),
        measuring_ms: stats(|row| row.measuring_ms),
        hashing_ms: stats(|row| row.hashing_ms),
        hand_over_ms: stats(|row| row.hand_over_ms),
        worst: worst(rows),
        latency_ms: Latency {
            camera_to_picture: Stats::of(prompt()),
            camera_to_picture_frames: prompt().count(),
            hc: stats(|row| row.hc_ms),
            or: stats(|row| row.or_ms),
            rvg: stats(|row| row.rvg_ms),
            hc_to_rvg: Stats::of(rows.iter().filter_map(|row| row.hc_to_rvg_ms)),
            hc_to_or: Stats::of(rows.iter().filter_map(|row| row.hc_to_or_ms)),
        },
        bandwidth: Bandwidth {
            hc_to_or: stats(|row| row.hc_to_or_bytes as f64),
            hc_to_rvg: stats(|row| row.hc_to_rvg_bytes as f64),
            control: stats(|row| row.control_bytes as f64),
            ids_delta: average(|row| row.ids_delta),
            ids_sent: average(|row| f64::from(row.ids_sent)),
            ids_full: average(|row| f64::from(row.ids_full)),
            paper_formula: average(|row| row.paper_formula),
            entropy_bound: average(|row| row.entropy_bound),
        },
        culling: culling(rows),
        triangles: Triangles {
            drawn: stats(|row| row.triangles_drawn as f64),
            far: stats(|row| row.triangles_far as f64),
            occluders: stats(|row| row.triangles_occluders as f64),
            source_in_frustum: stats(|row| row.source_triangles_in_frustum as f64),
        },
        audit: audit(rows),
        io: Io {
            hits: rows.iter().map(|row| row.io_hits).sum(),
            misses: rows.iter().map(|row| row.io_misses).sum(),
            waits: rows.iter().map(|row| row.io_waits).sum(),
            stall_ms: rows.iter().map(|row| row.io_stall_ms).sum(),
            bytes_read: rows.iter().map(|row| row.io_bytes_read).sum(),
            prefetched: rows.iter().map(|row| row.io_prefetched).sum(),
            prefetched_used: rows.iter().map(|row| row.io_prefetched_used).sum(),
            events: rows.iter().map(|row| row.io_events).sum(),
            events_foreseen: rows.iter().map(|row| row.io_events_foreseen).sum(),
            evicted: rows.iter().map(|row| row.io_evicted).sum(),
            faults: rows.iter().map(|row| row.io_faults).sum(),
            stall_ms_max: rows.iter().map(|row| row.io_stall_ms).fold(0.0, f64::max),
            besides_max: rows.iter().map(|row| row.io_besides).max().unwrap_or(0),
        },
        residency: record.settings.residency,
        stand_ins: stand_ins(rows),
        memory: memory(record),
        clocks: clocks(record),
        pids: pids(record),
    }
}

/// The longest frames; of equal ones the first.
fn worst(rows: &[FrameRow]) -> Vec<WorstFrame> {
    let mut longest: Vec<&FrameRow> = rows.iter().collect();
    longest.sort_by(|a, b| b.frame_ms.total_cmp(&a.frame_ms));
    let named = longest.into_iter().take(WORST).map(|row| WorstFrame {
        frame: row.frame,
        frame_ms: row.frame_ms,
        lead_in_ms: row.lead_in_ms,
        work_ms: row.work_ms,
        measuring_ms: row.measuring_ms,
        io_stall_ms: row.io_stall_ms,
    });
    named.collect()
}

fn culling(rows: &[FrameRow]) -> Culling {
    let counted = || rows.iter().filter_map(|row| Some((row.visible, row.with_pixels?)));
    let (drawn, seen) = counted().fold((0.0, 0.0), |(drawn, seen), (visible, with_pixels)| {
        (drawn + f64::from(visible), seen + f64::from(with_pixels))
    });
    let efficiency_frames = counted().count();
    let fronts: Vec<f64> = rows.iter().filter_map(|row| row.front.map(f64::from)).collect();
    let average =
        |figure: fn(&FrameRow) -> u32| mean(rows.iter().map(|row| f64::from(figure(row))));
    Culling {
        front: (!fronts.is_empty()).then(|| mean(fronts.iter().copied())),
        in_frustum: average(|row| row.in_frustum),
        tests: average(|row| row.queries + row.mesh_queries),
        queries: average(|row| row.queries),
        untested: average(|row| row.untested),
        at_eye: average(|row| row.at_eye),
        visible: average(|row| row.visible),
        with_pixels: (efficiency_frames > 0).then(|| seen / efficiency_frames as f64),
        efficiency: (seen > 0.0).then(|| drawn / seen),
        efficiency_frames,
    }
}

fn audit(rows: &[FrameRow]) -> Audit {
    let audited: Vec<u64> = rows.iter().filter_map(|row| row.differing_pixels).collect();
    Audit {
        frames: audited.len(),
        differing_frames: audited.iter().filter(|&&pixels| pixels > 0).count(),
        differing_pixels: audited.iter().sum(),
        unknown_pixels: rows.iter().filter_map(|row| row.unknown_pixels).sum(),
        front_faults: rows.iter().filter_map(|row| row.front_faults).map(u64::from).sum(),
    }
}

fn stand_ins(rows: &[FrameRow]) -> StandIns {
    StandIns {
        frames: rows.iter().filter(|row| row.replaced + row.holes > 0).count(),
        replaced: rows.iter().map(|row| u64::from(row.replaced)).sum(),
        holes: rows.iter().map(|row| u64::from(row.holes)).sum(),
        error_px: rows.iter().map(|row| row.stand_in_error_px).fold(0.0, f64::max),
    }
}

fn memory(record: &RunRecord) -> Memory {
    let peak = |figure: fn(&protocol::telemetry::PhaseReport) -> u64| {
        let of_seat = |seat| {
            let reports = record.phases.iter().flat_map(|phase| &phase.reports);
            reports.filter(|(s, _)| *s == seat).map(|(_, report)| figure(report)).max().unwrap_or(0)
        };
        let by_seat: Vec<u64> = record.nodes.iter().map(|node| of_seat(node.seat)).collect();
        by_seat
    };
    let (resident, rss) = (peak(|report| report.peak_resident), peak(|report| report.peak_rss));
    let cap = record.memory_cap;
    match record.processes {
        // The three seats of one process share its resident set but hold geometry each.
        1 => Memory {
            cap,
            peak_resident: vec![resident.iter().sum()],
            peak_rss: rss.into_iter().max().into_iter().collect(),
        },
        _ => Memory { cap, peak_resident: resident, peak_rss: rss },
    }
}

fn clocks(record: &RunRecord) -> Vec<Clock> {
    let clock = |node: &crate::record::NodeRecord| Clock {
        seat: node.seat.0,
        offset_ms: node.clock.offset as f64 / 1e6,
        error_ms: node.clock.error as f64 / 1e6,
        round_trip_ms: node.clock.round_trip_p50 as f64 / 1e6,
    };
    record.nodes.iter().map(clock).collect()
}

fn pids(record: &RunRecord) -> Vec<u32> {
    // Nodes of one process name it thrice. Where each has its own, equal numbers are of different machines.
    let processes = if record.processes == 1 { 1 } else { record.nodes.len() };
    record.nodes.iter().take(processes).map(|node| node.pid).collect()
}

/// Distinct words in the order they first come, joined by `, `.
fn joined<'a>(words: impl Iterator<Item = &'a str>) -> String {
    let mut distinct: Vec<&str> = Vec::new();
    for word in words {
        if !distinct.contains(&word) {
            distinct.push(word);
        }
    }
    distinct.join(", ")
}
