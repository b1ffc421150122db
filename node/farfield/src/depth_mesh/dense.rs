//! The dense mesh of a face (paper 000, section 4.2.1): two triangles over the whole solid angle of
//! every surviving pixel, in the face's projective space ([`protocol::format::projected`]).

use super::corners::around;
use crate::neighbours::Pixel;
use crate::redundancy::Surviving;
use crate::sample::Sample;
use std::collections::BTreeMap;

/// A mesh over a face's pixel grid.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DenseMesh {
    /// Corners of pixels, `(u, v)` in whole pixels, and the disparity there.
    pub vertices: Vec<DenseVertex>,
    /// Two for each pixel, counter-clockwise in a picture whose rows go down: that of its upper left half, then
    /// that of its lower right one.
    pub triangles: Vec<[u32; 3]>,
    /// The pixels, row by row.
    pub pixels: Vec<[u32; 2]>,
}

/// A vertex of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DenseVertex {
    /// Column and row of the corner.
    pub at: [u32; 2],
    /// Reciprocal view depth.
    pub disparity: f64,
}

/// Meshes the pixels of one face that survive.
///
/// The disparity of a corner is the mean over those pixels around it that are joined to the pixel in
/// question, directly or through others around the corner: what is flat has linear disparities, so this is
/// exact for it. Pixels that are not joined have corners of their own, so nothing spans a gap: there are no
/// skins. A corner at a border of the face is worked out from the pixels of both faces and the same
/// in both, so they meet without a seam.
pub fn dense_mesh(
    sample: &Sample,
    face: usize,
    surviving: &Surviving,
    joined: &(impl Fn(Pixel, Pixel) -> bool + Sync),
) -> DenseMesh {
    let side = sample.side;
    let mut mesh = DenseMesh::default();
    // By corner, the vertices made there, each with the pixels it belongs to.
    let mut made: BTreeMap<(u32, u32), Vec<Made>> = BTreeMap::new();
    for y in 0..side {
        // Corners above this row are done with.
        made = made.split_off(&(y, 0));
        for x in 0..side {
            if !surviving[face][sample.index(x, y)] {
                continue;
            }
            let pixel = Pixel { face, x, y };
            let [a, b, c, d] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| {
                let (i, j) = (x + dx, y + dy);
                let of_corner = made.entry((j, i)).or_default();
                if let Some(made) = of_corner.iter().find(|made| made.pixels.contains(&pixel)) {
                    return made.vertex;
                }
                let group = group(&around(side, face, i, j), pixel, joined);
                let of =
                    |p: &Pixel| f64::from(sample.faces[p.face].disparity[sample.index(p.x, p.y)]);
                let disparity = group.iter().map(of).sum::<f64>() / group.len() as f64;
                let vertex = mesh.vertices.len() as u32;
                mesh.vertices.push(DenseVertex { at: [i, j], disparity });
                of_corner.push(Made { pixels: group, vertex });
                vertex
            });
            mesh.triangles.extend([[a, c, b], [b, c, d]]);
            mesh.pixels.push([x, y]);
        }
    }
    mesh
}

/// A vertex, and the pixels around its corner that it belongs to.
struct Made {
    pixels: Vec<Pixel>,
    vertex: u32,
}

