//! A patch of a face of a scan cube ([`protocol::format::projected`]): where its vertices lie, and its picture, read
//! as it lies in the file.

use super::relight::Relight;
use super::texture::Textures;
use protocol::format::projected::{self, TILE, bc1_ends, bc1_pixel, mixed, normal_pixel, selector};

/// BC1 blocks of a tile.
const BLOCKS: usize = projected::TILE_BYTES / size_of::<Block>();

type Block = [u8; 8];

/// Vertices and picture.
pub(super) struct Patch {
    /// Packed grid positions.
    pub(super) positions: Box<[[u32; 2]]>,
    /// Pixels a side.
    side: u32,
    /// Row by row: 0, or 1 + the place of a tile, which exists.
    table: Box<[u32]>,
    blocks: Box<[Block]>,
    /// As many of normals, if it has any.
    normals: Option<Box<[Block]>>,
}

impl Patch {
    /// Takes a patch over; none where the table names a tile that is not stored.
    pub(super) fn read(parts: &projected::Patch<'_>) -> Option<Self> {
        let words = |bytes: &[u8]| -> Box<[u32]> {
            bytes.as_chunks().0.iter().map(|&word| u32::from_le_bytes(word)).collect()
        };
        let patch = Self {
            positions: words(parts.vertices).as_chunks().0.into(),
            side: parts.side,
            table: words(parts.table),
            blocks: parts.tiles.as_chunks().0.into(),
            normals: parts.normals.map(|normals| normals.as_chunks().0.into()),
        };
        let stored = patch.blocks.len() / BLOCKS;
        patch.table.iter().all(|&entry| entry as usize <= stored).then_some(patch)
    }

    /// Bytes of its arrays.
    pub(super) fn held_bytes(&self) -> usize {
        let Self { positions, side: _, table, blocks, normals } = self;
        let normals = normals.as_ref().map_or(0, |normals| size_of_val(&**normals));
        size_of_val(&**positions) + size_of_val(&**table) + size_of_val(&**blocks) + normals
    }

    /// The block in a column and row of blocks, if its tile is stored.
    fn block(&self, [x, y]: [u32; 2]) -> Option<usize> {
        const ACROSS: u32 = TILE / 4;
        let entry = self.table[(y / ACROSS * (self.side / TILE) + x / ACROSS) as usize];
        let place = entry.checked_sub(1)? as usize;
        Some(place * BLOCKS + (y % ACROSS * ACROSS + x % ACROSS) as usize)
    }

    /// The linear colour of a pixel, if its tile is stored; lit again if it has a normal.
    fn pixel(
        &self,
        textures: &Textures,
        [x, y]: [u32; 2],
        relight: Option<&Relight>,
    ) -> Option<[f32; 3]> {
        let block = self.block([x / 4, y / 4])?;
        let stored = textures.linear(bc1_pixel(self.blocks[block], x % 4, y % 4));
        let Some((relight, normals)) = relight.zip(self.normals.as_ref()) else {
            return Some(stored);
        };
        let factor = relight.factor(normal_pixel(normals[block], x % 4, y % 4));
        Some(stored.map(|c| c * factor))
    }

    /// Linear colour at a place in pixels from the picture's top left corner: the bilinear filter of
    /// `shaders/projected.wgsl`. What is not stored shows the nearest of the four pixels that is; black
    /// where none is.
    pub(super) fn sample(
        &self,
        textures: &Textures,
        place: [f32; 2],
        relight: Option<&Relight>,
    ) -> [f32; 3] {
        let last = self.side as i32 - 1;
        let axis = |coordinate: f32| {
            // NaN becomes 0.
            let from_center = coordinate.max(0.0).min(self.side as f32) - 0.5;
            let below = from_center.floor();
            let pixels = [0, 1].map(|step| (below as i32 + step).clamp(0, last) as u32);
            let share = from_center - below;
            (pixels, [1.0 - share, share])
        };
        let (columns, rows) = (axis(place[0]), axis(place[1]));
        let block = |[from, to]: [u32; 2]| (from / 4 == to / 4).then_some(from / 4);
        if let (None, Some(x), Some(y)) = (relight, block(columns.0), block(rows.0)) {
            let Some(block) = self.block([x, y]) else { return [0.0; 3] };
            return within_a_block(self.blocks[block], textures, columns, rows);
        }
        let (mut sum, mut stored) = ([0.0f32; 3], 0.0f32);
        let (mut nearest, mut most) = ([0.0; 3], -1.0);
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let at = [columns.0[x], rows.0[y]];
            let Some(color) = self.pixel(textures, at, relight) else { continue };
            let weight = columns.1[x] * rows.1[y];
            if weight > most {
                (nearest, most) = (color, weight);
            }
            (0..3).for_each(|k| sum[k] += color[k] * weight);
            stored += weight;
        }
        std::array::from_fn(|k| sum[k] + nearest[k] * (1.0 - stored))
    }
}

