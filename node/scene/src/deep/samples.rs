//! Where to measure: the same points every time, corners first of all.

use super::leaves::{each_leaf_below, placed};
use crate::store::{Store, StoreError};
use glam::DVec3;
use protocol::id::HlodId;

/// Samples taken of a triangle if all may have some: its corners and a point inside.
const A_TRIANGLE: u64 = 4;
/// Samples a triangle, in the mean, once its area counts too.
const WITH_AREA: u64 = 8;

/// At most `most` samples of the original below a hlod.
pub(super) fn below(store: &Store, id: HlodId, most: u32) -> Result<Vec<DVec3>, StoreError> {
    let skeleton = store.skeleton();
    let mut leaves = Vec::new();
    each_leaf_below(skeleton, id, |leaf| leaves.push(leaf));
    let originals = || leaves.iter().map(|leaf| &skeleton.levels_of(skeleton.hlod(*leaf))[0]);
    let mut picker = Picker::new(originals().map(|l| u64::from(l.triangles)).sum(), most);
    let mut samples = Vec::new();
    for level in originals() {
        if picker.takes_none_of(u64::from(level.triangles)) {
            picker.first += u64::from(level.triangles);
        } else {
            picker.pick(&placed(store, level)?.triangles, &mut samples);
        }
    }
    Ok(samples)
}

/// At most `most` samples of some triangles, half of them by area where there is room for that.
pub(super) fn of_triangles(triangles: &[[DVec3; 3]], most: u32) -> Vec<DVec3> {
    let count = triangles.len() as u64;
    let mut samples = Vec::new();
    let (most, wanted) = (u64::from(most), count * WITH_AREA);
    Picker::new(count, most.div_ceil(2) as u32).pick(triangles, &mut samples);
    let left = most.min(wanted).saturating_sub(samples.len() as u64);
    let area = |[a, b, c]: &[DVec3; 3]| (b - a).cross(c - a).length();
    let step = triangles.iter().map(area).sum::<f64>() / left as f64;
    let (mut passed, mut taken) = (0.0, 0);
    for triangle in triangles {
        passed += area(triangle);
        while taken < left && (taken as f64 + 0.5) * step < passed {
            samples.push(inside(triangle, taken));
            taken += 1;
        }
    }
    samples
}

/// Takes all samples of all triangles, or as many as allowed evenly by their number.
struct Picker {
    /// Triangles there are.
    triangles: u64,
    most: u64,
    /// Triangles passed.
    first: u64,
    /// Samples taken.
    taken: u64,
}

impl Picker {
    fn new(triangles: u64, most: u32) -> Self {
        Self { triangles, most: u64::from(most).max(1), first: 0, taken: 0 }
    }

    fn takes_all(&self) -> bool {
        self.triangles.saturating_mul(A_TRIANGLE) <= self.most
    }

    /// The triangle of the next sample, if not all are taken.
    fn next(&self) -> u64 {
        (u128::from(self.taken) * u128::from(self.triangles) / u128::from(self.most)) as u64
    }

    fn takes_none_of(&self, count: u64) -> bool {
        !self.takes_all() && self.next() >= self.first + count
    }

    fn pick(&mut self, triangles: &[[DVec3; 3]], samples: &mut Vec<DVec3>) {
        let end = self.first + triangles.len() as u64;
        if self.takes_all() {
            for (triangle, i) in triangles.iter().zip(self.first..) {
                samples.extend_from_slice(triangle);
                samples.push(inside(triangle, i));
            }
        } else {
            while self.taken < self.most && self.next() < end {
                let triangle = &triangles[(self.next() - self.first) as usize];
                let corner = (self.taken % A_TRIANGLE) as usize;
                let inner = || inside(triangle, self.taken);
                samples.push(triangle.get(corner).copied().unwrap_or_else(inner));
                self.taken += 1;
            }
        }
        self.first = end;
    }
}

/// A point inside a triangle, the `i`th of the additive sequence R2 (Roberts 2018), which fills the
/// square of two coordinates evenly, folded over its diagonal.
fn inside([a, b, c]: &[DVec3; 3], i: u64) -> DVec3 {
    let i = (i % (1 << 20)) as f64;
    let v = (0.5 + i * 0.754_877_666_246_692_7).fract();
    let w = (0.5 + i * 0.569_840_290_998_053_2).fract();
    let (v, w) = if v + w > 1.0 { (1.0 - v, 1.0 - w) } else { (v, w) };
    *a + (*b - *a) * v + (*c - *a) * w
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strip(count: u32) -> Vec<[DVec3; 3]> {
        let at = |i: u32| DVec3::X * f64::from(i);
        (0..count).map(|i| [at(i), at(i) + DVec3::X, at(i) + DVec3::Y]).collect()
    }

    #[test]
    fn of_nothing_and_of_points_samples_are_points() {
        assert!(of_triangles(&[], 100).is_empty());
        assert_eq!(of_triangles(&[[DVec3::ONE; 3]], 100), [DVec3::ONE; 4]);
        assert!(of_triangles(&strip(3), 1).len() == 1);
    }

    #[test]
    fn few_triangles_have_all_corners_and_larger_ones_more_points() {
        let mut triangles = strip(2);
        triangles.push([DVec3::ZERO, DVec3::X * 10.0, DVec3::Y * 10.0]);
        let samples = of_triangles(&triangles, 1000);
        assert_eq!(samples.len(), 3 * WITH_AREA as usize);
        assert!(triangles.iter().flatten().all(|corner| samples.contains(corner)));
        assert!(samples[12..].iter().filter(|p| p.x + p.y > 1.5).count() >= 10, "{samples:?}");
        for p in &samples {
            assert!(p.x >= 0.0 && p.y >= 0.0 && p.x + p.y <= 10.0 + 1e-12, "{p}");
        }
    }

    #[test]
    fn of_many_triangles_samples_are_spread_evenly_over_runs_of_any_length() {
        let triangles = strip(10_000);
        let mut whole = Vec::new();
        Picker::new(10_000, 1000).pick(&triangles, &mut whole);
        assert_eq!(whole.len(), 1000);
        let (mut parts, mut picker) = (Vec::new(), Picker::new(10_000, 1000));
        for run in triangles.chunks(7) {
            if picker.takes_none_of(run.len() as u64) {
                picker.first += run.len() as u64;
            } else {
                picker.pick(run, &mut parts);
            }
        }
        assert_eq!(parts, whole);
        for k in 0..10 {
            let within = |p: &&DVec3| (p.x / 1000.0) as i32 == k;
            assert!((98..=102).contains(&whole.iter().filter(within).count()));
        }
    }
}
