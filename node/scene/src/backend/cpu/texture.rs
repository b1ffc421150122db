//! Textures on the processor: the same trilinear filter as `shaders/texture.wgsl`.
//!
//! Colours are decoded from sRGB before they are filtered. The mip is chosen by the longer of the two
//! steps that texture coordinates make to the next pixel, across and down (OpenGL 4.6, section 8.14).

use crate::backend::{BackendError, Upload, stored_mips};
use protocol::format::texture::srgb_to_linear;
use protocol::format::{Texture as Record, Wrap};

/// Texture coordinates at a pixel, and how they change to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Footprint {
    pub(super) at: [f32; 2],
    pub(super) across: [f32; 2],
    pub(super) down: [f32; 2],
}

/// The textures of a scene that are there.
pub(super) struct Textures {
    linear: Vec<f32>,
    declared: Vec<Record>,
    /// By index.
    all: Vec<Option<Texture>>,
    /// Most bytes of pixels.
    room: u64,
    held: u64,
}

struct Texture {
    side: u32,
    wrap: [Wrap; 2],
    /// Mips, the largest first; each is a quarter of the one before.
    pixels: Box<[[u8; 4]]>,
}

impl Textures {
    /// None at all.
    pub(super) fn new() -> Self {
        let linear = (0..=u8::MAX).map(srgb_to_linear).collect();
        Self { linear, declared: Vec::new(), all: Vec::new(), room: 0, held: 0 }
    }

    /// Bytes of all pixels.
    pub(super) fn held_bytes(&self) -> u64 {
        self.held
    }

    /// Bytes that are set apart for them.
    pub(super) fn room(&self) -> u64 {
        self.room
    }

    /// Declares textures in place of all before, which go.
    pub(super) fn declare(&mut self, textures: &[Record], room: u64) {
        self.declared = textures.to_vec();
        self.all = textures.iter().map(|_| None).collect();
        (self.room, self.held) = (room, 0);
    }

    /// Takes one, unless it is there.
    ///
    /// Errors: `Device` for bytes that are no texture.
    pub(super) fn upload(&mut self, index: u32, bytes: &[u8]) -> Result<Upload, BackendError> {
        let at = index as usize;
        let (side, wrap, bytes) = stored_mips(&self.declared[at], bytes)?;
        if self.all[at].is_some() {
            return Ok(Upload::Done);
        }
        if self.held + bytes.len() as u64 > self.room {
            return Ok(Upload::Full);
        }
        self.held += bytes.len() as u64;
        self.all[at] = Some(Texture { side, wrap, pixels: bytes.as_chunks::<4>().0.into() });
        Ok(Upload::Done)
    }

    /// Forgets one; nothing happens if it is not there.
    pub(super) fn evict(&mut self, index: u32) {
        if let Some(texture) = self.all[index as usize].take() {
            self.held -= size_of_val(&*texture.pixels) as u64;
        }
    }

    /// Linear values of an sRGB-encoded colour.
    pub(super) fn linear(&self, rgb: [u8; 3]) -> [f32; 3] {
        rgb.map(|code| self.linear[usize::from(code)])
    }

    /// Linear colour and alpha; white where there is no such texture.
    pub(super) fn sample(&self, index: u32, footprint: &Footprint) -> [f32; 4] {
        let Some(Some(texture)) = self.all.get(index as usize) else { return [1.0; 4] };
        let side = texture.side as f32;
        let squared = |[u, v]: [f32; 2]| (u * u + v * v) * (side * side);
        let longest = squared(footprint.across).max(squared(footprint.down));
        let last = texture.side.ilog2();
        // At most one pixel of the texture a pixel of the picture: the largest mip. NaN too.
        let lod = if longest > 1.0 { (0.5 * longest.log2()).min(last as f32) } else { 0.0 };
        let level = lod as u32;
        let finer = self.bilinear(texture, level, footprint.at);
        let share = lod - level as f32;
        if share == 0.0 {
            return finer;
        }
        let coarser = self.bilinear(texture, (level + 1).min(last), footprint.at);
        mix(finer, coarser, share)
    }

    fn bilinear(&self, texture: &Texture, level: u32, [u, v]: [f32; 2]) -> [f32; 4] {
        let side = texture.side >> level;
        let axis = |coordinate: f32, wrap: Wrap| {
            let place = reduced(coordinate, wrap) * side as f32 - 0.5;
            let below = place.floor();
            let pixels = [below as i32, below as i32 + 1].map(|at| wrapped(at, side, wrap));
            (pixels, place - below)
        };
        let ([x0, x1], fx) = axis(u, texture.wrap[0]);
        let ([y0, y1], fy) = axis(v, texture.wrap[1]);
        // Mips before this one: a series in quarters.
        let before = (4 * texture.side * texture.side - 4 * side * side) / 3;
        let pixel = |x: u32, y: u32| {
            let [r, g, b, a] = texture.pixels[(before + y * side + x) as usize];
            let [r, g, b] = self.linear([r, g, b]);
            [r, g, b, f32::from(a) / 255.0]
        };
        let upper = mix(pixel(x0, y0), pixel(x1, y0), fx);
        mix(upper, mix(pixel(x0, y1), pixel(x1, y1), fx), fy)
    }
}

