//! The dependency tree of a group of samples (paper 000, section 4.1.1).

use glam::DVec3;

/// Which sample each sample's cube depends on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DependencyTree {
    /// Samples, each after the one it depends on; the intra sample first.
    pub order: Vec<usize>,
    /// By sample, the one it depends on; none for the intra sample.
    pub parents: Vec<Option<usize>>,
}

impl DependencyTree {
    /// The intra sample is the one nearest to the centroid of all; the others hang on it by a minimum
    /// spanning tree under the cube of the distance, which prefers many short steps to few long ones.
    /// Of equals the first counts.
    pub fn new(eyes: &[DVec3]) -> Self {
        let mut tree = Self { order: Vec::new(), parents: vec![None; eyes.len()] };
        let centroid = eyes.iter().sum::<DVec3>() / eyes.len().max(1) as f64;
        let from_centroid = |&at: &usize| eyes[at].distance_squared(centroid);
        let nearest = (0..eyes.len()).min_by(|a, b| from_centroid(a).total_cmp(&from_centroid(b)));
        let Some(intra) = nearest else { return tree };
        let weight = |a: usize, b: usize| eyes[a].distance(eyes[b]).powi(3);
        tree.order.push(intra);
        // By sample, the nearest in the tree (Prim's algorithm).
        let mut outside: Vec<(usize, usize)> =
            (0..eyes.len()).filter(|&at| at != intra).map(|at| (at, intra)).collect();
        loop {
            let lightest = (0..outside.len()).min_by(|&a, &b| {
                weight(outside[a].0, outside[a].1).total_cmp(&weight(outside[b].0, outside[b].1))
            });
            let Some(lightest) = lightest else { return tree };
            let (next, parent) = outside.remove(lightest);
            tree.parents[next] = Some(parent);
            tree.order.push(next);
            for (at, nearest) in &mut outside {
                if weight(*at, next) < weight(*at, *nearest) {
                    *nearest = next;
                }
            }
        }
    }

    /// Those a sample depends on, the nearest first, the intra sample last.
    pub fn ancestors(&self, sample: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(self.parents[sample], |&at| self.parents[at])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> DVec3 {
        DVec3::new(x, y, 1.0)
    }

    #[test]
    fn of_nothing_comes_nothing_and_one_is_intra() {
        let none = DependencyTree::new(&[]);
        assert!(none.order.is_empty() && none.parents.is_empty());
        assert_eq!(DependencyTree::new(&[at(3.0, 1.0)]).parents, [None]);
    }

    #[test]
    fn the_intra_sample_lies_in_the_middle_and_short_steps_are_preferred() {
        // A row: a plain star around the middle would be as short by distance, not by its cube.
        let eyes = [at(0.0, 0.0), at(4.0, 0.0), at(1.0, 0.0), at(2.0, 0.0), at(3.0, 0.0)];
        let tree = DependencyTree::new(&eyes);
        assert_eq!(tree.parents, [Some(2), Some(4), Some(3), None, Some(3)]);
        assert_eq!(tree.order[0], 3);
        assert_eq!(tree.ancestors(0).collect::<Vec<_>>(), [2, 3]);
    }

    #[test]
    fn no_other_tree_is_lighter() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(1);
        for _ in 0..30 {
            let eyes: Vec<DVec3> = (0..5)
                .map(|_| at(rng.random_range(0.0..9.0), rng.random_range(0.0..9.0)))
                .collect();
            let tree = DependencyTree::new(&eyes);
            let weight = |parents: &[Option<usize>]| -> f64 {
                let edges = parents.iter().enumerate().filter_map(|(a, b)| Some((a, (*b)?)));
                edges.map(|(a, b)| eyes[a].distance(eyes[b]).powi(3)).sum()
            };
            let intra = tree.order[0];
            // All assignments of parents that lead to the root.
            for code in 0..5usize.pow(5) {
                let mut parents: Vec<Option<usize>> =
                    (0..5).map(|at| Some(code / 5usize.pow(at) % 5)).collect();
                parents[intra] = None;
                let leads = |mut at: usize| {
                    (0..5).any(|_| match parents[at] {
                        None => true,
                        Some(up) => {
                            at = up;
                            false
                        }
                    })
                };
                if (0..5).all(leads) {
                    assert!(weight(&tree.parents) <= weight(&parents) + 1e-9);
                }
            }
            for (place, sample) in tree.order.iter().enumerate().skip(1) {
                let parent = tree.parents[*sample].unwrap();
                assert!(tree.order[..place].contains(&parent));
            }
        }
    }

    #[test]
    fn coincident_samples_are_a_tree_all_the_same() {
        let tree = DependencyTree::new(&[at(1.0, 1.0); 4]);
        assert_eq!(tree.parents, [None, Some(0), Some(0), Some(0)]);
    }
}
