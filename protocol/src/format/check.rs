//! Every promise the types of the skeleton make, checked.
//!
//! What passes can be walked without bounds in mind: indices lie in range, the tree is a tree of
//! limited depth, and errors grow towards the root.

mod far_field;
mod rule;

use super::class::Class;
use super::mesh::blob_bytes;
use super::projected;
use super::texture::{self, Texture, Wrap};
use super::vertex::{Layout, MAX_BLOB_VERTICES};
use super::{ALIGNMENT, Blob, Criteria, Hlod, NONE, Part, Skeleton};
use crate::id::{BlobId, HlodId};

pub use far_field::check_disjoint;
pub use rule::{Place, Rule, Violation};

/// Most hlods on a path from the root to a leaf, both counted: a fixed stack suffices to walk a tree.
pub const MAX_DEPTH: u32 = 64;

/// Greatest coordinate, and factor of a placement: what is drawn is `f32` beside the eye.
pub const FARTHEST: f64 = 1e30;

/// Checks the whole skeleton and reports the first broken rule.
pub fn check(skeleton: &Skeleton) -> Result<(), Violation> {
    check_info(skeleton)?;
    check_tree(&skeleton.hlods)?;
    check_hlods(skeleton)?;
    check_blobs(&skeleton.blobs)?;
    check_textures(&skeleton.textures)?;
    check_texture_lists(skeleton)?;
    for (i, transform) in skeleton.transforms.iter().enumerate() {
        let numbers = transform.linear.as_flattened().iter().chain(&transform.translation);
        hold_near(Place::Transform(i as u32), numbers)?;
    }
    check_parts(skeleton)?;
    check_levels(skeleton)?;
    check_errors(skeleton)?;
    far_field::check_far_fields(skeleton)
}

/// An error unless `kept`.
fn hold(place: Place, kept: bool, rule: Rule) -> Result<(), Violation> {
    if kept { Ok(()) } else { Err(Violation { place, rule }) }
}

/// Numbers that make places: finite, and no larger than [`FARTHEST`].
fn hold_near<'a>(
    place: Place,
    numbers: impl IntoIterator<Item = &'a f64> + Clone,
) -> Result<(), Violation> {
    hold(place, numbers.clone().into_iter().all(|x| x.is_finite()), Rule::NotFinite)?;
    hold(place, numbers.into_iter().all(|x| x.abs() <= FARTHEST), Rule::TooFar)
}

fn check_info(skeleton: &Skeleton) -> Result<(), Violation> {
    let info = &skeleton.info;
    hold(Place::Info, info.reserved == 0 && info.reserved2 == 0, Rule::Reserved)?;
    hold(Place::Info, info.up.iter().all(|c| c.is_finite()), Rule::NotFinite)?;
    hold(Place::Info, info.up.iter().any(|&c| c != 0.0), Rule::NoUp)?;
    check_criteria(&info.tree)?;
    check_criteria(&info.plain)?;
    let Some(root) = skeleton.hlods.first() else {
        return Err(Violation { place: Place::Info, rule: Rule::NoHlods });
    };
    let (said, sum) = (info.source_triangles, root.source_triangles);
    hold(Place::Info, said == sum, Rule::SourceTriangles { said, sum })
}

fn check_criteria(of: &Criteria) -> Result<(), Violation> {
    hold(Place::Info, of.reserved == 0 && of.reserved2 == 0, Rule::Reserved)?;
    let measures = [of.depth_mean, of.ideal_depth, of.overlap, of.localisation];
    hold(Place::Info, measures.iter().all(|m| m.is_finite()), Rule::NotFinite)?;
    hold(Place::Info, measures.iter().all(|&m| m >= 0.0), Rule::Negative)
}

/// The links alone: afterwards every walk along them stays in the table and ends.
fn check_tree(hlods: &[Hlod]) -> Result<(), Violation> {
    let mut depth = vec![1u32; hlods.len()];
    for (i, hlod) in hlods.iter().enumerate() {
        let place = Place::Hlod(HlodId(i as u32));
        let (first, count) = (hlod.first_child, hlod.child_count);
        let end = first as usize + count as usize;
        let follows =
            if count == 0 { first == 0 } else { first as usize > i && end <= hlods.len() };
        hold(place, follows, Rule::Children { first, count })?;

        let parent = hlod.parent;
        if i == 0 {
            hold(place, parent == NONE, Rule::Parent { parent })?;
            continue;
        }
        // A hlod names one parent, and that parent lists it: so each has exactly one.
        let listed = (parent as usize) < i && {
            let p = &hlods[parent as usize];
            i >= p.first_child as usize && i - (p.first_child as usize) < p.child_count as usize
        };
        hold(place, listed, Rule::Parent { parent })?;
        depth[i] = depth[parent as usize] + 1;
        hold(place, depth[i] <= MAX_DEPTH, Rule::Depth)?;
    }
    // The other direction: no hlod lists one that names another parent.
    let children: u64 = hlods.iter().map(|h| u64::from(h.child_count)).sum();
    if children != hlods.len() as u64 - 1 {
        for (i, hlod) in hlods.iter().enumerate() {
            let (first, count) = (hlod.first_child, hlod.child_count);
            let range = first as usize..first as usize + count as usize;
            let own = hlods[range].iter().all(|c| c.parent as usize == i);
            hold(Place::Hlod(HlodId(i as u32)), own, Rule::Children { first, count })?;
        }
    }
    Ok(())
}