fn mix(a: [f32; 4], b: [f32; 4], share: f32) -> [f32; 4] {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * share)
}

/// A coordinate near 0 that shows the same: whole pairs of textures taken off, or the far outside cut.
fn reduced(coordinate: f32, wrap: Wrap) -> f32 {
    match wrap {
        _ if !coordinate.is_finite() => 0.0,
        Wrap::Clamp => coordinate.clamp(-1.0, 2.0),
        Wrap::Repeat | Wrap::Mirror => coordinate - 2.0 * (coordinate * 0.5).floor(),
    }
}

/// The pixel of a row of `side`, a power of two, that shows at `at`.
fn wrapped(at: i32, side: u32, wrap: Wrap) -> u32 {
    let side = side as i32;
    let pixel = match wrap {
        Wrap::Repeat => at & (side - 1),
        Wrap::Clamp => at.clamp(0, side - 1),
        Wrap::Mirror => {
            let folded = at & (2 * side - 1);
            folded.min(2 * side - 1 - folded)
        }
    };
    pixel as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::format::texture::mips;

    fn textures(side: u32, wrap: [Wrap; 2], rgba: &[u8]) -> Textures {
        let bytes = mips(side, rgba);
        let record = Record {
            offset: 0,
            bytes: bytes.len() as u64,
            side,
            wrap: Wrap::pack(wrap),
            crc: 0,
            reserved: 0,
        };
        let mut textures = Textures::new();
        textures.declare(&[record], record.bytes);
        assert_eq!(textures.upload(0, &bytes).unwrap(), Upload::Done);
        textures
    }

    fn close_up(at: [f32; 2]) -> Footprint {
        Footprint { at, across: [0.0; 2], down: [0.0; 2] }
    }

    #[test]
    fn what_is_not_there_is_white() {
        assert_eq!(Textures::new().sample(0, &close_up([0.5; 2])), [1.0; 4]);
        let one = textures(1, [Wrap::Repeat; 2], &[0, 255, 0, 51]);
        for at in [[0.0; 2], [7.25, -3.5], [f32::NAN, 1e30], [f32::INFINITY, 0.0]] {
            assert_eq!(one.sample(0, &close_up(at)), [0.0, 1.0, 0.0, 0.2]);
        }
        assert_eq!(one.sample(1, &close_up([0.0; 2])), [1.0; 4]);
    }

    #[test]
    fn each_wrap_continues_in_its_way() {
        let at = [-9, -8, -5, -4, -1, 0, 3, 4, 7, 8];
        let pixels = |wrap| at.map(|at| wrapped(at, 4, wrap));
        assert_eq!(pixels(Wrap::Repeat), [3, 0, 3, 0, 3, 0, 3, 0, 3, 0]);
        assert_eq!(pixels(Wrap::Clamp), [0, 0, 0, 0, 0, 0, 3, 3, 3, 3]);
        assert_eq!(pixels(Wrap::Mirror), [0, 0, 3, 3, 0, 0, 3, 3, 0, 0]);
        // Far away and near give the same place.
        assert_eq!(reduced(-5.25, Wrap::Mirror), 0.75);
        assert_eq!(reduced(1e9, Wrap::Clamp), 2.0);
    }

    #[test]
    fn pixels_blend_across_their_borders_and_over_the_edge() {
        let columns = [[0u8, 0, 0, 255], [255, 255, 255, 255]].as_flattened().repeat(2);
        let red =
            |wrap, u: f32| textures(2, [wrap; 2], &columns).sample(0, &close_up([u, 0.25]))[0];
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            assert_eq!((red(wrap, 0.25), red(wrap, 0.5), red(wrap, 0.75)), (0.0, 0.5, 1.0));
        }
        // At the left edge repetition meets the right-hand pixel, the others themselves.
        assert_eq!([Wrap::Repeat, Wrap::Clamp, Wrap::Mirror].map(|w| red(w, 0.0)), [0.5, 0.0, 0.0]);
        assert_eq!(
            [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror].map(|w| red(w, 1.25)),
            [0.0, 1.0, 1.0]
        );
    }

    #[test]
    fn far_away_the_mean_is_left() {
        let rgba: Vec<u8> = (0..64).flat_map(|i| [255 * (i % 2) as u8, 0, 0, 255]).collect();
        let board = textures(8, [Wrap::Repeat; 2], &rgba);
        let at = |step: f32| {
            let footprint =
                Footprint { at: [0.3, 0.4], across: [step, 0.0], down: [0.0, step / 9.0] };
            board.sample(0, &footprint)[0]
        };
        for step in [0.25, 1.0, 50.0, f32::INFINITY] {
            assert!((at(step) - 0.5).abs() < 0.01, "{step}: {}", at(step));
        }
        assert_eq!(at(0.0), at(0.125));
        // Between two mips lies a mix of both.
        let (near, far, half) = (at(0.125), at(0.25), at(0.125 * std::f32::consts::SQRT_2));
        assert!((half - (near + far) / 2.0).abs() < 1e-4, "{near} {half} {far}");
    }
}
