//! A grid of cells that are solid or free, upright in the scene, with how far each is from the solid.

/// Most cells of a grid: 8 MB, and a quarter of a metre in a hall of 80 x 48 x 30 m.
pub(super) const MAX_CELLS: usize = 8_000_000;
/// Finest cells, as a share of the scene's diagonal.
const FINEST_OF_DIAGONAL: f64 = 1.0 / 700.0;
/// Height of a walker's eye where one unit is a metre.
const EYE_HEIGHT: f64 = 1.6;
/// The eye's height stays within these shares of the diagonal, whatever the unit may be.
const EYE_OF_DIAGONAL: [f64; 2] = [0.002, 0.1];
/// Classes beyond this one are not told apart, see [`Grid::class`].
pub(super) const FARTHEST: u8 = 4;
/// Least class of a cell that none of the 26 around it is solid.
pub(super) const CLEAR: u8 = 2;

/// Local coordinates are in cells, from the grid's corner; the third runs up.
pub(super) struct Grid {
    /// Scene axis of each local one.
    axes: [usize; 3],
    /// The scene's up axis points down.
    flipped: bool,
    /// Corner, along the local axes, scene units.
    origin: [f64; 3],
    /// Side of a cell, scene units.
    pub(super) cell: f64,
    /// Cells along each local axis.
    pub(super) dims: [usize; 3],
    /// Height of the eye's cell above a floor's cell.
    pub(super) eye_cells: usize,
    class: Vec<u8>,
}

impl Grid {
    /// An empty grid around a finite box, with room for an eye above it; `up` is rounded to an axis.
    pub(super) fn around(min: [f64; 3], max: [f64; 3], up: [f64; 3], max_cells: usize) -> Self {
        let vertical =
            (0..3).fold(0, |best, k| if up[k].abs() > up[best].abs() { k } else { best });
        let axes = [(vertical + 1) % 3, (vertical + 2) % 3, vertical];
        let flipped = up[vertical] < 0.0;
        let extent: [f64; 3] = std::array::from_fn(|k| max[axes[k]] - min[axes[k]]);
        let diagonal = extent.iter().map(|e| e * e).sum::<f64>().sqrt();
        let scale = if diagonal > 0.0 { diagonal } else { 1.0 };
        let [least, most] = EYE_OF_DIAGONAL.map(|share| share * scale);
        let height = EYE_HEIGHT.clamp(least, most);
        let mut cell = scale * FINEST_OF_DIAGONAL;
        loop {
            let eye_cells = ((height / cell).round() as usize).max(2);
            // One free cell all round, and above it all a standing eye with its clearance.
            let pad = [2, 2, eye_cells + 4];
            let dims: [usize; 3] =
                std::array::from_fn(|k| (extent[k] / cell) as usize + 1 + pad[k]);
            if dims.iter().product::<usize>() <= max_cells {
                let origin = std::array::from_fn(|k| {
                    let low = if k == 2 && flipped { -max[axes[k]] } else { min[axes[k]] };
                    low - cell
                });
                let class = vec![FARTHEST; dims.iter().product()];
                return Self { axes, flipped, origin, cell, dims, eye_cells, class };
            }
            cell *= 1.05;
        }
    }

