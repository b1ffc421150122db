//! What is rasterised into: depth, and who wrote it.

use super::raster::Span;
use protocol::settings::PictureSize;

/// Side of a tile, pixels.
const TILE: u32 = 8;

/// A reversed-Z depth buffer: 0 is infinitely far.
pub(super) struct Depth {
    size: PictureSize,
    /// Equal depths pass.
    inclusive: bool,
    pixels: Vec<f32>,
}

impl Depth {
    /// A cleared buffer.
    pub(super) fn new(size: PictureSize, inclusive: bool) -> Self {
        Self { size, inclusive, pixels: vec![0.0; pixel_count(size)] }
    }

    /// All depths, top row first.
    pub(super) fn into_pixels(self) -> Vec<f32> {
        self.pixels
    }

    fn passes(&self, z: f32, stored: f32) -> bool {
        z > stored || (self.inclusive && z == stored)
    }

    fn range(&self, span: &Span) -> std::ops::Range<usize> {
        let first = (span.y * self.size.width + span.x) as usize;
        first..first + span.len as usize
    }

    /// Writes depth alone.
    pub(super) fn write(&mut self, span: &Span) {
        let range = self.range(span);
        for (i, stored) in self.pixels[range].iter_mut().enumerate() {
            // Whether equal depths pass makes no difference to the depth that is left.
            *stored = stored.max(depth_at(span, i as u32));
        }
    }

    /// Writes depth, and `mark` wherever it passes.
    pub(super) fn write_owned<T: Copy>(&mut self, span: &Span, mark: T, marks: &mut [T]) {
        let range = self.range(span);
        for i in 0..span.len {
            let (z, at) = (depth_at(span, i), range.start + i as usize);
            if self.passes(z, self.pixels[at]) {
                self.pixels[at] = z;
                marks[at] = mark;
            }
        }
    }

    /// Calls `visit` with every pixel of the span that passes, its index and its column; all stay as
    /// they are.
    pub(super) fn visit_passing(&self, span: &Span, mut visit: impl FnMut(usize, u32)) {
        let range = self.range(span);
        for i in 0..span.len {
            let at = range.start + i as usize;
            if self.passes(depth_at(span, i), self.pixels[at]) {
                visit(at, span.x + i);
            }
        }
    }

    /// As [`Depth::write_owned`], but only in those columns where `is_there` says so.
    pub(super) fn write_owned_where<T: Copy>(
        &mut self,
        span: &Span,
        mark: T,
        marks: &mut [T],
        mut is_there: impl FnMut(u32) -> bool,
    ) {
        let range = self.range(span);
        for i in 0..span.len {
            let (z, at) = (depth_at(span, i), range.start + i as usize);
            if self.passes(z, self.pixels[at]) && is_there(span.x + i) {
                self.pixels[at] = z;
                marks[at] = mark;
            }
        }
    }

    /// The least depth of every tile.
    pub(super) fn tile_minima(&self) -> TileMinima {
        let across = self.size.width.div_ceil(TILE) as usize;
        let down = self.size.height.div_ceil(TILE) as usize;
        let mut minima = vec![f32::INFINITY; across * down];
        for (y, row) in self.pixels.chunks_exact(self.size.width as usize).enumerate() {
            let minima = &mut minima[y / TILE as usize * across..][..across];
            for (minimum, pixels) in minima.iter_mut().zip(row.chunks(TILE as usize)) {
                *minimum = pixels.iter().fold(*minimum, |least, &z| least.min(z));
            }
        }
        TileMinima { across, minima }
    }

    /// Whether a pixel of the span would pass. Tiles that are nearer than the whole of the span's part
    /// in them are skipped, which cannot change the answer: depth is monotone along a span, in f64
    /// and after rounding too.
    pub(super) fn any_passes(&self, span: &Span, tiles: &TileMinima) -> bool {
        let row = &self.pixels[self.range(span)];
        let mut i = 0;
        while i < span.len {
            let x = span.x + i;
            let end = (i + TILE - x % TILE).min(span.len);
            let nearest = depth_at(span, i).max(depth_at(span, end - 1));
            if self.passes(nearest, tiles.at(x / TILE, span.y / TILE))
                && (i..end).any(|i| self.passes(depth_at(span, i), row[i as usize]))
            {
                return true;
            }
            i = end;
        }
        false
    }

    /// Nothing of at most depth `z` passes in the pixels `x0..=x1`, `y0..=y1`, all within the picture.
    pub(super) fn hides(&self, z: f32, [x0, x1, y0, y1]: [u32; 4], tiles: &TileMinima) -> bool {
        (y0 / TILE..=y1 / TILE)
            .all(|y| (x0 / TILE..=x1 / TILE).all(|x| !self.passes(z, tiles.at(x, y))))
    }
}

/// The least depth of every tile of a [`Depth`].
pub(super) struct TileMinima {
    across: usize,
    minima: Vec<f32>,
}

impl TileMinima {
    fn at(&self, x: u32, y: u32) -> f32 {
        self.minima[y as usize * self.across + x as usize]
    }
}

fn depth_at(span: &Span, i: u32) -> f32 {
    (span.z + span.dz * f64::from(i)) as f32
}

/// Pixels of a picture.
pub(super) fn pixel_count(size: PictureSize) -> usize {
    size.width as usize * size.height as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    #[test]
    fn equal_depths_pass_only_where_told() {
        let size = PictureSize { width: 1, height: 1 };
        let span = Span { y: 0, x: 0, len: 1, z: 0.25, dz: 0.0 };
        for inclusive in [true, false] {
            let mut depth = Depth::new(size, inclusive);
            let mut owners = [9];
            depth.write_owned(&span, 1, &mut owners);
            depth.write_owned(&span, 2, &mut owners);
            assert_eq!(owners, [if inclusive { 2 } else { 1 }]);
            assert_eq!(depth.any_passes(&span, &depth.tile_minima()), inclusive);
            assert_eq!(depth.into_pixels(), [0.25]);
        }
    }

    #[test]
    fn tiles_never_change_an_answer() {
        let mut rng = StdRng::seed_from_u64(3);
        let mut answers = [0; 2];
        for (width, height) in [(1, 1), (7, 333), (65, 9)] {
            let size = PictureSize { width, height };
            let mut depth = Depth::new(size, true);
            for z in &mut depth.pixels {
                *z = rng.random_range(0.4..0.6);
            }
            let tiles = depth.tile_minima();
            for _ in 0..5000 {
                let x = rng.random_range(0..width);
                let len = rng.random_range(1..=width - x);
                let dz = rng.random_range(-0.01..0.01);
                let y = rng.random_range(0..height);
                let span = Span { y, x, len, z: rng.random_range(0.35..0.5), dz };
                let row = &depth.pixels[depth.range(&span)];
                let expected = (0..len).any(|i| depth_at(&span, i) >= row[i as usize]);
                assert_eq!(depth.any_passes(&span, &tiles), expected);
                answers[usize::from(expected)] += 1;
                if depth.hides(depth_at(&span, 0), [x, x + len - 1, y, y], &tiles) {
                    assert!(row.iter().all(|&stored| stored > depth_at(&span, 0)));
                }
            }
        }
        assert!(answers.iter().all(|&count| count > 1000), "{answers:?}");
    }
}
