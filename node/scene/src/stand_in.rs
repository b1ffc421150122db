//! What is drawn for hlods whose geometry is not there: the nearest ancestor that is, and the error in
//! pixels that this is seen to cause.

use crate::displacement::Projection;
use crate::front::{FrontEntry, box_from_eye};
use crate::view::pixel_at_unit_depth;
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
    /// Hlods of the front that are not drawn at their level, and which of `entries` stands for each.
    pub replaced: Vec<(HlodId, FrontEntry)>,
    /// Hlods of the front that nothing stands for: holes.
    pub holes: u32,
}

/// Replaces every entry whose level `is_there` denies: by another level of the same hlod, the next
/// coarser first, else by the finest level there is of the nearest ancestor, which then takes the place
/// of all entries below it. `entries` is sorted by hlod.
pub fn available(
    skeleton: &Skeleton,
    entries: &[FrontEntry],
    is_there: impl Fn(u32) -> bool,
) -> Available {
    if entries.iter().all(|entry| is_there(entry.level)) {
        return Available { entries: entries.to_vec(), ..Available::default() };
    }
    let mut chosen: BTreeMap<HlodId, u32> = BTreeMap::new();
    for entry in entries {
        let own = is_there(entry.level).then_some((entry.hlod, entry.level));
        // The finest level of an ancestor is the same for all below it.
        chosen.extend(own.or_else(|| stand_in(skeleton, entry, &is_there)));
    }
    let mut found = Available::default();
    let mut drawn: BTreeMap<HlodId, u32> = BTreeMap::new();
    for entry in entries {
        let up = std::iter::once(entry.hlod).chain(skeleton.ancestors(entry.hlod));
        let Some(hlod) = up.filter(|up| chosen.contains_key(up)).last() else {
            found.holes += 1;
            continue;
        };
        let shown = FrontEntry { hlod, level: chosen[&hlod] };
        drawn.insert(shown.hlod, shown.level);
        if shown != *entry {
            found.replaced.push((entry.hlod, shown));
        }
    }
    found.entries = drawn.into_iter().map(|(hlod, level)| FrontEntry { hlod, level }).collect();
    found
}

/// What a picture shows, by pixel.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// The hlod that is nearest, or [`NO_ITEM`](crate::backend::NO_ITEM).
    pub items: &'a [u32],
    /// Its depth in the target: near plane over view depth.
    pub depth: &'a [f32],
    /// Hlods that blend over some pixel.
    pub blended: &'a [u32],
}

/// Pixels by which a picture strays where something stands in: from the original surface to what is
/// shown, and back, whichever is more. `replaced` is as in [`Available`].
///
/// What should be seen lies in the boxes of the replaced hlods. What is seen of a stand-in lies where its
/// pixels are; what blends has no depth, and any point of its box counts. From each of them the other
/// surface is as far as the error of the stand-in's level, which [`Projection`] turns into pixels. Nothing
/// strays by more than the picture's diagonal.
pub fn seen_error(
    skeleton: &Skeleton,
    replaced: &[(HlodId, FrontEntry)],
    camera: &Camera,
    size: PictureSize,
    seen: &Seen<'_>,
) -> f64 {
    let projection = Projection::new(camera, size);
    let error = |entry: &FrontEntry| skeleton.levels[entry.level as usize].error;
    let errors: BTreeMap<u32, f64> =
        replaced.iter().map(|(_, by)| (by.hlod.0, error(by))).collect();
    let anywhere = |hlod: HlodId, error: f64| {
        projection.moved_px(&box_from_eye(skeleton.hlod(hlod), camera.eye), error)
    };

    let wanted = replaced.iter().map(|(hlod, by)| anywhere(*hlod, error(by)));
    let blended = seen.blended.iter().filter_map(|&item| {
        let error = errors.get(&item)?;
        Some(anywhere(HlodId(item), *error))
    });
    let pixel = pixel_at_unit_depth(camera, size);
    let solid = seen.items.iter().zip(seen.depth).zip(0u32..).filter_map(|((item, depth), at)| {
        let error = errors.get(item)?;
        let [x, y] = [(at % size.width, size.width), (at / size.width, size.height)]
            .map(|(at, side)| (f64::from(at) + 0.5 - f64::from(side) / 2.0) * pixel);
        let view_depth = f64::from(camera.near) / f64::from(*depth);
        Some(projection.moved_at_px(view_depth, (x * x + y * y).sqrt(), *error))
    });
    wanted.chain(blended).chain(solid).fold(0.0, f64::max)
}