    /// Scene point to local point.
    pub(super) fn local(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| {
            let c = p[self.axes[k]];
            let c = if k == 2 && self.flipped { -c } else { c };
            (c - self.origin[k]) / self.cell
        })
    }

    /// Local point to scene point.
    pub(super) fn scene(&self, p: [f64; 3]) -> [f64; 3] {
        let mut out = self.scene_direction(p);
        for k in 0..3 {
            let o = if k == 2 && self.flipped { -self.origin[k] } else { self.origin[k] };
            out[self.axes[k]] += o;
        }
        out
    }

    /// Local difference to scene difference.
    pub(super) fn scene_direction(&self, d: [f64; 3]) -> [f64; 3] {
        let mut out = [0.0; 3];
        for k in 0..3 {
            let c = d[k] * self.cell;
            out[self.axes[k]] = if k == 2 && self.flipped { -c } else { c };
        }
        out
    }

    /// Index of the cell that holds a local point; none outside.
    pub(super) fn cell_at(&self, p: [f64; 3]) -> Option<usize> {
        let inside = (0..3).all(|k| p[k] >= 0.0 && p[k] < self.dims[k] as f64);
        inside.then(|| self.index(p.map(|c| c as usize)))
    }

    pub(super) fn index(&self, c: [usize; 3]) -> usize {
        (c[2] * self.dims[1] + c[1]) * self.dims[0] + c[0]
    }

    pub(super) fn coordinates(&self, index: usize) -> [usize; 3] {
        let rest = index / self.dims[0];
        [index % self.dims[0], rest % self.dims[1], rest / self.dims[1]]
    }

    /// Middle of a cell, local.
    pub(super) fn middle(&self, index: usize) -> [f64; 3] {
        self.coordinates(index).map(|c| c as f64 + 0.5)
    }

    /// The cell a step away; none outside.
    pub(super) fn step(&self, index: usize, step: [isize; 3]) -> Option<usize> {
        let from = self.coordinates(index);
        let mut to = [0; 3];
        for k in 0..3 {
            to[k] = from[k].checked_add_signed(step[k]).filter(|&c| c < self.dims[k])?;
        }
        Some(self.index(to))
    }

    pub(super) fn len(&self) -> usize {
        self.class.len()
    }

    pub(super) fn fill(&mut self, index: usize) {
        self.class[index] = 0;
    }

    /// Steps (of a chess king in space) to the nearest solid cell, at most [`FARTHEST`]; 0 is solid.
    pub(super) fn class(&self, index: usize) -> u8 {
        self.class[index]
    }

    pub(super) fn solid(&self, index: usize) -> bool {
        self.class[index] == 0
    }

    /// A local point lies in a free cell.
    pub(super) fn free_at(&self, p: [f64; 3]) -> bool {
        self.cell_at(p).is_some_and(|i| !self.solid(i))
    }

    /// Classes of the free cells, once all solid ones are filled.
    pub(super) fn measure(&mut self) {
        // The least class within one step along each axis in turn is that of the whole cube around.
        for distance in 1..FARTHEST {
            let mut near: Vec<bool> = self.class.iter().map(|&c| c < distance).collect();
            for axis in 0..3 {
                near = self.dilated(&near, axis);
            }
            for (class, near) in self.class.iter_mut().zip(near) {
                if near && *class > distance {
                    *class = distance;
                }
            }
        }
    }

    fn dilated(&self, set: &[bool], axis: usize) -> Vec<bool> {
        let stride = [1, self.dims[0], self.dims[0] * self.dims[1]][axis];
        let count = self.dims[axis];
        (0..set.len())
            .map(|i| {
                let at = i / stride % count;
                set[i] || (at > 0 && set[i - stride]) || (at + 1 < count && set[i + stride])
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_boxes_make_grids() {
        for (min, max) in [
            ([5.0; 3], [5.0; 3]),
            ([0.0; 3], [1e6, 0.0, 1e6]),
            ([1e7, 0.0, 0.0], [1e7 + 1.0, 1e-9, 300.0]),
        ] {
            let grid = Grid::around(min, max, [0.0, 1.0, 0.0], 100_000);
            assert!(grid.len() <= 100_000);
            assert!(grid.dims[2] >= grid.eye_cells + 4);
            for corner in [min, max] {
                assert!(grid.cell_at(grid.local(corner)).is_some());
            }
        }
    }

    #[test]
    fn local_and_scene_are_inverse_for_every_up() {
        for up in [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.1, 0.0, -0.9]] {
            let grid = Grid::around([1.0, 2.0, 3.0], [4.0, 8.0, 9.0], up, 10_000);
            let p = [2.0, 7.5, 4.25];
            let q = grid.scene(grid.local(p));
            assert!((0..3).all(|k| (p[k] - q[k]).abs() < 1e-9), "{up:?} {q:?}");
            let higher = grid.local(std::array::from_fn(|k| p[k] + up[k]));
            assert!(higher[2] > grid.local(p)[2]);
        }
    }

    #[test]
    fn classes_are_chessboard_distances() {
        let mut grid = Grid::around([0.0; 3], [10.0; 3], [0.0, 1.0, 0.0], 20_000);
        let c = [5, 6, 7];
        grid.fill(grid.index(c));
        grid.measure();
        for i in 0..grid.len() {
            let p = grid.coordinates(i);
            let distance = (0..3).map(|k| p[k].abs_diff(c[k])).max().unwrap();
            assert_eq!(usize::from(grid.class(i)), distance.min(usize::from(FARTHEST)));
        }
    }
}
