//! From front entries to draws.

use crate::backend::Draw;
use crate::front::FrontEntry;
use protocol::format::{Hlod, Part, Skeleton};
use protocol::id::{BlobId, HlodId};

/// The draws of `entries` for an eye, one a part, ordered by (blob, hlod, part), so that instances of a
/// mesh follow each other.
///
/// The order depends on nothing but the three ids: a culled list is the unculled one with draws left
/// out. Where two surfaces have the same depth the later draw wins (GreaterEqual), and draws that are
/// hidden everywhere win nowhere, so both lists give the same picture, bit for bit.
///
/// Draws too far away for f32 are left out: they cover no pixel.
pub fn draw_list(skeleton: &Skeleton, entries: &[FrontEntry], eye: [f64; 3]) -> Vec<Draw> {
    let draws_of = |entry: &FrontEntry| {
        let parts = skeleton.parts_of(&skeleton.levels[entry.level as usize]);
        let hlod = entry.hlod;
        let distance = distance(skeleton.hlod(hlod), eye);
        parts.iter().map(move |part| Draw { distance, ..draw_of(skeleton, hlod, part, eye) })
    };
    let mut draws: Vec<Draw> = entries
        .iter()
        .flat_map(draws_of)
        .filter(|draw| {
            draw.linear.iter().flatten().chain(&draw.offset).all(|number| number.is_finite())
        })
        .collect();
    // Stable: the parts of an hlod that share a mesh keep their order.
    draws.sort_by_key(|draw| (draw.blob, draw.item));
    draws
}

fn draw_of(skeleton: &Skeleton, item: HlodId, part: &Part, eye: [f64; 3]) -> Draw {
    let blob = BlobId(part.blob);
    let mesh = skeleton.blob(blob);
    let placement = skeleton.transform_of(part);
    let origin = placement.apply(mesh.origin);
    Draw {
        blob,
        item,
        linear: placement.linear.map(|column| column.map(|c| (c * mesh.step) as f32)),
        offset: std::array::from_fn(|k| (origin[k] - eye[k]) as f32),
        distance: 0.0,
    }
}

/// From the eye to the middle of an hlod's box.
fn distance(hlod: &Hlod, eye: [f64; 3]) -> f32 {
    let from_eye = |k: usize| 0.5 * (hlod.min[k] + hlod.max[k]) - eye[k];
    (0..3).map(|k| from_eye(k) * from_eye(k)).sum::<f64>().sqrt() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front::front;
    use crate::random_scene::RandomScene;
    use protocol::settings::PictureSize;
    use rand::Rng;

    #[test]
    fn a_culled_list_is_the_whole_one_with_draws_left_out() {
        let mut scene = RandomScene::new(7, 4, 64.0);
        let camera = scene.camera();
        let size = PictureSize { width: 64, height: 64 };
        // Some share a mesh.
        for part in &mut scene.skeleton.parts {
            part.blob %= 7;
        }
        let entries = front(&scene.skeleton, &camera, size, 0.0).entries;
        assert!(draw_list(&scene.skeleton, &[], camera.eye).is_empty());
        let all = draw_list(&scene.skeleton, &entries, camera.eye);
        assert!(all.len() > 10 && all.is_sorted_by_key(|draw| (draw.blob, draw.item)));
        let some: Vec<_> = entries.iter().filter(|_| scene.rng.random_bool(0.5)).copied().collect();
        let culled = draw_list(&scene.skeleton, &some, camera.eye);
        let mut rest = all.iter();
        assert!(culled.iter().all(|draw| rest.any(|other| other == draw)));
    }

    #[test]
    fn a_moved_scene_is_drawn_alike() {
        let mut scene = RandomScene::new(6, 2, 64.0);
        let camera = scene.camera();
        let eye = camera.eye.map(|c| (c * 1024.0).floor() / 1024.0);
        let everything: Vec<_> = (0..scene.skeleton.hlods.len() as u32)
            .map(|id| FrontEntry {
                hlod: HlodId(id),
                level: scene.skeleton.hlods[id as usize].first_level,
            })
            .filter(|entry| scene.skeleton.hlod(entry.hlod).level_count > 0)
            .collect();
        let here = draw_list(&scene.skeleton, &everything, eye);
        let away = |c: f64| c + f64::from(1 << 23);
        for part in &mut scene.skeleton.parts {
            part.transform = protocol::format::NONE;
        }
        let unplaced = draw_list(&scene.skeleton, &everything, eye);
        assert_ne!(here, unplaced);
        for blob in &mut scene.skeleton.blobs {
            blob.origin = blob.origin.map(away);
        }
        for (a, b) in draw_list(&scene.skeleton, &everything, eye.map(away)).iter().zip(&unplaced) {
            assert_eq!((a.linear, a.item), (b.linear, b.item));
            assert!((0..3).all(|k| (a.offset[k] - b.offset[k]).abs() < 1e-6));
        }
    }

    #[test]
    fn nothing_that_is_not_finite_is_drawn() {
        let mut scene = RandomScene::new(6, 1, 1.0);
        let count = scene.skeleton.levels.len();
        scene.skeleton.blobs[0].origin[1] = 1e300;
        scene.skeleton.blobs[1].step = f64::INFINITY;
        let entries: Vec<_> =
            (0..count as u32).map(|level| FrontEntry { hlod: HlodId(0), level }).collect();
        let parts = &scene.skeleton.parts;
        let finite = parts.iter().filter(|part| part.blob > 1).count();
        assert!(finite < parts.len() && parts.len() > count, "{finite}");
        let draws = draw_list(&scene.skeleton, &entries, [0.0; 3]);
        assert_eq!(draws.len(), finite);
        // The root's box, seen from three and four away.
        scene.skeleton.hlods[0].min = [2.0, -1.0, 3.0];
        scene.skeleton.hlods[0].max = [4.0, 1.0, 5.0];
        assert_eq!(distance(&scene.skeleton.hlods[0], [0.0; 3]), 5.0);
        assert_eq!(distance(&scene.skeleton.hlods[0], [3.0, 0.0, 4.0]), 0.0);
    }
}
