//! One row a picture: what the phases of a run say about each frame.

use crate::record::{PhaseRecord, RunRecord};
use protocol::id::{FrameIndex, Seat};
use protocol::schedule::{self, Phase, Role};
use protocol::telemetry::{CullCounts, DrawCounts, Missing, Nanos, PhaseReport, WorkReport};
use serde::Serialize;

/// Bytes a TCP, IP and Ethernet header takes, and ids a packet holds, in paper 004, section 6.1.
const PAPER_HEADER: f64 = 50.0;
const PAPER_IDS_A_PACKET: f64 = 100.0;
/// Bytes of the paper's camera.
const PAPER_CAMERA: f64 = 72.0;

/// Everything that varies by frame. Times in milliseconds on the coordinator's clock, sizes in bytes;
/// empty where a frame was not measured that way.
///
/// A frame's phases are the one that draws it and, for frame 0, all before that: the lead-in, in which no
/// picture is drawn yet. So every phase is one frame's, and the frames' times add up to the run's.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FrameRow {
    /// The frame.
    pub frame: u32,
    /// From the start of its (first) phase to the start of the phase after it; the last, to its end.
    pub frame_ms: f64,
    /// Of that, the lead-in: 0 but for frame 0.
    pub lead_in_ms: f64,
    /// Of `frame_ms`, from the start of a phase to the end of the last role's work in it. What is missing is
    /// measuring, handing over, reports and the next broadcast. An end that clocks put behind the phase's (they
    /// are aligned within `clocks.error_ms`) counts as that.
    pub work_ms: f64,
    /// Of `frame_ms`, spent on audit, item buffer and stand-ins' error.
    pub measuring_ms: f64,
    /// Spent on the picture's hash, beside the phases.
    pub hashing_ms: f64,
    /// Of `frame_ms`, spent by the render thread on handing the picture to the thread that hashes and writes it.
    pub hand_over_ms: f64,
    /// An audit, an item buffer or a stand-in's error was taken.
    pub measured: bool,
    /// From the broadcast of its camera to the end of its picture; empty where another frame was measured
    /// in a phase between, for the picture waited for that.
    pub camera_to_picture_ms: Option<f64>,
    /// Work of HC.
    pub hc_ms: f64,
    /// Work of OR.
    pub or_ms: f64,
    /// Work of RVG.
    pub rvg_ms: f64,
    /// From HC's end-of-frame message to its arrival at the display.
    pub hc_to_rvg_ms: Option<f64>,
    /// From HC's end-of-frame message to its arrival at the next OR.
    pub hc_to_or_ms: Option<f64>,
    /// Bytes on the socket from HC to OR.
    pub hc_to_or_bytes: u64,
    /// Bytes on the socket from HC to RVG.
    pub hc_to_rvg_bytes: u64,
    /// Bytes between coordinator and all nodes, both ways.
    pub control_bytes: u64,
    /// Code of the change of ids for one receiver, in bits, by eight: what fills the last byte is not counted.
    pub ids_delta: f64,
    /// The same as it is sent: in whole bytes, with counts and ends of its chunks.
    pub ids_sent: u32,
    /// Bytes of the visible set as plain ids.
    pub ids_full: u32,
    /// 8n + nh/b + 3(72 + h), n the changed ids (paper 004, section 4.5).
    pub paper_formula: f64,
    /// Least bits of the code, by eight: log2 C(|base|, leaving) + log2 C(hlods - |base|, entering), for a change
    /// of more than 512 ids the sum of that over its chunks' stretches of ids.
    pub entropy_bound: f64,
    /// Ids that changed.
    pub changed: u32,
    /// Ids of the base that left.
    pub leaving: u32,
    /// Ids that entered.
    pub entering: u32,
    /// Hlods on the front, in the frustum or not; counted where the item buffer is drawn.
    pub front: Option<u32>,
    /// Hlods on the front and in the frustum.
    pub in_frustum: u32,
    /// Boxes tested.
    pub queries: u32,
    /// Hlods tested by their own triangles.
    pub mesh_queries: u32,
    /// Triangles that HC drew, as further occluders and to be tested themselves.
    pub triangles_hc: u64,
    /// Hlods visible without a test: the box holds the eye or lies within a few near distances of it.
    pub at_eye: u32,
    /// Hlods visible without a test for any other reason.
    pub untested: u32,
    /// Hlods found visible.
    pub visible: u32,
    /// Hlods with a visible pixel.
    pub with_pixels: Option<u32>,
    /// Source triangles under the hlods in the frustum.
    pub source_triangles_in_frustum: u64,
    /// Triangles drawn into the picture.
    pub triangles_drawn: u64,
    /// Of these, triangles of cubes.
    pub triangles_far: u64,
    /// Triangles drawn as occluders.
    pub triangles_occluders: u64,
    /// Pixels in which the audit's two pictures differ.
    pub differing_pixels: Option<u64>,
    /// Pixels of which the audit says nothing, for something was not there.
    pub unknown_pixels: Option<u64>,
    /// Hlods that the audit found wrong on the front.
    pub front_faults: Option<u32>,
    /// Hlods of the picture that something coarser stood for.
    pub replaced: u32,
    /// Hlods of the picture that nothing stood for.
    pub holes: u32,
    /// Pixels by which the picture strays at most where something stood in.
    pub stand_in_error_px: f64,
    /// Meshes and textures that were there when needed, all nodes.
    pub io_hits: u64,
    /// Meshes and textures that had to be read, all nodes.
    pub io_misses: u64,
    /// How often a drawing waited for one to be read, all nodes.
    pub io_waits: u64,
    /// Longest wait because of loading of any node.
    pub io_stall_ms: f64,
    /// Most bytes that a drawing of any node uploaded of what it did not need.
    pub io_besides: u64,
    /// Bytes read, all nodes.
    pub io_bytes_read: u64,
    /// Of those, read before they were needed.
    pub io_prefetched: u64,
    /// Bytes read ahead that were needed for the first time, all nodes.
    pub io_prefetched_used: u64,
    /// Of those needed, how many the drawing before had not needed, all nodes.
    pub io_events: u64,
    /// Of those, there in time.
    pub io_events_foreseen: u64,
    /// Bytes given up to make room, all nodes.
    pub io_evicted: u64,
    /// Meshes and textures that turned out to be unreadable, all nodes.
    pub io_faults: u64,
    /// Hash of the picture.
    pub picture_hash: String,
}

