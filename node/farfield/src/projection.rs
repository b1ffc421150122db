//! A sample's surfaces as the six faces around a viewpoint show them: only where that is of interest.
//!
//! A triangle whose corners lie in one face's pyramid is seen in that face alone, in the rectangle around its
//! corners. Nearly all are like that and cover a pixel's centre or none, so most are settled by looking
//! at that rectangle ([`Wanted`]).

use crate::raster::{Covered, Place, fill, outside, place, span};
use crate::wanted::Wanted;
use glam::{DVec3, DVec4};
use rayon::prelude::*;

/// Triangles or corners that one task looks at.
const CHUNK: usize = 4096;

/// Corners of a sample's surfaces relative to a viewpoint.
pub(crate) struct Projection(Vec<(DVec4, Option<Place>)>);

impl Projection {
    /// A corner at `S + ray / d` lies at `(ray + (S - V) d) / d` relative to `V`. Onto faces of `side * side` pixels.
    pub(crate) fn new(sample: DVec3, corners: &[(DVec3, f64)], eye: DVec3, side: u32) -> Self {
        let seen = |&(ray, disparity): &(DVec3, f64)| {
            let at = (ray + (sample - eye) * disparity).extend(disparity);
            (at, place(at, side))
        };
        Self(corners.par_iter().with_min_len(CHUNK).map(seen).collect())
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
