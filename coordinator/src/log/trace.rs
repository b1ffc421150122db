//! `trace.json`: all roles on one clock, in Chrome's trace event format (opens in Perfetto).

use crate::record::{NodeRecord, RunRecord};
use protocol::telemetry::WorkReport;
use serde_json::{Value, json};

/// The run as a trace; times in microseconds since the first phase.
pub fn trace(record: &RunRecord) -> String {
    let zero = record.phases.first().map_or(0, |phase| phase.started as i64);
    let micros = |time: i64| (time - zero) as f64 / 1e3;
    let mut events = vec![name_event(0, "coordinator".to_owned())];
    for node in &record.nodes {
        events.push(name_event(lane(node), format!("seat {} (pid {})", node.seat, node.pid)));
    }
    for phase in &record.phases {
        let (start, end) = (phase.started as i64, phase.ended as i64);
        events.push(span_event(
            0,
            &format!("phase {}", phase.phase.0),
            micros(start),
            micros(end),
            json!({}),
        ));
        for (seat, report) in &phase.reports {
            let node = record.nodes.iter().find(|node| node.seat == *seat);
            if let (Some(node), Some(work)) = (node, &report.work) {
                let at = |time: u64| micros(time as i64 + node.clock.offset);
                events.push(work_event(lane(node), work, at));
            }
        }
    }
    json!({ "displayTimeUnit": "ms", "traceEvents": events }).to_string()
}

fn lane(node: &NodeRecord) -> u32 {
    u32::from(node.seat.0) + 1
}

fn work_event(lane: u32, work: &WorkReport, at: impl Fn(u64) -> f64) -> Value {
    let name = format!("{}({})", work.role.short(), work.frame);
    let detail = match (&work.cull, &work.draw) {
        (Some(cull), _) => {
            json!({ "in_frustum": cull.in_frustum, "queries": cull.queries, "visible": cull.visible })
        }
        (None, Some(draw)) => json!({ "hlods": draw.hlods, "triangles": draw.triangles }),
        (None, None) => json!({}),
    };
    span_event(lane, &name, at(work.started), at(work.finished), detail)
}

fn span_event(lane: u32, name: &str, start: f64, end: f64, detail: Value) -> Value {
    json!({ "name": name, "ph": "X", "pid": lane, "tid": lane, "ts": start, "dur": end - start, "args": detail })
}

fn name_event(lane: u32, name: String) -> Value {
    json!({ "name": "process_name", "ph": "M", "pid": lane, "tid": lane, "args": { "name": name } })
}
