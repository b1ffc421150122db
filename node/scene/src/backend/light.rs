//! The one lighting rule, shared by every backend: base colour, one sun, ambient, two-sided.
//!
//! `colour = base * (AMBIENT + SUN * max(0, dot(n, sun_direction())))`, linear RGB, where `n` is the
//! unit normal in scene axes, flipped to face the viewer. The sun stands as it does over a scene whose
//! y axis points up.

/// Share of the base colour that needs no light.
pub const AMBIENT: f32 = 0.35;
/// Share of the base colour that the sun adds where it falls straight on.
pub const SUN: f32 = 0.65;
/// Linear RGB where nothing is drawn.
pub const SKY: [f32; 3] = [0.60, 0.70, 0.82];

/// Unit vector towards the sun, scene axes.
pub fn sun_direction() -> [f32; 3] {
    let [x, y, z] = [0.35f32, 0.85, 0.4];
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

/// Light on a surface with unit normal `n` that faces the viewer, as a factor on its base colour.
pub fn intensity(n: [f32; 3]) -> f32 {
    let sun = sun_direction();
    AMBIENT + SUN * (n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2]).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_lies_between_ambient_and_one() {
        let sun = sun_direction();
        assert!((intensity(sun) - (AMBIENT + SUN)).abs() < 1e-6);
        assert_eq!(intensity(sun.map(|c| -c)), AMBIENT);
        assert!((AMBIENT + SUN - 1.0).abs() < 1e-6);
    }
}
