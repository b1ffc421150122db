//! Simplification of a face's mesh (paper 000, section 4.2.2), in the face's projective space.
//!
//! There a point is `(u, v, w)`: its place in the picture, and `w = disparity * parallax`, where `parallax =
//! side / 2 * reach` and `reach` is the greatest distance from the sample's viewpoint to any in the cell. A
//! viewpoint that is `b` away sees a point shifted by `side / 2 * b * disparity <= w` pixels. So whatever moves
//! by at most `e` in this space moves by about `e` pixels in the sample's picture, and by at most `e` more in
//! that of any viewpoint of the cell: one distance holds borders, silhouettes of all viewpoints, and depths
//! to the tolerance. Planes are planes in it, too, so what is flat costs nothing. The distance is proven as in
//! the bake, both ways, against the dense mesh on its grid ([`super::reference`]).

use super::dense::DenseMesh;
use super::places::Places;
use super::reference::{Deviation, Reference};
use geometry::mesh::{Mesh, MeshVertex};
use geometry::simplify::simplify;
use geometry::weld::{Weld, weld};
use glam::{DVec3, Vec3};
use protocol::format::projected::SUBPIXELS;
use protocol::format::vertex::POSITION_MAX;

/// Shares of the tolerance that the simplifier, which only estimates, is given one after another. At the first
/// most sheets are proven at once, and what strays of the others halves from round to round; the last are for
/// the few where holding vertices makes others stray.
const ROUNDS: [f64; 16] =
    [0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.6, 0.6, 0.3, 0.3];
/// Pixels beyond the distance of a point that strays in which vertices are held.
const HELD_PX: f64 = 0.5;
/// What is added to them in each round, so that what strays again is held more firmly; from the third on
/// the corners of a triangle that strays, too.
const MORE_HELD_PX: f64 = 0.5;

/// What a mesh is simplified for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Purpose {
    /// Pixels along a side of the face.
    pub side: u32,
    /// Greatest distance from the sample's viewpoint to any of the cell, scene units.
    pub reach: f64,
    /// Greatest error, pixels; half of one is the paper's.
    pub tolerance_px: f64,
}

/// A mesh as it is stored.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FaceMesh {
    /// `u` and `v` in [`SUBPIXELS`] of a pixel, disparity in steps.
    pub vertices: Vec<[u32; 3]>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Disparity of a step, a power of two.
    pub step: f64,
    /// Proven error, pixels.
    pub error_px: f64,
}

/// The smallest power of two by which no disparity exceeds the grid.
pub fn disparity_step(largest: f64) -> f64 {
    let least = largest / f64::from(POSITION_MAX);
    if least > 0.0 { 2f64.powi(least.log2().ceil() as i32) } else { 1.0 }
}

