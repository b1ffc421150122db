//! What a delta sample need not hold: points that an ancestor has seen (paper 000, section 4.1.2).

use crate::neighbours::{Pixel, STEPS};
use crate::sample::Sample;
use glam::DVec3;

/// How alike two points must be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Share of the view depth that stands for the depth's own precision.
    pub depth_share: f64,
    /// Pixels of the ancestor by which a point may lie before or behind its surface.
    pub pixels: f64,
}

impl Default for Tolerance {
    /// A depth is a 32-bit float proportional to the disparity, so it is known to within 2^-24 of itself;
    /// what it is computed from (coordinates relative to the eye, in f32, on a grid) loses more, 2^-16
    /// with a wide margin. Each sample is taken of meshes that err by half a pixel
    /// ([`crate::capture::LOD_PX`]), so two may disagree by one; another half is for a surface that bends between
    /// the pixels of the ancestor.
    fn default() -> Self {
        Self { depth_share: 1.0 / (1 << 16) as f64, pixels: 1.5 }
    }
}

impl Tolerance {
    /// Distance at which two points still count as one, for a point at a view depth in a face of `side`
    /// pixels: it grows with the depth.
    pub fn at(&self, depth: f64, side: u32) -> f64 {
        depth * (self.depth_share + self.pixels * 2.0 / f64::from(side))
    }
}

/// By face and pixel, whether a sample's point is to be kept: something is seen there, and no ancestor has
/// seen it.
pub type Surviving = [Vec<bool>; 6];

/// What is left of `sample` beside its `ancestors`.
pub fn surviving(sample: &Sample, ancestors: &[&Sample], tolerance: &Tolerance) -> Surviving {
    std::array::from_fn(|face| {
        (0..sample.side * sample.side)
            .map(|at| {
                let (x, y) = (at % sample.side, at / sample.side);
                sample.point(face, x, y).is_some_and(|point| {
                    !ancestors.iter().any(|other| has_seen(other, point, tolerance))
                })
            })
            .collect()
    })
}

/// Whether a surface that `other` shows goes through `point`: that of one of the four pixels around it, each
/// extended to there as it is inclined.
///
/// One pixel alone would not do: a point beside a silhouette falls into a pixel behind it as often as not, so the
/// rims of all that is seen would survive. Nor would its element as it is: on a surface that is met at
/// a grazing angle it lies far away.
fn has_seen(other: &Sample, point: DVec3, tolerance: &Tolerance) -> bool {
    let Some((face, [u, v], depth)) = other.project(point - other.eye) else { return false };
    let reach = tolerance.at(depth, other.side) / (depth * depth);
    let (x, y) = ((u - 0.5).floor() as i64, (v - 0.5).floor() as i64);
    [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]].into_iter().any(|at| {
        let extended = extended(other, face, at, [u, v]);
        extended.is_some_and(|disparity| (disparity - 1.0 / depth).abs() <= reach)
    })
}

/// The disparity at `to`, pixels, of the surface that the pixel `at` of a face shows: linear, with the lesser
/// of its steps to the pixels on both sides, which is the one on the same surface.
fn extended(sample: &Sample, face: usize, at: [i64; 2], to: [f64; 2]) -> Option<f64> {
    let disparity = |[x, y]: [i64; 2]| {
        let inside = 0..i64::from(sample.side);
        let seen = inside.contains(&x) && inside.contains(&y);
        let of = || sample.faces[face].disparity[sample.index(x as u32, y as u32)];
        seen.then(of).filter(|&disparity| disparity > 0.0).map(f64::from)
    };
    let here = disparity(at)?;
    let slope = |[dx, dy]: [i64; 2]| {
        let behind = disparity([at[0] - dx, at[1] - dy]).map(|before| here - before);
        let ahead = disparity([at[0] + dx, at[1] + dy]).map(|after| after - here);
        let steps = [behind, ahead].into_iter().flatten();
        steps.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0)
    };
    let [du, dv] = [0, 1].map(|k| to[k] - at[k] as f64 - 0.5);
    Some(here + du * slope([1, 0]) + dv * slope([0, 1]))
}

/// What survives, and the pixels beside it that show something.
pub fn dilated(sample: &Sample, surviving: &Surviving) -> Surviving {
    grown(sample, surviving, |_, to| {
        sample.faces[to.face].disparity[sample.index(to.x, to.y)] > 0.0
    })
}

/// Lets what survives overlap with what an ancestor shows of the same surface by one pixel, so that no crack
/// opens between the two: every pixel joined to a surviving one beside it survives, too.
pub fn overlapping(
    sample: &Sample,
    surviving: &Surviving,
    joined: &impl Fn(Pixel, Pixel) -> bool,
) -> Surviving {
    grown(sample, surviving, joined)
}

