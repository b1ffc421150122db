//! The one lighting rule, shared by every backend: base colour, one sun, ambient, two-sided.
//!
//! `colour = base * (AMBIENT + SUN * max(0, dot(n, sun)))`, linear RGB, where `n` is the unit normal in
//! scene axes, flipped to face the viewer, and `sun` the unit vector towards the sun.
//!
//! Scan cubes hold colours under [`baked_sun`]. Under another, a pixel that has a normal is lit again: times the light
//! that falls there now, over what fell, before it is filtered.

use protocol::sun::Sun;

/// Share of the base colour that needs no light.
pub const AMBIENT: f32 = 0.35;
/// Share of the base colour that the sun adds where it falls straight on.
pub const SUN: f32 = 0.65;
/// Linear RGB where nothing is drawn.
pub const SKY: [f32; 3] = [0.60, 0.70, 0.82];

/// Unit vector towards the sun that scan cubes were lit by, scene axes.
pub fn baked_sun() -> [f32; 3] {
    Sun::default().unit()
}

/// Light on a surface with unit normal `n` that faces the viewer, as a factor on its base colour.
pub fn intensity(n: [f32; 3], sun: [f32; 3]) -> f32 {
    AMBIENT + SUN * (n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2]).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_lies_between_ambient_and_one() {
        let sun = baked_sun();
        assert!((intensity(sun, sun) - (AMBIENT + SUN)).abs() < 1e-6);
        assert_eq!(intensity(sun.map(|c| -c), sun), AMBIENT);
        assert!((AMBIENT + SUN - 1.0).abs() < 1e-6);
    }
}