/// Milliseconds of a span of nanoseconds.
fn ms(span: i64) -> f64 {
    span as f64 / 1e6
}

/// Looks into a record by role and frame.
struct Lookup<'a>(&'a RunRecord);

impl<'a> Lookup<'a> {
    /// What `role` reported for `frame`: its seat, the phase, the report.
    fn work(&self, role: Role, frame: u32) -> Option<(Seat, &'a PhaseRecord, &'a WorkReport)> {
        let seat = schedule::seat_of(self.0.settings.schedule, role, FrameIndex(frame));
        self.0.phases.iter().skip(frame as usize).take(3).find_map(|phase| {
            let work = report_of(phase, seat)?.work.as_ref()?;
            (work.role == role && work.frame.0 == frame).then_some((seat, phase, work))
        })
    }

    /// A node's time on the coordinator's clock.
    fn aligned(&self, seat: Seat, time: Nanos) -> i64 {
        let offset =
            self.0.nodes.iter().find(|node| node.seat == seat).map_or(0, |node| node.clock.offset);
        time as i64 + offset
    }

    /// The phases that are the frame's, in order; the last draws it.
    fn phases_of(&self, frame: u32) -> &'a [PhaseRecord] {
        let drawn_in = schedule::drawn_in(self.0.settings.schedule, FrameIndex(frame));
        let first = if frame == 0 { Phase::FIRST } else { drawn_in };
        let phases = &self.0.phases;
        let from = phases.partition_point(|p| p.phase < first);
        &phases[from..phases.partition_point(|p| p.phase <= drawn_in)]
    }

    /// Measuring in `phase`.
    fn measuring(phase: &PhaseRecord) -> Nanos {
        let draws = phase.reports.iter().filter_map(|(_, report)| report.work?.draw);
        draws.map(|draw| draw.measuring_ns).sum()
    }

    /// From the start of `phase` to the end of the last work in it.
    fn work_in(&self, phase: &PhaseRecord) -> i64 {
        let ends = phase.reports.iter().filter_map(|(seat, report)| {
            Some(self.aligned(*seat, report.work?.finished).min(phase.ended as i64))
        });
        ends.max().map_or(0, |end| (end - phase.started as i64).max(0))
    }

    /// The phase before `phase`.
    fn before(&self, phase: &PhaseRecord) -> Option<&'a PhaseRecord> {
        self.0.phases.iter().find(|p| p.phase.next() == phase.phase)
    }
}

