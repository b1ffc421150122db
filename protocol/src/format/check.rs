//! Every promise the types of the skeleton make, checked.
//!
//! What passes can be walked without bounds in mind: indices lie in range, the tree is a tree of
//! limited depth, and errors grow towards the root.

use super::mesh::mesh_bytes;
use super::vertex::MAX_BLOB_VERTICES;
use super::{ALIGNMENT, Hlod, NONE, Skeleton};
use crate::id::{BlobId, HlodId};

/// Most hlods on a path from the root to a leaf, both counted: a fixed stack suffices to walk a tree.
pub const MAX_DEPTH: u32 = 64;

/// Where a rule is broken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// The scene's facts.
    Info,
    /// A hlod.
    Hlod(HlodId),
    /// A level, index into [`Skeleton::levels`].
    Level(u32),
    /// A blob.
    Blob(BlobId),
    /// A placement, index into [`Skeleton::transforms`].
    Transform(u32),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Info => f.write_str("the scene's facts"),
            Self::Hlod(id) => write!(f, "hlod {id}"),
            Self::Level(index) => write!(f, "level {index}"),
            Self::Blob(id) => write!(f, "blob {id}"),
            Self::Transform(index) => write!(f, "transform {index}"),
        }
    }
}

/// The rule that is broken.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Rule {
    /// There is a root.
    #[error("there are no hlods")]
    NoHlods,
    /// Spare fields are zero.
    #[error("a reserved field is not zero")]
    Reserved,
    /// No NaN, no infinity.
    #[error("a number is not finite")]
    NotFinite,
    /// Up is a direction.
    #[error("the up direction has no length")]
    NoUp,
    /// Parents come before children and list them.
    #[error("parent {parent} does not come before it or does not list it")]
    Parent {
        /// What the hlod names.
        parent: u32,
    },
    /// Children come after their parent, in range.
    #[error("its children {first}..+{count} do not follow it in the table")]
    Children {
        /// First child.
        first: u32,
        /// How many.
        count: u32,
    },
    /// Not deeper than [`MAX_DEPTH`].
    #[error("it lies deeper than {MAX_DEPTH} hlods")]
    Depth,
    /// Boxes hold something.
    #[error("the least corner of its box exceeds the greatest")]
    EmptyBox,
    /// Boxes hold their children's.
    #[error("its box leaves that of its parent")]
    OutsideParent,
    /// Levels in range.
    #[error("its levels {first}..+{count} are not in the table")]
    LevelRange {
        /// First level.
        first: u32,
        /// How many.
        count: u32,
    },
    /// Every level belongs to exactly one hlod.
    #[error("it belongs to {owners} hlods")]
    Owners {
        /// How many.
        owners: u32,
    },
    /// Leaves can be drawn.
    #[error("it is a leaf without a level")]
    BareLeaf,
    /// Objects in range.
    #[error("object {object} is none of the source's")]
    Object {
        /// What the hlod names.
        object: u32,
    },
    /// Source triangles add up.
    #[error("it counts {said} source triangles, its parts {sum}")]
    SourceTriangles {
        /// The count.
        said: u64,
        /// The sum.
        sum: u64,
    },
    /// Errors are distances.
    #[error("its error {error} is no distance")]
    Error {
        /// The error.
        error: f64,
    },
    /// Errors grow towards coarser levels and towards the root.
    #[error("its error {error} is smaller than {finer} of what it stands for")]
    NotMonotone {
        /// The error.
        error: f64,
        /// The greater error of something finer.
        finer: f64,
    },
    /// Blobs in range.
    #[error("blob {blob} is not in the table")]
    NoBlob {
        /// What the level names.
        blob: u32,
    },
    /// Placements in range.
    #[error("transform {transform} is not in the table")]
    NoTransform {
        /// What the level names.
        transform: u32,
    },
    /// Levels know their mesh.
    #[error("it counts {said} triangles, its mesh {found}")]
    Triangles {
        /// The level's count.
        said: u32,
        /// The blob's count.
        found: u32,
    },
    /// Grid steps are powers of two.
    #[error("its step {step} is no power of two")]
    Step {
        /// The step.
        step: f64,
    },
    /// Meshes have triangles, and 16 bits reach every vertex.
    #[error("{vertices} vertices and {triangles} triangles are no mesh of {bytes} bytes")]
    MeshSize {
        /// Vertices.
        vertices: u32,
        /// Triangles.
        triangles: u32,
        /// Bytes.
        bytes: u64,
    },
    /// Blobs lie one after the other, each at the next multiple of 64.
    #[error("it starts at {offset} instead of {expected}")]
    Offset {
        /// Where it starts.
        offset: u64,
        /// Where it should.
        expected: u64,
    },
}

