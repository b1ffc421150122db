//! A walk through the free space of a scene.
//!
//! The walk is one endless way that a seed fixes; asking for more frames only follows it further. So
//! every step below works on a window of the way: legs are appended, smoothing reaches a fixed number of points, and the
//! gaze looks a fixed distance ahead.

use super::grid::Grid;
use super::route::Region;
use super::{FOV_Y_DEG, Pose};
use rand::{Rng, SeedableRng, rngs::StdRng};

/// Distance between two poses as a share of the scene's diagonal: 1.5 m/s at 30 pictures a second in a
/// hall of 100 m.
pub(super) const SPEED_OF_DIAGONAL: f64 = 5e-4;
/// How far ahead on the way the walker looks, as a share of the diagonal.
const LOOK_AHEAD_OF_DIAGONAL: f64 = 0.03;
/// Passes of smoothing; each moves a point by its two neighbours.
const SMOOTHING: usize = 12;
/// Points that a spline puts between two of the way.
const SPLINE: u32 = 4;
/// Candidates for the next waypoint; the one farthest from the last few is taken.
const CANDIDATES: u32 = 8;
/// How many of the last waypoints the next one keeps away from.
const REMEMBERED: usize = 16;
/// Share of the wanted direction that the gaze takes on in one frame: at most about 1.7 degrees.
const TURN: f64 = 0.03;
/// Steepest gaze: rise over run.
const STEEPEST: f64 = 0.35;

type Point = [f64; 3];

fn mix(a: Point, b: Point, t: f64) -> Point {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t)
}

fn minus(a: Point, b: Point) -> Point {
    std::array::from_fn(|k| a[k] - b[k])
}

fn length(a: Point) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

/// The first `frames` poses of the walk of `seed`; none where there is no room to walk.
pub(super) fn walk(
    grid: &Grid,
    diagonal: f64,
    up: [f64; 3],
    frames: u32,
    seed: u64,
) -> Option<Vec<Pose>> {
    let region = Region::find(grid)?;
    let speed = SPEED_OF_DIAGONAL * diagonal / grid.cell;
    let ahead = LOOK_AHEAD_OF_DIAGONAL * diagonal / grid.cell;
    let needed = speed * f64::from(frames) + 2.0 * ahead;
    let mut tour = Tour::new(&region, seed);
    let mut wanted = 1.3 * needed;
    let way = loop {
        tour.extend(grid, &region, wanted)?;
        let way = Way::new(spline(grid, &smooth(grid, &tour.points)));
        if way.length() >= needed {
            break way;
        }
        wanted *= 1.5;
    };
    let mut gaze = None;
    let poses = (0..frames)
        .map(|frame| {
            let s = speed * f64::from(frame);
            let eye = way.verified(grid, s);
            let direction = turn(gaze, way.outlook(s, ahead));
            gaze = Some(direction);
            let target = std::array::from_fn(|k| eye[k] + direction[k] * ahead);
            Pose {
                eye: grid.scene(eye),
                target: grid.scene(target),
                up,
                fov_y_deg: FOV_Y_DEG,
                near: None,
            }
        })
        .collect();
    Some(poses)
}

/// Waypoints drawn one after another, and the cells between them.
struct Tour {
    random: StdRng,
    visited: Vec<u32>,
    /// Middles of the cells on the way.
    points: Vec<Point>,
    length: f64,
}

impl Tour {
    fn new(region: &Region, seed: u64) -> Self {
        let mut tour = Self {
            random: StdRng::seed_from_u64(seed),
            visited: Vec::new(),
            points: Vec::new(),
            length: 0.0,
        };
        let start = tour.draw(region);
        tour.visited.push(start);
        tour
    }

    /// A place, the more enclosed the more likely.
    fn draw(&mut self, region: &Region) -> u32 {
        // One added, so that places where nothing is near may be drawn too.
        let total: u64 = region.places.iter().map(|p| p.1 + 1).sum();
        let mut left = self.random.random_range(0..total);
        for &(node, value) in &region.places {
            if left <= value {
                return node;
            }
            left -= value + 1;
        }
        unreachable!("a number below the sum falls on one of its terms")
    }

    /// Appends legs until the way is `wanted` cells long; none if there is nowhere to go.
    fn extend(&mut self, grid: &Grid, region: &Region, wanted: f64) -> Option<()> {
        let middle = |node: u32| grid.middle(region.cells[node as usize] as usize);
        while self.length < wanted {
            let from = *self.visited.last()?;
            let mut best = (-1.0, from);
            for _ in 0..CANDIDATES {
                let node = self.draw(region);
                let recent = self.visited.iter().rev().take(REMEMBERED);
                let nearest = recent
                    .map(|&v| length(minus(middle(v), middle(node))))
                    .fold(f64::INFINITY, f64::min);
                if nearest > best.0 {
                    best = (nearest, node);
                }
            }
            let mut to = best.1;
            if to == from {
                // All candidates fell on one place: any other node of the region serves.
                let last = region.cells.len() as u32 - 1;
                to = if from == last { 0 } else { last };
            }
            if to == from {
                return None;
            }
            let leg = region.route(grid, from, to);
            let skip = usize::from(!self.points.is_empty());
            for &node in &leg[skip..] {
                let point = middle(node);
                if let Some(&last) = self.points.last() {
                    self.length += length(minus(point, last));
                }
                self.points.push(point);
            }
            self.visited.push(to);
        }
        Some(())
    }
}

