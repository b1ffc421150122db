//! The near field of a view cell: the leaves that reach into it (paper 000, section 3.1.1). All other
//! leaves are its far field.

use crate::front::Field;
use protocol::format::{Skeleton, ViewCell};
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
    /// The near field of the cell between two corners, scene units. Boxes that touch it belong to it.
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

/// The view cells that have a far field of some method, with their near fields.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cells(Vec<(usize, ViewCell, NearField)>);

impl Cells {
    /// Those of `skeleton` whose far field is of the method of this number.
    pub fn new(skeleton: &Skeleton, method: u32) -> Self {
        let cells = skeleton.view_cells.iter().enumerate();
        let wanted = cells.filter(|(_, cell)| cell.method == method);
        let with_near =
            wanted.map(|(at, cell)| (at, *cell, NearField::new(skeleton, cell.min, cell.max)));
        Self(with_near.collect())
    }

    /// Index into [`Skeleton::view_cells`] of the one that holds `eye`. Its lower sides belong to it, its
    /// upper ones to its neighbours.
    pub fn at(&self, eye: [f64; 3]) -> Option<usize> {
        self.holding(eye).map(|(at, ..)| *at)
    }

    /// What is drawn as geometry from `eye`.
    pub fn field_at(&self, eye: [f64; 3]) -> Field<'_> {
        self.holding(eye).map_or(Field::Whole, |(.., near)| Field::Near(near))
    }

    fn holding(&self, eye: [f64; 3]) -> Option<&(usize, ViewCell, NearField)> {
        let holds = |cell: &ViewCell| (0..3).all(|k| cell.min[k] <= eye[k] && eye[k] < cell.max[k]);
        self.0.iter().find(|(_, cell, _)| holds(cell))
    }
}
