//! What a bake of far fields tells.

use serde::Serialize;

/// What was made of one cell.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CellSummary {
    /// Least corner.
    pub min: [f64; 3],
    /// Greatest corner.
    pub max: [f64; 3],
    /// Its far field is worth cubes.
    pub kept: bool,
    /// Samples.
    pub samples: usize,
    /// Cubes made of them: fewer where geometry turned out to be cheaper before all were.
    pub cubes: usize,
    /// Greatest void surface seen from any candidate after the corners, then after each further
    /// sample, steradians.
    pub objective: Vec<f64>,
    /// Points of the samples that cubes were made of.
    pub points: u64,
    /// Of those, removed.
    pub redundant: u64,
    /// Triangles of all cubes that were made.
    pub triangles: u64,
    /// Triangles that the views have in sight of the cubes drawn by default, mean.
    pub cubes_in_view: u64,
    /// And of the same as geometry, at one pixel of error.
    pub geometry_in_view: u64,
    /// Triangles of the source in the near field.
    pub near_triangles: u64,
    /// Bytes of all faces.
    pub bytes: u64,
    /// Seconds spent placing, sampling and encoding.
    pub seconds: [f64; 3],
}

/// What was made.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FarSummary {
    /// By cell.
    pub cells: Vec<CellSummary>,
    /// Bytes of the file.
    pub file_bytes: u64,
}

impl std::fmt::Display for FarSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (at, cell) in self.cells.iter().enumerate() {
            let [least, most] =
                [cell.min, cell.max].map(|c| c.map(|c| format!("{c:.1}")).join(" "));
            writeln!(f, "cell {at:<10} {least} to {most}, {} triangles near", cell.near_triangles)?;
            let shown: Vec<String> = cell.objective.iter().map(|sr| format!("{sr:.2}")).collect();
            writeln!(f, "  samples       {}, unseen sr {}", cell.samples, shown.join(" "))?;
            let removed = 100.0 * cell.redundant as f64 / cell.points.max(1) as f64;
            writeln!(
                f,
                "  points        {} of {} cubes, {removed:.1}% redundant",
                cell.points, cell.cubes
            )?;
            let fate = match (cell.kept, cell.cubes_in_view < cell.geometry_in_view) {
                (true, true) => "kept",
                (true, false) => "geometry is cheaper: kept all the same",
                (false, _) => "geometry is cheaper: left out",
            };
            writeln!(
                f,
                "  triangles     {} in cubes; in view {}, as geometry {}: {fate}",
                cell.triangles, cell.cubes_in_view, cell.geometry_in_view
            )?;
            let [place, sample, encode] = cell.seconds;
            writeln!(
                f,
                "  bytes         {}; seconds: place {place:.1}, sample {sample:.1}, encode {encode:.1}",
                cell.bytes
            )?;
        }
        write!(f, "file            {} bytes", self.file_bytes)
    }
}
