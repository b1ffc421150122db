//! The picture of a face as it is stored: the tiles that a mesh shows, in BC1.

use crate::depth_mesh::simplify::FaceMesh;
use crate::normals::FaceNormals;
use crate::patches::Window;
use crate::sample::FacePicture;
use protocol::format::projected::{SUBPIXELS, TILE, TILE_BYTES};
use texpresso::{COLOUR_WEIGHTS_UNIFORM, Format, Params};

/// A patch's stored picture ([`protocol::format::projected`]).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StoredPicture {
    /// By tile of the window, 0 or 1 + its place among the stored.
    pub table: Vec<u32>,
    /// The stored tiles.
    pub tiles: Vec<u8>,
    /// As many bytes of normals, if the face has any.
    pub normals: Option<Vec<u8>>,
}

/// Stores the tiles of a window that triangles of `mesh` reach into. Pixels without a colour of their own take the
/// one of a neighbour that has, so that a filter over the edge of what is shown finds nothing dark.
pub fn stored_picture(
    picture: &FacePicture,
    normals: Option<&FaceNormals>,
    side: u32,
    mesh: &FaceMesh,
    triangles: &[[u32; 3]],
    window: Window,
) -> StoredPicture {
    let Window { at: [left, top], across } = window;
    let mut is_shown = vec![false; (across * across) as usize];
    for triangle in triangles {
        let corners = triangle.map(|v| mesh.vertices[v as usize]);
        let tiles = |k: usize| {
            let least = corners.iter().map(|c| c[k]).min().unwrap_or(0) / SUBPIXELS;
            let most = corners.iter().map(|c| c[k]).max().unwrap_or(0).div_ceil(SUBPIXELS);
            // A filter reaches half a pixel beyond.
            let first = least.saturating_sub(1) / TILE;
            first.max(window.at[k])..(most / TILE + 1).min(window.at[k] + across)
        };
        for row in tiles(1) {
            for column in tiles(0) {
                let reached = || meets(corners, [column, row]);
                let shown = &mut is_shown[((row - top) * across + column - left) as usize];
                *shown = *shown || reached();
            }
        }
    }
    let mut stored = StoredPicture {
        table: vec![0; is_shown.len()],
        tiles: Vec::new(),
        normals: normals.map(|_| Vec::new()),
    };
    for (at, _) in is_shown.iter().enumerate().filter(|(_, shown)| **shown) {
        let tile_at = [left + at as u32 % across, top + at as u32 / across];
        stored.tiles.extend(tile(picture, side, tile_at));
        if let Some((stored, normals)) = stored.normals.as_mut().zip(normals) {
            stored.extend(normals.tile(tile_at));
        }
        stored.table[at] = (stored.tiles.len() / TILE_BYTES) as u32;
    }
    stored
}

/// Whether a triangle comes within a pixel of a tile. Separating axes: the tile's own are known to overlap.
fn meets(corners: [[u32; 3]; 3], tile: [u32; 2]) -> bool {
    let corner = |c: [u32; 3]| [i64::from(c[0]), i64::from(c[1])];
    let [a, b, c] = corners.map(corner);
    let (unit, size) = (i64::from(SUBPIXELS), i64::from(TILE * SUBPIXELS));
    let least = tile.map(|at| i64::from(at) * size - unit);
    let most = tile.map(|at| (i64::from(at) + 1) * size + unit);
    [(a, b, c), (b, c, a), (c, a, b)].into_iter().all(|(from, to, opposite)| {
        let normal = [from[1] - to[1], to[0] - from[0]];
        let along = |p: [i64; 2]| normal[0] * (p[0] - from[0]) + normal[1] * (p[1] - from[1]);
        let inside = along(opposite).signum();
        let box_corners = [least, [most[0], least[1]], [least[0], most[1]], most];
        inside == 0 || box_corners.into_iter().any(|p| along(p) * inside >= 0)
    })
}

/// What a pixel of a face of `side` pixels has, or the first of its neighbours that has any.
pub(crate) fn own_or_beside<T>(
    side: u32,
    (x, y): (u32, u32),
    of: impl Fn(u32, u32) -> Option<T>,
) -> Option<T> {
    let near = |at: u32| at.saturating_sub(1)..(at + 2).min(side);
    let beside = || near(y).flat_map(|y| near(x).map(move |x| (x, y))).find_map(|(x, y)| of(x, y));
    of(x, y).or_else(beside)
}

