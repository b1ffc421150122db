//! Which triangles of a surface meet in a place.

/// In place of a number: there is none.
pub(super) const NONE: u32 = u32::MAX;
/// Most triangles of a place that are looked at: a cap of a cylinder may have hundreds.
const MOST: usize = 16;

/// For each place the triangles that have a corner there.
#[derive(Debug, Clone, Default)]
pub(super) struct Fans {
    /// By triangle, the places of its corners.
    corners: Vec<[u32; 3]>,
    /// By place, the last corner there, three a triangle.
    last: Vec<u32>,
    /// By corner, the one before in the same place.
    before: Vec<[u32; 3]>,
}

impl Fans {
    /// From the places of each triangle's corners.
    pub(super) fn new(corners: Vec<[u32; 3]>) -> Self {
        let count = corners.as_flattened().iter().max().map_or(0, |&most| most as usize + 1);
        let mut last = vec![NONE; count];
        let before = std::iter::zip(&corners, 0..).map(|(places, triangle)| {
            std::array::from_fn(|k| {
                std::mem::replace(&mut last[places[k] as usize], 3 * triangle + k as u32)
            })
        });
        let before = before.collect();
        Self { corners, last, before }
    }

    /// Bytes it takes in memory.
    pub(super) fn bytes(&self) -> usize {
        (self.corners.capacity() + self.before.capacity()) * size_of::<[u32; 3]>()
            + self.last.capacity() * size_of::<u32>()
    }

    /// A triangle with a corner in `place`, or [`NONE`].
    pub(super) fn any(&self, place: u32) -> u32 {
        self.last
            .get(place as usize)
            .map_or(NONE, |&corner| if corner == NONE { NONE } else { corner / 3 })
    }

    /// The last triangles with corners in `place` and in one of `others`, and those.
    pub(super) fn sharing(&self, place: u32, others: [u32; 2]) -> impl Iterator<Item = u32> + '_ {
        let at = |corner: &u32| self.before.as_flattened().get(*corner as usize).copied();
        let first = self.last.get(place as usize).copied();
        std::iter::successors(first, at)
            .take(MOST)
            .take_while(|&corner| corner != NONE)
            .map(|corner| corner / 3)
            .filter(move |&t| self.corners[t as usize].iter().any(|place| others.contains(place)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_meets_nowhere() {
        let none = Fans::default();
        assert_eq!(none.any(0), NONE);
        assert_eq!(none.sharing(3, [1, 2]).count(), 0);
    }

    #[test]
    fn sides_are_found_from_either_end() {
        let fans = Fans::new(vec![[0, 1, 2], [2, 1, 5], [5, 6, 2]]);
        assert_eq!([fans.any(0), fans.any(6), fans.any(3), fans.any(99)], [0, 2, NONE, NONE]);
        assert_eq!(fans.sharing(1, [2, 2]).collect::<Vec<_>>(), [1, 0]);
        assert_eq!(fans.sharing(2, [1, 1]).collect::<Vec<_>>(), [1, 0]);
        assert_eq!(fans.sharing(2, [0, 6]).collect::<Vec<_>>(), [2, 0]);
        assert_eq!(fans.sharing(4, [0, 6]).count(), 0);
    }

    #[test]
    fn of_many_triangles_some_are_looked_at() {
        let fans = Fans::new((1..100).map(|i| [0, i, i + 1]).collect());
        assert_eq!(fans.sharing(0, [99, 99]).count(), 2);
        assert_eq!(fans.sharing(0, [1, 1]).count(), 0);
    }
}