/// What [`Patch::sample`] finds where all four pixels lie in one block, as most do: its colours are worked out once.
fn within_a_block(
    block: Block,
    textures: &Textures,
    (columns, across): ([u32; 2], [f32; 2]),
    (rows, down): ([u32; 2], [f32; 2]),
) -> [f32; 3] {
    let [a, b] = bc1_ends(block);
    let mut sum = [0.0f32; 3];
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let code = mixed(a, b, selector(block, columns[x] % 4, rows[y] % 4));
        let color = textures.linear(code);
        let weight = across[x] * down[y];
        (0..3).for_each(|k| sum[k] += color[k] * weight);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of tiles, white and black in turn, of which some are stored.
    fn patch(stored: [bool; 2]) -> Patch {
        let mut table = [0u32; 4];
        let mut tiles = Vec::new();
        for (i, color) in [0xffu8, 0].into_iter().enumerate().filter(|(i, _)| stored[*i]) {
            tiles.extend([color, color, color, color, 0, 0, 0, 0].repeat(BLOCKS));
            let entry = (tiles.len() / projected::TILE_BYTES) as u32;
            (table[i], table[2 + i]) = (entry, entry);
        }
        let table: Vec<u8> = table.iter().flat_map(|entry| entry.to_le_bytes()).collect();
        let (vertices, indices) = (&[][..], &[][..]);
        let (table, tiles, normals) = (&table[..], &tiles[..], None);
        let parts = projected::Patch { side: 32, vertices, indices, table, tiles, normals };
        Patch::read(&parts).expect("a sound patch")
    }

    #[test]
    fn no_place_is_out_of_the_picture() {
        let (patch, textures) = (patch([true, true]), Textures::new());
        let red = |x: f32| patch.sample(&textures, [x, 31.9], None)[0];
        for (at, expected) in [(f32::NAN, 1.0), (f32::NEG_INFINITY, 1.0), (-3.0, 1.0), (0.0, 1.0)] {
            assert_eq!(red(at), expected, "{at}");
        }
        assert_eq!([red(15.5), red(15.75), red(16.0), red(16.5)], [1.0, 0.75, 0.5, 0.0]);
        assert_eq!([red(32.0), red(1e30), red(f32::INFINITY)], [0.0; 3]);
    }

    #[test]
    fn what_is_not_stored_shows_its_nearest_neighbour_that_is() {
        let textures = Textures::new();
        let red = |patch: &Patch, x: f32| patch.sample(&textures, [x, 7.3], None)[0];
        let left = patch([true, false]);
        // Inside, at the border, and beyond it by less than a pixel.
        for (at, expected) in [(3.0, 1.0), (15.75, 1.0), (16.25, 1.0), (17.0, 0.0)] {
            assert!((red(&left, at) - expected).abs() < 1e-6, "{at}");
        }
        let right = patch([false, true]);
        assert_eq!([red(&right, 15.75), red(&right, 16.25)], [0.0; 2]);
    }

    #[test]
    fn a_table_that_names_what_is_not_stored_is_damaged() {
        let parts = projected::Patch {
            side: 16,
            vertices: &[],
            indices: &[],
            table: &[2, 0, 0, 0],
            tiles: &[0; projected::TILE_BYTES],
            normals: None,
        };
        assert!(Patch::read(&parts).is_none());
        assert!(Patch::read(&projected::Patch { table: &[1, 0, 0, 0], ..parts }).is_some());
    }
}