/// One tile, 16 blocks row by row.
fn tile(picture: &FacePicture, side: u32, [column, row]: [u32; 2]) -> Vec<u8> {
    let colored = |x: u32, y: u32| {
        let at = (y * side + x) as usize;
        (picture.disparity[at] > 0.0).then(|| picture.color[at])
    };
    let mut rgba = Vec::with_capacity((TILE * TILE * 4) as usize);
    for y in row * TILE..(row + 1) * TILE {
        for x in column * TILE..(column + 1) * TILE {
            let [r, g, b] = own_or_beside(side, (x, y), colored).unwrap_or_default();
            rgba.extend([r, g, b, 255]);
        }
    }
    // BC1 has a mode of three colours and a hole, told by the order of the end points, which a face knows
    // nothing of. The colour half of a BC3 block, the second, is never in that mode.
    let mut blocks = vec![0; 2 * TILE_BYTES];
    // An error counts alike in all channels, as where pictures are compared.
    let params = Params { weights: COLOUR_WEIGHTS_UNIFORM, ..Params::default() };
    Format::Bc3.compress(&rgba, TILE as usize, TILE as usize, params, &mut blocks);
    blocks.as_chunks::<16>().0.iter().flat_map(|block| block[8..].to_vec()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::FACES;
    use protocol::format::projected::Patch;
    use rand::{Rng, SeedableRng, rngs::StdRng};
    use scene::backend::normal;

    fn picture(side: u32, color: impl Fn(u32, u32) -> [u8; 3]) -> FacePicture {
        let at = (0..side * side).map(|at| (at % side, at / side));
        FacePicture {
            disparity: vec![0.5; (side * side) as usize],
            color: at.map(|(x, y)| color(x, y)).collect(),
            ..Default::default()
        }
    }

    fn triangle(corners: [[u32; 2]; 3]) -> FaceMesh {
        let vertices = corners.map(|[u, v]| [u * SUBPIXELS, v * SUBPIXELS, 9]).to_vec();
        FaceMesh { vertices, triangles: vec![[0, 1, 2]], step: 1.0, error_px: 0.0 }
    }

    /// Of a whole face in one window.
    fn stored(picture: &FacePicture, side: u32, mesh: &FaceMesh) -> StoredPicture {
        let window = Window { at: [0; 2], across: side / TILE };
        stored_picture(picture, None, side, mesh, &mesh.triangles, window)
    }

    /// The bytes of its table.
    fn table_of(stored: &StoredPicture) -> Vec<u8> {
        stored.table.iter().flat_map(|entry| entry.to_le_bytes()).collect()
    }

    fn patch<'a>(side: u32, table: &'a [u8], stored: &'a StoredPicture) -> Patch<'a> {
        let StoredPicture { tiles, normals, .. } = stored;
        Patch { side, vertices: &[], indices: &[], table, tiles, normals: normals.as_deref() }
    }

    #[test]
    fn a_window_is_a_part_of_the_whole() {
        let mesh = triangle([[0, 0], [0, 64], [64, 64]]);
        let picture = picture(64, |x, y| [x as u8, y as u8, 7]);
        let whole = stored(&picture, 64, &mesh);
        let window = Window { at: [1, 2], across: 2 };
        let part = stored_picture(&picture, None, 64, &mesh, &mesh.triangles, window);
        let tile = |of: &StoredPicture, at: usize| {
            let place = of.table[at].checked_sub(1).map(|place| place as usize * TILE_BYTES);
            place.map(|at| of.tiles[at..at + TILE_BYTES].to_vec())
        };
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let of_whole = tile(&whole, (y + 2) * 4 + x + 1);
            assert!(of_whole.is_some());
            assert_eq!(tile(&part, y * 2 + x), of_whole, "{x} {y}");
        }
    }

    #[test]
    fn a_face_without_triangles_stores_no_tile() {
        let stored = stored(&picture(32, |_, _| [9; 3]), 32, &FaceMesh::default());
        assert_eq!(stored, StoredPicture { table: vec![0; 4], tiles: vec![], normals: None });
    }

    #[test]
    fn normals_lie_beside_the_colours_of_the_same_tiles() {
        // Left half right, right half straight at the viewpoint, of the face that looks along +x.
        let mut picture = picture(64, |x, _| [x as u8; 3]);
        picture.normal = (0..64 * 64)
            .map(|at| normal::encode([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]][at % 64 / 32]))
            .collect();
        let normals = FaceNormals::of(&picture, 64, &FACES[0]);
        let mesh = triangle([[0, 0], [0, 64], [64, 64]]);
        let window = Window { at: [1, 0], across: 3 };
        let bare = stored_picture(&picture, None, 64, &mesh, &mesh.triangles, window);
        let full = stored_picture(&picture, normals.as_ref(), 64, &mesh, &mesh.triangles, window);
        assert_eq!((&bare.table, &bare.tiles), (&full.table, &full.tiles));
        assert_eq!(full.normals.as_ref().map(Vec::len), Some(full.tiles.len()));
        let table = table_of(&full);
        let face = patch(48, &table, &full);
        assert!(face.normal(47, 0).is_none() && face.pixel(47, 0) == [0; 3], "no such tile");
        for x in 0..48 {
            let expected = if x < 16 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
            let found = face.normal(x, 47).unwrap();
            assert!((0..3).all(|k| (found[k] - expected[k]).abs() < 0.02), "{x}: {found:?}");
        }
    }

    #[test]
    fn tiles_that_a_triangle_reaches_are_stored_and_no_others() {
        // The diagonal half of a face of 8x8 tiles.
        let mesh = triangle([[0, 0], [0, 128], [128, 128]]);
        let stored = stored(&picture(128, |_, _| [9; 3]), 128, &mesh);
        let is_stored = |x: usize, y: usize| stored.table[y * 8 + x] > 0;
        for (x, y) in (0..8).flat_map(|x| (0..8).map(move |y| (x, y))) {
            assert!(is_stored(x, y) || x > y, "{x} {y}");
            assert!(!is_stored(x, y) || x <= y + 1, "{x} {y}");
        }
        assert_eq!(
            stored.tiles.len() / TILE_BYTES,
            stored.table.iter().filter(|t| **t > 0).count()
        );
    }

    #[test]
    fn colours_come_back_nearly_as_they_were() {
        let mesh = triangle([[0, 0], [0, 64], [64, 64]]);
        for (smooth, most) in [(true, 8), (false, 40)] {
            let mut rng = StdRng::seed_from_u64(1);
            let noise: Vec<u8> = (0..64 * 64).map(|_| rng.random_range(0..40)).collect();
            let truth = picture(64, |x, y| {
                let n = if smooth { 0 } else { noise[(y * 64 + x) as usize] };
                [60 + 2 * x as u8 + n, 100 + y as u8 + n, 90 + n]
            });
            let stored = stored(&truth, 64, &mesh);
            let table = table_of(&stored);
            let face = patch(64, &table, &stored);
            for (x, y) in (0..64).flat_map(|x| (x..64).map(move |y| (x, y))) {
                let (found, truth) = (face.pixel(x, y), truth.color[(y * 64 + x) as usize]);
                let off = (0..3).map(|k| found[k].abs_diff(truth[k])).max().unwrap();
                assert!(off <= most, "{x} {y}: {found:?} {truth:?}");
            }
        }
    }

    #[test]
    fn a_plain_colour_is_met_whatever_it_is() {
        let mesh = triangle([[0, 0], [0, 16], [16, 16]]);
        let mut rng = StdRng::seed_from_u64(2);
        for _ in 0..500 {
            let color: [u8; 3] = std::array::from_fn(|_| rng.random());
            let stored = stored(&picture(16, |_, _| color), 16, &mesh);
            let table = table_of(&stored);
            let face = patch(16, &table, &stored);
            let found = face.pixel(7, 9);
            assert!((0..3).all(|k| found[k].abs_diff(color[k]) <= 1), "{found:?} {color:?}");
        }
    }

    #[test]
    fn beside_the_edge_of_what_is_seen_nothing_is_dark() {
        let mut half = picture(32, |_, _| [200; 3]);
        for at in 0..32 * 32 {
            if at % 32 >= 10 {
                (half.disparity[at], half.color[at]) = (0.0, [0; 3]);
            }
        }
        let stored = stored(&half, 32, &triangle([[0, 0], [0, 32], [10, 32]]));
        let table = table_of(&stored);
        let face = patch(32, &table, &stored);
        assert!((0..32).all(|y| face.pixel(10, y)[1] > 190), "{:?}", face.pixel(10, 3));
    }
}
