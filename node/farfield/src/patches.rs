//! The patches of a face: its mesh cut into parts that lie close together, so that those outside a camera's
//! frustum need not be drawn, nor be in memory.

use crate::depth_mesh::simplify::FaceMesh;
use crate::picture::StoredPicture;
use protocol::format::projected::{SUBPIXELS, TILE};
use std::ops::Range;

/// Triangles of a patch at most: small enough that a frustum cuts off most of what it does not see, large enough
/// that a patch is worth a draw.
pub const PATCH_TRIANGLES: usize = 1024;

/// A square of tiles of a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// Column and row of its first tile.
    pub at: [u32; 2],
    /// Tiles along a side.
    pub across: u32,
}

/// Triangles of a face, and the window of the picture that they lie in.
#[derive(Debug, Clone, PartialEq)]
pub struct BakedPatch {
    /// Triangles of the face's mesh.
    pub triangles: Range<usize>,
    /// Where they lie, with the pixels that a filter reaches from there.
    pub window: Window,
    /// What is stored of the picture there.
    pub picture: StoredPicture,
}

/// Orders the triangles of a mesh of a face of `side` pixels so that those of a patch follow one another, and
/// names the patches: halves of halves along the longer side of where their middles lie.
pub fn patches(mesh: &mut FaceMesh, side: u32) -> Vec<(Range<usize>, Window)> {
    let corners = |triangle: &[u32; 3]| triangle.map(|v| mesh.vertices[v as usize]);
    let middle = |triangle: &[u32; 3], axis: usize| -> u32 {
        corners(triangle).iter().map(|corner| corner[axis]).sum()
    };
    let mut found = Vec::new();
    let all = 0..mesh.triangles.len();
    let mut open: Vec<Range<usize>> = Some(all).filter(|all| !all.is_empty()).into_iter().collect();
    while let Some(range) = open.pop() {
        let triangles = &mut mesh.triangles[range.clone()];
        if triangles.len() <= PATCH_TRIANGLES {
            let corners = triangles.iter().flat_map(corners).map(|[u, v, _]| [u, v]);
            found.push((range, window(corners, side)));
            continue;
        }
        let extent = |axis: usize| {
            let middles = || triangles.iter().map(|triangle| middle(triangle, axis));
            middles().max().unwrap_or(0) - middles().min().unwrap_or(0)
        };
        let axis = usize::from(extent(1) > extent(0));
        triangles.sort_by_key(|triangle| (middle(triangle, axis), *triangle));
        let half = range.start + triangles.len() / 2;
        open.extend([half..range.end, range.start..half]);
    }
    found
}

/// The tiles that places, in [`SUBPIXELS`], and a filter there reach into.
fn window(places: impl Iterator<Item = [u32; 2]>, side: u32) -> Window {
    let (mut least, mut most) = ([u32::MAX; 2], [0; 2]);
    for place in places {
        for axis in 0..2 {
            least[axis] = least[axis].min(place[axis]);
            most[axis] = most[axis].max(place[axis]);
        }
    }
    let tiles = side / TILE;
    let first =
        least.map(|at| (at / SUBPIXELS).saturating_sub(1) / TILE).map(|at| at.min(tiles - 1));
    let end = most.map(|at| (at.div_ceil(SUBPIXELS) / TILE + 1).min(tiles));
    let across = (end[0] - first[0]).max(end[1] - first[1]);
    Window { at: first.map(|at| at.min(tiles - across)), across }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    const SIDE: u32 = 128;

    fn mesh(rng: &mut StdRng, triangles: usize) -> FaceMesh {
        let vertices = (0..3 * triangles / 2 + 3).map(|_| {
            let [u, v] = [0; 2].map(|_| rng.random_range(0..=SIDE * SUBPIXELS));
            [u, v, rng.random_range(0..9)]
        });
        let vertices: Vec<[u32; 3]> = vertices.collect();
        let vertex = |rng: &mut StdRng| rng.random_range(0..vertices.len() as u32);
        let triangles = (0..triangles).map(|_| [0; 3].map(|_| vertex(rng))).collect();
        FaceMesh { triangles, vertices: vertices.clone(), step: 1.0, error_px: 0.0 }
    }

    #[test]
    fn every_triangle_is_in_one_patch_and_its_window() {
        let mut rng = StdRng::seed_from_u64(2);
        for count in [0, 1, PATCH_TRIANGLES, PATCH_TRIANGLES + 1, 5000] {
            let mut mesh = mesh(&mut rng, count);
            let mut before = mesh.triangles.clone();
            let found = patches(&mut mesh, SIDE);
            let mut after = mesh.triangles.clone();
            before.sort_unstable();
            after.sort_unstable();
            assert_eq!(before, after);
            let mut end = 0;
            for (range, window) in &found {
                assert_eq!(range.start, end);
                end = range.end;
                assert!(range.len() <= PATCH_TRIANGLES);
                assert!(count <= PATCH_TRIANGLES || range.len() > PATCH_TRIANGLES / 3);
                let corners = mesh.triangles[range.clone()].as_flattened();
                for &corner in corners {
                    for axis in 0..2 {
                        let at = mesh.vertices[corner as usize][axis];
                        let first = window.at[axis] * TILE * SUBPIXELS;
                        let last = first + window.across * TILE * SUBPIXELS;
                        // A filter's half pixel is inside, too, but at the face's own border.
                        assert!(first == 0 || first + SUBPIXELS / 2 <= at);
                        assert!(last == SIDE * SUBPIXELS || at + SUBPIXELS / 2 <= last);
                        assert!(first <= at && at <= last && last <= SIDE * SUBPIXELS);
                    }
                }
            }
            assert_eq!(end, count);
        }
    }

    #[test]
    fn patches_are_as_small_as_what_they_hold() {
        // 4,096 triangles in rows of small squares: patches cover a quarter of the face each, not all of it.
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for at in 0..4096u32 {
            let [u, v] = [at % 64 * 2 * SUBPIXELS, at / 64 * 2 * SUBPIXELS];
            triangles.push([0, 1, 2].map(|k| vertices.len() as u32 + k));
            vertices.extend([[u, v, 1], [u, v + SUBPIXELS, 1], [u + SUBPIXELS, v, 1]]);
        }
        let mut mesh = FaceMesh { vertices, triangles, step: 1.0, error_px: 0.0 };
        let found = patches(&mut mesh, SIDE);
        assert_eq!(found.len(), 4);
        assert!(found.iter().all(|(_, window)| window.across <= 5), "{found:?}");
    }
}
