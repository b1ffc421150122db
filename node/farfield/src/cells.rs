//! View cells: regions of viewpoints that share a far field (paper 000, sections 3.1.1 and 5.1).

use crate::placement::Region;
use glam::DVec3;
use protocol::format::Skeleton;
#[cfg(doc)]
use protocol::format::ViewCell;
use scene::near_field::{NearField, with_margin};
use std::collections::BTreeMap;

/// Triangles of a cell's near field above which it is divided.
pub const CELL_TRIANGLES: u64 = 100_000;

/// Share of its sides by which a cell's near field reaches beyond it ([`ViewCell::margin`]): of cells of 10 m the
/// last and first 0.3 m, together a step, are the change from one to the next.
pub const MARGIN: f32 = 1.0 / 32.0;

/// How the scene is divided into cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Division {
    /// A cell is divided while its near field has more triangles of the source than this.
    pub most_triangles: u64,
    /// And while it lies at most this deep.
    pub most_depth: u32,
}

impl Default for Division {
    /// What is drawn as geometry beside the cubes is worth about as much as an intra cube (tens of
    /// thousands of triangles). Six halvings of an 80 m plant give cells of 1.3 m: below that a person
    /// leaves one with each step.
    fn default() -> Self {
        Self { most_triangles: CELL_TRIANGLES, most_depth: 6 }
    }
}

/// One cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Least corner, scene units.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
    /// What is drawn as geometry from inside it and its margin.
    pub near: NearField,
    /// Those of the viewpoints asked for that lie in it.
    pub viewpoints: Vec<DVec3>,
}

impl Cell {
    /// Where samples may be taken: at the mean height of its viewpoints, `up` being the axis, or anywhere
    /// (`in_space`).
    pub fn region(&self, up: usize, in_space: bool) -> Region {
        let (mut min, mut max) = (self.min, self.max);
        if in_space {
            return Region::Box { min, max };
        }
        let heights = self.viewpoints.iter().map(|viewpoint| viewpoint[up]);
        let height = heights.sum::<f64>() / self.viewpoints.len() as f64;
        (min[up], max[up]) = (height, height);
        Region::Rectangle { min, max, up }
    }
}

/// The cells that hold `viewpoints`, each once, in the order of the octree over the scene's box. Viewpoints
/// outside of the scene are in no cell.
pub fn cells_along(skeleton: &Skeleton, viewpoints: &[DVec3], division: &Division) -> Vec<Cell> {
    let Some(root) = skeleton.hlods.first() else { return Vec::new() };
    let (min, max) = (DVec3::from_array(root.min), DVec3::from_array(root.max));
    let mut cells: BTreeMap<Vec<u8>, Cell> = BTreeMap::new();
    // Near fields by path: many viewpoints go the same way.
    let mut known: BTreeMap<Vec<u8>, NearField> = BTreeMap::new();
    for &viewpoint in viewpoints {
        if viewpoint.cmplt(min).any() || viewpoint.cmpgt(max).any() {
            continue;
        }
        let (mut path, mut min, mut max) = (Vec::new(), min, max);
        let near = loop {
            let made = || {
                let [min, max] = with_margin(min.to_array(), max.to_array(), MARGIN);
                NearField::new(skeleton, min, max)
            };
            let near = known.entry(path.clone()).or_insert_with(made);
            let is_small = near.triangles(skeleton) <= division.most_triangles;
            if is_small || path.len() as u32 >= division.most_depth {
                break near.clone();
            }
            let middle = 0.5 * (min + max);
            let mut octant = 0;
            for k in 0..3 {
                // A viewpoint on the border belongs to the upper side, as at run time.
                if viewpoint[k] >= middle[k] {
                    min[k] = middle[k];
                    octant |= 1 << k;
                } else {
                    max[k] = middle[k];
                }
            }
            path.push(octant);
        };
        let cell = Cell { min, max, near, viewpoints: Vec::new() };
        cells.entry(path).or_insert(cell).viewpoints.push(viewpoint);
    }
    cells.into_values().collect()
}

/// The axis that points up most: along it a walker's eye keeps its height.
pub fn up_axis(skeleton: &Skeleton) -> usize {
    let up = DVec3::from_array(skeleton.info.up).abs();
    (0..3).rev().max_by(|&a, &b| up[a].total_cmp(&up[b])).unwrap_or(2)
}
