//! Box queries against a finished depth buffer.

use super::project::Projection;
use super::raster::{SUBPIXELS, Turns};
use super::target::{Depth, TileMinima};
use crate::backend::BoxQuery;
use std::ops::ControlFlow;

/// Corners by their bits (x 1, y 2, z 4); two triangles a face.
const FACES: [[usize; 3]; 12] = [
    [0, 2, 6],
    [0, 6, 4],
    [1, 3, 7],
    [1, 7, 5],
    [0, 1, 5],
    [0, 5, 4],
    [2, 3, 7],
    [2, 7, 6],
    [0, 1, 3],
    [0, 3, 2],
    [4, 5, 7],
    [4, 7, 6],
];

/// Relative room above the depths of the corners: far more than interpolation in f64 errs, so that a box
/// is only rejected whole if each of its pixels would be.
const ROOM: f64 = 1e-6;

/// Whether a pixel of the box, front faces or back, passes the depth test.
pub(super) fn is_visible(
    projection: &Projection,
    query: &BoxQuery,
    depth: &Depth,
    tiles: &TileMinima,
) -> bool {
    let sides = [query.min, query.max];
    let corners: [_; 8] = std::array::from_fn(|corner| {
        projection.clip(std::array::from_fn(|axis| f64::from(sides[corner >> axis & 1][axis])))
    });
    let placed = corners.map(|corner| projection.place(corner));
    if placed.iter().all(|corner| corner.on_grid()) {
        let screen = placed.map(|corner| corner.screen);
        let pixels = |coordinates: [i32; 8], limit: u32| {
            let first = i64::from(coordinates.into_iter().fold(i32::MAX, i32::min));
            let last = i64::from(coordinates.into_iter().fold(i32::MIN, i32::max));
            let limit = i64::from(limit) - 1;
            let (first, last) = (first.div_euclid(SUBPIXELS), last.div_euclid(SUBPIXELS));
            (first <= limit && last >= 0).then(|| (first.max(0) as u32, last.min(limit) as u32))
        };
        let across = pixels(screen.map(|corner| corner.x), projection.size.width);
        let down = pixels(screen.map(|corner| corner.y), projection.size.height);
        let (Some((x0, x1)), Some((y0, y1))) = (across, down) else {
            return false;
        };
        let nearest = screen.iter().fold(0.0f64, |nearest, corner| nearest.max(corner.z));
        if depth.hides((nearest * (1.0 + ROOM)) as f32, [x0, x1, y0, y1], tiles) {
            return false;
        }
    }
    FACES.iter().any(|face| {
        projection
            .triangle(
                face.map(|corner| placed[corner]),
                Turns::Either,
                |k| corners[face[k]],
                |span| {
                    if depth.any_passes(&span, tiles) {
                        ControlFlow::Break(())
                    } else {
                        ControlFlow::Continue(())
                    }
                },
            )
            .is_break()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::{Backend, Completion, Part, Pass, Shading, View};
    use crate::draw_list::draw_list;
    use crate::front::front;
    use crate::occludee::{BoxTest, BoxTests, Rules};
    use crate::random_scene::RandomScene;
    use protocol::settings::PictureSize;

    /// The depth a box writes.
    fn box_depth(view: &View, query: &BoxQuery) -> Vec<f32> {
        let projection = Projection::new(view);
        let mut depth = Depth::new(view.size, true);
        let sides = [query.min, query.max];
        let corners: [_; 8] = std::array::from_fn(|i| {
            projection.clip(std::array::from_fn(|axis| f64::from(sides[i >> axis & 1][axis])))
        });
        for face in FACES {
            let placed = face.map(|i| projection.place(corners[i]));
            let _ = projection.triangle(
                placed,
                Turns::Either,
                |k| corners[face[k]],
                |span| {
                    depth.write(&span);
                    ControlFlow::Continue(())
                },
            );
        }
        depth.into_pixels()
    }

    /// Pixels an hlod writes, and those of them its box does not reach in front of.
    fn uncovered(scene: &mut RandomScene, size: PictureSize, rules: &Rules) -> (usize, usize) {
        let camera = scene.camera();
        let view = View::new(&camera, size);
        let mut backend = scene.backend(size, rules);
        let (mut written, mut uncovered) = (0, 0);
        for entry in front(&scene.skeleton, &camera, size, 1.0).entries {
            let hlod = scene.skeleton.hlod(entry.hlod);
            let tests = BoxTests::new(&camera, size, backend.precision(), *rules);
            let test = tests.test(hlod, scene.skeleton.longest_edge(hlod));
            let BoxTest::Query(query) = test else { continue };
            let draws = draw_list(&scene.skeleton, &[entry], camera.eye);
            let pass = Pass::Shade {
                view,
                shading: Shading::default(),
                draws,
                with_depth: true,
                part: Part::WHOLE,
            };
            backend.submit(pass).unwrap();
            let mut completions = Vec::new();
            backend.poll(&mut completions).unwrap();
            let Some(Completion::Picture { picture, .. }) = completions.pop() else {
                panic!("no picture");
            };
            let geometry = picture.depth.unwrap();
            for (z, of_box) in geometry.into_iter().zip(box_depth(&view, &query)) {
                written += usize::from(z > 0.0);
                uncovered += usize::from(z > 0.0 && of_box < z);
            }
        }
        (written, uncovered)
    }

    #[test]
    fn every_pixel_of_an_hlod_lies_behind_its_box() {
        let (mut written, mut without_growth) = (0, 0);
        for seed in 0..240u64 {
            let scale = [1.0 / 1024.0, 1.0, 8192.0][seed as usize % 3];
            let sizes = [(1, 1), (7, 333), (96, 61)];
            let (width, height) = sizes[seed as usize / 3 % 3];
            let size = PictureSize { width, height };
            let mut scene = RandomScene::new(seed, 2, scale);
            let (pixels, bad) = uncovered(&mut scene, size, &Rules::default());
            assert_eq!(bad, 0, "seed {seed}");
            written += pixels;
            let mut scene = RandomScene::new(seed, 2, scale);
            without_growth +=
                uncovered(&mut scene, size, &Rules { grow: false, ..Rules::default() }).1;
        }
        assert!(written > 8000 && without_growth > 200, "{written} {without_growth}");
    }
}
