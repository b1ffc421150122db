//! The log of a run: pure figures from a [`RunRecord`], then the files of INTERFACES.

pub mod frames;
mod plot;
pub mod report;
pub mod stats;
pub mod summary;
pub mod table;
pub mod trace;

#[cfg(test)]
mod tests;

use crate::out_folder::frames_of;
use crate::record::RunRecord;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What is written, in this order: where there is a summary, all is there.
pub const FILES: [&str; 4] = ["frames.csv", "trace.json", "report.html", "summary.json"];

/// Facts about the scene a run showed.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFacts {
    /// Where the scene file lies.
    pub path: String,
    /// Hlods of the hierarchy.
    pub hlods: u64,
    /// Triangles of the source, instances counted each.
    pub triangles: u64,
    /// Objects of the source.
    pub objects: u64,
    /// Digest of the scene file, in hex.
    pub digest: String,
    /// Distance of the near plane over the frames, scene units.
    pub near: stats::Stats,
}

/// A log file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {source}; check that the folder exists, is writable and has room", path.display())]
pub struct LogError {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub source: std::io::Error,
}

/// The figures of a run, nothing written.
pub fn figures(record: &RunRecord, scene: &SceneFacts) -> summary::Summary {
    summary::summarise(record, scene, &frames::rows(record))
}

/// Writes [`FILES`] into `dir`, each to a temporary name first, and returns the summary.
pub fn write_all(
    record: &RunRecord,
    scene: &SceneFacts,
    dir: &Path,
) -> Result<summary::Summary, LogError> {
    let rows = frames::rows(record);
    let summary = summary::summarise(record, scene, &rows);
    let json = serde_json::to_string_pretty(&summary).expect("the summary holds only plain values");
    let [rest @ .., last] = FILES.map(|name| dir.join(name));
    let [of_frames, of_trace, of_report] = rest;
    publish(&of_frames, &frames::csv(&rows))?;
    publish(&of_trace, trace::trace(record).as_bytes())?;
    publish(&of_report, report::html(&summary, &rows, &frames_of(dir)).as_bytes())?;
    publish(&last, json.as_bytes())?;
    Ok(summary)
}

/// Writes a whole file under a temporary name beside it, then renames: never half a file.
fn publish(path: &Path, bytes: &[u8]) -> Result<(), LogError> {
    let fail = |source| LogError { path: path.to_owned(), source };
    let temporary = path.with_extension(format!("part-{}", std::process::id()));
    let write = || {
        let mut file = std::fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)
    };
    write().inspect_err(|_| drop(std::fs::remove_file(&temporary))).map_err(fail)
}
