//! Pictures of scan cubes under another sun than they were taken under.

use super::project::{cross, unit};
use crate::backend::{Draw, light};

/// The sun of a pass, unit vectors in scene axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sunlight {
    pub(super) sun: [f32; 3],
    /// The one that pictures of scan cubes show, where it is another.
    pub(super) moved_from: Option<[f32; 3]>,
}

impl Sunlight {
    pub(super) fn new(sun: [f32; 3]) -> Self {
        let baked = light::baked_sun();
        Self { sun, moved_from: (sun != baked).then_some(baked) }
    }
}

/// The axes that a draw's normals have: its face's right, up, and back to the viewpoint.
#[derive(Clone, Copy)]
pub(super) struct FaceAxes([[f32; 3]; 3]);

impl FaceAxes {
    /// Those of a projected blob, whose columns lie along its face.
    pub(super) fn of(draw: &Draw) -> Self {
        let [right, down] = [0, 1].map(|column: usize| unit(draw.linear[column].map(f64::from)));
        Self([right, down.map(|c| -c), cross(down, right)].map(|axis| axis.map(|c| c as f32)))
    }

    /// A vector in scene axes, in these.
    fn turn(&self, v: [f32; 3]) -> [f32; 3] {
        self.0.map(|axis| axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2])
    }
}

/// The sun that shines now and the one that shone when a picture was taken, unit vectors in its face's axes.
pub(super) struct Relight {
    now: [f32; 3],
    then: [f32; 3],
}

impl Relight {
    /// None where the light is the picture's own.
    pub(super) fn new(Sunlight { sun, moved_from }: Sunlight, axes: &FaceAxes) -> Option<Self> {
        moved_from.map(|baked| Self { now: axes.turn(sun), then: axes.turn(baked) })
    }

    /// The factor on the colour of what has a normal, of any length.
    pub(super) fn factor(&self, normal: [f32; 3]) -> f32 {
        let normal = unit(normal.map(f64::from)).map(|c| c as f32);
        light::intensity(normal, self.now) / light::intensity(normal, self.then)
    }
}
