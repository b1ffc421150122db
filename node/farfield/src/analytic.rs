//! Scenes of boxes and a ground, cast ray by ray: samples that are right by construction.

use crate::sample::{FacePicture, Sample};
use glam::DVec3;

/// Boxes, and the plane `z = ground` if there is one.
#[derive(Default)]
pub(crate) struct Scene {
    pub(crate) boxes: Vec<[DVec3; 2]>,
    pub(crate) ground: Option<f64>,
}

impl Scene {
    pub(crate) fn of(boxes: &[[f64; 6]]) -> Self {
        let boxes =
            boxes.iter().map(|&[a, b, c, d, e, f]| [DVec3::new(a, b, c), DVec3::new(d, e, f)]);
        Self { boxes: boxes.collect(), ground: None }
    }

    /// The paper's figure 3 in a closed room: a wall along x at y = 2, from side to side, with a gap of 1, before a
    /// rear wall at y = 6.
    pub(crate) fn gap() -> Self {
        Self::of(&[
            [-15.0, -5.0, -15.0, 15.0, 6.0, 15.0],
            [-15.0, 2.0, -15.0, -0.5, 2.1, 15.0],
            [0.5, 2.0, -15.0, 15.0, 2.1, 15.0],
        ])
    }

    /// The ray's first hit with a surface, in units of its direction.
    pub(crate) fn first_hit(&self, eye: DVec3, ray: DVec3) -> Option<f64> {
        let hits = self.boxes.iter().filter_map(|[low, high]| {
            let (a, b) = ((low - eye) / ray, (high - eye) / ray);
            let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
            let hit = if enter > 0.0 { enter } else { leave };
            (enter <= leave && hit > 0.0).then_some(hit)
        });
        let ground = self.ground.map(|z| (z - eye.z) / ray.z).filter(|&hit| hit > 0.0);
        hits.chain(ground).filter(|hit| hit.is_finite()).min_by(f64::total_cmp)
    }

    pub(crate) fn sample(&self, eye: DVec3, side: u32) -> Sample {
        let blank =
            FacePicture { color: vec![[0; 3]; (side * side) as usize], ..Default::default() };
        let mut sample = Sample { eye, side, faces: std::array::from_fn(|_| blank.clone()) };
        for face in 0..6 {
            let seen = (0..side * side).map(|i| {
                let ray = sample.ray(face, f64::from(i % side) + 0.5, f64::from(i / side) + 0.5);
                self.first_hit(eye, ray).map_or(0.0, |depth| (1.0 / depth) as f32)
            });
            sample.faces[face].disparity = seen.collect();
        }
        sample
    }
}
