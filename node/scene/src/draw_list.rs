//! From front entries to draws.

use crate::backend::{Draw, Draws};
use crate::front::FrontEntry;
use protocol::format::{Blob, Class, Hlod, Part, Skeleton};
use protocol::id::{BlobId, HlodId};

/// The draws of `entries` for an eye, one a part, in the lists of the classes they have.
///
/// Solid ones go by (kind of the blob, blob, hlod, part): instances of a mesh follow each other, and
/// what one pipeline draws mostly does. Backends draw a blob's instances class by class, so triangles
/// are drawn by (kind, blob, class, hlod, part). Where two surfaces have the same depth the later one
/// wins (GreaterEqual). Nothing in that order depends on what else is drawn, and no part of it on more
/// than one blob. So a culled list is the whole one with draws left out, and those win nowhere, being
/// hidden everywhere: the picture is the same, bit for bit. So is one drawn in stretches of whole blobs.
///
/// What blends goes far to near by the middles of the hlods' boxes, at one distance by (blob, hlod, part):
/// culling takes draws out of that order, too, and changes none of the rest.
///
/// Draws too far away for f32 are left out: they cover no pixel.
pub fn draw_list(skeleton: &Skeleton, entries: &[FrontEntry], eye: [f64; 3]) -> Draws {
    let draws_of = |entry: &FrontEntry| {
        let parts = skeleton.parts_of(&skeleton.levels[entry.level as usize]);
        let hlod = entry.hlod;
        let distance = distance(skeleton.hlod(hlod), eye);
        parts.iter().map(move |part| Draw { distance, ..draw_of(skeleton, hlod, part, eye) })
    };
    let mut all: Vec<Draw> = entries
        .iter()
        .flat_map(draws_of)
        .filter(|draw| {
            draw.linear.iter().flatten().chain(&draw.offset).all(|number| number.is_finite())
        })
        .collect();
    // Stable, as all that follow: the parts of an hlod that share a mesh keep their order.
    all.sort_by_key(|draw| (draw.blob, draw.item));
    let has = |draw: &&Draw, wanted: fn(Class) -> bool| {
        let blob = skeleton.blob(draw.blob);
        Class::ALL.into_iter().any(|class| wanted(class) && blob.has(class))
    };
    let mut solid: Vec<Draw> =
        all.iter().filter(|draw| has(draw, |class| !class.is_blend())).copied().collect();
    solid.sort_by_key(|draw| kind(skeleton.blob(draw.blob)));
    let mut blending: Vec<Draw> =
        all.iter().filter(|draw| has(draw, Class::is_blend)).copied().collect();
    blending.sort_by(|a, b| b.distance.total_cmp(&a.distance));
    Draws { solid, blending }
}

/// Tells blobs apart that need different pipelines for what is solid; what has holes comes last.
fn kind(blob: &Blob) -> u32 {
    let solid = Class::ALL.into_iter().filter(|&class| !class.is_blend() && blob.has(class));
    let classes: u32 = solid.map(|class| 1 << class as u32).sum();
    classes << 1 | u32::from(blob.is_textured())
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
        disparity_step: 0.0,
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

    /// A scene whose parts share few meshes, and its finest front.
    fn scene_of_instances() -> (RandomScene, Vec<FrontEntry>, [f64; 3]) {
        let mut scene = RandomScene::new(7, 4, 64.0);
        let camera = scene.camera();
        let size = PictureSize { width: 64, height: 64 };
        for part in &mut scene.skeleton.parts {
            part.blob %= 30;
        }
        let entries = front(&scene.skeleton, &camera, size, 0.0).entries;
        (scene, entries, camera.eye)
    }

    #[test]
    fn a_culled_list_is_the_whole_one_with_draws_left_out() {
        let (mut scene, entries, eye) = scene_of_instances();
        assert_eq!(draw_list(&scene.skeleton, &[], eye), Draws::default());
        let all = draw_list(&scene.skeleton, &entries, eye);
        assert!(all.solid.len() > 10 && all.blending.len() > 10);
        let some: Vec<_> = entries.iter().filter(|_| scene.rng.random_bool(0.5)).copied().collect();
        let culled = draw_list(&scene.skeleton, &some, eye);
        for (all, culled) in [(&all.solid, &culled.solid), (&all.blending, &culled.blending)] {
            let mut rest = all.iter();
            assert!(culled.len() < all.len());
            assert!(culled.iter().all(|draw| rest.any(|other| other == draw)));
        }
    }

    #[test]
    fn kinds_and_blobs_stay_together_and_what_blends_goes_far_to_near() {
        let (scene, entries, eye) = scene_of_instances();
        let Draws { solid, blending } = draw_list(&scene.skeleton, &entries, eye);
        let blob = |draw: &Draw| scene.skeleton.blob(draw.blob);
        assert!(solid.is_sorted_by_key(|draw| (kind(blob(draw)), draw.blob, draw.item)));
        let kinds = solid.chunk_by(|a, b| kind(blob(a)) == kind(blob(b))).count();
        assert!(kinds > 3 && kinds < 30, "{kinds}");
        assert!(blending.is_sorted_by(|a, b| {
            (-a.distance, a.blob, a.item) <= (-b.distance, b.blob, b.item)
        }));
        let blends = |draw: &Draw| Class::ALL.iter().any(|c| c.is_blend() && blob(draw).has(*c));
        assert!(blending.iter().all(blends));
        assert!(solid.iter().any(blends) && !solid.iter().all(blends));
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
        let here = draw_list(&scene.skeleton, &everything, eye).solid;
        let away = |c: f64| c + f64::from(1 << 23);
        for part in &mut scene.skeleton.parts {
            part.transform = protocol::format::NONE;
        }
        let unplaced = draw_list(&scene.skeleton, &everything, eye).solid;
        assert_ne!(here, unplaced);
        for blob in &mut scene.skeleton.blobs {
            blob.origin = blob.origin.map(away);
        }
        let far = draw_list(&scene.skeleton, &everything, eye.map(away)).solid;
        for (a, b) in far.iter().zip(&unplaced) {
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
        let Draws { solid, blending } = draw_list(&scene.skeleton, &entries, [0.0; 3]);
        let blending_alone = blending.iter().filter(|draw| !solid.contains(draw)).count();
        assert_eq!(solid.len() + blending_alone, finite);
        // The root's box, seen from three and four away.
        scene.skeleton.hlods[0].min = [2.0, -1.0, 3.0];
        scene.skeleton.hlods[0].max = [4.0, 1.0, 5.0];
        assert_eq!(distance(&scene.skeleton.hlods[0], [0.0; 3]), 5.0);
        assert_eq!(distance(&scene.skeleton.hlods[0], [3.0, 0.0, 4.0]), 0.0);
    }
}
