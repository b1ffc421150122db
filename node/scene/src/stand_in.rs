//! What is drawn for hlods whose geometry is not there: the nearest ancestor that is, and the error in
//! pixels that this causes.

use crate::front::{FrontEntry, box_from_eye};
use crate::view::pixel_at_unit_depth;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::HlodId;
use protocol::settings::PictureSize;
use std::collections::BTreeMap;

/// What to draw of a front of which not all is there.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Available {
    /// What is drawn, sorted by hlod.
    pub entries: Vec<FrontEntry>,
    /// Hlods of the front that something else stands for.
    pub replaced: u32,
    /// Hlods of the front that nothing stands for: holes.
    pub holes: u32,
    /// Greatest projected error of what stands in, pixels; 0 where nothing does.
    pub error_px: f64,
}

/// Replaces every entry whose level `is_there` denies: by another level of the same hlod, the next
/// coarser first, else by the finest level there is of the nearest ancestor, which then takes the place
/// of all entries below it. `entries` is sorted by hlod.
pub fn available(
    skeleton: &Skeleton,
    entries: &[FrontEntry],
    camera: &Camera,
    size: PictureSize,
    is_there: impl Fn(u32) -> bool,
) -> Available {
    if entries.iter().all(|entry| is_there(entry.level)) {
        return Available { entries: entries.to_vec(), ..Available::default() };
    }
    let mut found = Available::default();
    let mut chosen: BTreeMap<HlodId, u32> = BTreeMap::new();
    let mut replaced: Vec<(HlodId, u32)> = Vec::new();
    for entry in entries {
        if is_there(entry.level) {
            chosen.insert(entry.hlod, entry.level);
            continue;
        }
        match stand_in(skeleton, entry, &is_there) {
            Some((hlod, level)) => {
                found.replaced += 1;
                // The finest level of an ancestor is the same for all below it.
                chosen.insert(hlod, level);
                replaced.push((hlod, level));
            }
            None => found.holes += 1,
        }
    }
    let is_covered = |hlod: HlodId| skeleton.ancestors(hlod).any(|up| chosen.contains_key(&up));
    let entries = chosen.iter().filter(|(hlod, _)| !is_covered(**hlod));
    found.entries = entries.map(|(&hlod, &level)| FrontEntry { hlod, level }).collect();
    let error = |&(hlod, level): &(HlodId, u32)| {
        projected_error(skeleton, &FrontEntry { hlod, level }, camera, size)
    };
    found.error_px = replaced.iter().map(error).fold(0.0, f64::max);
    found
}

/// Pixels by which what is seen of `entry` strays at most: its error at the nearest point of its box,
/// or at the near plane.
pub fn projected_error(
    skeleton: &Skeleton,
    entry: &FrontEntry,
    camera: &Camera,
    size: PictureSize,
) -> f64 {
    let seen_from_eye = box_from_eye(skeleton.hlod(entry.hlod), camera.eye);
    let distance = seen_from_eye.distance(DVec3::ZERO).max(f64::from(camera.near));
    let error = skeleton.levels[entry.level as usize].error;
    error / (distance * pixel_at_unit_depth(camera, size))
}

fn stand_in(
    skeleton: &Skeleton,
    entry: &FrontEntry,
    is_there: &impl Fn(u32) -> bool,
) -> Option<(HlodId, u32)> {
    let hlod = skeleton.hlod(entry.hlod);
    let (first, end) = (hlod.first_level, hlod.first_level + hlod.level_count);
    let own = (entry.level + 1..end).chain((first..entry.level).rev()).find(|&l| is_there(l));
    own.map(|level| (entry.hlod, level)).or_else(|| {
        skeleton.ancestors(entry.hlod).find_map(|id| {
            let hlod = skeleton.hlod(id);
            let mut levels = hlod.first_level..hlod.first_level + hlod.level_count;
            levels.find(|&level| is_there(level)).map(|level| (id, level))
        })
    })
}

