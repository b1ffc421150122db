//! How the triangles of a blob are drawn; they lie sorted by it.

/// What a triangle does to what lies behind it, and from which sides it is seen.
///
/// A single-sided triangle is seen where its corners turn counter-clockwise, in mesh space; under a
/// placement that mirrors, where they turn clockwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Class {
    /// Hides all of it; seen from the front.
    OpaqueSingle,
    /// Hides all of it; seen from both sides.
    OpaqueDouble,
    /// Has holes where its alpha lies below the cutoff; seen from the front.
    MaskSingle,
    /// Has holes; seen from both sides.
    MaskDouble,
    /// Mixes with it by its alpha; seen from the front.
    BlendSingle,
    /// Mixes with it; seen from both sides.
    BlendDouble,
}

impl Class {
    /// How many there are.
    pub const COUNT: usize = 6;
    /// All, in the order in which triangles lie.
    pub const ALL: [Self; Self::COUNT] = [
        Self::OpaqueSingle,
        Self::OpaqueDouble,
        Self::MaskSingle,
        Self::MaskDouble,
        Self::BlendSingle,
        Self::BlendDouble,
    ];

    /// It hides all that lies behind it.
    pub fn is_opaque(self) -> bool {
        matches!(self, Self::OpaqueSingle | Self::OpaqueDouble)
    }

    /// It has holes.
    pub fn is_mask(self) -> bool {
        matches!(self, Self::MaskSingle | Self::MaskDouble)
    }

    /// It mixes with what lies behind it.
    pub fn is_blend(self) -> bool {
        matches!(self, Self::BlendSingle | Self::BlendDouble)
    }

    /// It is seen from the front alone.
    pub fn is_single_sided(self) -> bool {
        matches!(self, Self::OpaqueSingle | Self::MaskSingle | Self::BlendSingle)
    }

    /// The counts of a blob whose triangles are all of this class.
    pub fn all(self, triangles: u32) -> [u32; Self::COUNT] {
        let mut classes = [0; Self::COUNT];
        classes[self as usize] = triangles;
        classes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::Blob;
    use bytemuck::Zeroable;

    #[test]
    fn triangles_lie_class_after_class() {
        let blob = Blob { classes: [2, 0, 3, 1, 0, 4], ..Blob::zeroed() };
        let ranges = Class::ALL.map(|class| blob.triangles_of(class));
        assert_eq!(ranges, [0..2, 2..2, 2..5, 5..6, 6..6, 6..10]);
        assert!(blob.has(Class::MaskDouble) && !blob.has(Class::OpaqueDouble));
        assert!(
            Class::ALL.map(|class| Blob::zeroed().triangles_of(class)).iter().all(|r| r.is_empty())
        );
    }

    #[test]
    fn every_class_is_of_one_kind() {
        for (at, class) in Class::ALL.into_iter().enumerate() {
            assert_eq!(class as usize, at);
            assert_eq!(class.is_single_sided(), at % 2 == 0);
            let kinds = [class.is_opaque(), class.is_mask(), class.is_blend()];
            assert_eq!(kinds.iter().position(|&kind| kind), Some(at / 2));
            assert_eq!(class.all(7)[at], 7);
        }
    }
}