/// Boxes, level ranges and triangle counts; the links are known to be good.
fn check_hlods(skeleton: &Skeleton) -> Result<(), Violation> {
    let levels = skeleton.levels.len();
    for (i, hlod) in skeleton.hlods.iter().enumerate() {
        let place = Place::Hlod(HlodId(i as u32));
        let corners = [hlod.min, hlod.max];
        hold_near(place, corners.as_flattened())?;
        hold(place, (0..3).all(|k| hlod.min[k] <= hlod.max[k]), Rule::EmptyBox)?;
        if hlod.parent != NONE {
            let outer = &skeleton.hlods[hlod.parent as usize];
            let inside = (0..3).all(|k| outer.min[k] <= hlod.min[k] && hlod.max[k] <= outer.max[k]);
            hold(place, inside, Rule::OutsideParent)?;
        }
        let (first, count) = (hlod.first_level, hlod.level_count);
        let in_range = first as usize + count as usize <= levels;
        hold(place, in_range, Rule::LevelRange { first, count })?;
        let object = hlod.object;
        hold(place, object == NONE || object < skeleton.info.objects, Rule::Object { object })?;
        if hlod.child_count == 0 {
            hold(place, count > 0, Rule::BareLeaf)?;
        } else {
            let said = hlod.source_triangles;
            let parts = skeleton.children_of(hlod).map(|c| skeleton.hlod(c).source_triangles);
            let sum = parts.fold(0, u64::saturating_add);
            hold(place, said == sum, Rule::SourceTriangles { said, sum })?;
        }
    }
    Ok(())
}

/// Blobs one after another, each a mesh or patch whose triangles all have a class.
pub(super) fn check_blobs(blobs: &[Blob]) -> Result<(), Violation> {
    let mut expected = 0u64;
    for (i, blob) in blobs.iter().enumerate() {
        let place = Place::Blob(BlobId(i as u32));
        let layout = blob.layout;
        let Some(of_vertex) = Layout::of(layout) else {
            return Err(Violation { place, rule: Rule::Layout { layout } });
        };
        let [side, tiles] = blob.image;
        let possible = match of_vertex {
            Layout::Projected | Layout::ProjectedNormals => {
                projected::is_side(side) && tiles <= projected::most_tiles(side)
            }
            // Where a list of textures lies is held against the lists themselves.
            Layout::Textured => true,
            Layout::Plain => blob.image == [0; 2],
        };
        hold(place, possible, Rule::Picture { side, tiles })?;
        let (vertices, triangles, bytes) = (blob.vertices, blob.triangles, blob.bytes);
        let is_mesh = vertices > 0
            && triangles > 0
            && vertices as usize <= MAX_BLOB_VERTICES
            && bytes == blob_bytes(blob);
        hold(place, is_mesh, Rule::MeshSize { vertices, triangles, bytes })?;
        let sum = blob.classes.iter().map(|&n| u64::from(n)).sum();
        hold(place, sum == u64::from(triangles), Rule::Classes { sum, triangles })?;
        let masked = Class::ALL.iter().any(|class| class.is_mask() && blob.has(*class));
        hold(place, of_vertex == Layout::Textured || !masked, Rule::PlainMask)?;
        expected = after(place, blob.offset, bytes, expected)?;
        hold(place, is_power_of_two(blob.step), Rule::Step { step: blob.step })?;
        hold_near(place, blob.origin.iter().chain(&[blob.step]))?;
        if blob.is_projected() {
            let all = Class::OpaqueDouble.all(triangles);
            hold(place, blob.classes == all, Rule::PatchClass)?;
            let tiles = |at: f64| at >= 0.0 && at % f64::from(projected::TILE) == 0.0;
            let [left, top, rest] = blob.origin;
            hold(place, tiles(left) && tiles(top) && rest == 0.0, Rule::PatchOrigin)?;
        }
    }
    Ok(())
}

/// Where the next thing starts if this one lies at `offset`, which must be `expected`.
fn after(place: Place, offset: u64, bytes: u64, expected: u64) -> Result<u64, Violation> {
    let rule = Rule::Offset { offset, expected };
    hold(place, offset == expected, rule)?;
    // No file is that long; the offset that does not fit is the broken rule.
    let end = offset.checked_add(bytes).and_then(|e| e.checked_next_multiple_of(ALIGNMENT));
    end.ok_or(Violation { place, rule })
}

