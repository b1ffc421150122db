//! Where the sun stands.

use serde::{Deserialize, Serialize};

/// A direction towards the sun, scene axes, of any length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[f64; 3]", into = "[f64; 3]")]
pub struct Sun([f64; 3]);

/// A vector without a direction.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{0:?} is no direction: give three finite numbers, one of them not 0")]
pub struct NoDirection([f64; 3]);

impl Sun {
    /// The unit vector. The same bits on every machine.
    pub fn unit(self) -> [f32; 3] {
        // A power of two changes no bit of the quotients, and no square leaves the range of numbers.
        let scale = f64::from_bits(largest(self.0).to_bits() & f64::INFINITY.to_bits());
        let [x, y, z] = self.0.map(|c| (c / scale) as f32);
        let length = (x * x + y * y + z * z).sqrt();
        [x / length, y / length, z / length]
    }
}

/// As it stands over a scene whose y axis points up.
impl Default for Sun {
    fn default() -> Self {
        Self([0.35, 0.85, 0.4])
    }
}

impl TryFrom<[f64; 3]> for Sun {
    type Error = NoDirection;

    fn try_from(towards: [f64; 3]) -> Result<Self, NoDirection> {
        let has_one = towards.iter().all(|c| c.is_finite()) && largest(towards).is_normal();
        has_one.then_some(Self(towards)).ok_or(NoDirection(towards))
    }
}

impl From<Sun> for [f64; 3] {
    fn from(sun: Sun) -> Self {
        sun.0
    }
}

fn largest(v: [f64; 3]) -> f64 {
    v.iter().fold(0.0, |largest, c| c.abs().max(largest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_direction_is_refused() {
        for v in [[0.0; 3], [0.0, f64::NAN, 1.0], [1.0, f64::INFINITY, 0.0], [-0.0, 5e-324, 0.0]] {
            assert!(Sun::try_from(v).is_err(), "{v:?}");
        }
    }

    #[test]
    fn any_length_gives_the_same_unit_vector() {
        let unit = |v| Sun::try_from(v).unwrap().unit();
        assert_eq!(unit([0.0, -2.0, 0.0]), [0.0, -1.0, 0.0]);
        let whole = unit([-1.0, 0.5, 0.25]);
        for exponent in [-1020, -70, 3, 1000] {
            let scale = 2f64.powi(exponent);
            assert_eq!(unit([-scale, 0.5 * scale, 0.25 * scale]), whole, "2^{exponent}");
        }
        let [x, y, z] = unit([f64::MAX, f64::MIN_POSITIVE, -f64::MAX]).map(f64::from);
        assert!((x * x + y * y + z * z - 1.0).abs() < 1e-6 && x == -z);
    }

    #[test]
    fn the_default_keeps_its_bits() {
        let bits = Sun::default().unit().map(f32::to_bits);
        assert_eq!(bits, [0x3eb2_c0f1, 0x3f59_0edc, 0x3ecc_4a38]);
        assert_eq!(Sun::try_from(<[f64; 3]>::from(Sun::default())), Ok(Sun::default()));
    }
}
