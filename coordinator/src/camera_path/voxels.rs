//! Fills a grid with a scene's geometry: every cell that a triangle touches becomes solid.

use super::generate::GenerateError;
use super::grid::Grid;
use protocol::format::{Hlod, Level, Part, Skeleton, Transform, Vertex};
use protocol::id::{BlobId, HlodId};

/// Levels are used whose error is below this share of a cell.
///
/// A quarter leaves room for errors that are estimates: together with the cell of clearance a walker
/// keeps, the true surface may be five times as far off as stated.
const ERROR_OF_CELL: f64 = 0.25;
/// A triangle over more cells than this is halved.
const CELLS_AT_ONCE: usize = 12;
/// How many times as far as the grid reaches a corner may lie away from its own.
const BEYOND: f64 = 4.0;
/// Grows a cell's half side in the overlap test, against rounding.
const SLACK: f64 = 1e-6;

/// Marks the cells of all geometry, of the coarsest levels that are fine enough, and measures clearances.
pub(super) fn fill<B: AsRef<[u8]>, E: std::error::Error + Send + Sync + 'static>(
    grid: &mut Grid,
    skeleton: &Skeleton,
    mut read_blob: impl FnMut(BlobId) -> Result<B, E>,
) -> Result<(), GenerateError> {
    let tolerance = ERROR_OF_CELL * grid.cell;
    let mut open = vec![HlodId(0)];
    while let Some(id) = open.pop() {
        let hlod = skeleton.hlod(id);
        if let Some(level) = fitting_level(skeleton, hlod, tolerance) {
            for part in skeleton.parts_of(level) {
                let blob = BlobId(part.blob);
                let bytes = read_blob(blob)
                    .map_err(|e| GenerateError::Blob { blob, source: Box::new(e) })?;
                fill_part(grid, skeleton, part, bytes.as_ref())?;
            }
        } else {
            open.extend(skeleton.children_of(hlod));
        }
    }
    grid.measure();
    Ok(())
}

/// The coarsest level within the tolerance; a leaf's finest where there is none.
fn fitting_level<'a>(skeleton: &'a Skeleton, hlod: &Hlod, tolerance: f64) -> Option<&'a Level> {
    let levels = skeleton.levels_of(hlod);
    let fitting = levels.iter().rev().find(|level| level.error <= tolerance);
    if hlod.child_count == 0 { fitting.or(levels.first()) } else { fitting }
}

fn fill_part(
    grid: &mut Grid,
    skeleton: &Skeleton,
    part: &Part,
    bytes: &[u8],
) -> Result<(), GenerateError> {
    let id = BlobId(part.blob);
    let bad = |reason: &'static str| GenerateError::Geometry { blob: id, reason };
    let blob = skeleton.blob(id);
    let placement: Transform = skeleton.transform_of(part);
    let one = blob.vertex_layout().vertex_bytes();
    let index_bytes = blob.triangles as usize * 6;
    let (vertices, rest) = bytes.split_at_checked(blob.vertex_bytes()).ok_or(bad("too short"))?;
    let indices = rest.get(..index_bytes).ok_or(bad("too short"))?;
    let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let points: Vec<[f64; 3]> = vertices
        .chunks_exact(one)
        .map(|v| {
            let vertex = Vertex { position: [word(v), word(&v[4..])], normal: 0, color: 0 };
            let g = vertex.grid();
            let mesh = std::array::from_fn(|k| blob.origin[k] + blob.step * f64::from(g[k]));
            grid.local(placement.apply(mesh))
        })
        .collect();
    // What far exceeds the scene's box would be cut for ever; an approximation may leave it a little.
    let is_near = |p: &[f64; 3]| (0..3).all(|k| p[k].abs() <= BEYOND * grid.dims[k] as f64);
    if !points.iter().all(is_near) {
        return Err(bad("it lies far outside of the scene's box; bake the scene again"));
    }
    for triangle in indices.chunks_exact(6) {
        let corner = |k: usize| {
            let index = u16::from_le_bytes([triangle[2 * k], triangle[2 * k + 1]]);
            points.get(usize::from(index)).copied().ok_or(bad("an index is out of range"))
        };
        fill_triangle(grid, [corner(0)?, corner(1)?, corner(2)?]);
    }
    Ok(())
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Marks every cell a triangle of local points touches; halves it while its box is large, so that a
/// long slanting one does not cost the volume of its box.
fn fill_triangle(grid: &mut Grid, triangle: [[f64; 3]; 3]) {
    let mut open = vec![triangle];
    while let Some(t) = open.pop() {
        let bound = |pick: fn(f64, f64) -> f64, slack: f64| -> [usize; 3] {
            std::array::from_fn(|k| {
                let c = pick(pick(t[0][k], t[1][k]), t[2][k]) + slack;
                // A cast of a float saturates at 0, and what lies past the last cell counts there.
                (c as usize).min(grid.dims[k] - 1)
            })
        };
        let (low, high) = (bound(f64::min, -SLACK), bound(f64::max, SLACK));
        let cells: usize = (0..3).map(|k| high[k] - low[k] + 1).product();
        let edges: [[f64; 3]; 3] = std::array::from_fn(|k| sub(t[(k + 1) % 3], t[k]));
        let long = (0..3).fold(0, |best, k| {
            if dot(edges[k], edges[k]) > dot(edges[best], edges[best]) { k } else { best }
        });
        if cells > CELLS_AT_ONCE && dot(edges[long], edges[long]) > 1.0 {
            let (a, b, c) = (t[long], t[(long + 1) % 3], t[(long + 2) % 3]);
            let middle = std::array::from_fn(|k| 0.5 * (a[k] + b[k]));
            open.push([a, middle, c]);
            open.push([middle, b, c]);
            continue;
        }
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let index = grid.index([x, y, z]);
                    if !grid.solid(index)
                        && (cells == 1 || touches(&t, &edges, [x, y, z].map(|c| c as f64 + 0.5)))
                    {
                        grid.fill(index);
                    }
                }
            }
        }
    }
}

