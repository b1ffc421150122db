//! A triangle mesh while it is being worked on.

use crate::bounds::Aabb;
use glam::{DAffine3, DMat3, DVec3, Vec3};

/// One vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshVertex {
    /// Position, in the mesh's own units.
    pub position: DVec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Linear RGBA, 8 bits a channel.
    pub color: [u8; 4],
    /// Texture coordinates; zero where the surface has no texture.
    pub tex_coord: [f32; 2],
    /// What the triangles of this vertex are made of: a number whose meaning is the caller's. All
    /// corners of a triangle have the same.
    pub surface: u16,
    /// A vertex on the border to a neighbouring piece stays where it is in every hlod that lies
    /// deeper in the tree than this: there both sides have met. [`u8::MAX`] for all others.
    pub seam: u8,
}

impl MeshVertex {
    /// A plain vertex: no texture, no border, surface 0.
    pub fn plain(position: DVec3, normal: Vec3, color: [u8; 4]) -> Self {
        Self { position, normal, color, tex_coord: [0.0; 2], surface: 0, seam: u8::MAX }
    }
}

/// An indexed triangle mesh. Every index is below `vertices.len()`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<MeshVertex>,
    /// Triangles, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The box around all vertices.
    pub fn bounds(&self) -> Aabb {
        Aabb::of(self.vertices.iter().map(|vertex| vertex.position))
    }

    /// Corner positions of a triangle.
    pub fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|index| self.vertices[index as usize].position)
    }

    /// Appends a copy of `other`.
    pub fn append(&mut self, other: &Self) {
        let base = self.vertices.len() as u32;
        self.vertices.extend_from_slice(&other.vertices);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|index| index + base)));
    }

    /// The mesh placed by `target_from_mesh`. Normals go with the inverse transpose, and a mirror
    /// turns the windings over, so that fronts stay fronts.
    pub fn placed(mut self, target_from_mesh: &DAffine3) -> Self {
        for vertex in &mut self.vertices {
            vertex.position = target_from_mesh.transform_point3(vertex.position);
        }
        self.turn(&target_from_mesh.matrix3);
        self
    }

    /// Normals and windings as `linear` makes them; positions stay.
    pub fn turn(&mut self, linear: &DMat3) {
        let normal_matrix = cofactors(linear);
        for vertex in &mut self.vertices {
            let normal = normal_matrix * vertex.normal.as_dvec3();
            vertex.normal = normal.try_normalize().unwrap_or(DVec3::Z).as_vec3();
        }
        if linear.determinant() < 0.0 {
            self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
    }
}

/// The inverse transpose times |determinant|: no division, so flattening placements work too.
fn cofactors(m: &DMat3) -> DMat3 {
    let sign = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(
        m.y_axis.cross(m.z_axis) * sign,
        m.z_axis.cross(m.x_axis) * sign,
        m.x_axis.cross(m.y_axis) * sign,
    )
}

/// Unit normal of a triangle by the right-hand rule; `None` when it has no area.
pub fn face_normal(corners: [DVec3; 3]) -> Option<DVec3> {
    (corners[1] - corners[0]).cross(corners[2] - corners[0]).try_normalize()
}

/// The largest factor by which a linear map stretches a length: an upper bound within one part in
/// 10^9 of its largest singular value (Jacobi rotations of A^T A; Golub and Van Loan, section 8.5).
pub fn largest_stretch(linear: &DMat3) -> f64 {
    let scale = linear.to_cols_array().iter().fold(0.0f64, |most, v| most.max(v.abs()));
    if scale == 0.0 {
        return 0.0;
    }
    let unit = *linear * (1.0 / scale);
    let mut a = (unit.transpose() * unit).to_cols_array_2d();
    // Each sweep squares the off-diagonal part: eight are far past rounding for a 3x3 matrix.
    for _ in 0..8 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate_away(&mut a, p, q);
        }
    }
    let largest = a[0][0].max(a[1][1]).max(a[2][2]).max(0.0);
    largest.sqrt() * scale * (1.0 + 1e-9)
}

