//! View cells at run time: what the picture for an eye is put together of (paper 000, sections 3.1.1 and 5.4.2).

use crate::front::Field;
use crate::near_field::{NearField, Reach, with_margin};
use protocol::format::{Skeleton, ViewCell};
use protocol::id::HlodId;

/// Sum of the weights of the compositions of a picture.
pub const WHOLE: u32 = 1 << 16;
/// Compositions of a picture at most: as many cells as meet in a corner.
const MOST: usize = 8;

/// One way to put together what an eye sees. Where cells meet there are several, and the picture is a mix of theirs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Composition<'a> {
    /// Index into [`Skeleton::view_cells`] of the one whose far field is drawn, and its near field, which alone is
    /// drawn as geometry; none where all is.
    pub cell: Option<(usize, &'a NearField)>,
    /// Its part of [`WHOLE`], never 0.
    pub weight: u32,
}

impl Composition<'_> {
    /// Whether an hlod of the front of [`Cells::field_at`] is drawn in this one.
    pub fn has(&self, hlod: HlodId) -> bool {
        self.cell.is_none_or(|(_, near)| near.reach_of(hlod) == Reach::Leaf)
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
        let with_near = wanted.map(|(at, cell)| {
            let [min, max] = with_margin(cell.min, cell.max, cell.margin);
            (at, *cell, NearField::new(skeleton, min, max))
        });
        Self(with_near.collect())
    }

    /// Index into [`Skeleton::view_cells`] of the one that holds `eye`. Its lower sides belong to it, its
    /// upper ones to its neighbours.
    pub fn at(&self, eye: [f64; 3]) -> Option<usize> {
        let holds = |cell: &ViewCell| (0..3).all(|k| cell.min[k] <= eye[k] && eye[k] < cell.max[k]);
        self.0.iter().find(|(_, cell, _)| holds(cell)).map(|(at, ..)| *at)
    }

    /// What the picture for `eye` is mixed of, the cell that holds it first; the whole scene as geometry outside of all
    /// cells. Inside, every weight changes continuously with the eye, across borders too.
    pub fn compositions(&self, eye: [f64; 3]) -> Vec<Composition<'_>> {
        let Some(home) = self.at(eye) else {
            return vec![Composition { cell: None, weight: WHOLE }];
        };
        let depths: Vec<f64> =
            self.0.iter().map(|(at, cell, _)| depth(cell, eye, *at == home)).collect();
        let sum: f64 = depths.iter().sum();
        // Rounded down; what is left over is the home's, which therefore has some in any case.
        let all = self.0.iter().zip(depths).map(|((at, _, near), depth)| Composition {
            cell: Some((*at, near)),
            weight: (depth / sum * f64::from(WHOLE)) as u32,
        });
        let (mut mixed, mut others): (Vec<_>, Vec<_>) =
            all.partition(|of| of.cell.is_some_and(|(at, _)| at == home));
        others.retain(|of| of.weight > 0);
        others.sort_by_key(|of| std::cmp::Reverse(of.weight));
        others.truncate(MOST - 1);
        mixed[0].weight = WHOLE - others.iter().map(|of| of.weight).sum::<u32>();
        mixed.append(&mut others);
        mixed
    }

    /// What is drawn as geometry in any of the compositions for `eye`.
    pub fn field_at(&self, eye: [f64; 3]) -> Field<'_> {
        let near = self.compositions(eye).into_iter().map(|of| of.cell.map(|(_, near)| near));
        let near: Option<Vec<_>> = near.collect();
        near.map_or(Field::Whole, Field::Near)
    }
}