/// Simplifies `dense`. Vertices on the border of the face stay where they are, so that faces still meet.
///
/// Sheets that are proven to lie within the tolerance are done; near what strays of the others, vertices are held
/// where they are, and they are simplified again. A sheet that strays after all [`ROUNDS`] stays dense.
pub fn simplified(dense: &DenseMesh, purpose: &Purpose) -> FaceMesh {
    let Purpose { side, reach, tolerance_px } = *purpose;
    let largest = dense.vertices.iter().map(|vertex| vertex.disparity).fold(0.0, f64::max);
    let step = disparity_step(largest);
    let grid = |disparity: f64| ((disparity / step).round() as u32).min(POSITION_MAX);
    // Depths keep a pixel's worth of difference where no viewpoint of the cell would see any.
    let parallax = step * (0.5 * f64::from(side) * reach).max(1.0 / largest.max(f64::MIN_POSITIVE));
    let vertices = dense.vertices.iter().map(|vertex| {
        let [u, v] = vertex.at;
        let place =
            DVec3::new(f64::from(u), f64::from(v), f64::from(grid(vertex.disparity)) * parallax);
        let is_border = [u, v].iter().any(|at| at % side == 0);
        let seam = if is_border { 0 } else { u8::MAX };
        MeshVertex { seam, ..MeshVertex::plain(place, Vec3::Z, [255; 4]) }
    });
    let whole = Mesh { vertices: vertices.collect(), triangles: dense.triangles.clone() };
    // Nothing is welded but what lies in one place, so triangles are as many as before.
    let mut open = weld(&whole, Weld { depth: 1, ..Weld::within(0.0) });
    drop(whole);
    let reference = Reference::new(&open, &dense.pixels, side);
    let places = Places::new(&open.vertices, side);
    let mut done = Vec::new();
    let mut error_px = 0.0f64;
    for (round, share) in ROUNDS.into_iter().enumerate() {
        if open.triangles.is_empty() {
            break;
        }
        let fewer = simplify(&open, 0, share * tolerance_px).triangles;
        let there = reference.there(&fewer, tolerance_px);
        let back = reference.back(&open.triangles, &fewer, tolerance_px);
        let more = MORE_HELD_PX * round as f64;
        let mut strays = vec![false; open.vertices.len()];
        for (triangles, Deviation { bound, strays: points }) in
            [(&fewer, there), (&open.triangles, back)]
        {
            error_px = error_px.max(bound);
            for point in points {
                let corners = triangles[point.triangle as usize];
                strays[reference.sheet(corners)] = true;
                let at = corners.map(|corner| open.vertices[corner as usize].position);
                let around_corners = at.into_iter().flat_map(|at| places.near(at, more - 1.0));
                let around = places.near(point.at, point.distance + HELD_PX + more);
                around.chain(around_corners).for_each(|v| open.locked[v as usize] = true);
            }
        }
        let strays = |triangle: &[u32; 3]| strays[reference.sheet(*triangle)];
        done.extend(fewer.iter().filter(|triangle| !strays(triangle)));
        open.triangles.retain(strays);
    }
    done.append(&mut open.triangles);
    stored(&Mesh { vertices: open.vertices, triangles: done }, parallax, step, error_px)
}