/// Pulls every point towards its neighbours as long as it stays clear. The last points, which further
/// legs would still move, are left out.
fn smooth(grid: &Grid, raw: &[Point]) -> Vec<Point> {
    let clear =
        |p: Point| grid.cell_at(p).is_some_and(|cell| grid.class(cell) >= super::grid::CLEAR);
    let mut points = raw.to_vec();
    for _ in 0..SMOOTHING {
        let before = points.clone();
        for i in 1..points.len().saturating_sub(1) {
            let between = mix(before[i - 1], before[i + 1], 0.5);
            let pulled = mix(before[i], between, 0.5);
            if clear(pulled) {
                points[i] = pulled;
            }
        }
    }
    points.truncate(raw.len().saturating_sub(SMOOTHING).max(1));
    points
}

/// A Catmull-Rom spline through the points; a stretch that leaves free space becomes straight.
fn spline(grid: &Grid, points: &[Point]) -> Vec<Point> {
    let mut out: Vec<Point> = points.first().copied().into_iter().collect();
    for i in 1..points.len().saturating_sub(2) {
        if i == 1 {
            out.push(points[1]);
        }
        let [a, b, c, d] = [points[i - 1], points[i], points[i + 1], points[i + 2]];
        let curve = |t: f64| -> Point {
            std::array::from_fn(|k| {
                let (p, q) = (c[k] - a[k], 2.0 * a[k] - 5.0 * b[k] + 4.0 * c[k] - d[k]);
                let r = 3.0 * (b[k] - c[k]) + d[k] - a[k];
                b[k] + 0.5 * t * (p + t * (q + t * r))
            })
        };
        let at = |k: u32| f64::from(k) / f64::from(SPLINE);
        let bent = (1..SPLINE).all(|k| grid.free_at(curve(at(k))));
        for k in 1..SPLINE {
            out.push(if bent { curve(at(k)) } else { mix(b, c, at(k)) });
        }
        out.push(c);
    }
    out
}

/// A polyline by the distance along it.
struct Way {
    points: Vec<Point>,
    /// Distance of each point from the first.
    at: Vec<f64>,
}

impl Way {
    fn new(points: Vec<Point>) -> Self {
        let mut at = Vec::with_capacity(points.len());
        let mut sum = 0.0;
        for (i, &point) in points.iter().enumerate() {
            if i > 0 {
                sum += length(minus(point, points[i - 1]));
            }
            at.push(sum);
        }
        Self { points, at }
    }

    fn length(&self) -> f64 {
        self.at.last().copied().unwrap_or(0.0)
    }

    /// Index of the stretch at a distance, and how far along that stretch.
    fn locate(&self, s: f64) -> (usize, f64) {
        let i = self.at.partition_point(|&a| a <= s).clamp(1, self.at.len() - 1) - 1;
        let stretch = self.at[i + 1] - self.at[i];
        (i, if stretch > 0.0 { ((s - self.at[i]) / stretch).clamp(0.0, 1.0) } else { 0.0 })
    }

    fn point(&self, s: f64) -> Point {
        let (i, t) = self.locate(s);
        mix(self.points[i], self.points[i + 1], t)
    }

    /// The point at a distance, or the last point of the way before it if that is not free.
    fn verified(&self, grid: &Grid, s: f64) -> Point {
        let point = self.point(s);
        if grid.free_at(point) { point } else { self.points[self.locate(s).0] }
    }

    /// Mean direction to the way ahead, none where it leads nowhere; never steep.
    fn outlook(&self, s: f64, ahead: f64) -> Option<Point> {
        let eye = self.point(s);
        let mut sum = [0.0; 3];
        for share in [0.5, 1.0, 1.5] {
            let d = minus(self.point(s + share * ahead), eye);
            sum = std::array::from_fn(|k| sum[k] + d[k]);
        }
        let level = (sum[0] * sum[0] + sum[1] * sum[1]).sqrt();
        if level < 0.05 * ahead {
            return None;
        }
        sum[2] = sum[2].clamp(-STEEPEST * level, STEEPEST * level);
        unit(sum)
    }
}

fn unit(a: Point) -> Option<Point> {
    let l = length(a);
    (l > 1e-9).then(|| a.map(|c| c / l))
}

/// The gaze after one frame of turning towards the wanted direction.
fn turn(gaze: Option<Point>, wanted: Option<Point>) -> Point {
    let Some(gaze) = gaze else { return wanted.unwrap_or([1.0, 0.0, 0.0]) };
    let Some(mut wanted) = wanted else { return gaze };
    let along = gaze[0] * wanted[0] + gaze[1] * wanted[1];
    if along < 0.0 {
        // More than a right angle: first turn level, to the side the wanted direction is on.
        let left = gaze[0] * wanted[1] - gaze[1] * wanted[0] >= 0.0;
        let side = if left { 1.0 } else { -1.0 };
        wanted = [-gaze[1] * side, gaze[0] * side, 0.0];
    }
    unit(mix(gaze, wanted, TURN)).unwrap_or(gaze)
}

#[cfg(test)]
mod tests;