fn check_textures(textures: &[Texture]) -> Result<(), Violation> {
    let mut next = 0u64;
    for (i, texture) in textures.iter().enumerate() {
        let place = Place::Texture(i as u32);
        let Texture { side, wrap, bytes, .. } = *texture;
        hold(place, texture::is_side(side), Rule::Side { side })?;
        hold(place, Wrap::unpack(wrap).is_some(), Rule::Wrap { wrap })?;
        let expected = texture::mip_bytes(side);
        hold(place, bytes == expected, Rule::TextureSize { bytes, expected })?;
        next = after(place, texture.offset, bytes, next)?;
        hold(place, texture.reserved == 0, Rule::Reserved)?;
    }
    Ok(())
}

/// Lists of textured blobs one after another, none left over, each ascending and of textures there are.
fn check_texture_lists(skeleton: &Skeleton) -> Result<(), Violation> {
    let (lists, textures) = (&skeleton.texture_lists, skeleton.textures.len());
    let mut expected = 0u32;
    for (i, blob) in skeleton.blobs.iter().enumerate().filter(|(_, blob)| blob.is_textured()) {
        let place = Place::Blob(BlobId(i as u32));
        let [first, count] = blob.image;
        let fits = first == expected && count as usize <= lists.len() - expected as usize;
        hold(place, fits, Rule::TextureRange { first, count, expected })?;
        let list = &lists[first as usize..][..count as usize];
        let ascends = list.windows(2).all(|pair| pair[0] < pair[1]);
        let exist = list.last().is_none_or(|&last| (last as usize) < textures);
        hold(place, ascends && exist, Rule::TextureList)?;
        expected += count;
    }
    hold(Place::Info, expected as usize == lists.len(), Rule::StrayTextures)
}

/// Positive, normal, and without a fraction bit.
pub(super) fn is_power_of_two(x: f64) -> bool {
    let fraction = x.to_bits() & ((1 << (f64::MANTISSA_DIGITS - 1)) - 1);
    x.is_normal() && x > 0.0 && fraction == 0
}

/// Every part names a mesh and a placement that exist.
fn check_parts(skeleton: &Skeleton) -> Result<(), Violation> {
    for (i, part) in skeleton.parts.iter().enumerate() {
        let place = Place::Part(i as u32);
        let (blob, transform) = (part.blob, part.transform);
        let Some(mesh) = skeleton.blobs.get(blob as usize) else {
            return Err(Violation { place, rule: Rule::NoBlob { blob } });
        };
        hold(place, !mesh.is_projected(), Rule::PatchAsPart { blob })?;
        let placed = transform == NONE || (transform as usize) < skeleton.transforms.len();
        hold(place, placed, Rule::NoTransform { transform })?;
    }
    Ok(())
}

/// Owners, parts, triangles and errors; the parts are known to be good.
fn check_levels(skeleton: &Skeleton) -> Result<(), Violation> {
    // Differences of a running count: a hostile file may list all levels under every hlod.
    let mut owners = vec![0i64; skeleton.levels.len() + 1];
    for hlod in &skeleton.hlods {
        owners[hlod.first_level as usize] += 1;
        owners[hlod.first_level as usize + hlod.level_count as usize] -= 1;
    }
    let mut owned = 0;
    let mut expected = 0u32;
    for (i, level) in skeleton.levels.iter().enumerate() {
        let place = Place::Level(i as u32);
        owned += owners[i];
        hold(place, owned == 1, Rule::Owners { owners: owned as u32 })?;
        let (first, count) = (level.first_part, level.part_count);
        let rest = skeleton.parts.len() - expected as usize;
        let follow = first == expected && count > 0 && count as usize <= rest;
        hold(place, follow, Rule::PartRange { first, count, expected })?;
        expected += count;
        let triangles = |part: &Part| u64::from(skeleton.blobs[part.blob as usize].triangles);
        let (said, found) = (level.triangles, skeleton.parts_of(level).iter().map(triangles).sum());
        hold(place, u64::from(said) == found, Rule::Triangles { said, found })?;
        let edge = level.longest_edge;
        hold(place, edge.is_finite() && edge >= 0.0, Rule::LongestEdge { edge })?;
        let error = level.error;
        hold(place, error.is_finite() && error >= 0.0, Rule::Error { error })?;
    }
    hold(Place::Part(expected), expected as usize == skeleton.parts.len(), Rule::StrayPart)
}

/// Monotone errors (paper 004, section 2.1), through hlods without levels of their own too.
fn check_errors(skeleton: &Skeleton) -> Result<(), Violation> {
    let mut greatest = vec![0.0f64; skeleton.hlods.len()];
    for (i, hlod) in skeleton.hlods.iter().enumerate().rev() {
        // Children come later in the table, so theirs is known.
        for level in hlod.first_level..hlod.first_level + hlod.level_count {
            let (error, finer) = (skeleton.levels[level as usize].error, greatest[i]);
            hold(Place::Level(level), error >= finer, Rule::NotMonotone { error, finer })?;
            greatest[i] = error;
        }
        if hlod.parent != NONE {
            let parent = hlod.parent as usize;
            greatest[parent] = greatest[parent].max(greatest[i]);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