fn report_of(phase: &PhaseRecord, seat: Seat) -> Option<&PhaseReport> {
    phase.reports.iter().find(|(s, _)| *s == seat).map(|(_, report)| report)
}

/// Bytes `from` had sent to `to` when `phase` ended.
fn sent(phase: Option<&PhaseRecord>, from: Seat, to: Seat) -> u64 {
    let links =
        phase.and_then(|phase| report_of(phase, from)).map_or(&[][..], |report| &report.sent);
    links.iter().filter(|link| link.to == to).map(|link| link.bytes).sum()
}

/// Control bytes of all nodes and the coordinator when `phase` ended.
fn control(phase: Option<&PhaseRecord>) -> u64 {
    phase.map_or(0, |p| {
        p.control_sent + p.reports.iter().map(|(_, report)| report.sent_control).sum::<u64>()
    })
}

/// The rows of a run, in frame order.
pub fn rows(record: &RunRecord) -> Vec<FrameRow> {
    (0..record.settings.frames).filter_map(|frame| row(&Lookup(record), frame)).collect()
}

fn row(lookup: &Lookup<'_>, frame: u32) -> Option<FrameRow> {
    let (hc_seat, hc_phase, hc) = lookup.work(Role::HardwareCull, frame)?;
    let (rvg_seat, rvg_phase, rvg) = lookup.work(Role::RenderVisibleGeometry, frame)?;
    let (_, or_phase, or) = lookup.work(Role::OcclusionRepresentation, frame)?;
    let cull = hc.cull.unwrap_or_default();
    let draw = rvg.draw.unwrap_or_default();

    let mut row = FrameRow { frame, ..FrameRow::default() };
    fill_times(&mut row, lookup, (or_phase, or), (hc_seat, hc), (rvg_seat, rvg_phase, rvg));
    fill_counts(&mut row, &cull, &draw, or.draw.as_ref());
    let picture = lookup.0.pictures.get(&FrameIndex(frame));
    row.picture_hash = picture.map_or(String::new(), |picture| format!("{:016x}", picture.hash));
    row.hashing_ms = picture.map_or(0.0, |picture| ms(picture.hashing as i64));
    let before = lookup.before(hc_phase);
    let bytes =
        |to: Seat| sent(Some(hc_phase), hc_seat, to).saturating_sub(sent(before, hc_seat, to));
    for seat in schedule::receivers(lookup.0.settings.schedule, FrameIndex(frame)) {
        if seat == rvg_seat {
            row.hc_to_rvg_bytes = bytes(seat);
        } else {
            row.hc_to_or_bytes = bytes(seat);
        }
    }
    row.control_bytes = control(Some(hc_phase)).saturating_sub(control(before));
    let reports = lookup.phases_of(frame).iter().flat_map(|phase| &phase.reports);
    for io in reports.map(|(_, report)| report.io) {
        row.io_hits += io.hits;
        row.io_misses += io.misses;
        row.io_waits += io.waits;
        row.io_besides = row.io_besides.max(io.besides);
        row.io_stall_ms = row.io_stall_ms.max(ms(io.stall_ns as i64));
        row.io_bytes_read += io.bytes_read;
        row.io_prefetched += io.prefetched;
        row.io_prefetched_used += io.prefetched_used;
        row.io_events += io.events;
        row.io_events_foreseen += io.events_foreseen;
        row.io_evicted += io.evicted;
        row.io_faults += io.faults;
    }
    Some(row)
}

