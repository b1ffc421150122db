//! Samples: six range pictures around a viewpoint (paper 000, section 3.1).

use glam::DVec3;
pub use protocol::format::projected::{FACES, FaceAxes};

/// What one face of the cube shows: `side * side` pixels, top row first. A pixel's centre lies at half
/// coordinates; [`protocol::format::projected`] says where in space that is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FacePicture {
    /// Reciprocal view depth along the face's axis, 1 over scene units; 0 where nothing is seen.
    pub disparity: Vec<f32>,
    /// Colour as it was shaded, sRGB-encoded; of no meaning where nothing is seen.
    pub color: Vec<[u8; 3]>,
    /// Code ([`scene::backend::normal`]) of the unit normal that faces the viewpoint; empty where normals were
    /// not asked for.
    pub normal: Vec<[u8; 3]>,
}

/// A sample: what is seen from a viewpoint in all directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The viewpoint.
    pub eye: DVec3,
    /// Pixels along a side of a face.
    pub side: u32,
    /// In the order of [`FACES`].
    pub faces: [FacePicture; 6],
}

impl Sample {
    /// Index of a pixel.
    pub fn index(&self, x: u32, y: u32) -> usize {
        (y * self.side + x) as usize
    }

    /// Direction of face coordinates in pixels (a pixel's centre is at half coordinates), of unit view
    /// depth, not of unit length.
    pub fn ray(&self, face: usize, u: f64, v: f64) -> DVec3 {
        let FaceAxes { forward, right, up } = FACES[face];
        let to_unit = 2.0 / f64::from(self.side);
        DVec3::from_array(forward) + DVec3::from_array(right) * (u * to_unit - 1.0)
            - DVec3::from_array(up) * (v * to_unit - 1.0)
    }

    /// Where a pixel's centre lies in space; none where nothing is seen.
    pub fn point(&self, face: usize, x: u32, y: u32) -> Option<DVec3> {
        let disparity = self.faces[face].disparity[self.index(x, y)];
        let ray = self.ray(face, f64::from(x) + 0.5, f64::from(y) + 0.5);
        (disparity > 0.0).then(|| self.eye + ray / f64::from(disparity))
    }

    /// The face that a direction from the viewpoint meets, the face coordinates in pixels, and the view
    /// depth along that face's axis. None of no direction.
    pub fn project(&self, direction: DVec3) -> Option<(usize, [f64; 2], f64)> {
        let size = direction.abs();
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let face = 2 * axis + usize::from(direction[axis] < 0.0);
        let FaceAxes { forward, right, up } = FACES[face];
        let depth = direction.dot(DVec3::from_array(forward));
        let half = 0.5 * f64::from(self.side);
        let u = half * (1.0 + direction.dot(DVec3::from_array(right)) / depth);
        let v = half * (1.0 - direction.dot(DVec3::from_array(up)) / depth);
        (depth > 0.0).then_some((face, [u, v], depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_direction_is_met_once_and_leads_back() {
        let picture =
            FacePicture { disparity: vec![0.0; 64], color: vec![[0; 3]; 64], ..Default::default() };
        let faces = std::array::from_fn(|_| picture.clone());
        let sample = Sample { eye: DVec3::new(1.0, 2.0, 3.0), side: 8, faces };
        assert_eq!(sample.project(DVec3::ZERO), None);
        for face in 0..6 {
            for (u, v) in [(0.5, 0.5), (7.9, 0.1), (4.0, 4.0), (2.25, 6.5)] {
                let ray = sample.ray(face, u, v);
                let (found, at, depth) = sample.project(ray * 3.0).unwrap();
                assert_eq!(found, face);
                assert!((at[0] - u).abs() < 1e-9 && (at[1] - v).abs() < 1e-9, "{at:?}");
                assert!((depth - 3.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_pixel_lies_on_its_ray_at_its_depth() {
        let mut picture =
            FacePicture { disparity: vec![0.0; 64], color: vec![[0; 3]; 64], ..Default::default() };
        picture.disparity[3 * 8 + 5] = 0.25;
        let faces = std::array::from_fn(|_| picture.clone());
        let sample = Sample { eye: DVec3::new(1.0, 2.0, 3.0), side: 8, faces };
        assert_eq!(sample.point(0, 0, 0), None);
        // +x at depth 4, 1.5 pixels right of the middle (-y), half a pixel up.
        let at = sample.point(0, 5, 3).unwrap();
        assert!((at - DVec3::new(5.0, 2.0 - 1.5, 3.0 + 0.5)).length() < 1e-12, "{at}");
    }
}
