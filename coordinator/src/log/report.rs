//! `report.html`: one self-contained page with plots, the table and a strip of pictures.

use super::frames::FrameRow;
use super::plot::{Curve, plot};
use super::summary::Summary;
use super::table::table;
use base64::Engine;
use protocol::file;
use std::fmt::Write;
use std::io::Read;
use std::path::Path;

/// Most pictures on the strip.
const STRIP: usize = 8;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:900px;padding:0 1rem;\
color:#1f2328;background:#fff}h1{font-size:1.5rem}pre{background:#f6f8fa;padding:1rem;overflow-x:auto;font-size:12px}\
figure{margin:1.5rem 0}figcaption{font-weight:600}svg{width:100%;height:auto}svg text{font-size:11px;fill:#59636e}\
.grid{stroke:#d1d9e0}polyline{fill:none;stroke-width:1.5}.legend span{margin-right:1rem}.legend i{display:inline-block;\
width:.8em;height:.8em;margin-right:.3em}.strip{display:grid;grid-template-columns:1fr 1fr;gap:.5rem}.strip img{width:100%}\
.strip figure{margin:0}.strip figcaption{font-weight:400;font-size:12px}";

/// The page. Pictures are taken from `frames_dir` where the run wrote them.
pub fn html(summary: &Summary, rows: &[FrameRow], frames_dir: &Path) -> String {
    let curve = |name, figure: fn(&FrameRow) -> f64| Curve {
        name,
        values: rows.iter().map(|r| Some(figure(r))).collect(),
    };
    let gapped = |name, figure: fn(&FrameRow) -> Option<f64>| Curve {
        name,
        values: rows.iter().map(figure).collect(),
    };
    let plots = [
        plot(
            "Frame time",
            "ms",
            &[
                curve("frame", |r| r.frame_ms),
                curve("of it, work", |r| r.work_ms),
                curve("of it, measuring", |r| r.measuring_ms),
                curve("of it, handing over", |r| r.hand_over_ms),
                curve("hashing, beside it", |r| r.hashing_ms),
            ],
        ),
        plot(
            "Work by role",
            "ms",
            &[curve("OR", |r| r.or_ms), curve("HC", |r| r.hc_ms), curve("RVG", |r| r.rvg_ms)],
        ),
        plot(
            "Camera to picture, and the visible set's way",
            "ms",
            &[
                gapped("camera to picture", |r| r.camera_to_picture_ms),
                gapped("HC to RVG", |r| r.hc_to_rvg_ms),
                gapped("HC to OR", |r| r.hc_to_or_ms),
            ],
        ),
        plot(
            "Bytes on the sockets",
            "bytes a frame",
            &[
                curve("HC to OR", |r| r.hc_to_or_bytes as f64),
                curve("HC to RVG", |r| r.hc_to_rvg_bytes as f64),
                curve("control", |r| r.control_bytes as f64),
            ],
        ),
        plot(
            "Change of the visible set",
            "bytes a frame",
            &[
                curve("code", |r| r.ids_delta),
                curve("its entropy bound", |r| r.entropy_bound),
                curve("as sent, with counts", |r| f64::from(r.ids_sent)),
            ],
        ),
        plot("The whole visible set", "bytes a frame", &[curve("ids", |r| f64::from(r.ids_full))]),
        plot(
            "Hlods",
            "count",
            &[
                curve("in frustum", |r| f64::from(r.in_frustum)),
                curve("visible", |r| f64::from(r.visible)),
                gapped("with a visible pixel", |r| r.with_pixels.map(f64::from)),
            ],
        ),
        plot(
            "Triangles",
            "count",
            &[
                curve("drawn", |r| r.triangles_drawn as f64),
                curve("of cubes", |r| r.triangles_far as f64),
                curve("occluders", |r| r.triangles_occluders as f64),
            ],
        ),
        plot(
            "Geometry loaded, all nodes",
            "bytes a frame",
            &[
                curve("read", |r| r.io_bytes_read as f64),
                curve("of it, read ahead", |r| r.io_prefetched as f64),
                curve("read ahead, needed first now", |r| r.io_prefetched_used as f64),
                curve("given up", |r| r.io_evicted as f64),
            ],
        ),
        plot(
            "Meshes needed, all nodes",
            "count",
            &[curve("there", |r| r.io_hits as f64), curve("missing", |r| r.io_misses as f64)],
        ),
        plot(
            "Waiting because of loading",
            "ms",
            &[curve("longest of any node", |r| r.io_stall_ms)],
        ),
        plot(
            "Error of what stood in for missing geometry",
            "pixels",
            &[curve("greatest", |r| r.stand_in_error_px)],
        ),
    ];
    let mut page = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Occluster run</title><style>{STYLE}</style><h1>Occluster: {}</h1>",
        escape(&summary.scene.path)
    );
    page.push_str(&strip(rows, frames_dir));
    let _ = write!(page, "<pre>{}</pre>", escape(&table(summary)));
    plots.iter().for_each(|plot| page.push_str(plot));
    page.push_str("</html>\n");
    page
}

/// Pictures at even distances along the run, embedded.
fn strip(rows: &[FrameRow], frames_dir: &Path) -> String {
    let shown = STRIP.min(rows.len());
    let pictures: String = (0..shown)
        .filter_map(|k| {
            let row = &rows[k * (rows.len() - 1) / (shown - 1).max(1)];
            let mut png = Vec::new();
            let mut file = file::open(&frames_dir.join(format!("{:06}.png", row.frame))).ok()?;
            file.read_to_end(&mut png).ok()?;
            let data = base64::engine::general_purpose::STANDARD.encode(png);
            Some(format!(
                "<figure><img alt=\"frame {0}\" src=\"data:image/png;base64,{data}\"><figcaption>frame {0}: {1} hlods, {2} \
                 triangles</figcaption></figure>",
                row.frame, row.visible, row.triangles_drawn
            ))
        })
        .collect();
    if pictures.is_empty() {
        String::new()
    } else {
        format!("<div class=\"strip\">{pictures}</div>")
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
