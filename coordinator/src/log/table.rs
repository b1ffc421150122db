//! The closing table a person reads.

use super::stats::Stats;
use super::summary::{Audit, Summary};
use std::fmt::Write;

/// The figures of a run as aligned text.
pub fn table(summary: &Summary) -> String {
    let mut out = String::new();
    let s = summary;
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<22}{text}");
    };
    line(
        "scene",
        format!(
            "{} triangles, {} objects, {} hlods",
            s.scene.triangles, s.scene.objects, s.scene.hlods
        ),
    );
    line("backend", format!("{} ({})", s.backend.name, s.backend.driver));
    let run = format!(
        "{} frames of {}x{}, {} process{}",
        s.frames,
        s.size.width,
        s.size.height,
        s.processes,
        if s.processes == 1 { "" } else { "es" }
    );
    line(
        "run",
        format!("{run}, schedule {:?}, cull {:?}, lod {} px", s.schedule, s.cull, s.lod_px)
            .to_lowercase(),
    );
    if s.mixed {
        let why = "seats drew with different renderers (--mixed): visible pixels may be lacking";
        line("not exact", why.to_owned());
    }
    line("", format!("{:>10}{:>10}{:>10}{:>10}{:>10}", "p50", "p90", "p99", "max", "mean"));
    let mut stats = |name: &str, v: &Stats, digits: usize| {
        let cells: String = [v.p50, v.p90, v.p99, v.max, v.mean]
            .iter()
            .map(|value| format!("{value:>10.digits$}"))
            .collect();
        line(name, cells);
    };
    stats("frame ms", &s.frame_ms, 2);
    stats("of it, work", &s.work_ms, 2);
    stats("of it, measuring", &s.measuring_ms, 2);
    stats("of it, handing over", &s.hand_over_ms, 2);
    stats("frames not measured", &s.frame_unmeasured_ms, 2);
    stats("hashing, beside it", &s.hashing_ms, 2);
    // Where every frame waits for another's measuring there is nothing to state.
    if s.latency_ms.camera_to_picture_frames > 0 {
        stats("camera to picture ms", &s.latency_ms.camera_to_picture, 2);
    }
    stats("OR ms", &s.latency_ms.or, 2);
    stats("HC ms", &s.latency_ms.hc, 2);
    stats("RVG ms", &s.latency_ms.rvg, 2);
    stats("HC to RVG ms", &s.latency_ms.hc_to_rvg, 3);
    stats("HC to OR ms", &s.latency_ms.hc_to_or, 3);
    stats("HC to OR bytes", &s.bandwidth.hc_to_or, 0);
    stats("HC to RVG bytes", &s.bandwidth.hc_to_rvg, 0);
    stats("control bytes", &s.bandwidth.control, 0);
    stats("triangles drawn", &s.triangles.drawn, 0);
    if s.triangles.far.max > 0.0 {
        stats("of these, of cubes", &s.triangles.far, 0);
    }
    stats("source in frustum", &s.triangles.source_in_frustum, 0);
    line("worst frames ms", worst(s));
    let c = &s.culling;
    let efficiency = c.efficiency.map_or("not measured".to_owned(), |e| format!("{e:.2}"));
    let front = c.front.map_or(String::new(), |front| format!("front {front:.0}, "));
    line(
        "hlods a frame",
        format!(
            "{front}in frustum {:.0}, tests {:.0}, visible {:.1}; drawn / with a pixel {efficiency}",
            c.in_frustum, c.tests, c.visible
        ),
    );
    line(
        "visible untested",
        format!("{:.2} at the eye, {:.2} for other reasons", c.at_eye, c.untested),
    );
    let b = &s.bandwidth;
    line(
        "ids, bytes a frame",
        format!(
            "change {:.1} (bound {:.1}), as sent {:.1}, full {:.0}, paper's formula {:.0}",
            b.ids_delta, b.entropy_bound, b.ids_sent, b.ids_full, b.paper_formula
        ),
    );
    line("audit", audit(&s.audit));
    let io = &s.io;
    let mb = |bytes: u64| bytes as f64 / 1e6;
    line(
        "geometry",
        format!(
            "{} meshes there, {} missing, waited {:.1} ms; read {:.1} MB, {:.1} ahead, {:.1} of that used",
            io.hits,
            io.misses,
            io.stall_ms,
            mb(io.bytes_read),
            mb(io.prefetched),
            mb(io.prefetched_used)
        ),
    );
    let missing = &s.stand_ins;
    if missing.frames > 0 {
        line(
            "not as it should be",
            format!(
                "{} frames: {} hlods replaced by coarser ones, {} holes, error up to {:.2} px",
                missing.frames, missing.replaced, missing.holes, missing.error_px
            ),
        );
    }
    let clocks: Vec<String> = s
        .clocks
        .iter()
        .map(|c| format!("seat {} +-{:.3} (round trip {:.3})", c.seat, c.error_ms, c.round_trip_ms))
        .collect();
    line("clocks ms", clocks.join(", "));
    let mib = |bytes: &u64| format!("{:.0}", *bytes as f64 / f64::from(1 << 20));
    let by = |values: &[u64]| values.iter().map(mib).collect::<Vec<_>>().join(" / ");
    line(
        "memory MiB",
        format!(
            "peak {} of which geometry {}",
            by(&s.memory.peak_rss),
            by(&s.memory.peak_resident)
        ),
    );
    out
}

/// What the audit found, in words.
fn audit(found: &Audit) -> String {
    if found.frames == 0 {
        return "off".to_owned();
    }
    let mut text =
        format!("{} differing pixels in {} frames", found.differing_pixels, found.frames);
    if found.unknown_pixels > 0 {
        let unknown = found.unknown_pixels;
        let _ = write!(text, "; {unknown} not compared, for something was not there");
    }
    if found.front_faults > 0 {
        let _ = write!(text, "; {} hlods are wrong on the front", found.front_faults);
    }
    text
}

/// The longest frames, and what in them was not work on the picture.
fn worst(summary: &Summary) -> String {
    let named = summary.worst.iter().map(|worst| {
        let parts = [
            ("lead-in", worst.lead_in_ms),
            ("measuring", worst.measuring_ms),
            ("waiting for geometry", worst.io_stall_ms),
        ];
        let parts: Vec<String> = parts
            .iter()
            .filter(|(_, ms)| *ms >= 0.05)
            .map(|(name, ms)| format!("{name} {ms:.1}"))
            .collect();
        let of_it =
            if parts.is_empty() { String::new() } else { format!(" ({})", parts.join(", ")) };
        format!("#{} {:.1}{of_it}", worst.frame, worst.frame_ms)
    });
    named.collect::<Vec<_>>().join(", ")
}
