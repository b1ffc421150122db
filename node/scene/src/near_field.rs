//! The near field of a view cell: the leaves that reach into it (paper 000, section 3.1.1). All other
//! leaves are its far field.

use protocol::format::Skeleton;
#[cfg(doc)]
use protocol::format::ViewCell;
use protocol::id::HlodId;

/// How an hlod stands to a near field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// It is one of its leaves.
    Leaf,
    /// Some of its leaves lie below.
    Below,
    /// It has nothing of it.
    None,
}

/// Leaves whose boxes meet a box.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NearField {
    leaves: Vec<HlodId>,
    /// By hlod.
    reach: Vec<Reach>,
}

impl NearField {
    /// Of the box between two corners, scene units. Leaves that touch it belong to it.
    pub fn new(skeleton: &Skeleton, min: [f64; 3], max: [f64; 3]) -> Self {
        let mut reach = vec![Reach::None; skeleton.hlods.len()];
        let mut leaves = Vec::new();
        // Parents come first; one whose box does not meet the cell has no child whose does.
        for (at, hlod) in skeleton.hlods.iter().enumerate() {
            let meets = (0..3).all(|k| hlod.min[k] <= max[k] && min[k] <= hlod.max[k]);
            if meets && hlod.child_count == 0 {
                leaves.push(HlodId(at as u32));
                reach[at] = Reach::Leaf;
                for up in skeleton.ancestors(HlodId(at as u32)) {
                    reach[up.index()] = Reach::Below;
                }
            }
        }
        Self { leaves, reach }
    }

    /// Its leaves, sorted.
    pub fn leaves(&self) -> &[HlodId] {
        &self.leaves
    }

    /// How an hlod stands to it.
    pub fn reach_of(&self, hlod: HlodId) -> Reach {
        self.reach[hlod.index()]
    }

    /// Triangles of the source in it.
    pub fn triangles(&self, skeleton: &Skeleton) -> u64 {
        self.leaves.iter().map(|leaf| skeleton.hlod(*leaf).source_triangles).sum()
    }
}

/// The corners of the box of a cell with its margin ([`ViewCell::margin`]): what its near field reaches into.
pub fn with_margin(min: [f64; 3], max: [f64; 3], margin: f32) -> [[f64; 3]; 2] {
    if margin == 0.0 {
        return [min, max];
    }
    let band: [f64; 3] = std::array::from_fn(|k| f64::from(margin) * (max[k] - min[k]));
    [std::array::from_fn(|k| min[k] - band[k]), std::array::from_fn(|k| max[k] + band[k])]
}