/// One Jacobi rotation: zeroes `a[p][q]` of a symmetric matrix.
fn rotate_away(a: &mut [[f64; 3]; 3], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for row in a.iter_mut() {
        let (left, right) = (row[p], row[q]);
        row[p] = c * left - s * right;
        row[q] = s * left + c * right;
    }
    let (above, below) = (a[p], a[q]);
    a[p] = std::array::from_fn(|k| c * above[k] - s * below[k]);
    a[q] = std::array::from_fn(|k| s * above[k] + c * below[k]);
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A mesh from positions, all grey, with z as normal.
    pub(crate) fn mesh_of(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Mesh {
        let vertex =
            |p: &[f64; 3]| MeshVertex::plain(DVec3::from_array(*p), Vec3::Z, [128, 128, 128, 255]);
        Mesh { vertices: positions.iter().map(vertex).collect(), triangles: triangles.to_vec() }
    }

    /// A UV sphere of radius 1 with smooth normals.
    pub(crate) fn sphere(rings: u32, sectors: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for ring in 0..=rings {
            for sector in 0..=sectors {
                let theta = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
                let phi = std::f64::consts::TAU * f64::from(sector % sectors) / f64::from(sectors);
                let (sine, cosine) =
                    if ring == 0 || ring == rings { (0.0, theta.cos()) } else { theta.sin_cos() };
                let p = DVec3::new(sine * phi.cos(), sine * phi.sin(), cosine);
                mesh.vertices.push(MeshVertex::plain(p, p.as_vec3(), [255; 4]));
            }
        }
        let at = |ring: u32, sector: u32| ring * (sectors + 1) + sector;
        for ring in 0..rings {
            for sector in 0..sectors {
                let (a, b) = (at(ring, sector), at(ring, sector + 1));
                let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
                if ring > 0 {
                    mesh.triangles.push([a, c, b]);
                }
                if ring + 1 < rings {
                    mesh.triangles.push([b, c, d]);
                }
            }
        }
        mesh
    }

    #[test]
    fn a_map_to_nothing_stretches_nothing_and_a_flat_one_keeps_its_scale() {
        assert_eq!(largest_stretch(&DMat3::ZERO), 0.0);
        let flat = DMat3::from_diagonal(DVec3::new(3.0, 0.0, 1.0));
        assert!((largest_stretch(&flat) - 3.0).abs() < 1e-8);
    }

    #[test]
    fn the_stretch_bounds_every_direction_and_is_reached() {
        let m = DMat3::from_cols_array(&[1.0, 2.0, -1.0, 0.5, 3e-7, 4.0, -2.5, 1.0, 1.0]);
        let stretch = largest_stretch(&m);
        let mut seen = 0.0f64;
        for i in 0..200 {
            for j in 0..200 {
                let (theta, phi) = (f64::from(i) * 0.0158, f64::from(j) * 0.0315);
                let d = DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
                seen = seen.max((m * d).length());
            }
        }
        assert!(seen <= stretch && seen > stretch * 0.999, "{seen} {stretch}");
    }

    #[test]
    fn a_mirror_keeps_fronts_in_front() {
        let mesh = mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]);
        let mirror = DAffine3::from_scale(DVec3::new(-2.0, 1.0, 1.0));
        let placed = mesh.placed(&mirror);
        assert_eq!(face_normal(placed.corners(placed.triangles[0])), Some(DVec3::Z));
        assert_eq!(placed.vertices[0].normal, Vec3::Z);
    }

    #[test]
    fn appending_shifts_the_indices() {
        let one = mesh_of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]);
        let mut two = Mesh::default();
        assert!(two.bounds().is_empty());
        two.append(&one);
        two.append(&one);
        assert_eq!(two.triangles, [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(face_normal([DVec3::ZERO; 3]), None);
    }
}
