//! Normals as pixels: 8 bits an axis, `round(255 * (0.5 + 0.5 n))` with halves rounded up.
//!
//! The code of no normal is that of the zero vector, 128 on each axis.

/// The code of a vector in scene axes, at most of unit length.
pub fn encode(n: [f32; 3]) -> [u8; 3] {
    n.map(|c| (127.5 * c + 128.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_rounded_to_nearest() {
        assert_eq!(encode([0.0; 3]), [128; 3]);
        assert_eq!(encode([-1.0, 1.0, -0.0]), [0, 255, 128]);
        let beyond = 1.0f32.next_up();
        assert_eq!(encode([-beyond, beyond, 0.0]), [0, 255, 128]);
        for i in -1000..=1000 {
            let c = i as f32 / 1000.0;
            let [code, ..] = encode([c; 3]);
            assert!((f32::from(code) - 255.0 * (0.5 + 0.5 * c)).abs() <= 0.501, "{c} {code}");
        }
    }
}
