//! Where a walker can be, and the ways between.

use super::grid::{CLEAR, FARTHEST, Grid};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

const NONE: u32 = u32::MAX;
/// Fewer cells than this to walk on are no floor but, say, the top of a chimney.
const LEAST_FLOOR: usize = 200;
/// A region shorter than this share of the grid's diagonal is taken only where there is no longer one:
/// the inside of a closed tank is free and enclosed, but no place to walk.
const LEAST_SPAN: f64 = 0.25;
/// Places that are judged for how much there is to see.
const JUDGED: usize = 60_000;
/// How far a place looks around itself, as a share of the grid's longest side.
const VIEW_OF_LONGEST: f64 = 0.1;

/// The steps to the 26 cells around one.
fn steps() -> impl Iterator<Item = [isize; 3]> {
    (-1..=1)
        .flat_map(|z| (-1..=1).flat_map(move |y| (-1..=1).map(move |x| [x, y, z])))
        .filter(|step| *step != [0, 0, 0])
}

/// The connected set of cells a walk keeps to.
///
/// No cell of it touches a solid one, so a straight line between the middles of two that touch each
/// other runs through free cells alone.
pub(super) struct Region {
    /// Cells, ascending.
    pub(super) cells: Vec<u32>,
    /// Index into `cells` by cell.
    node_of: Vec<u32>,
    /// Some of the nodes with how enclosed they are, always at least one.
    pub(super) places: Vec<(u32, u64)>,
}

impl Region {
    /// The region with most to see: on floors where there are any, else anywhere free; none where
    /// there is no room to move at all.
    pub(super) fn find(grid: &Grid) -> Option<Self> {
        let floors: Vec<u32> =
            (0..grid.len()).filter(|&i| on_floor(grid, i)).map(|i| i as u32).collect();
        if let Some(region) = Self::best(grid, floors).filter(|r| r.cells.len() >= LEAST_FLOOR) {
            return Some(region);
        }
        let free = (0..grid.len()).filter(|&i| grid.class(i) >= CLEAR).map(|i| i as u32).collect();
        Self::best(grid, free).filter(|r| r.cells.len() >= 2)
    }

    /// The connected part of `cells` whose places see most.
    fn best(grid: &Grid, cells: Vec<u32>) -> Option<Self> {
        let mut node_of = vec![NONE; grid.len()];
        for (node, &cell) in cells.iter().enumerate() {
            node_of[cell as usize] = node as u32;
        }
        let mut part = vec![NONE; cells.len()];
        let mut spans_scene = Vec::new();
        for start in 0..cells.len() {
            if part[start] != NONE {
                continue;
            }
            let id = spans_scene.len() as u32;
            part[start] = id;
            let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
            let mut open = vec![start];
            while let Some(node) = open.pop() {
                let at = grid.coordinates(cells[node] as usize);
                low = std::array::from_fn(|k| at[k].min(low[k]));
                high = std::array::from_fn(|k| at[k].max(high[k]));
                for next in neighbours(grid, &node_of, cells[node] as usize) {
                    if part[next] == NONE {
                        part[next] = id;
                        open.push(next);
                    }
                }
            }
            let square = |d: [usize; 3]| d.iter().map(|c| (c * c) as f64).sum::<f64>();
            let extent = square(std::array::from_fn(|k| high[k] - low[k]));
            spans_scene.push(extent >= LEAST_SPAN * LEAST_SPAN * square(grid.dims));
        }
        let parts = spans_scene.len() as u32;
        // Judging every cell of a large open space would take minutes.
        let stride = cells.len().div_ceil(JUDGED).max(1);
        let mut score = vec![0u64; parts as usize];
        let mut judged = Vec::new();
        for node in (0..cells.len()).step_by(stride) {
            let value = enclosure(grid, cells[node] as usize);
            score[part[node] as usize] += value;
            judged.push((node, value));
        }
        // The first of equals, whatever the order of the search.
        let best =
            (0..parts).max_by_key(|&p| (spans_scene[p as usize], score[p as usize], Reverse(p)))?;
        let kept: Vec<u32> =
            (0..cells.len()).filter(|&n| part[n] == best).map(|n| cells[n]).collect();
        node_of.fill(NONE);
        for (node, &cell) in kept.iter().enumerate() {
            node_of[cell as usize] = node as u32;
        }
        let places: Vec<(u32, u64)> = judged
            .into_iter()
            .filter(|&(node, _)| part[node] == best)
            .map(|(node, value)| (node_of[cells[node] as usize], value))
            .collect();
        (!places.is_empty()).then_some(Self { cells: kept, node_of, places })
    }

