//! The rules of view cells and scan cubes.

use super::{Place, Rule, Violation, hold};
use crate::format::{Cube, Method, NONE, Skeleton, ViewCell, projected};
use crate::id::BlobId;

/// View cells, their cubes, and whose patch each projected blob is; the blobs are known to be good.
pub(super) fn check_far_fields(skeleton: &Skeleton) -> Result<(), Violation> {
    let mut expected = 0u32;
    for (i, cell) in skeleton.view_cells.iter().enumerate() {
        let place = Place::ViewCell(i as u32);
        let numbers = cell.min.iter().chain(&cell.max).chain([&cell.objective]);
        hold(place, numbers.copied().all(f64::is_finite), Rule::NotFinite)?;
        hold(place, (0..3).all(|k| cell.min[k] < cell.max[k]), Rule::FlatCell)?;
        hold(place, cell.objective >= 0.0, Rule::Negative)?;
        let margin = cell.margin;
        hold(place, (0.0..0.5).contains(&margin), Rule::Margin { margin })?;
        let Some(method) = Method::of(cell.method) else {
            return Err(Violation { place, rule: Rule::Method { method: cell.method } });
        };
        let (first, count) = (cell.first_cube, cell.cube_count);
        let rest = skeleton.cubes.len() - expected as usize;
        let follow = first == expected && count as usize <= rest;
        hold(place, follow, Rule::CubeRange { first, count, expected })?;
        hold(place, (method == Method::None) == (count == 0), Rule::CubeCount { count })?;
        for cube in first..first + count {
            check_cube(skeleton, cell, method, cube)?;
        }
        expected += count;
    }
    hold(Place::Cube(expected), expected as usize == skeleton.cubes.len(), Rule::StrayCube)?;
    check_owners(skeleton)
}

fn check_cube(
    skeleton: &Skeleton,
    cell: &ViewCell,
    method: Method,
    index: u32,
) -> Result<(), Violation> {
    let place = Place::Cube(index);
    let cube = &skeleton.cubes[index as usize];
    hold(place, cube.eye.iter().all(|c| c.is_finite()), Rule::NotFinite)?;
    let inside = (0..3).all(|k| cell.min[k] <= cube.eye[k] && cube.eye[k] <= cell.max[k]);
    hold(place, inside, Rule::OutsideCell)?;
    let parent = cube.parent;
    let earlier = method == Method::Itdm && (cell.first_cube..index).contains(&parent);
    hold(place, parent == NONE || earlier, Rule::CubeParent { parent })?;
    let mut found = 0;
    hold(place, projected::is_side(cube.side), Rule::Face { side: cube.side })?;
    hold(place, cube.patches.is_sorted(), Rule::Patches)?;
    for blob in cube.blobs() {
        let patch = skeleton.blobs.get(blob as usize).filter(|patch| patch.is_projected());
        let Some(patch) = patch else {
            return Err(Violation { place, rule: Rule::NoPatch { blob } });
        };
        let room = f64::from(cube.side) - f64::from(patch.image[0]);
        let fits = patch.origin[..2].iter().all(|&at| at <= room);
        hold(Place::Blob(BlobId(blob)), fits, Rule::Window { side: cube.side })?;
        found += u64::from(patch.triangles);
    }
    let said = cube.triangles;
    hold(place, u64::from(said) == found, Rule::Triangles { said, found })
}

/// Each projected blob is one patch of one cube.
fn check_owners(skeleton: &Skeleton) -> Result<(), Violation> {
    let mut owners = vec![0u32; skeleton.blobs.len()];
    for blob in skeleton.cubes.iter().flat_map(Cube::blobs) {
        owners[blob as usize] = owners[blob as usize].saturating_add(1);
    }
    for (i, (blob, owners)) in (0..).zip(skeleton.blobs.iter().zip(owners)) {
        let place = Place::Blob(BlobId(i));
        hold(place, owners == u32::from(blob.is_projected()), Rule::PatchOwners { owners })?;
    }
    Ok(())
}

/// No two view cells share more than a face, so that every viewpoint inside is at home in one.
///
/// Cells are held against those that begin, along x, before they end: the more there are side by side, the
/// longer it takes, so this is left to whoever reads or writes a whole file. [`super::check()`] has passed.
pub fn check_disjoint(cells: &[ViewCell]) -> Result<(), Violation> {
    let mut order: Vec<u32> = (0..cells.len() as u32).collect();
    let cell = |i: u32| &cells[i as usize];
    order.sort_by(|&a, &b| cell(a).min[0].total_cmp(&cell(b).min[0]));
    for (at, &a) in order.iter().enumerate() {
        let near = order[at + 1..].iter().take_while(|&&b| cell(b).min[0] < cell(a).max[0]);
        for &b in near {
            let (one, two) = (cell(a), cell(b));
            let apart = (1..3).any(|k| one.max[k] <= two.min[k] || two.max[k] <= one.min[k]);
            let rule = Rule::Overlap { other: a.min(b) };
            hold(Place::ViewCell(a.max(b)), apart, rule)?;
        }
    }
    Ok(())
}
