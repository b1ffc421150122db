//! Where most of a mesh or a scene lies, and how far that reaches: what a grid must be fine for. A stray
//! object or triangle, however far away, changes neither.

use crate::source::SourceMesh;
use bytemuck::{Pod, Zeroable};
use glam::{DAffine3, DVec3};

/// Triangles of a part that stand for all of it.
pub(crate) const SAMPLES: usize = 8;
/// The share of all triangles that is looked for where they lie closest together.
const SHARE: f64 = 0.25;
/// All that lies within so many times the room that these take belongs to them. Triangles that are spread
/// evenly take a quarter of it on an axis, so then that is everything.
const REACH: f64 = 64.0;

/// A triangle, in the space of its mesh.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Sample {
    middle: [f32; 3],
    /// Longest side of its box.
    longest: f32,
}

/// Some triangles of a part, evenly spread over its list; nothing in particular where it has none.
pub(crate) fn samples(part: &SourceMesh) -> [Sample; SAMPLES] {
    let count = part.indices.len();
    std::array::from_fn(|i| {
        let Some(triangle) = part.indices.get(i * count / SAMPLES) else {
            return Sample::zeroed();
        };
        let corners = triangle.map(|vertex| part.position(vertex as usize));
        let (low, high) = corners.iter().fold((corners[0], corners[0]), |(low, high), &corner| {
            (low.min(corner), high.max(corner))
        });
        let middle = (low * 0.5 + high * 0.5).as_vec3().to_array();
        Sample { middle, longest: (high - low).max_element() as f32 }
    })
}

/// Where most triangles lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bulk {
    /// Somewhere in the middle of them.
    pub(crate) middle: DVec3,
    /// How far they reach at most; infinite where nothing tells.
    pub(crate) reach: f64,
}

impl Bulk {
    /// Of samples as `placed` puts them, each of which stands for so many triangles; `stretch` is how much
    /// that lengthens at most.
    ///
    /// On each axis the shortest stretch is looked for that holds a quarter of all triangles' middles. The
    /// longest of the three, and twice a triangle that a quarter of all are no longer than, are what they
    /// take; [`REACH`] times that is how far they reach.
    pub(crate) fn of(samples: impl Iterator<Item = (DVec3, f64, f64)>) -> Self {
        let samples: Vec<(DVec3, f64, f64)> = samples.collect();
        let wanted = SHARE * samples.iter().map(|(.., weight)| weight).sum::<f64>();
        let mut middle = DVec3::ZERO;
        let mut room = 0.0f64;
        for axis in 0..3 {
            let on_axis = samples.iter().map(|&(at, _, weight)| (at[axis], weight)).collect();
            let [low, high] = closest(on_axis, wanted);
            middle[axis] = low * 0.5 + high * 0.5;
            room = room.max(high - low);
        }

        let mut lengths: Vec<(f64, f64)> = samples.iter().map(|&(_, l, w)| (l, w)).collect();
        lengths.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut sum = 0.0;
        let reaches = |&&(_, weight): &&(f64, f64)| {
            sum += weight;
            sum >= wanted
        };
        let longest = lengths.iter().find(reaches).map_or(0.0, |length| length.0);

        let reach = REACH * (room + 2.0 * longest);
        Self { middle, reach: if reach > 0.0 { reach } else { f64::INFINITY } }
    }
}

/// Samples of one mesh, placed: where each is, how long, and how many triangles it stands for.
pub(crate) fn placed(
    samples: impl Iterator<Item = (Sample, f64)>,
    place: &DAffine3,
    stretch: f64,
) -> impl Iterator<Item = (DVec3, f64, f64)> {
    samples.map(move |(sample, weight)| {
        let middle = place.transform_point3(DVec3::from(sample.middle.map(f64::from)));
        (middle, f64::from(sample.longest) * stretch, weight)
    })
}

/// The shortest stretch of an axis that holds values of this weight; the first of several.
fn closest(mut values: Vec<(f64, f64)>, wanted: f64) -> [f64; 2] {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut best = [0.0, f64::INFINITY];
    let (mut first, mut held) = (0, 0.0);
    for &(value, weight) in &values {
        held += weight;
        while held - values[first].1 >= wanted {
            held -= values[first].1;
            first += 1;
        }
        if held >= wanted && value - values[first].0 < best[1] - best[0] {
            best = [values[first].0, value];
        }
    }
    if best[1].is_finite() { best } else { [0.0; 2] }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bulk(points: &[(f64, f64)]) -> Bulk {
        Bulk::of(points.iter().map(|&(x, longest)| (DVec3::splat(x), longest, 1.0)))
    }

    #[test]
    fn nothing_and_one_place_tell_nothing() {
        assert_eq!(bulk(&[]).reach, f64::INFINITY);
        assert_eq!(bulk(&[(3.0, 0.0)]).reach, f64::INFINITY);
        assert_eq!(bulk(&[(3.0, 1.0); 9]), Bulk { middle: DVec3::splat(3.0), reach: 128.0 });
    }

    #[test]
    fn evenly_spread_triangles_reach_beyond_their_box_and_strays_change_nothing() {
        let even: Vec<(f64, f64)> = (0..100).map(|i| (f64::from(i), 1.0)).collect();
        let alone = bulk(&even);
        assert!(alone.reach > 100.0, "{alone:?}");
        for strays in [
            vec![(5e6, 1e-6)],
            vec![(5e6, 1.0), (-5e6, 1.0)],
            vec![(0.0, 1e7); 2],
            (0..50).map(|i| (5e6 + f64::from(i) * 1e5, 1.0)).collect(),
        ] {
            let with = bulk(&[&even[..], &strays].concat());
            assert!(with.reach < 2.0 * alone.reach, "{strays:?} {with:?}");
            assert!((0.0..100.0).contains(&with.middle.x), "{strays:?} {with:?}");
        }
        // Half of them here and half there are two of a kind.
        let two: Vec<(f64, f64)> = (0..24).map(|i| (f64::from(i / 12) * 5e6, 2.0)).collect();
        assert!(bulk(&two).reach < 1000.0);
    }
}
