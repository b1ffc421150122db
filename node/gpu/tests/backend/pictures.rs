//! The shading rule, depth, and what pictures must not depend on.

use crate::support::{
    Mesh, NEAR, backend, cube_over, draw, items, picture, random_box, shade, view,
};
use rand::SeedableRng;
use rand::rngs::StdRng;
use scene::backend::{Draw, Shading, light, normal};

fn srgb_byte(linear: f32) -> u8 {
    let encoded =
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

/// The middle pixel of a wall with a normal, drawn with columns `linear`.
fn wall_pixel(shading: Shading, normal: [f32; 3], linear: [[f32; 3]; 3]) -> Option<[u8; 4]> {
    let mut backend = backend(9, 9)?;
    Mesh::square(normal, u32::from_le_bytes([255, 128, 0, 7])).upload(&mut backend, 0);
    let corner = |k: usize| -0.5 * (linear[0][k] + linear[1][k]);
    let wall =
        Draw { linear, offset: [corner(0), corner(1), -1.0], ..draw(0, 0, [1.0; 3], [0.0; 3]) };
    let picture = picture(&mut backend, view(9, 9), shading, &[wall]);
    let depth = picture.depth.expect("asked for depth")[40];
    assert!((depth - NEAR).abs() < 1e-6, "depth of a wall at distance 1: {depth}");
    Some(picture.rgba[160..164].try_into().expect("four bytes"))
}

fn check_wall(normal: [f32; 3], linear: [[f32; 3]; 3], scene_normal: [f32; 3]) {
    let lit = |sun| {
        let factor = light::intensity(scene_normal, sun);
        [1.0, 128.0 / 255.0, 0.0].map(|base| srgb_byte(base * factor))
    };
    let other_sun = [-0.48, 0.6, 0.64];
    let Shading::Lit { sun } = Shading::default() else { panic!("lit by default") };
    for (shading, expected) in [
        (Shading::Lit { sun }, lit(sun)),
        (Shading::Lit { sun: other_sun }, lit(other_sun)),
        (Shading::Normals, normal::encode(scene_normal)),
    ] {
        let Some(found) = wall_pixel(shading, normal, linear) else { return };
        for (a, b) in found.iter().zip(expected) {
            let off = a.abs_diff(b);
            assert!(off <= 1, "{shading:?}: {found:?}, not {expected:?}, normal {scene_normal:?}");
        }
        assert_eq!(found[3], 255, "opaque");
    }
}

#[test]
fn light_follows_the_rule() {
    let plain = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    let unit = |v: [f32; 3]| {
        let length = v.iter().map(|c| c * c).sum::<f32>().sqrt();
        v.map(|c| c / length)
    };
    let slanted = unit([0.5, 0.25, 0.7]);
    check_wall([0.0, 0.0, 1.0], plain, [0.0, 0.0, 1.0]);
    check_wall(slanted, plain, slanted);
    // Both sides alike.
    check_wall(slanted.map(|c| -c), plain, slanted);
    check_wall([0.0, 0.0, -1.0], plain, [0.0, 0.0, 1.0]);
    // Normals follow the cofactors: twice as wide in x, half the slope in x.
    let wide = [[8.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    check_wall(slanted, wide, unit([0.25, 0.25, 0.7]));
    // A mirror image.
    let mirrored = [[-4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    check_wall(slanted, mirrored, unit([-0.5, 0.25, 0.7]));
    // No third dimension to speak of, as in a grid of tiny steps.
    let flat = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4e-12]];
    check_wall([0.0, 0.0, 1.0], flat, [0.0, 0.0, 1.0]);
}

#[test]
fn tiny_grid_steps_keep_their_light() {
    let Some(mut backend) = backend(9, 9) else { return };
    let white = Mesh::square([0.0, 0.0, 1.0], u32::MAX);
    white.upload(&mut backend, 0);
    // The near plane and everything behind it scaled down by 2^-70.
    let small = (-70f32).exp2();
    let mut tiny = view(9, 9);
    tiny.clip_from_eye[3][2] *= small;
    let shown = |backend: &mut _, view, scale: f32| {
        let offset = [-2.0 * scale, -2.0 * scale, -scale];
        shade(backend, view, &[draw(0, 0, [4.0 * scale; 3], offset)]).rgba
    };
    assert_eq!(shown(&mut backend, tiny, small), shown(&mut backend, view(9, 9), 1.0));
}

fn crowd() -> Vec<Draw> {
    let mut random = StdRng::seed_from_u64(3);
    (0..300).map(|i| cube_over(i % 2, i, &random_box(&mut random, 64..900, 100))).collect()
}

#[test]
fn the_same_pass_gives_the_same_bits() {
    let Some(mut first) = backend(127, 65) else { return };
    let Some(mut other) = backend(127, 65) else { return };
    let view = view(127, 65);
    for backend in [&mut first, &mut other] {
        Mesh::cube(0xff20_80c0).upload(backend, 0);
        Mesh::cube(0xffc0_4020).upload(backend, 1);
    }
    let expected = shade(&mut first, view, &crowd());
    items(&mut first, view, &crowd()[..10]);
    assert!(shade(&mut first, view, &crowd()) == expected, "again");
    assert!(shade(&mut other, view, &crowd()) == expected, "on another device");
}

#[test]
fn instances_give_the_bits_of_single_draws() {
    let Some(mut backend) = backend(127, 65) else { return };
    let view = view(127, 65);
    // Blob 1 is the same mesh: alternating between the two makes every draw a call of its own.
    Mesh::cube(0xff20_80c0).upload(&mut backend, 0);
    Mesh::cube(0xff20_80c0).upload(&mut backend, 1);
    let single = crowd();
    let instanced: Vec<Draw> =
        single.iter().map(|draw| Draw { blob: protocol::id::BlobId(0), ..*draw }).collect();
    assert!(shade(&mut backend, view, &single) == shade(&mut backend, view, &instanced));
    let ids = items(&mut backend, view, &single);
    assert_eq!(ids, items(&mut backend, view, &instanced));
    let mut distinct = ids;
    distinct.sort_unstable();
    distinct.dedup();
    assert!(distinct.len() > 50, "{} items seen", distinct.len());
}

#[test]
fn items_and_pictures_share_their_depth() {
    let Some(mut backend) = backend(127, 65) else { return };
    let view = view(127, 65);
    Mesh::cube(0xff20_80c0).upload(&mut backend, 0);
    Mesh::cube(0xffc0_4020).upload(&mut backend, 1);
    let ids = items(&mut backend, view, &crowd());
    let depth = shade(&mut backend, view, &crowd()).depth.unwrap();
    assert!(ids.iter().zip(&depth).all(|(&id, &z)| (id == u32::MAX) == (z == 0.0)));
    assert!(depth.iter().all(|z| (0.0..=1.0).contains(z)));
}
