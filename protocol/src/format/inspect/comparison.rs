//! The criteria of paper 004, section 2.1.1, of the scene's tree beside those of a plain one.

use crate::format::{Criteria, SceneInfo};
use serde::Serialize;

/// The criteria of both trees. What they mean, `geometry::criteria` says, which measures them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Comparison {
    /// Leaves.
    pub leaves: Pair,
    /// Depth of the deepest leaf, the root at 0.
    pub depth_max: Pair,
    /// Mean depth of the leaves.
    pub depth_mean: Pair,
    /// Depth of a full tree with as many leaves.
    pub ideal_depth: Pair,
    /// Volume that siblings share over their parent's volume, mean.
    pub overlap: Pair,
    /// Boxes around a triangle that a random line through the scene meets, the root's among them.
    pub localisation: Pair,
    /// Triangles of a leaf that a tenth of the leaves do not exceed.
    pub size_p10: Pair,
    /// Triangles of a leaf, median.
    pub size_p50: Pair,
    /// Triangles of a leaf that nine tenths of the leaves do not exceed.
    pub size_p90: Pair,
}

/// One criterion of both trees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pair {
    /// Of the scene's own tree.
    pub tree: f64,
    /// Of a bottom-up hierarchy over the objects as they come.
    pub plain: f64,
    /// The first over the second; none where that is 0.
    pub ratio: Option<f64>,
}

impl Comparison {
    /// None where the bake measured nothing.
    pub(super) fn of(info: &SceneInfo) -> Option<Self> {
        let (tree, plain) = (info.tree, info.plain);
        if tree.leaves == 0 || plain.leaves == 0 {
            return None;
        }
        let pair = |of: fn(&Criteria) -> f64| {
            let (tree, plain) = (of(&tree), of(&plain));
            Pair { tree, plain, ratio: (plain != 0.0).then(|| tree / plain) }
        };
        Some(Self {
            leaves: pair(|c| c.leaves as f64),
            depth_max: pair(|c| f64::from(c.depth_max)),
            depth_mean: pair(|c| c.depth_mean),
            ideal_depth: pair(|c| c.ideal_depth),
            overlap: pair(|c| c.overlap),
            localisation: pair(|c| c.localisation),
            size_p10: pair(|c| f64::from(c.size_p10)),
            size_p50: pair(|c| f64::from(c.size_p50)),
            size_p90: pair(|c| f64::from(c.size_p90)),
        })
    }
}

impl std::fmt::Display for Comparison {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "criteria                    tree        plain    ratio")?;
        for (name, digits, pair) in [
            ("leaves", 0, self.leaves),
            ("depth, greatest", 0, self.depth_max),
            ("depth, mean", 2, self.depth_mean),
            ("depth, ideal", 0, self.ideal_depth),
            ("sibling overlap", 4, self.overlap),
            ("localisation", 3, self.localisation),
            ("leaf triangles, 10%", 0, self.size_p10),
            ("leaf triangles, 50%", 0, self.size_p50),
            ("leaf triangles, 90%", 0, self.size_p90),
        ] {
            let Pair { tree, plain, ratio } = pair;
            let ratio = ratio.map_or("-".to_owned(), |ratio| format!("{ratio:.3}"));
            writeln!(f, "{name:19} {tree:12.digits$} {plain:12.digits$} {ratio:>8}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_said_of_trees_that_were_not_measured() {
        let one = Criteria { leaves: 1, ..Criteria::default() };
        assert_eq!(Comparison::of(&SceneInfo::default()), None);
        assert_eq!(Comparison::of(&SceneInfo { tree: one, ..SceneInfo::default() }), None);
        assert_eq!(Comparison::of(&SceneInfo { plain: one, ..SceneInfo::default() }), None);
    }

    #[test]
    fn both_trees_stand_side_by_side() {
        let tree = Criteria { leaves: 100, overlap: 0.05, size_p90: 7, ..Criteria::default() };
        let plain = Criteria { leaves: 400, size_p90: 2, ..Criteria::default() };
        let compared = Comparison::of(&SceneInfo { tree, plain, ..SceneInfo::default() });
        let compared = compared.expect("measured");
        assert_eq!(compared.leaves, Pair { tree: 100.0, plain: 400.0, ratio: Some(0.25) });
        assert_eq!(compared.overlap, Pair { tree: 0.05, plain: 0.0, ratio: None });
        assert_eq!(compared.size_p90.ratio, Some(3.5));
        let text = compared.to_string();
        assert_eq!(text.lines().count(), 10);
        assert!(
            text.contains("leaves                       100          400    0.250\n"),
            "{text}"
        );
        assert!(
            text.contains("sibling overlap           0.0500       0.0000        -\n"),
            "{text}"
        );
    }
}