/// A broken rule and where.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{place}: {rule}")]
pub struct Violation {
    /// Where.
    pub place: Place,
    /// What.
    pub rule: Rule,
}

/// Checks the whole skeleton and reports the first broken rule.
pub fn check(skeleton: &Skeleton) -> Result<(), Violation> {
    check_info(skeleton)?;
    check_tree(&skeleton.hlods)?;
    check_hlods(skeleton)?;
    check_blobs(skeleton)?;
    for (i, transform) in skeleton.transforms.iter().enumerate() {
        let numbers = transform.linear.as_flattened().iter().chain(&transform.translation);
        hold(Place::Transform(i as u32), numbers.copied().all(f64::is_finite), Rule::NotFinite)?;
    }
    check_levels(skeleton)?;
    check_errors(skeleton)
}

/// An error unless `kept`.
fn hold(place: Place, kept: bool, rule: Rule) -> Result<(), Violation> {
    if kept { Ok(()) } else { Err(Violation { place, rule }) }
}

fn check_info(skeleton: &Skeleton) -> Result<(), Violation> {
    let info = &skeleton.info;
    hold(Place::Info, info.reserved == 0 && info.reserved2 == 0, Rule::Reserved)?;
    hold(Place::Info, info.up.iter().all(|c| c.is_finite()), Rule::NotFinite)?;
    hold(Place::Info, info.up.iter().any(|&c| c != 0.0), Rule::NoUp)?;
    let Some(root) = skeleton.hlods.first() else {
        return Err(Violation { place: Place::Info, rule: Rule::NoHlods });
    };
    let (said, sum) = (info.source_triangles, root.source_triangles);
    hold(Place::Info, said == sum, Rule::SourceTriangles { said, sum })
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
        hold(place, corners.as_flattened().iter().all(|c| c.is_finite()), Rule::NotFinite)?;
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

fn check_blobs(skeleton: &Skeleton) -> Result<(), Violation> {
    let mut expected = 0u64;
    for (i, blob) in skeleton.blobs.iter().enumerate() {
        let place = Place::Blob(BlobId(i as u32));
        let (vertices, triangles, bytes) = (blob.vertices, blob.triangles, blob.bytes);
        let is_mesh = vertices > 0
            && triangles > 0
            && vertices as usize <= MAX_BLOB_VERTICES
            && bytes == mesh_bytes(vertices, triangles);
        hold(place, is_mesh, Rule::MeshSize { vertices, triangles, bytes })?;
        let offset = blob.offset;
        hold(place, offset == expected, Rule::Offset { offset, expected })?;
        // No file is that long; the offset that does not fit is the broken rule.
        let end = offset.checked_add(bytes).and_then(|e| e.checked_next_multiple_of(ALIGNMENT));
        expected = end.ok_or(Violation { place, rule: Rule::Offset { offset, expected } })?;
        hold(place, is_power_of_two(blob.step), Rule::Step { step: blob.step })?;
        hold(place, blob.origin.iter().all(|c| c.is_finite()), Rule::NotFinite)?;
        hold(place, blob.reserved == 0, Rule::Reserved)?;
    }
    Ok(())
}

/// Positive, normal, and without a fraction bit.
pub(super) fn is_power_of_two(x: f64) -> bool {
    let fraction = x.to_bits() & ((1 << (f64::MANTISSA_DIGITS - 1)) - 1);
    x.is_normal() && x > 0.0 && fraction == 0
}

fn check_levels(skeleton: &Skeleton) -> Result<(), Violation> {
    // Differences of a running count: a hostile file may list all levels under every hlod.
    let mut owners = vec![0i64; skeleton.levels.len() + 1];
    for hlod in &skeleton.hlods {
        owners[hlod.first_level as usize] += 1;
        owners[hlod.first_level as usize + hlod.level_count as usize] -= 1;
    }
    let mut owned = 0;
    for (i, level) in skeleton.levels.iter().enumerate() {
        let place = Place::Level(i as u32);
        owned += owners[i];
        hold(place, owned == 1, Rule::Owners { owners: owned as u32 })?;
        let (blob, transform) = (level.blob, level.transform);
        let Some(mesh) = skeleton.blobs.get(blob as usize) else {
            return Err(Violation { place, rule: Rule::NoBlob { blob } });
        };
        let (said, found) = (level.triangles, mesh.triangles);
        hold(place, said == found, Rule::Triangles { said, found })?;
        let placed = transform == NONE || (transform as usize) < skeleton.transforms.len();
        hold(place, placed, Rule::NoTransform { transform })?;
        hold(place, level.reserved == 0, Rule::Reserved)?;
        let error = level.error;
        hold(place, error.is_finite() && error >= 0.0, Rule::Error { error })?;
    }
    Ok(())
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