/// What would be drawn without culling, beside the same stand-ins: entries of `whole` that are there, but
/// for those that something in `replaced`, as in [`Available`], takes the place of. `whole` is sorted by hlod.
pub fn unculled(
    skeleton: &Skeleton,
    whole: &[FrontEntry],
    replaced: &[(HlodId, FrontEntry)],
    is_there: impl Fn(u32) -> bool,
) -> Vec<FrontEntry> {
    let stand_ins: BTreeMap<HlodId, u32> =
        replaced.iter().map(|(_, by)| (by.hlod, by.level)).collect();
    let is_drawn = |entry: &&FrontEntry| {
        let mut up = std::iter::once(entry.hlod).chain(skeleton.ancestors(entry.hlod));
        is_there(entry.level) && !up.any(|id| stand_ins.contains_key(&id))
    };
    let mut entries: Vec<FrontEntry> = whole.iter().filter(is_drawn).copied().collect();
    entries.extend(stand_ins.iter().map(|(&hlod, &level)| FrontEntry { hlod, level }));
    entries.sort_by_key(|entry| entry.hlod);
    entries
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
    use crate::backend::NO_ITEM;
    use crate::front::front;
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
            let whole = available(skeleton, &front, |_| true);
            assert_eq!(whole, Available { entries: front.clone(), ..Available::default() });
            let none = available(skeleton, &front, |_| false);
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
            let found = available(skeleton, &front, |l| there[l as usize]);
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
            let stands_in = |entry| found.replaced.iter().any(|(_, by)| by == entry);
            for entry in &found.entries {
                // One that is on the front itself stands for nothing else: what covers others is not.
                assert_ne!(front.contains(entry), stands_in(entry));
            }
            let own = front.iter().filter(|entry| found.entries.contains(entry)).count();
            assert_eq!(own + found.replaced.len() + found.holes as usize, front.len());
            replaced += found.replaced.len();
        }
        assert!(replaced > 500, "{replaced}");
    }

    #[test]
    fn without_culling_the_same_stand_ins_are_drawn_and_nothing_twice() {
        let (mut more, mut hidden) = (0, 0);
        for seed in 0..100 {
            let mut scene = RandomScene::new(seed, 3, 16.0);
            let camera = scene.camera();
            let front = front(&scene.skeleton, &camera, SIZE, 2.0).entries;
            let there: Vec<bool> =
                scene.skeleton.levels.iter().map(|_| scene.rng.random_bool(0.6)).collect();
            let is_there = |level: u32| there[level as usize];
            // Every third is visible.
            let visible: Vec<FrontEntry> = front.iter().step_by(3).copied().collect();
            let skeleton = &scene.skeleton;
            let shown = available(skeleton, &visible, is_there);
            let whole = unculled(skeleton, &front, &shown.replaced, is_there);

            assert!(whole.is_sorted_by(|a, b| a.hlod < b.hlod));
            assert!(shown.entries.iter().all(|entry| whole.contains(entry)), "seed {seed}");
            for entry in &whole {
                let above = |id| whole.iter().any(|other| other.hlod == id);
                assert!(is_there(entry.level) && !skeleton.ancestors(entry.hlod).any(above));
            }
            let beside = front.iter().filter(|entry| is_there(entry.level)).filter(|entry| {
                let stands = |id| shown.replaced.iter().any(|(_, by)| by.hlod == id);
                !std::iter::once(entry.hlod).chain(skeleton.ancestors(entry.hlod)).any(stands)
            });
            assert!(beside.clone().all(|entry| whole.contains(entry)), "seed {seed}");
            more += whole.len() - shown.entries.len();
            hidden += front.len() - beside.count();
        }
        assert!(more > 300 && hidden > 300, "{more} {hidden}");
    }

    #[test]
    fn the_error_seen_is_that_of_the_pixel_that_strays_most() {
        let mut scene = RandomScene::new(3, 2, 16.0);
        let camera = Camera { near: 0.5, ..scene.camera() };
        scene.skeleton.levels.iter_mut().for_each(|level| level.error = 0.0);
        let levels = &mut scene.skeleton.levels;
        (levels[1].error, levels[2].error) = (0.25, 2.0);
        let entry = |hlod, level| FrontEntry { hlod: HlodId(hlod), level };
        // 3 lies far away, so that only what is seen counts.
        let far = &mut scene.skeleton.hlods[3];
        (far.min, far.max) = ([1e9; 3], [2e9; 3]);
        let replaced = [(HlodId(3), entry(0, 1)), (HlodId(3), entry(1, 2))];
        let pixel = pixel_at_unit_depth(&camera, SIZE);
        let error = |items: &[u32], depth: &[f32], blended: &[u32]| {
            // In the middle of the picture, where a ray is as long as it is deep.
            let before = 24 * 64 + 32 - items.len() / 2;
            let items = [&vec![NO_ITEM; before][..], items].concat();
            let depth = [&vec![0.0; before][..], depth].concat();
            let seen = Seen { items: &items, depth: &depth, blended };
            seen_error(&scene.skeleton, &replaced, &camera, SIZE, &seen)
        };
        let is_about = |found: f64, truth: f64| (found - truth).abs() < 2e-3 * truth;
        assert!(error(&[], &[], &[]) < 1e-6);
        // What is not seen, and what stands for itself, does not stray.
        assert!(error(&[NO_ITEM, 2], &[0.0, 1.0], &[2]) < 1e-6);
        // View depths 100 and 50 with a quarter of a unit, 2000 and 200 with two.
        assert!(is_about(error(&[0, 0, 1], &[0.005, 0.01, 0.00025], &[]), 0.25 / 50.0 / pixel));
        assert!(is_about(error(&[0, 0, 1], &[0.005, 0.01, 0.0025], &[]), 2.0 / 200.0 / pixel));
        let anywhere = |hlod, error| {
            let seen = box_from_eye(scene.skeleton.hlod(HlodId(hlod)), camera.eye);
            Projection::new(&camera, SIZE).moved_px(&seen, error)
        };
        let diagonal = 64f64.hypot(48.0);
        assert_eq!(error(&[], &[], &[1]), anywhere(1, 2.0));
        // What should be seen and is not.
        let seen = Seen { items: &[], depth: &[], blended: &[] };
        let told = seen_error(&scene.skeleton, &[(HlodId(2), entry(0, 1))], &camera, SIZE, &seen);
        assert_eq!(told, anywhere(2, 0.25));
        // The same a pixel from the picture's corner: farther away, and seen at an angle.
        let mut items = vec![NO_ITEM; 64 * 48];
        items[0] = 1;
        let seen = Seen { items: &items, depth: &[0.00025; 64 * 48], blended: &[] };
        let told = seen_error(&scene.skeleton, &replaced, &camera, SIZE, &seen);
        let off_axis = 31.5f64.hypot(23.5) * pixel;
        let first_order = 2.0 / 2000.0 * (1.0 + off_axis * off_axis).sqrt() / pixel;
        assert!((told / first_order - 1.0).abs() < 5e-3, "{told} {first_order}");
        // An error larger than the distance fills the picture, no more.
        scene.skeleton.levels[1].error = 1e30;
        let told = seen_error(&scene.skeleton, &replaced, &camera, SIZE, &seen);
        assert_eq!(told, diagonal);
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
            assert_eq!(available(skeleton, &front, there).holes, 0, "seed {seed}");
        }
    }
}
