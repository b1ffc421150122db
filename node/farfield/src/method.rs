//! The ways to stand in for what is far: one list, a folder each.

use crate::field::{Cubes, FarField};
use crate::itdm::Itdm;
use crate::select::Budget;
use crate::tdm::Tdm;
use protocol::format::Method as Number;
use protocol::format::Skeleton;
use scene::view_cells::Cells;
use std::sync::Arc;

/// All ways.
pub static METHODS: [&dyn Method; 2] = [&Tdm, &Itdm];

/// One way.
pub trait Method: Sync {
    /// Its name on the command line.
    fn tag(&self) -> &'static str;

    /// Its number in a scene file.
    fn number(&self) -> Number;

    /// What stands in for the far fields of `cells` at run time: scan cubes, unless a method has its own.
    fn open(
        &self,
        skeleton: Arc<Skeleton>,
        cells: Arc<Cells>,
        budget: Budget,
    ) -> Arc<dyn FarField> {
        Arc::new(Cubes::new(skeleton, cells, budget))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::MARGIN;
    use glam::DVec3;
    use protocol::camera::Camera;
    use protocol::format::{Blob, Class, Cube, Hlod, NONE, ViewCell};
    use protocol::settings::{Far, PictureSize};
    use rand::{Rng, SeedableRng, rngs::StdRng};
    use scene::backend::Draw;
    use std::collections::BTreeSet;

    const SIZE: PictureSize = PictureSize { width: 64, height: 48 };
    const TRIANGLES: u64 = 10;
    /// Cubes of each cell of the street.
    const CUBES: usize = 5;

    /// A root without geometry over the unit cubes of a row, one view cell each: the first of TDM, two of ITDM, the
    /// last without a far field. Each cell's cubes but for the last two hang in a chain.
    fn row() -> Skeleton {
        let leaf = Hlod {
            min: [0.0; 3],
            max: [4.0, 1.0, 1.0],
            parent: NONE,
            first_child: 0,
            child_count: 0,
            first_level: 0,
            level_count: 0,
            object: NONE,
            source_triangles: 0,
        };
        let patch = Blob {
            step: 0.25,
            triangles: TRIANGLES as u32,
            classes: Class::OpaqueDouble.all(TRIANGLES as u32),
            layout: protocol::format::vertex::Layout::Projected as u32,
            image: [16, 0],
            ..Blob::default()
        };
        let mut rng = StdRng::seed_from_u64(7);
        let (mut view_cells, mut cubes, mut blobs) = (Vec::new(), Vec::new(), Vec::new());
        let methods = [Number::Tdm, Number::Itdm, Number::Itdm, Number::None];
        for (number, at) in methods.into_iter().zip([0.0, 1.0, 2.0, 3.0]) {
            let first_cube = cubes.len() as u32;
            let count = if number == Number::None { 0 } else { CUBES };
            for place in 0..count {
                let patches = std::array::from_fn(|at| {
                    let start = blobs.len() as u32;
                    // Up to three for each of the six faces.
                    let count = if at < 6 { rng.random_range(0..4) } else { 0 };
                    blobs.extend((0..count).map(|_| patch));
                    start
                });
                let parent = match place {
                    0 => NONE,
                    1 | 2 => first_cube + place as u32 - 1,
                    _ => first_cube,
                };
                let [x, y, z] = std::array::from_fn(|_| rng.random_range(0.0..1.0));
                let triangles = u64::from(blobs.len() as u32 - patches[0]) * TRIANGLES;
                cubes.push(Cube {
                    eye: [at + x, y, z],
                    patches,
                    side: 16,
                    parent,
                    triangles: triangles as u32,
                });
            }
            view_cells.push(ViewCell {
                min: [at, 0.0, 0.0],
                max: [at + 1.0, 1.0, 1.0],
                first_cube,
                cube_count: count as u32,
                method: number as u32,
                margin: MARGIN,
                objective: 0.1,
            });
        }
        Skeleton {
            info: Default::default(),
            hlods: vec![leaf],
            levels: vec![],
            parts: vec![],
            blobs,
            transforms: vec![],
            textures: vec![],
            texture_lists: vec![],
            view_cells,
            cubes,
        }
    }

    fn open(method: &dyn Method, skeleton: &Arc<Skeleton>, budget: Budget) -> Arc<dyn FarField> {
        let cells = Arc::new(Cells::new(skeleton, method.number() as u32));
        method.open(Arc::clone(skeleton), cells, budget)
    }

    /// Cameras in and around the row.
    fn cameras() -> Vec<Camera> {
        let mut rng = StdRng::seed_from_u64(8);
        let camera = |_| {
            let eye = [-0.5..4.5, -0.2..1.2, -0.2..1.2].map(|range| rng.random_range(range));
            let target: [f64; 3] = std::array::from_fn(|_| rng.random_range(-9.0..9.0));
            Camera::look_at(eye, target, [0.0, 0.0, 1.0], 40.0, 0.01).expect("a direction")
        };
        (0..400).map(camera).collect()
    }

    /// The cells that a picture is mixed of.
    fn mixed(skeleton: &Skeleton, method: &dyn Method, eye: [f64; 3]) -> Vec<usize> {
        let cells = Cells::new(skeleton, method.number() as u32);
        let cells = cells.compositions(eye).into_iter().filter_map(|of| of.cell);
        cells.map(|(cell, _)| cell).collect()
    }

    /// The cubes that draws belong to, in order.
    fn cubes_of(skeleton: &Skeleton, draws: &[Draw]) -> Vec<usize> {
        let owner = |draw: &Draw| {
            let cubes = &skeleton.cubes;
            let owns = |cube: &Cube| cube.blobs().any(|blob| blob == draw.blob.0);
            cubes.iter().position(owns).expect("a face of a cube")
        };
        let mut found: Vec<usize> = draws.iter().map(owner).collect();
        found.dedup();
        found
    }

    #[test]
    fn every_way_has_a_word_and_a_number_of_its_own() {
        let tags: BTreeSet<_> = METHODS.iter().map(|method| method.tag()).collect();
        let numbers: BTreeSet<_> = METHODS.iter().map(|method| method.number() as u32).collect();
        assert_eq!((tags.len(), numbers.len()), (METHODS.len(), METHODS.len()));
        assert!(!numbers.contains(&(Number::None as u32)));
        for method in METHODS {
            assert_eq!(Number::of(method.number() as u32), Some(method.number()));
            assert_eq!(format!("{:?}", method.number()).to_lowercase(), method.tag());
        }
        // What a run can be told, and what there is.
        let words = [Far::Tdm, Far::Itdm].map(|far| format!("{far:?}").to_lowercase());
        assert_eq!(tags, words.iter().map(String::as_str).collect());
    }

    #[test]
    fn where_there_are_no_cells_nothing_is_wanted() {
        let mut skeleton = row();
        skeleton.view_cells.clear();
        skeleton.cubes.clear();
        let skeleton = Arc::new(skeleton);
        for method in METHODS {
            let far = open(method, &skeleton, Budget { cubes: 8, triangles: None });
            for camera in cameras() {
                assert!(far.wanted(camera.eye).is_empty(), "{}", method.tag());
            }
        }
    }

    #[test]
    fn what_is_drawn_is_wanted_lies_in_the_eyes_cell_and_keeps_the_budget() {
        let skeleton = Arc::new(row());
        for method in METHODS {
            for (most, triangles) in [
                (1, None),
                (2, None),
                (3, None),
                (99, None),
                (99, Some(45)),
                (3, Some(25)),
                (9, Some(0)),
            ] {
                let budget = Budget { cubes: most, triangles };
                let what = format!("{}: {budget:?}", method.tag());
                let far = open(method, &skeleton, budget);
                let mut drawn = 0;
                for camera in cameras() {
                    let wanted = far.wanted(camera.eye);
                    let inside = skeleton.view_cells.iter().any(|cell| {
                        let holds = |k| cell.min[k] <= camera.eye[k] && camera.eye[k] < cell.max[k];
                        cell.method == method.number() as u32 && (0..3).all(holds)
                    });
                    let cells = mixed(&skeleton, method, camera.eye);
                    assert_eq!((cells.is_empty(), wanted.is_empty()), (!inside, !inside), "{what}");
                    for at in cells {
                        let cell = &skeleton.view_cells[at];
                        let draws = far.draws(at, &camera, SIZE);
                        let blobs: BTreeSet<_> = draws.iter().map(|draw| draw.blob).collect();
                        assert_eq!(blobs.len(), draws.len(), "{what}: drawn once");
                        assert!(draws.iter().all(|draw| wanted.contains(&draw.blob)), "{what}");
                        let cubes = cubes_of(&skeleton, &draws);
                        let first = cell.first_cube as usize;
                        assert!(
                            cubes.iter().all(|cube| (first..first + CUBES).contains(cube)),
                            "{what}"
                        );
                        assert!(cubes.len() <= most as usize, "{what}: {cubes:?}");
                        let cost = draws.len() as u64 * TRIANGLES;
                        assert!(
                            triangles.is_none_or(|most| cost <= most) || cubes.len() == 1,
                            "{what}: {cost} of {cubes:?}"
                        );
                        drawn += draws.len();
                    }
                }
                assert!(drawn > 50, "{what}: a weak test, {drawn} faces");
            }
        }
    }

    #[test]
    fn the_nearest_cube_and_its_ancestors_stand_before_all_others() {
        let skeleton = Arc::new(row());
        let (mut before, mut behind) = (0, 0);
        for camera in cameras() {
            let far = open(&Itdm, &skeleton, Budget { cubes: 99, triangles: None });
            for cell in mixed(&skeleton, &Itdm, camera.eye) {
                let draws = far.draws(cell, &camera, SIZE);
                let cubes = skeleton.cubes_of(&skeleton.view_cells[cell]);
                let eye = DVec3::from_array(camera.eye);
                let away = |cube: &&Cube| DVec3::from_array(cube.eye).distance(eye);
                let nearest = cubes.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
                let up = |cube: &&Cube| skeleton.cubes.get(cube.parent as usize);
                let path: Vec<&Cube> = std::iter::successors(nearest, up).collect();
                for draw in draws {
                    let is_first = path.iter().any(|cube| cube.blobs().contains(&draw.blob.0));
                    let step = skeleton.blob(draw.blob).step as f32;
                    assert!(if is_first {
                        draw.disparity_step == step
                    } else {
                        draw.disparity_step < step
                    });
                    before += usize::from(is_first);
                    behind += usize::from(!is_first);
                }
            }
        }
        assert!(before > 50 && behind > 50, "{before} {behind}");
    }

    #[test]
    fn more_cubes_only_add() {
        let skeleton = Arc::new(row());
        for method in METHODS {
            for camera in cameras() {
                let of = |cubes, cell| {
                    let far = open(method, &skeleton, Budget { cubes, triangles: None });
                    let draws = far.draws(cell, &camera, SIZE);
                    draws.iter().map(|draw| draw.blob).collect::<Vec<_>>()
                };
                for cell in mixed(&skeleton, method, camera.eye) {
                    for cubes in 1..=CUBES as u32 {
                        assert!(
                            of(cubes + 1, cell).starts_with(&of(cubes, cell)),
                            "{}",
                            method.tag()
                        );
                    }
                }
            }
        }
    }
}