/// Adds the neighbours of what survives, within its face, to which `goes` from there.
fn grown(sample: &Sample, surviving: &Surviving, goes: impl Fn(Pixel, Pixel) -> bool) -> Surviving {
    let side = sample.side;
    let mut found = surviving.clone();
    for (index, _) in surviving.iter().flatten().enumerate().filter(|(_, survives)| **survives) {
        let from = Pixel::of_index(side, index);
        let beside = (0..STEPS.len()).filter_map(|step| from.neighbour(side, step));
        for to in beside.filter(|to| to.face == from.face && goes(from, *to)) {
            found[to.face][sample.index(to.x, to.y)] = true;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::FacePicture;

    /// The inside of an axis-aligned box from a place in it; `behind` is where a wall at `x = 2` is open.
    fn room(eye: DVec3, side: u32, wall_until_y: f64) -> Sample {
        let mut sample = Sample { eye, side, faces: Default::default() };
        for face in 0..6 {
            let (disparity, color) = (0..side * side)
                .map(|at| {
                    let (x, y) = (at % side, at / side);
                    let ray = sample.ray(face, f64::from(x) + 0.5, f64::from(y) + 0.5);
                    let hit = |k: usize, bound: f64| (bound - eye[k]) / ray[k];
                    let mut t = f64::INFINITY;
                    for k in 0..3 {
                        for bound in [-10.0, 10.0] {
                            let at = hit(k, bound);
                            if at > 0.0 {
                                t = t.min(at);
                            }
                        }
                    }
                    let wall = hit(0, 2.0);
                    if wall > 0.0 && (eye + ray * wall).y < wall_until_y {
                        t = t.min(wall);
                    }
                    ((1.0 / t) as f32, [0; 3])
                })
                .unzip();
            sample.faces[face] = FacePicture { disparity, color, ..Default::default() };
        }
        sample
    }

    fn share(surviving: &Surviving) -> f64 {
        let all = surviving.iter().map(Vec::len).sum::<usize>();
        surviving.iter().flatten().filter(|kept| **kept).count() as f64 / all as f64
    }

    #[test]
    fn what_stands_alone_survives_whole() {
        let sample = room(DVec3::ZERO, 16, 0.0);
        assert_eq!(share(&surviving(&sample, &[], &Tolerance::default())), 1.0);
        let mut with_sky = sample.clone();
        with_sky.faces[4].disparity.fill(0.0);
        let left = surviving(&with_sky, &[], &Tolerance::default());
        assert!(!left[4].iter().any(|kept| *kept) && left[0].iter().all(|kept| *kept));
    }

    #[test]
    fn the_same_room_from_elsewhere_is_redundant_but_for_what_was_hidden() {
        let intra = room(DVec3::new(0.0, 0.0, 0.0), 64, 0.0);
        let twin = surviving(&intra, &[&intra], &Tolerance::default());
        assert_eq!(share(&twin), 0.0);
        let moved = room(DVec3::new(0.3, 4.0, 0.5), 64, 0.0);
        let left = surviving(&moved, &[&intra], &Tolerance::default());
        // What lay behind the wall survives.
        let mut hidden = 0;
        for (face, left) in left.iter().enumerate() {
            for at in 0..64 * 64 {
                let point = moved.point(face, at % 64, at / 64).unwrap();
                let to_wall = 2.0 / point.x;
                let was_hidden = point.x > 2.5 && (point * to_wall).y < -0.2;
                if was_hidden {
                    hidden += 1;
                    assert!(left[at as usize], "{point}");
                }
            }
        }
        let kept = left.iter().flatten().filter(|kept| **kept).count();
        assert!(hidden > 100 && kept < hidden * 2, "{kept} kept, {hidden} were hidden");
        assert!(share(&left) < 0.2, "{}", share(&left));
        // A third sample that has both for ancestors keeps less than one that has the first alone.
        let third = room(DVec3::new(0.4, 3.0, 0.4), 64, 0.0);
        let one = share(&surviving(&third, &[&intra], &Tolerance::default()));
        let two = share(&surviving(&third, &[&moved, &intra], &Tolerance::default()));
        assert!(two < one, "{two} {one}");
    }

    #[test]
    fn what_survives_grows_by_a_pixel_where_something_is_seen() {
        let mut sample = room(DVec3::ZERO, 16, 0.0);
        sample.faces[2].disparity[5 * 16 + 6] = 0.0;
        let mut surviving: Surviving = std::array::from_fn(|_| vec![false; 256]);
        surviving[2][5 * 16 + 5] = true;
        let grown = dilated(&sample, &surviving);
        assert_eq!(grown[2].iter().filter(|kept| **kept).count(), 8);
        assert!(!grown[2][5 * 16 + 6] && grown[2][4 * 16 + 4]);
        assert!(grown[0].iter().all(|kept| !kept));
    }

    #[test]
    fn the_tolerance_grows_with_the_depth() {
        let tolerance = Tolerance::default();
        let [near, far] = [1e-3, 1e6].map(|depth| tolerance.at(depth, 512));
        assert!((far / near - 1e9).abs() < 1.0);
        assert!(tolerance.at(1.0, 512) > tolerance.at(1.0, 1024));
    }
}