/// The coarsest complete cut: of each branch the coarsest level of the highest hlod that has any.
/// With it there nothing is ever a hole.
pub fn coarsest_cut(skeleton: &Skeleton) -> Vec<FrontEntry> {
    let mut entries = Vec::new();
    let mut waiting: Vec<HlodId> = skeleton.hlods.first().map(|_| HlodId(0)).into_iter().collect();
    while let Some(id) = waiting.pop() {
        let hlod = skeleton.hlod(id);
        match hlod.level_count {
            0 => waiting.extend(skeleton.children_of(hlod)),
            count => entries.push(FrontEntry { hlod: id, level: hlod.first_level + count - 1 }),
        }
    }
    entries.sort_by_key(|entry| entry.hlod);
    entries
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::{Backend, Completion, Draws, NO_ITEM, Part, Pass, View};
    use crate::draw_list::draw_list;
    use crate::front::front;
    use crate::occludee::Rules;
    use crate::random_scene::RandomScene;
    use rand::Rng;

    const SIZE: PictureSize = PictureSize { width: 64, height: 48 };

    #[test]
    fn where_all_is_there_nothing_changes_and_where_nothing_is_all_are_holes() {
        for seed in 0..20 {
            let mut scene = RandomScene::new(seed, 3, 16.0);
            let camera = scene.camera();
            let skeleton = &scene.skeleton;
            let front = front(skeleton, &camera, SIZE, 2.0).entries;
            let whole = available(skeleton, &front, &camera, SIZE, |_| true);
            assert_eq!(whole, Available { entries: front.clone(), ..Available::default() });
            let none = available(skeleton, &front, &camera, SIZE, |_| false);
            let holes = front.len() as u32;
            assert_eq!(none, Available { holes, ..Available::default() });
        }
    }

    #[test]
    fn every_entry_is_drawn_once_by_itself_or_by_what_is_nearest() {
        let mut replaced = 0;
        for seed in 0..200 {
            let mut scene = RandomScene::new(seed, 3, 16.0);
            let camera = scene.camera();
            let front =
                front(&scene.skeleton, &camera, SIZE, [0.0, 2.0][seed as usize % 2]).entries;
            let share = [0.1, 0.5, 0.9][seed as usize % 3];
            let there: Vec<bool> =
                scene.skeleton.levels.iter().map(|_| scene.rng.random_bool(share)).collect();
            let skeleton = &scene.skeleton;
            let found = available(skeleton, &front, &camera, SIZE, |l| there[l as usize]);
            assert!(found.entries.is_sorted_by(|a, b| a.hlod < b.hlod));
            assert!(found.entries.iter().all(|entry| there[entry.level as usize]));
            let drawn = |id: HlodId| found.entries.iter().any(|entry| entry.hlod == id);
            let mut holes = 0;
            for entry in &front {
                let count = std::iter::once(entry.hlod)
                    .chain(skeleton.ancestors(entry.hlod))
                    .filter(|&id| drawn(id))
                    .count();
                let levels = std::iter::once(entry.hlod)
                    .chain(skeleton.ancestors(entry.hlod))
                    .flat_map(|id| {
                        let hlod = skeleton.hlod(id);
                        hlod.first_level..hlod.first_level + hlod.level_count
                    });
                let any_there = levels.into_iter().any(|level| there[level as usize]);
                assert_eq!(count, usize::from(any_there), "seed {seed}");
                holes += u32::from(!any_there);
            }
            assert_eq!(found.holes, holes);
            for entry in &found.entries {
                let is_own = front.contains(entry);
                assert!(
                    is_own || projected_error(skeleton, entry, &camera, SIZE) <= found.error_px
                );
            }
            replaced += found.replaced;
        }
        assert!(replaced > 500, "{replaced}");
    }

    /// By pixel, the hlod seen there and its view depth.
    fn seen(scene: &RandomScene, camera: &Camera, entries: &[FrontEntry]) -> Vec<(HlodId, f64)> {
        let mut backend = scene.backend(SIZE, &Rules::default());
        let view = View::new(camera, SIZE);
        let mut run = |pass| {
            backend.submit(pass).unwrap();
            let mut completions = Vec::new();
            backend.poll(&mut completions).unwrap();
            completions.remove(0)
        };
        // What blends leaves no depth.
        let draws = draw_list(&scene.skeleton, entries, camera.eye);
        let draws = Draws { blending: vec![], ..draws };
        let (part, with_depth) = (Part::WHOLE, true);
        let Completion::Items { items, .. } = run(Pass::Items { view, draws: draws.clone(), part })
        else {
            panic!("no items")
        };
        let Completion::Picture { picture, .. } =
            run(Pass::Shade { view, draws, with_depth, part })
        else {
            panic!("no picture")
        };
        let depths = picture.depth.unwrap();
        let pixels = items.into_iter().zip(depths).filter(|(item, _)| *item != NO_ITEM);
        let depth = |z: f32| f64::from(camera.near) / f64::from(z);
        pixels.map(|(item, z)| (HlodId(item), depth(z))).collect()
    }

    #[test]
    fn the_error_told_bounds_what_is_seen() {
        let mut measured = 0;
        for seed in 0..300 {
            let mut scene = RandomScene::new(seed, 3, 16.0);
            let camera = scene.camera();
            let lod_px = 2.0;
            let front = front(&scene.skeleton, &camera, SIZE, lod_px).entries;
            let there: Vec<bool> =
                scene.skeleton.levels.iter().map(|_| scene.rng.random_bool(0.7)).collect();
            let found = available(&scene.skeleton, &front, &camera, SIZE, |l| there[l as usize]);
            let pixel = pixel_at_unit_depth(&camera, SIZE);
            let seen = seen(&scene, &camera, &found.entries);
            for entry in found.entries.iter().filter(|entry| !front.contains(entry)) {
                let nearest = seen.iter().filter(|(hlod, _)| *hlod == entry.hlod).map(|(_, d)| *d);
                let Some(nearest) = nearest.reduce(f64::min) else { continue };
                let error = scene.skeleton.levels[entry.level as usize].error;
                let (shown, told) = (
                    error / (nearest * pixel),
                    projected_error(&scene.skeleton, entry, &camera, SIZE),
                );
                // Depths are rounded.
                assert!(
                    shown <= told * 1.001 && told <= found.error_px,
                    "seed {seed}: {shown} {told}"
                );
                measured += 1;
            }
        }
        assert!(measured > 100, "{measured}");
    }

    #[test]
    fn the_coarsest_cut_leaves_no_hole() {
        for seed in 0..20 {
            let mut scene = RandomScene::new(seed, 3, 16.0);
            let camera = scene.camera();
            if seed % 2 == 1 {
                // An inner hlod without levels is refined at once.
                scene.skeleton.hlods[0].level_count = 0;
            }
            let skeleton = &scene.skeleton;
            let cut = coarsest_cut(skeleton);
            let front = front(skeleton, &camera, SIZE, 0.0).entries;
            let there = |level: u32| cut.iter().any(|entry| entry.level == level);
            assert_eq!(available(skeleton, &front, &camera, SIZE, there).holes, 0, "seed {seed}");
        }
    }
}
