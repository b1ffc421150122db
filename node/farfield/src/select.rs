//! Which cubes of a cell are drawn (paper 000, sections 4.3.1 and 4.3.2).

use glam::DVec3;

/// A cube to choose from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Its sample's viewpoint.
    pub eye: DVec3,
    /// The cube of the same list that it depends on.
    pub parent: Option<usize>,
    /// Triangles of its faces that lie in the frustum.
    pub triangles: u64,
}

/// How much may be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Cubes at most: the fidelity target.
    pub cubes: u32,
    /// Triangles at most, where a frame rate is to be kept. The first cube is drawn all the same.
    pub triangles: Option<u64>,
}

/// Cubes to draw.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Selected {
    /// By index, in the order they are added.
    pub cubes: Vec<usize>,
    /// The first so many are the nearest cube and those it depends on.
    pub path: usize,
}

/// Cubes are added in this order: the cube nearest to `eye`, after its ancestors from
/// the intra cube down; then the next nearest with those of its ancestors that are not there yet, until the
/// budget ends. A cube is never there without its ancestors. Of equally near cubes the first counts.
pub fn selected(cubes: &[Choice], eye: DVec3, budget: &Budget) -> Selected {
    let mut by_distance: Vec<usize> = (0..cubes.len()).collect();
    by_distance.sort_by(|&a, &b| {
        let distance = |at: usize| cubes[at].eye.distance_squared(eye);
        distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
    });
    let mut added = Vec::new();
    let (mut triangles, mut first_path) = (0, None);
    for nearest in by_distance {
        let mut path: Vec<usize> =
            std::iter::successors(Some(nearest), |&at| cubes[at].parent).collect();
        while let Some(next) = path.pop() {
            if added.contains(&next) {
                continue;
            }
            triangles += cubes[next].triangles;
            let too_many = budget.triangles.is_some_and(|most| triangles > most);
            if added.len() as u32 >= budget.cubes || (too_many && !added.is_empty()) {
                let path = first_path.unwrap_or(added.len());
                return Selected { cubes: added, path };
            }
            added.push(next);
        }
        first_path = first_path.or(Some(added.len()));
    }
    Selected { path: first_path.unwrap_or(0), cubes: added }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Intra 0 at 0; 1 at 2 on it, 2 at 4 on 1, 3 at -3 on 0.
    fn cubes() -> Vec<Choice> {
        let cube = |x: f64, parent| Choice { eye: DVec3::new(x, 0.0, 0.0), parent, triangles: 10 };
        vec![cube(0.0, None), cube(2.0, Some(0)), cube(4.0, Some(1)), cube(-3.0, Some(0))]
    }

    fn select(x: f64, cubes_at_most: u32, triangles: Option<u64>) -> Vec<usize> {
        let budget = Budget { cubes: cubes_at_most, triangles };
        selected(&cubes(), DVec3::new(x, 0.0, 0.0), &budget).cubes
    }

    #[test]
    fn the_first_path_is_told_apart() {
        let path = |x: f64, cubes_at_most| {
            let budget = Budget { cubes: cubes_at_most, triangles: None };
            selected(&cubes(), DVec3::new(x, 0.0, 0.0), &budget).path
        };
        assert_eq!(
            [(5.0, 9), (5.0, 3), (5.0, 2), (-3.0, 9), (0.0, 9)].map(|(x, k)| path(x, k)),
            [3, 3, 2, 2, 1]
        );
        assert_eq!(
            selected(&[], DVec3::ZERO, &Budget { cubes: 3, triangles: None }),
            Selected::default()
        );
    }

    #[test]
    fn of_nothing_nothing_is_drawn() {
        assert!(select(0.0, 0, None).is_empty());
    }

    #[test]
    fn ancestors_come_first_and_a_short_budget_cuts_the_path() {
        assert_eq!(select(5.0, 9, None), [0, 1, 2, 3]);
        assert_eq!(select(5.0, 2, None), [0, 1]);
        assert_eq!(select(5.0, 1, None), [0]);
        assert_eq!(select(-3.0, 2, None), [0, 3]);
        assert_eq!(select(-3.0, 3, None), [0, 3, 1]);
    }

    #[test]
    fn triangles_end_the_list_but_one_cube_is_always_drawn() {
        assert_eq!(select(5.0, 9, Some(25)), [0, 1]);
        assert_eq!(select(5.0, 9, Some(30)), [0, 1, 2]);
        assert_eq!(select(5.0, 9, Some(3)), [0]);
    }

    #[test]
    fn more_budget_only_adds() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(1);
        for _ in 0..200 {
            let count = rng.random_range(1..12);
            let all: Vec<Choice> = (0..count)
                .map(|at| Choice {
                    eye: DVec3::new(rng.random_range(0.0..9.0), rng.random_range(0.0..9.0), 0.0),
                    parent: (at > 0).then(|| rng.random_range(0..at)),
                    triangles: rng.random_range(0..50),
                })
                .collect();
            let eye = DVec3::new(rng.random_range(0.0..9.0), 4.0, 0.0);
            let of = |cubes| selected(&all, eye, &Budget { cubes, triangles: None }).cubes;
            for cubes in 0..=count as u32 {
                let found = of(cubes);
                assert_eq!(found.len(), cubes as usize);
                assert_eq!(found[..], of(count as u32)[..cubes as usize]);
                for (place, cube) in found.iter().enumerate() {
                    assert!(all[*cube].parent.is_none_or(|up| found[..place].contains(&up)));
                }
            }
        }
    }
}