/// Triangle against the unit cell around `middle` by separating axes (Akenine-Moller 2001, "Fast 3D
/// triangle-box overlap testing"); the cell's own three axes are settled by the caller's box.
fn touches(triangle: &[[f64; 3]; 3], edges: &[[f64; 3]; 3], middle: [f64; 3]) -> bool {
    let p = triangle.map(|corner| sub(corner, middle));
    let apart = |axis: [f64; 3]| {
        let reach = (0.5 + SLACK) * (axis[0].abs() + axis[1].abs() + axis[2].abs());
        let at = p.map(|corner| dot(corner, axis));
        at.iter().all(|&c| c > reach) || at.iter().all(|&c| c < -reach)
    };
    let unit = |k: usize| std::array::from_fn(|i| f64::from(u8::from(i == k)));
    !apart(cross(edges[0], edges[1]))
        && edges.iter().all(|&edge| (0..3).all(|k| !apart(cross(edge, unit(k)))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        Grid::around([0.0; 3], [30.0; 3], [0.0, 0.0, 1.0], 60_000)
    }

    #[test]
    fn points_of_a_triangle_lie_in_solid_cells_and_far_cells_stay_free() {
        for t in [
            [[1.2, 1.3, 2.0], [19.5, 4.0, 9.0], [3.0, 18.0, 18.5]],
            [[3.0, 3.0, 5.0], [15.0, 3.0, 5.0], [15.0, 15.0, 5.0]],
            [[2.0, 2.0, 2.0], [18.0, 18.0, 18.0], [2.0, 2.0, 2.0]],
            [[7.5, 7.5, 7.5]; 3],
        ] {
            let mut grid = grid();
            fill_triangle(&mut grid, t);
            let mut near = vec![false; grid.len()];
            for i in 0..=200 {
                for j in 0..=200 - i {
                    let (u, v) = (f64::from(i) / 200.0, f64::from(j) / 200.0);
                    let w = 1.0 - u - v;
                    let p = std::array::from_fn(|k| t[0][k] * u + t[1][k] * v + t[2][k] * w);
                    let cell = grid.cell_at(p).unwrap();
                    assert!(grid.solid(cell), "{p:?}");
                    for step in (0..27).map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1]) {
                        let around = grid.step(cell, step).unwrap();
                        let off = sub(grid.middle(around), p).map(f64::abs);
                        // Samples lie up to a tenth of a cell apart.
                        near[around] |= off.iter().all(|&c| c < 0.6);
                    }
                }
            }
            assert!((0..grid.len()).all(|i| near[i] || !grid.solid(i)), "{t:?}");
        }
    }
}
