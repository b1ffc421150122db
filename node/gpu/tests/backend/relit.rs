//! Faces of scan cubes under another sun than they were taken under: by their normals, if they have any, and by
//! both backends alike.

use crate::faces::{Both, FULL, Face, PIXELS, SIDE, VIEW, seen};
use crate::projected::{off, random_face};
use protocol::format::projected::Patch;
use protocol::format::texture::srgb_to_linear;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::{Draw, Shading, light};

/// Behind the viewer and to the right; behind what is seen, where most of it has only ambient light.
const SUNS: [[f32; 3]; 2] = [[0.6, 0.0, 0.8], [0.0, -0.8, -0.6]];

/// A face that looks along -z, turned by so many quarters of a circle: its right and up, and how it is drawn as blob
/// 0 from its sample's eye.
fn turned(quarters: u32) -> ([[f32; 3]; 2], Draw) {
    let [right, up] = [[0, 1], [1, 2], [2, 3], [3, 0]][quarters as usize].map(|at: usize| {
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0f32]][at]
    });
    let unit = (2.0 / f64::from(FULL)) as f32;
    let draw = Draw {
        linear: [right.map(|c| c * unit), up.map(|c| -c * unit), [0.0; 3]],
        offset: std::array::from_fn(|k| up[k] - right[k] + [0.0, 0.0, -1.0][k]),
        ..seen(0, [0.0; 3])
    };
    ([right, up], draw)
}

fn encoded(linear: f32) -> u8 {
    let s =
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (s * 255.0).round() as u8
}

/// What its own eye sees of such a face under a sun, as its bytes say.
fn expected(face: &Face, [right, up]: [[f32; 3]; 2], sun: [f32; 3]) -> Vec<u8> {
    let (blob, bytes) = face.blob();
    let patch = Patch::of(&blob, &bytes);
    let pixel = |at: u32| {
        // From the middle of the picture, in half pixels, to the right and up.
        let place =
            [2 * (at % SIDE), 2 * (SIDE - 1 - at / SIDE)].map(|c| c as i32 - SIDE as i32 + 1);
        let along = |axis: [f32; 3]| place[0] * axis[0] as i32 + place[1] * axis[1] as i32;
        let [u, v] = [along(right), -along(up)].map(|c| (c + SIDE as i32 - 1) as u32 / 2);
        let n = patch.normal(u, v).expect("all tiles are stored");
        let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
        let n: [f32; 3] = std::array::from_fn(|k| {
            (right[k] * n[0] + up[k] * n[1] + [0.0, 0.0, n[2]][k]) / length
        });
        let factor = light::intensity(n, sun) / light::intensity(n, light::baked_sun());
        let [r, g, b] = patch.pixel(u, v).map(|code| encoded(srgb_to_linear(code) * factor));
        [r, g, b, u8::MAX]
    };
    (0..SIDE * SIDE).flat_map(pixel).collect()
}

#[test]
fn a_face_is_lit_again_however_it_is_turned() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(21));
    for quarters in 0..4 {
        let face = Face::whole(random, 0.25, 0.0).with_normals(random);
        both.face(0, &face);
        let (axes, draw) = turned(quarters);
        for sun in SUNS {
            let expected = expected(&face, axes, sun);
            for picture in both.pictures(Shading::Lit { sun }, &[draw]) {
                assert_eq!(off(&picture.rgba, &expected, 1), 0, "{quarters} {sun:?}");
            }
        }
    }
}

#[test]
fn normals_change_no_bit_under_the_sun_of_the_bake() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(22));
    let draw = seen(0, [0.2, -0.1, 0.4]);
    for _ in 0..4 {
        let bare = random_face(random, 60);
        both.face(0, &bare);
        let stored = both.shade(&[draw]);
        // Without normals the light stays, whatever the sun.
        assert!(both.pictures(Shading::Lit { sun: SUNS[0] }, &[draw]) == stored);
        both.face(0, &bare.with_normals(random));
        assert!(both.shade(&[draw]) == stored);
        let moved = both.pictures(Shading::Lit { sun: SUNS[0] }, &[draw]);
        for (moved, stored) in moved.iter().zip(&stored) {
            assert!(off(&moved.rgba, &stored.rgba, 1) > 200);
            assert_eq!(moved.depth, stored.depth);
        }
    }
}

#[test]
fn light_is_laid_on_before_the_filter() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(23));
    // Gray; the left half looks to the left, the right half to the right.
    let mut face = Face::whole(random, 0.25, 0.0);
    face.tiles.fill(Some([[0xef, 0x7b, 0xef, 0x7b, 0, 0, 0, 0]; 16]));
    let across = |at: usize| if at % 4 < 2 { 1 } else { 255 };
    let of_tile = |at| [[across(at), 128, across(at), 128, 0, 0, 0, 0]; 16];
    face.normals = Some((0..face.tiles.len()).map(of_tile).collect());
    both.face(0, &face);
    let sun = [1.0, 0.0, 0.0];
    // From so near by that a pixel of the face takes eight of the view's.
    let near = seen(0, [0.0, 0.0, 3.5]);
    let [left, right] = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]].map(|n| {
        let factor = light::intensity(n, sun) / light::intensity(n, light::baked_sun());
        srgb_to_linear(123) * factor
    });
    for picture in both.pictures(Shading::Lit { sun }, &[near]) {
        let row = &picture.rgba[4 * PIXELS / 2..][..4 * VIEW as usize];
        let ends = [row[0], row[4 * VIEW as usize - 4]];
        for (end, linear) in ends.into_iter().zip([left, right]) {
            assert!(end.abs_diff(encoded(linear)) <= 1, "{end} {linear}");
        }
        // Half a pixel of the view beyond the middle.
        let (middle, share) = (row[4 * (VIEW as usize / 2)], 0.5 + 0.5 / 8.0);
        let expected = encoded(left * (1.0 - share) + right * share);
        assert!(middle.abs_diff(expected) <= 1, "{middle}, not {expected}");
    }
}

#[test]
fn random_faces_are_lit_alike() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(24));
    let (mut different, mut covered) = (0, 0);
    for round in 0..12 {
        for id in 0..3 {
            let mut face = random_face(random, 40).with_normals(random);
            // Soft blocks: the driver's corners lie on another raster.
            for block in face.normals.iter_mut().flatten().flatten() {
                let ends = [0; 2].map(|_| random.random_range(100..156u8));
                (block[0], block[1]) = (ends[0], ends[1]);
                (block[2], block[3]) = (ends[0] + 4, ends[1] - 4);
            }
            both.face(id, &face);
        }
        let draws = [0, 1, 2].map(|id| seen(id, [0.0; 3].map(|_| random.random_range(-0.4..0.4))));
        let pictures = both.pictures(Shading::Lit { sun: SUNS[round % 2] }, &draws);
        let [a, b] = &pictures[..] else { return };
        different += off(&a.rgba, &b.rgba, 3);
        covered += a.depth.iter().flatten().filter(|&&z| z > 0.0).count();
    }
    eprintln!("{different} colours of {covered} pixels differ");
    assert!(covered > 10_000 && different * 50 <= covered, "{different} of {covered}");
}