fn fill_times(
    row: &mut FrameRow,
    lookup: &Lookup<'_>,
    (or_phase, or): (&PhaseRecord, &WorkReport),
    (hc_seat, hc): (Seat, &WorkReport),
    (rvg_seat, rvg_phase, rvg): (Seat, &PhaseRecord, &WorkReport),
) {
    let span = |work: &WorkReport| ms(work.finished as i64 - work.started as i64);
    (row.hc_ms, row.or_ms, row.rvg_ms) = (span(hc), span(or), span(rvg));
    // The camera of frame i goes out with phase i - 1, in which OR(i) works. What is measured after a picture
    // keeps the phase open, and all that follows waits.
    let between =
        lookup.0.phases.iter().filter(|p| (or_phase.phase..rvg_phase.phase).contains(&p.phase));
    let delayed = between.map(Lookup::measuring).sum::<Nanos>() > 0;
    let shown = lookup.aligned(rvg_seat, rvg.finished);
    row.camera_to_picture_ms = (!delayed).then(|| ms(shown - or_phase.started as i64));

    let phases = lookup.phases_of(row.frame);
    let started = phases.first().map_or(rvg_phase.started, |first| first.started);
    row.frame_ms = ms(rvg_phase.ended as i64 - started as i64);
    row.lead_in_ms = ms(rvg_phase.started as i64 - started as i64);
    row.work_ms = ms(phases.iter().map(|phase| lookup.work_in(phase)).sum());
    let draw = rvg.draw.unwrap_or_default();
    row.measured = draw.measuring_ns > 0;
    row.measuring_ms = ms(draw.measuring_ns as i64);
    row.hand_over_ms = ms(draw.hand_over_ns as i64);

    let Some(sent) = hc.visible_sent.map(|at| lookup.aligned(hc_seat, at)) else { return };
    let arrival = |seat: Seat, work: &WorkReport| {
        Some(ms(lookup.aligned(seat, work.visible_received?) - sent))
    };
    if rvg_seat != hc_seat {
        row.hc_to_rvg_ms = arrival(rvg_seat, rvg);
    }
    if let Some((seat, _, next_or)) = lookup.work(Role::OcclusionRepresentation, row.frame + 1) {
        row.hc_to_or_ms = arrival(seat, next_or);
    }
}

fn fill_counts(row: &mut FrameRow, cull: &CullCounts, draw: &DrawCounts, or: Option<&DrawCounts>) {
    (row.leaving, row.entering) = (cull.leaving, cull.entering);
    row.changed = cull.leaving + cull.entering;
    let changed = f64::from(row.changed);
    row.ids_delta = f64::from(cull.ids_delta_bits) / 8.0;
    row.ids_sent = cull.ids_sent;
    row.ids_full = cull.ids_full;
    row.paper_formula = 8.0 * changed
        + changed * PAPER_HEADER / PAPER_IDS_A_PACKET
        + 3.0 * (PAPER_CAMERA + PAPER_HEADER);
    row.entropy_bound = cull.ids_bound_bits / 8.0;
    row.front = draw.front;
    row.in_frustum = cull.in_frustum;
    row.queries = cull.queries;
    (row.mesh_queries, row.triangles_hc) = (cull.mesh_queries, cull.triangles);
    (row.at_eye, row.untested) = (cull.at_eye, cull.untested);
    row.visible = cull.visible;
    row.with_pixels = draw.hlods_with_pixels;
    row.source_triangles_in_frustum = cull.source_triangles_in_frustum;
    (row.triangles_drawn, row.triangles_far) = (draw.triangles, draw.far_triangles);
    let Missing { replaced, holes, error_px } = draw.missing;
    (row.replaced, row.holes, row.stand_in_error_px) = (replaced, holes, error_px);
    row.triangles_occluders = or.map_or(0, |or| or.triangles);
    row.differing_pixels = draw.audit.map(|audit| audit.differing_pixels);
    row.unknown_pixels = draw.audit.map(|audit| audit.unknown_pixels);
    row.front_faults = draw.audit.map(|audit| audit.front_faults);
}

/// The rows as CSV with a header, named as in [`FrameRow`].
pub fn csv(rows: &[FrameRow]) -> Vec<u8> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).expect("a row holds only plain values");
    }
    writer.into_inner().expect("a vector takes every write")
}