/// The vertices that are used, on the grid.
fn stored(mesh: &Mesh, parallax: f64, step: f64, error_px: f64) -> FaceMesh {
    let mut place = vec![u32::MAX; mesh.vertices.len()];
    let mut found = FaceMesh { step, error_px, ..FaceMesh::default() };
    for triangle in &mesh.triangles {
        found.triangles.push(triangle.map(|v| {
            let place = &mut place[v as usize];
            if *place == u32::MAX {
                *place = found.vertices.len() as u32;
                let p = mesh.vertices[v as usize].position;
                let pixels = |at: f64| (at * f64::from(SUBPIXELS)).round() as u32;
                found.vertices.push([pixels(p.x), pixels(p.y), (p.z / parallax).round() as u32]);
            }
            *place
        }));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::dense::DenseVertex;
    use super::*;

    const SIDE: u32 = 64;

    /// A mesh of all pixels of the columns given, with corners at the disparity that `of` gives.
    fn sheet(columns: std::ops::Range<u32>, of: impl Fn(u32, u32) -> f64) -> DenseMesh {
        let width = columns.len() as u32 + 1;
        let corner = |x: u32, y: u32| y * width + x - columns.start;
        let vertices = (0..=SIDE).flat_map(|v| (columns.start..=columns.end).map(move |u| [u, v]));
        let vertices = vertices.map(|at| DenseVertex { at, disparity: of(at[0], at[1]) }).collect();
        let triangles = (0..SIDE)
            .flat_map(|y| columns.clone().map(move |x| (x, y)))
            .flat_map(|(x, y)| {
                let [a, b, c, d] =
                    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| corner(x + dx, y + dy));
                [[a, c, b], [b, c, d]]
            })
            .collect();
        let pixels = (0..SIDE).flat_map(|y| columns.clone().map(move |x| [x, y])).collect();
        DenseMesh { vertices, triangles, pixels }
    }

    fn both(a: DenseMesh, b: DenseMesh) -> DenseMesh {
        let first = a.vertices.len() as u32;
        let moved = b.triangles.iter().map(|t| t.map(|v| v + first));
        DenseMesh {
            triangles: a.triangles.iter().copied().chain(moved).collect(),
            vertices: [a.vertices, b.vertices].concat(),
            pixels: [a.pixels, b.pixels].concat(),
        }
    }

    const PURPOSE: Purpose = Purpose { side: SIDE, reach: 2.0, tolerance_px: 0.5 };

    #[test]
    fn of_nothing_nothing_is_left() {
        let found = simplified(&DenseMesh::default(), &PURPOSE);
        assert!(found.triangles.is_empty() && found.vertices.is_empty() && found.error_px == 0.0);
    }

    #[test]
    fn steps_are_powers_of_two_and_cover_all_depths() {
        assert_eq!(disparity_step(0.0), 1.0);
        for depth in [1e-3, 0.3, 1.0, 17.0, 1e6] {
            let step = disparity_step(1.0 / depth);
            assert_eq!(step.log2().fract(), 0.0);
            let most = 1.0 / depth / step;
            assert!(most <= f64::from(POSITION_MAX) && most > f64::from(POSITION_MAX) / 2.1);
        }
    }

    #[test]
    fn a_slanted_plane_costs_its_border_alone() {
        let found = simplified(
            &sheet(0..SIDE, |u, v| 0.02 + 1e-3 * f64::from(u) + 5e-4 * f64::from(v)),
            &PURPOSE,
        );
        assert!(found.error_px <= 0.5);
        // 256 vertices of the border stay; a triangulation of them has 254 triangles.
        assert!(found.triangles.len() <= 260, "{}", found.triangles.len());
        let on_border = found
            .vertices
            .iter()
            .filter(|[u, v, _]| [u, v].iter().any(|&&at| at == 0 || at == SIDE * SUBPIXELS));
        assert_eq!(on_border.count(), 256);
    }

    #[test]
    fn a_gap_stays_a_gap_and_bumps_stay_within_half_a_pixel() {
        let bumpy =
            |u: u32, v: u32| 0.2 + 0.02 * ((f64::from(u) * 0.3).sin() * (f64::from(v) * 0.2).cos());
        let dense = both(sheet(0..20, bumpy), sheet(20..SIDE, |_, _| 0.01));
        let found = simplified(&dense, &PURPOSE);
        assert!(found.error_px <= 0.5 && found.triangles.len() < dense.triangles.len() / 3);
        for triangle in &found.triangles {
            let is_near =
                triangle.map(|v| f64::from(found.vertices[v as usize][2]) * found.step > 0.1);
            assert!(is_near.iter().all(|near| *near == is_near[0]), "a skin");
        }
        // Sampled anew, in pixels.
        let place =
            |[u, v, w]: [f64; 3]| DVec3::new(u, v, w * 0.5 * f64::from(SIDE) * PURPOSE.reach);
        let stored = found.vertices.iter().map(|&[u, v, d]| {
            place([f64::from(u) / 16.0, f64::from(v) / 16.0, f64::from(d) * found.step])
        });
        let mesh = |vertices: Vec<DVec3>, triangles: &[[u32; 3]]| Mesh {
            vertices: vertices.iter().map(|p| MeshVertex::plain(*p, Vec3::Z, [0; 4])).collect(),
            triangles: triangles.to_vec(),
        };
        let whole = dense.vertices.iter().map(|vertex| {
            place([f64::from(vertex.at[0]), f64::from(vertex.at[1]), vertex.disparity])
        });
        let (fewer, whole) =
            (mesh(stored.collect(), &found.triangles), mesh(whole.collect(), &dense.triangles));
        use geometry::hausdorff::{Surface, sampled};
        let away = sampled(&fewer, &Surface::new(&whole), 3).max(sampled(
            &whole,
            &Surface::new(&fewer),
            2,
        ));
        assert!(away <= found.error_px + 1e-3, "{away} {}", found.error_px);
    }

    #[test]
    fn no_tolerance_keeps_all_and_the_same_input_gives_the_same_mesh() {
        let dense = sheet(0..SIDE, |u, v| 0.1 + 0.05 * f64::from((u * 7 + v * 13) % 5));
        let exact = simplified(&dense, &Purpose { tolerance_px: 0.0, ..PURPOSE });
        assert_eq!(exact.triangles.len(), dense.triangles.len());
        assert_eq!(simplified(&dense, &PURPOSE), simplified(&dense, &PURPOSE));
    }
}