/// How deep `eye` lies in a cell with its margin: 1 from where it is as far from all faces as the margin is wide, a half
/// on a face, 0 where the margin ends. Without one a cell is `home` or nothing.
fn depth(cell: &ViewCell, eye: [f64; 3], home: bool) -> f64 {
    if cell.margin == 0.0 {
        return f64::from(u8::from(home));
    }
    let of_axis = |k: usize| {
        let band = f64::from(cell.margin) * (cell.max[k] - cell.min[k]);
        let inwards = (eye[k] - cell.min[k]).min(cell.max[k] - eye[k]);
        (0.5 + 0.5 * inwards / band).clamp(0.0, 1.0)
    };
    (0..3).map(of_axis).product()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_scene::RandomScene;
    use protocol::format::Method;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    const METHOD: u32 = Method::Itdm as u32;

    fn cell(min: [f64; 3], max: [f64; 3], margin: f32) -> ViewCell {
        let method = METHOD;
        ViewCell { min, max, first_cube: 0, cube_count: 1, method, margin, objective: 0.0 }
    }

    /// The cube from -16 to 16, divided at random as an octree, some of whose cells have no far field.
    fn divided(seed: u64) -> (Skeleton, StdRng) {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut skeleton = RandomScene::new(seed, 3, 32.0).skeleton;
        let mut waiting = vec![([-16.0; 3], [16.0; 3])];
        while let Some((min, max)) = waiting.pop() {
            if max[0] - min[0] < 5.0 || (max[0] - min[0] < 20.0 && rng.random_bool(0.6)) {
                let method = if rng.random_bool(0.2) { 0 } else { METHOD };
                skeleton.view_cells.push(ViewCell { method, ..cell(min, max, 0.0625) });
                continue;
            }
            for octant in 0..8 {
                let (mut least, mut most) = (min, max);
                for k in 0..3 {
                    let middle = 0.5 * (min[k] + max[k]);
                    *(if octant >> k & 1 == 1 { &mut least[k] } else { &mut most[k] }) = middle;
                }
                waiting.push((least, most));
            }
        }
        (skeleton, rng)
    }

    /// By cell, its weight.
    fn weights(cells: &Cells, eye: [f64; 3], count: usize) -> Vec<i64> {
        let mut weights = vec![0; count];
        for of in cells.compositions(eye) {
            weights[of.cell.unwrap().0] = i64::from(of.weight);
        }
        weights
    }

    #[test]
    fn weights_are_a_whole_and_change_as_little_as_the_eye_does() {
        let mut mixed = [0; 5];
        for seed in 0..6 {
            let (skeleton, mut rng) = divided(seed);
            let cells = Cells::new(&skeleton, METHOD);
            for _ in 0..2000 {
                // Half of them beside a corner of a cell.
                let any = rng.random_range(0..skeleton.view_cells.len());
                let near = skeleton.view_cells[any].max;
                let at_corner = rng.random_bool(0.5);
                let eye: [f64; 3] = std::array::from_fn(|k| match at_corner {
                    true => near[k] + rng.random_range(-0.4..0.4),
                    false => rng.random_range(-16.0..16.0),
                });
                let of = cells.compositions(eye);
                assert_eq!(of.iter().map(|of| of.weight).sum::<u32>(), WHOLE);
                assert!(of.iter().all(|of| of.weight > 0));
                let Some(home) = cells.at(eye) else {
                    assert!(of.len() == 1 && of[0].cell.is_none());
                    continue;
                };
                assert_eq!(of[0].cell.unwrap().0, home);
                mixed[of.len().min(4)] += 1;
                let beside = eye.map(|c| c + rng.random_range(-1e-3..1e-3));
                if cells.at(beside).is_some() {
                    let of = |eye| weights(&cells, eye, skeleton.view_cells.len());
                    let change = of(eye).into_iter().zip(of(beside)).map(|(a, b)| (a - b).abs());
                    // The thinnest margin, of cells of 4, is a quarter; a corner's weight is an eighth at least.
                    assert!(change.max().unwrap() < 2000, "{eye:?} {beside:?}");
                }
            }
        }
        assert!(mixed[1] > 1000 && mixed[2..].iter().all(|&count| count > 100), "{mixed:?}");
    }

    #[test]
    fn where_cells_meet_each_has_its_share_and_inside_one_has_all() {
        let mut skeleton = RandomScene::new(1, 2, 8.0).skeleton;
        let [a, b] = [[0.0, 8.0], [8.0, 16.0]].map(|[min, max]| ([min, 0.0, 0.0], [max, 8.0, 8.0]));
        for (margin, on_border, inside) in [(0.125, WHOLE / 2, 1.0), (0.0, WHOLE, 0.0)] {
            skeleton.view_cells = [a, b].map(|(min, max)| cell(min, max, margin)).to_vec();
            let cells = Cells::new(&skeleton, METHOD);
            let at = |x: f64| -> Vec<(usize, u32)> {
                let of = cells.compositions([x, 4.0, 7.5]);
                of.iter().map(|of| (of.cell.unwrap().0, of.weight)).collect()
            };
            for (x, home) in [(8.0, 1), (8f64.next_down(), 0)] {
                let (of, weight) = at(x)[0];
                assert!(of == home && weight.abs_diff(on_border) <= 1, "{weight}");
                assert_eq!(at(x).len() as u32, WHOLE / on_border);
            }
            assert_eq!(at(8.0 - inside - 1e-9), [(0, WHOLE)]);
            assert_eq!(at(8.0 + inside), [(1, WHOLE)]);
        }
        let cells = Cells::new(&skeleton, METHOD);
        assert_eq!(
            cells.compositions([4.0, 4.0, 9.0]),
            [Composition { cell: None, weight: WHOLE }]
        );
    }

    #[test]
    fn no_file_makes_more_pictures_than_cells_meet_in_a_corner() {
        let mut skeleton = RandomScene::new(1, 2, 8.0).skeleton;
        skeleton.view_cells = vec![cell([0.0; 3], [8.0; 3], 0.25); 500];
        let cells = Cells::new(&skeleton, METHOD);
        let of = cells.compositions([4.0; 3]);
        assert_eq!((of.len(), of[0].cell.unwrap().0), (MOST, 0));
        assert_eq!(of.iter().map(|of| of.weight).sum::<u32>(), WHOLE);
    }

    #[test]
    fn geometry_is_that_of_all_compositions_and_reaches_beyond_the_cell() {
        let mut several = 0;
        for seed in 0..6 {
            let (skeleton, mut rng) = divided(seed);
            let cells = Cells::new(&skeleton, METHOD);
            for _ in 0..200 {
                let eye: [f64; 3] = std::array::from_fn(|_| rng.random_range(-16.0..16.0));
                let of = cells.compositions(eye);
                let Field::Near(near) = cells.field_at(eye) else {
                    assert!(cells.at(eye).is_none() && of[0].has(HlodId(0)));
                    continue;
                };
                assert_eq!(near.len(), of.len());
                several += usize::from(of.len() > 1);
                for (at, hlod) in skeleton.hlods.iter().enumerate() {
                    let id = HlodId(at as u32);
                    for of in &of {
                        let c = &skeleton.view_cells[of.cell.unwrap().0];
                        let [min, max] = with_margin(c.min, c.max, c.margin);
                        let meets = (0..3).all(|k| hlod.min[k] <= max[k] && min[k] <= hlod.max[k]);
                        assert_eq!(of.has(id), meets && hlod.child_count == 0);
                    }
                }
            }
        }
        assert!(several > 50, "{several}");
    }
}
