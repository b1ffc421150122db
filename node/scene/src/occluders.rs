//! Occluders of a frame: the last visible set, mapped onto the present front (paper 004, section 4.2).
//!
//! What is mapped lies on the very front that will be drawn, at the same levels; that is what makes
//! culling conservative (paper 004, section 2.1).

use crate::front::{Front, FrontEntry};
use protocol::format::Skeleton;
use protocol::id::HlodId;
use protocol::visible::VisibleSet;

/// A set of hlods, one bit each.
struct Marks(Vec<u64>);

impl Marks {
    fn new(len: usize) -> Self {
        Self(vec![0; len.div_ceil(64)])
    }

    fn has(&self, id: u32) -> bool {
        self.0[id as usize / 64] >> (id % 64) & 1 == 1
    }

    /// Whether it was new.
    fn insert(&mut self, id: u32) -> bool {
        let new = !self.has(id);
        self.0[id as usize / 64] |= 1 << (id % 64);
        new
    }
}

/// `hlod`, its parent and so on up to the root.
fn upwards(skeleton: &Skeleton, hlod: HlodId) -> impl Iterator<Item = u32> {
    std::iter::once(hlod).chain(skeleton.ancestors(hlod)).map(|id| id.0)
}

/// The entries of `front` that stand for `previous`: each of its hlods if it is on the front, else its
/// ancestor there, else its descendants there. Sorted by hlod, without repeats.
///
/// A front of what is in the frustum suffices: the rest rasterises nothing. Ids that the skeleton does
/// not have are passed over, which only costs occlusion.
pub fn map_onto_front(
    skeleton: &Skeleton,
    previous: &VisibleSet,
    front: &Front,
) -> Vec<FrontEntry> {
    let count = skeleton.hlods.len();
    let mut on_front = Marks::new(count);
    for entry in &front.entries {
        on_front.insert(entry.hlod.0);
    }
    let mut was_visible = Marks::new(count);
    let mut chosen = Marks::new(count);
    let mut climbed = Marks::new(count);
    for &hlod in previous.ids().iter().filter(|hlod| hlod.index() < count) {
        was_visible.insert(hlod.0);
        // A path that was climbed before led to the same entry.
        for id in upwards(skeleton, hlod).take_while(|&id| climbed.insert(id)) {
            if on_front.has(id) {
                chosen.insert(id);
                break;
            }
        }
    }
    // What stands above the front is found from below, so that no subtree is searched; paths known to
    // lead to nothing visible are climbed once.
    let mut barren = Marks::new(count);
    let stood_for = |entry: &&FrontEntry| {
        let mut path = upwards(skeleton, entry.hlod).take_while(|&id| !barren.has(id));
        let found = chosen.has(entry.hlod.0) || path.any(|id| was_visible.has(id));
        if !found {
            for id in upwards(skeleton, entry.hlod) {
                if !barren.insert(id) {
                    break;
                }
            }
        }
        found
    };
    front.entries.iter().filter(stood_for).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front::front;
    use crate::random_scene::RandomScene;
    use protocol::settings::PictureSize;
    use rand::Rng;

    const SIZE: PictureSize = PictureSize { width: 64, height: 48 };

    /// By definition: for each entry, whether any hlod of the set is it, above it or below it.
    fn expected(skeleton: &Skeleton, previous: &VisibleSet, front: &Front) -> Vec<FrontEntry> {
        let above = |low: HlodId, high: HlodId| upwards(skeleton, low).any(|id| id == high.0);
        let related = |entry: &&FrontEntry| {
            previous.ids().iter().any(|&id| above(id, entry.hlod) || above(entry.hlod, id))
        };
        front.entries.iter().filter(related).copied().collect()
    }

    #[test]
    fn nothing_stands_for_nothing() {
        let mut scene = RandomScene::new(1, 2, 16.0);
        let camera = scene.camera();
        let front = front(&scene.skeleton, &camera, SIZE, 1.0);
        assert!(map_onto_front(&scene.skeleton, &VisibleSet::default(), &front).is_empty());
        let foreign = VisibleSet::from_sorted(vec![HlodId(9999), HlodId(u32::MAX)]);
        assert!(map_onto_front(&scene.skeleton, &foreign, &front).is_empty());
    }

    #[test]
    fn a_front_stands_for_itself() {
        for seed in 0..20 {
            let mut scene = RandomScene::new(seed, 4, 16.0);
            let camera = scene.camera();
            let front = front(&scene.skeleton, &camera, SIZE, 2.0);
            let all = front.entries.iter().map(|entry| entry.hlod).collect();
            let mapped = map_onto_front(&scene.skeleton, &VisibleSet::from_sorted(all), &front);
            assert_eq!(mapped, front.entries);
        }
    }

    #[test]
    fn any_set_is_mapped_as_defined() {
        let mut mapped = 0;
        for seed in 0..60 {
            let mut scene = RandomScene::new(seed, 4, 16.0);
            let camera = scene.camera();
            let lod_px = [0.0, 1.0, 10.0][seed as usize % 3];
            let front = front(&scene.skeleton, &camera, SIZE, lod_px);
            let share = [0.002, 0.02, 0.3][seed as usize / 3 % 3];
            let ids = (1..scene.skeleton.hlods.len() as u32).map(HlodId);
            let ids = ids.filter(|_| scene.rng.random_bool(share)).collect();
            let previous = VisibleSet::from_sorted(ids);
            let found = map_onto_front(&scene.skeleton, &previous, &front);
            assert_eq!(found, expected(&scene.skeleton, &previous, &front), "seed {seed}");
            mapped += usize::from(!found.is_empty() && found.len() < front.entries.len());
        }
        assert!(mapped > 20, "{mapped}");
    }
}
