//! A sample's surfaces as the six faces around a viewpoint show them: only where that is of interest.
//!
//! A triangle whose corners lie in one face's pyramid is seen in that face alone, in the rectangle around its
//! corners. Nearly all are like that and cover a pixel's centre or none, so most are settled by looking
//! at that rectangle ([`Wanted`]).

use crate::neighbours::Pixel;
use crate::raster::{Covered, Place, fill, outside, place, span};
use crate::sample::Sample;
use crate::wanted::Wanted;
use glam::{DVec3, DVec4};
use rayon::prelude::*;

/// Triangles that one task looks at.
const CHUNK: usize = 4096;

/// A sample's pixels relative to a viewpoint.
pub(crate) struct Projection(Vec<(DVec4, Option<Place>)>);

impl Projection {
    /// What pixel `p` shows lies at `S + ray / d`, so relative to `V` at `(ray + (S - V) d) / d`; what has no
    /// greater disparity than `least` is endlessly far. Onto faces of `side * side` pixels.
    pub(crate) fn new(sample: &Sample, least: f32, eye: DVec3, side: u32) -> Self {
        let across = sample.side as usize;
        let mut corners = vec![(DVec4::ZERO, None); 6 * across * across];
        corners.par_chunks_mut(across.max(1)).enumerate().for_each(|(row, corners)| {
            let (face, y) = (row / across, (row % across) as u32);
            for (x, corner) in (0..).zip(corners) {
                let (ray, disparity) = Pixel { face, x, y }.ray(sample);
                let disparity = if disparity > f64::from(least) { disparity } else { 0.0 };
                let at = (ray + (sample.eye - eye) * disparity).extend(disparity);
                *corner = (at, place(at, side));
            }
        });
        Self(corners)
    }

    /// Calls `visit` with a face, and the index and the disparity of each of its wanted pixels whose centre a
    /// triangle covers, triangle by triangle; for different faces at the same time.
    pub(crate) fn draw<T: Send>(
        &self,
        triangles: &[[u32; 3]],
        wanted: &[Wanted; 6],
        side: u32,
        faces: &mut [T; 6],
        visit: impl Fn(&mut T, usize, f64) + Sync,
    ) {
        let chunks: Vec<[Vec<(u32, Covered)>; 6]> = triangles
            .par_chunks(CHUNK)
            .map(|triangles| {
                let mut seen: [Vec<(u32, Covered)>; 6] = Default::default();
                for (at, triangle) in (0..).zip(triangles) {
                    self.covered(triangle, side, |face, covered| {
                        if wanted[face].any(&covered.columns, &covered.rows) {
                            seen[face].push((at, covered));
                        }
                    });
                }
                seen
            })
            .collect();
        faces.par_iter_mut().enumerate().for_each(|(face, picture)| {
            for (seen, triangles) in chunks.iter().zip(triangles.chunks(CHUNK)) {
                for (at, covered) in &seen[face] {
                    let corners = triangles[*at as usize].map(|corner| self.0[corner as usize].0);
                    fill(face, side, corners, covered, &wanted[face], |pixel, disparity| {
                        visit(picture, pixel, disparity);
                    });
                }
            }
        });
    }

    /// The faces that may show a triangle, each with the pixels it may cover there.
    fn covered(&self, triangle: &[u32; 3], side: u32, mut visit: impl FnMut(usize, Covered)) {
        let [a, b, c] = triangle.map(|corner| &self.0[corner as usize]);
        if let (Some(p), Some(q), Some(r)) = (&a.1, &b.1, &c.1)
            && p.face == q.face
            && q.face == r.face
        {
            return visit(p.face, Covered::between([p, q, r], side));
        }
        let corners = [a.0, b.0, c.0];
        let beyond = corners.map(outside).into_iter().fold(u32::MAX, |all, one| all & one);
        for face in (0..6).filter(|face| beyond >> (4 * face) & 15 == 0) {
            visit(face, span(face, side, corners));
        }
    }
}