    /// The cheapest way between two nodes, both ends included; it keeps off walls where it can.
    pub(super) fn route(&self, grid: &Grid, from: u32, to: u32) -> Vec<u32> {
        let goal = grid.coordinates(self.cells[to as usize] as usize);
        let estimate = |node: usize| {
            let at = grid.coordinates(self.cells[node] as usize);
            let mut d: [usize; 3] = std::array::from_fn(|k| at[k].abs_diff(goal[k]));
            d.sort_unstable();
            // The least cost of the octile distance: as many diagonals as fit.
            (d[0] as u32 * STEP[2]
                + (d[1] - d[0]) as u32 * STEP[1]
                + (d[2] - d[1]) as u32 * STEP[0])
                * wall_factor(FARTHEST)
        };
        let mut cost = vec![u32::MAX; self.cells.len()];
        let mut came_from = vec![NONE; self.cells.len()];
        let mut open = BinaryHeap::new();
        cost[from as usize] = 0;
        open.push(Reverse((estimate(from as usize), from)));
        while let Some(Reverse((promised, node))) = open.pop() {
            if node == to {
                break;
            }
            let node = node as usize;
            if promised > cost[node] + estimate(node) {
                continue;
            }
            let cell = self.cells[node] as usize;
            let at = grid.coordinates(cell);
            for next in neighbours(grid, &self.node_of, cell) {
                let there = grid.coordinates(self.cells[next] as usize);
                let moved = (0..3).filter(|&k| at[k] != there[k]).count();
                let class = grid.class(self.cells[next] as usize);
                let reached = cost[node] + STEP[moved - 1] * wall_factor(class);
                if reached < cost[next] {
                    cost[next] = reached;
                    came_from[next] = node as u32;
                    open.push(Reverse((reached + estimate(next), next as u32)));
                }
            }
        }
        let mut way = vec![to];
        let mut at = to;
        while at != from {
            at = came_from[at as usize];
            assert!(at != NONE, "a region is connected");
            way.push(at);
        }
        way.reverse();
        way
    }
}

/// Cost of a step along one, two and three axes: 10 times its length.
const STEP: [u32; 3] = [10, 14, 17];

/// What a step into a cell of this class costs more: brushing along a wall is dear.
fn wall_factor(class: u8) -> u32 {
    u32::from(FARTHEST - class.min(FARTHEST)) + 1
}

fn neighbours<'a>(
    grid: &'a Grid,
    node_of: &'a [u32],
    cell: usize,
) -> impl Iterator<Item = usize> + 'a {
    steps()
        .filter_map(move |step| grid.step(cell, step))
        .map(|next| node_of[next])
        .filter(|&node| node != NONE)
        .map(|node| node as usize)
}

/// An eye here is clear of everything and stands on something solid.
fn on_floor(grid: &Grid, index: usize) -> bool {
    if grid.class(index) < CLEAR {
        return false;
    }
    let layer = grid.dims[0] * grid.dims[1];
    let height = index / layer;
    height >= grid.eye_cells
        && (1..grid.eye_cells).all(|k| !grid.solid(index - k * layer))
        && grid.solid(index - grid.eye_cells * layer)
}

/// How enclosed a cell is: rays level in eight directions and one up, those that hit something
/// counted, to the third power, so that rooms outweigh yards and yards outweigh roofs.
fn enclosure(grid: &Grid, cell: usize) -> u64 {
    let longest = grid.dims.into_iter().max().unwrap_or(0) as f64;
    let reach = (VIEW_OF_LONGEST * longest) as u32 + 1;
    let hits = steps()
        .filter(|step| step[2] == 0 || *step == [0, 0, 1])
        .filter(|&step| {
            let mut at = cell;
            (0..reach).any(|_| match grid.step(at, step) {
                Some(next) => {
                    at = next;
                    grid.solid(next)
                }
                None => false,
            })
        })
        .count() as u64;
    hits.pow(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor under two halls, with a wall between them that has a gap.
    fn halls() -> Grid {
        let mut grid = Grid::around([0.0; 3], [30.0, 30.0, 3.0], [0.0, 0.0, 1.0], 60_000);
        let [across, along, height] = grid.dims;
        for x in 0..across {
            for y in 0..along {
                grid.fill(grid.index([x, y, 0]));
                let gap = y.abs_diff(along / 4) < 3;
                for z in 1..height {
                    if x == across / 2 && !gap {
                        grid.fill(grid.index([x, y, z]));
                    }
                }
            }
        }
        grid.measure();
        grid
    }

    #[test]
    fn nowhere_to_go_in_a_solid_block() {
        let mut grid = Grid::around([0.0; 3], [1.0; 3], [0.0, 0.0, 1.0], 5000);
        (0..grid.len()).for_each(|i| grid.fill(i));
        grid.measure();
        assert!(Region::find(&grid).is_none());
    }

    #[test]
    fn a_region_is_clear_and_a_route_goes_through_the_gap() {
        let grid = halls();
        let region = Region::find(&grid).unwrap();
        for &cell in &region.cells {
            let around = steps().filter_map(|step| grid.step(cell as usize, step));
            assert!(around.into_iter().all(|next| !grid.solid(next)));
            assert_eq!(grid.coordinates(cell as usize)[2], grid.eye_cells);
        }
        let at = |node: u32| grid.coordinates(region.cells[node as usize] as usize);
        let last = region.cells.len() as u32 - 1;
        let way = region.route(&grid, 0, last);
        assert_eq!((way[0], way[way.len() - 1]), (0, last));
        for pair in way.windows(2) {
            let (a, b) = (at(pair[0]), at(pair[1]));
            assert!((0..3).all(|k| a[k].abs_diff(b[k]) <= 1));
        }
        let middle = way.iter().map(|&n| at(n)).find(|c| c[0] == grid.dims[0] / 2).unwrap();
        assert!(middle[1].abs_diff(grid.dims[1] / 4) < 2, "{middle:?}");
    }
}
