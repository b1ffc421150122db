//! Which corners make the triangles of a primitive, by its mode (glTF 2.0, section 3.7.2.1).

/// How corners follow each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Topology {
    /// Three corners each.
    List,
    /// Each corner makes a triangle with the two before it.
    Strip,
    /// Each corner makes a triangle with the one before it and the first.
    Fan,
}

impl Topology {
    /// Of the mode of a primitive that makes triangles.
    pub(super) fn of(mode: u64) -> Option<Self> {
        match mode {
            4 => Some(Self::List),
            5 => Some(Self::Strip),
            6 => Some(Self::Fan),
            _ => None,
        }
    }

    /// Triangles that `corners` corners make; a remainder too short for one makes none.
    pub(super) fn triangles(self, corners: usize) -> usize {
        match self {
            Self::List => corners / 3,
            Self::Strip | Self::Fan => corners.saturating_sub(2),
        }
    }

    /// The corners of triangle `t`, counter-clockwise as the format defines it.
    pub(super) fn corners(self, t: usize) -> [usize; 3] {
        match self {
            Self::List => [3 * t, 3 * t + 1, 3 * t + 2],
            Self::Strip => [t, t + 1 + t % 2, t + 2 - t % 2],
            Self::Fan => [t + 1, t + 2, 0],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_corners_make_no_triangle() {
        for topology in [Topology::List, Topology::Strip, Topology::Fan] {
            assert_eq!(
                [0, 1, 2].map(|corners| topology.triangles(corners)),
                [0; 3],
                "{topology:?}"
            );
            assert_eq!(topology.triangles(3), 1);
        }
        assert_eq!(Topology::List.triangles(5), 1);
    }

    #[test]
    fn windings_agree_across_a_strip_and_a_fan() {
        // A unit square as a strip (0 1 2 3 zig-zag) and as a fan: every triangle turns the same way.
        let area = |points: [[i32; 2]; 4], topology: Topology| -> Vec<i32> {
            (0..topology.triangles(4))
                .map(|t| {
                    let [a, b, c] = topology.corners(t).map(|corner| points[corner]);
                    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
                })
                .collect()
        };
        assert_eq!(area([[0, 0], [1, 0], [0, 1], [1, 1]], Topology::Strip), [1, 1]);
        assert_eq!(area([[0, 0], [1, 0], [1, 1], [0, 1]], Topology::Fan), [1, 1]);
    }
}