/// Those of `pixels` that hang together with `first`, `pixels`' order kept.
fn group(pixels: &[Pixel], first: Pixel, joined: &impl Fn(Pixel, Pixel) -> bool) -> Vec<Pixel> {
    let mut is_in: Vec<bool> = pixels.iter().map(|pixel| *pixel == first).collect();
    for _ in 1..pixels.len() {
        for at in 0..pixels.len() {
            let reached =
                (0..pixels.len()).any(|from| is_in[from] && joined(pixels[from], pixels[at]));
            is_in[at] |= reached;
        }
    }
    pixels.iter().zip(is_in).filter_map(|(pixel, is_in)| is_in.then_some(*pixel)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::FacePicture;
    use glam::DVec3;

    /// What is seen of planes `normal . p = 1` around the origin, the nearest of them; sky elsewhere.
    fn planes(side: u32, planes: &[DVec3]) -> Sample {
        let mut sample = Sample { eye: DVec3::ZERO, side, faces: Default::default() };
        for face in 0..6 {
            let pixels = (0..side * side).map(|at| {
                let ray = sample.ray(face, f64::from(at % side) + 0.5, f64::from(at / side) + 0.5);
                let disparity = planes.iter().map(|n| n.dot(ray)).fold(0.0, f64::max);
                (disparity as f32, [0; 3])
            });
            let (disparity, color) = pixels.unzip();
            sample.faces[face] = FacePicture { disparity, color, ..Default::default() };
        }
        sample
    }

    fn all(sample: &Sample) -> Surviving {
        std::array::from_fn(|face| sample.faces[face].disparity.iter().map(|d| *d > 0.0).collect())
    }

    #[test]
    fn where_nothing_survives_there_is_no_mesh() {
        let sample = planes(16, &[]);
        assert_eq!(dense_mesh(&sample, 0, &all(&sample), &|_, _| true), DenseMesh::default());
    }

    #[test]
    fn a_plane_is_met_exactly_and_faces_meet_without_a_seam() {
        let normal = DVec3::new(0.5, 0.3, 0.1);
        let sample = planes(16, &[normal]);
        let mut on_border: BTreeMap<[i64; 3], Vec<f64>> = BTreeMap::new();
        for face in 0..6 {
            let mesh = dense_mesh(&sample, face, &all(&sample), &|a, b| {
                [a, b].iter().all(|p| sample.faces[p.face].disparity[sample.index(p.x, p.y)] > 0.0)
            });
            let shown = all(&sample)[face].iter().filter(|shown| **shown).count();
            assert_eq!(mesh.triangles.len(), 2 * shown);
            for vertex in &mesh.vertices {
                let [i, j] = vertex.at;
                let ray = sample.ray(face, f64::from(i), f64::from(j));
                let is_inside = (1..16).contains(&i) && (1..16).contains(&j);
                let truth = normal.dot(ray);
                if is_inside && truth > 0.1 {
                    assert!(
                        (vertex.disparity - truth).abs() < 1e-6,
                        "{} {truth}",
                        vertex.disparity
                    );
                }
                if !is_inside {
                    let key = (ray.normalize() * 1e6).round().to_array().map(|c| c as i64);
                    on_border.entry(key).or_default().push(vertex.disparity);
                    assert!(truth <= 0.1 || (vertex.disparity / truth - 1.0).abs() < 0.1);
                }
            }
        }
        let shared = on_border.values().filter(|disparities| disparities.len() > 1);
        assert!(shared.clone().count() > 20);
        assert!(shared.flat_map(|d| d.windows(2)).all(|pair| pair[0] == pair[1]));
    }

    #[test]
    fn nothing_spans_a_gap() {
        // A near plane over the left half of +x, a far one elsewhere.
        let (near, far) = (DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.05, 0.0, 0.0));
        let mut sample = planes(16, &[far]);
        let near = planes(16, &[near]);
        for y in 0..16 {
            for x in 0..8 {
                let at = sample.index(x, y);
                sample.faces[0].disparity[at] = near.faces[0].disparity[at];
            }
        }
        let joined = |a: Pixel, b: Pixel| a.face == b.face && (a.x < 8) == (b.x < 8);
        let mesh = dense_mesh(&sample, 0, &all(&sample), &joined);
        for triangle in &mesh.triangles {
            let disparities = triangle.map(|v| mesh.vertices[v as usize].disparity);
            assert!(disparities.iter().all(|d| (d - disparities[0]).abs() < 0.01));
        }
        // Corners of the gap are there twice.
        assert_eq!(mesh.vertices.len(), 17 * 18);
    }

    #[test]
    fn pixels_around_a_corner_hang_together_through_each_other() {
        let pixels = around(16, 0, 5, 5);
        let chain = |a: Pixel, b: Pixel| a.x.abs_diff(b.x) + a.y.abs_diff(b.y) == 1;
        assert_eq!(group(&pixels, pixels[3], &chain), pixels);
        assert_eq!(group(&pixels, pixels[2], &|_, _| false), [pixels[2]]);
    }
}
