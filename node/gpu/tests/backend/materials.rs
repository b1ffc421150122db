//! Textures, holes, blending and single-sided faces: the driver against the rasteriser in Rust.

use crate::support::{Mesh, backend, draw, items, lists, picture, shade, vertex, view};
use protocol::format::texture::mips;
use protocol::format::vertex::Layout;
use protocol::format::{Blob, Class, NONE, Texture, TexturedVertex, Wrap};
use protocol::id::BlobId;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::cpu::CpuBackend;
use scene::backend::{Backend, Draw, NO_ITEM, Part, Picture, Shading, Upload, upload_textures};

const WIDTH: u32 = 127;
const HEIGHT: u32 = 95;
const RED: u32 = 0x8000_00ff;
const GREEN: u32 = 0x8000_ff00;

/// Both backends with the same textures and meshes.
struct Both {
    gpu: gpu::WgpuBackend,
    cpu: CpuBackend,
}

impl Both {
    fn new(textures: &[(u32, [Wrap; 2], Vec<u8>)]) -> Option<Self> {
        let mut both =
            Self { gpu: backend(WIDTH, HEIGHT)?, cpu: CpuBackend::new(view(WIDTH, HEIGHT).size) };
        let record = |(side, wrap, rgba): &(u32, [Wrap; 2], Vec<u8>)| {
            let bytes = mips(*side, rgba);
            let (length, wrap) = (bytes.len() as u64, Wrap::pack(*wrap));
            (Texture { offset: 0, bytes: length, side: *side, wrap, crc: 0, reserved: 0 }, bytes)
        };
        let made: Vec<_> = textures.iter().map(record).collect();
        let textures: Vec<_> = made.iter().map(|(texture, bytes)| (*texture, &bytes[..])).collect();
        let backends: [&mut dyn Backend; 2] = [&mut both.gpu, &mut both.cpu];
        for backend in backends {
            let upload = upload_textures(backend, &textures).expect("sound textures");
            assert_eq!(upload, Upload::Done);
        }
        Some(both)
    }

    fn upload(&mut self, id: u32, blob: &Blob, bytes: &[u8]) {
        let backends: [&mut dyn Backend; 2] = [&mut self.gpu, &mut self.cpu];
        for backend in backends {
            let upload = backend.upload(BlobId(id), blob, bytes).expect("a sound blob");
            assert_eq!(upload, Upload::Done);
        }
    }

    /// The unit square of one class; textured where there is a texture coordinate at its corner (1, 1).
    fn square(&mut self, id: u32, class: Class, color: u32, textured: Option<(u32, f32)>) {
        let corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]];
        let plain = corners.map(|corner| vertex(corner, [0.0, 0.0, 1.0], color));
        let mut mesh = Mesh { vertices: plain.to_vec(), indices: vec![0, 1, 2, 1, 3, 2] };
        let mut blob = Blob { vertices: 4, triangles: 2, classes: class.all(2), ..Blob::default() };
        let Some((texture, reach)) = textured else {
            return self.upload(id, &blob, &mesh.bytes());
        };
        blob.layout = Layout::Textured as u32;
        let vertices = [0, 1, 2, 3].map(|i| TexturedVertex {
            plain: plain[i],
            tex_coord: [corners[i][0] as f32 * reach, corners[i][1] as f32 * reach],
            texture,
            cutoff: if class.is_mask() { 0.5 } else { 0.0 },
        });
        mesh.vertices.clear();
        self.upload(id, &blob, &[bytemuck::cast_slice(&vertices), &mesh.bytes()].concat());
    }

    /// Draws with both and compares; the driver's picture.
    fn agree(&mut self, draws: &[Draw]) -> Picture {
        let (lit, of_cpu) = self.pictures(Shading::default(), draws);
        let depths = lit.depth.iter().flatten().zip(of_cpu.depth.iter().flatten());
        let depths = depths.filter(|(a, b)| (*a - *b).abs() > 1e-4).count();
        let colors = off(&lit, &of_cpu, 3);
        let (a, b) = self.pictures(Shading::Normals, draws);
        let normals = off(&a, &b, 1);
        let counts = format!("{colors} colours, {normals} normals and {depths} depths differ");
        eprintln!("{counts}");
        let most = (WIDTH * HEIGHT) as usize / 50;
        assert!([colors, normals, depths].iter().all(|&count| count <= most), "{counts}");
        lit
    }

    /// The driver's picture and the rasteriser's.
    fn pictures(&mut self, shading: Shading, draws: &[Draw]) -> (Picture, Picture) {
        let view = view(WIDTH, HEIGHT);
        let of_gpu = picture(&mut self.gpu, view, shading, draws);
        (of_gpu, picture(&mut self.cpu, view, shading, draws))
    }
}

/// Pixels that are off by more than so many steps.
fn off(a: &Picture, b: &Picture, steps: u8) -> usize {
    let pairs = a.rgba.chunks_exact(4).zip(b.rgba.chunks_exact(4));
    pairs.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > steps)).count()
}

/// Noise with alpha.
fn noise(side: u32, seed: u64) -> Vec<u8> {
    let mut random = StdRng::seed_from_u64(seed);
    (0..4 * side * side).map(|_| random.random_range(40..=255)).collect()
}

/// A floor that leads away from the eye.
fn floor(blob: u32) -> Draw {
    let mut draw = draw(blob, 1, [1.0; 3], [-6.0, -1.0, -14.0]);
    draw.linear = [[12.0, 0.0, 0.0], [0.0, 0.0, 13.5], [0.0, 1.0, 0.0]];
    draw
}

/// A wall of a width across the eye's line at a depth, its middle at `x`.
fn wall(blob: u32, width: f32, x: f32, depth: f32) -> Draw {
    draw(blob, blob, [width; 3], [x - width / 2.0, -width / 2.0, -depth])
}

#[test]
fn textures_in_perspective_agree_at_every_side_and_wrap() {
    let wraps = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];
    let sides = [1, 2, 8, 16, 32, 64, 256];
    let textures: Vec<_> = sides
        .into_iter()
        .flat_map(|side| wraps.map(|wrap| (side, [wrap, Wrap::Repeat], noise(side, 5))))
        .collect();
    let Some(mut both) = Both::new(&textures) else { return };
    let mut pictures = Vec::new();
    for (index, (side, wrap, _)) in (0..).zip(&textures) {
        both.square(index, Class::OpaqueDouble, u32::MAX, Some((index, 6.5)));
        eprintln!("{side} {wrap:?}");
        pictures.push(both.agree(&[floor(index)]).rgba);
    }
    // What repeats, clamps and mirrors differs.
    for of_side in pictures.chunks(3).skip(2) {
        assert!(of_side[0] != of_side[1] && of_side[1] != of_side[2] && of_side[0] != of_side[2]);
    }
    // Close up one pixel fills the view.
    both.square(99, Class::OpaqueDouble, 0xff80_c0ff, Some((6, 0.3)));
    both.agree(&[wall(99, 9.0, 0.0, 1.0)]);
    // No texture at all is white.
    both.square(98, Class::OpaqueDouble, 0xff80_c0ff, Some((NONE, 1.0)));
    both.square(97, Class::OpaqueDouble, 0xff80_c0ff, None);
    let bare = both.agree(&[wall(98, 3.0, 0.0, 2.0)]);
    assert_eq!(bare.rgba, both.agree(&[wall(97, 3.0, 0.0, 2.0)]).rgba);
}

#[test]
fn masks_have_holes_that_show_what_lies_behind() {
    // Two columns: there and not.
    let rgba = [[255u8, 255, 255, 255], [255, 255, 255, 0]].as_flattened().repeat(2);
    let Some(mut both) = Both::new(&[(2, [Wrap::Repeat; 2], rgba)]) else { return };
    both.square(0, Class::MaskDouble, RED | 0xff00_0000, Some((0, 4.0)));
    both.square(1, Class::OpaqueDouble, GREEN, None);
    let draws = [wall(0, 3.0, 0.0, 2.0), wall(1, 8.0, 0.0, 4.0)];
    let picture = both.agree(&draws);
    let count = |channel: usize| {
        picture.rgba.chunks(4).filter(|p| p[channel] > 90 && p[1 - channel] < 20).count()
    };
    assert!(count(0) > 1500 && count(1) > 1500, "{} {}", count(0), count(1));
    let shown = items(&mut both.gpu, view(WIDTH, HEIGHT), &draws);
    let of_cpu = items(&mut both.cpu, view(WIDTH, HEIGHT), &draws);
    let other = shown.iter().zip(&of_cpu).filter(|(a, b)| a != b).count();
    assert!(other * 50 < shown.len(), "{other}");
    for item in [0, 1] {
        assert!(shown.iter().filter(|&&id| id == item).count() > 1500, "{item}");
    }
}

#[test]
fn normals_are_those_of_what_is_there_and_does_not_blend() {
    let rgba = [[255u8, 255, 255, 255], [255, 255, 255, 0]].as_flattened().repeat(2);
    let Some(mut both) = Both::new(&[(2, [Wrap::Repeat; 2], rgba)]) else { return };
    both.square(0, Class::MaskDouble, u32::MAX, Some((0, 4.0)));
    both.square(1, Class::OpaqueDouble, u32::MAX, Some((0, 4.0)));
    both.square(2, Class::BlendDouble, RED, Some((0, 4.0)));
    both.square(3, Class::BlendSingle, GREEN, None);
    let solid = [wall(0, 3.0, 0.0, 2.0), floor(1)];
    let glass = [wall(2, 9.0, 0.0, 1.5), wall(3, 9.0, 0.0, 3.0)];
    let (alone, _) = both.pictures(Shading::Normals, &solid);
    let (behind, of_cpu) = both.pictures(Shading::Normals, &[&solid[..], &glass].concat());
    assert!(alone == behind && off(&behind, &of_cpu, 1) * 50 < (WIDTH * HEIGHT) as usize);
    let count = |code: [u8; 3]| alone.rgba.chunks(4).filter(|p| p[..3] == code).count();
    let [wall, floor, sky] = [[128, 128, 255], [128, 255, 128], [128; 3]].map(count);
    assert!([wall, floor, sky].iter().all(|&pixels| pixels > 1000), "{wall} {floor} {sky}");
}

#[test]
fn what_blends_is_laid_over_far_to_near_in_any_order_of_draws() {
    let Some(mut both) = Both::new(&[(8, [Wrap::Mirror; 2], noise(8, 2))]) else { return };
    both.square(0, Class::OpaqueDouble, u32::MAX, None);
    both.square(1, Class::BlendDouble, RED, None);
    both.square(2, Class::BlendSingle, GREEN, None);
    both.square(3, Class::BlendDouble, u32::MAX, Some((0, 2.0)));
    let back = wall(0, 9.0, 0.0, 6.0);
    let near = |blob, depth| wall(blob, 2.0, 0.0, depth);
    let pictures = [(2.0, 3.0), (3.0, 2.0)].map(|(red, green)| {
        let list = [back, near(1, red), near(2, green), wall(3, 4.0, 1.0, 4.0), near(1, 7.0)];
        let picture = both.agree(&list);
        let turned: Vec<Draw> = list.into_iter().rev().collect();
        assert_eq!(picture.rgba, both.agree(&turned).rgba);
        picture
    });
    // Which of two lies before the other shows; depth is the opaque wall's.
    let middle = ((HEIGHT / 2 * WIDTH + WIDTH / 2 - 12) * 4) as usize;
    let [red_near, green_near] = pictures.each_ref().map(|p| &p.rgba[middle..middle + 2]);
    assert!(
        red_near[0] > red_near[1] && green_near[1] > green_near[0],
        "{red_near:?} {green_near:?}"
    );
    assert_eq!(pictures[0].depth, pictures[1].depth);
    let depth = pictures[0].depth.as_ref().unwrap();
    assert!((depth[middle / 4] - 0.125 / 6.0).abs() < 1e-6);
    assert!(pictures[0].rgba.chunks(4).all(|pixel| pixel[3] == 255));
}

#[test]
fn what_blends_has_an_item_layer_of_its_own() {
    let Some(mut both) = Both::new(&[]) else { return };
    both.square(0, Class::OpaqueDouble, u32::MAX, None);
    both.square(1, Class::BlendDouble, RED, None);
    let draws = [wall(0, 20.0, 0.0, 6.0), wall(1, 2.0, 0.0, 2.0), wall(1, 2.0, 0.0, 7.0)];
    let layers = |backend: &mut dyn Backend| {
        let (view, draws, part) = (view(WIDTH, HEIGHT), lists(&draws), Part::WHOLE);
        let pass = scene::backend::Pass::Items { view, draws, part };
        backend.submit(pass).unwrap();
        let mut completions = Vec::new();
        backend.poll(&mut completions).unwrap();
        match completions.pop() {
            Some(scene::backend::Completion::Items { items, blended, .. }) => (items, blended),
            other => panic!("items expected, not {other:?}"),
        }
    };
    let (items, blended) = layers(&mut both.gpu);
    assert!((items.clone(), blended.clone()) == layers(&mut both.cpu));
    assert!(items.iter().all(|&id| id == 0));
    let glass = blended.iter().filter(|&&id| id == 1).count();
    assert!(glass > 500 && blended.iter().all(|&id| id == 1 || id == NO_ITEM), "{glass}");
}

#[test]
fn single_sided_faces_are_seen_from_their_front_mirrored_or_not() {
    let Some(mut both) = Both::new(&[(1, [Wrap::Clamp; 2], vec![255; 4])]) else { return };
    let classes = [Class::OpaqueSingle, Class::MaskSingle, Class::BlendSingle];
    for (id, class) in (0..).zip(classes) {
        both.square(id, class, u32::MAX, Some((0, 1.0)));
        let front = wall(id, 2.0, 0.0, 2.0);
        // Turned half about the line of sight's upright: seen from behind.
        let mut back = front;
        (back.linear[0], back.linear[2]) = ([-2.0, 0.0, 0.0], [0.0, 0.0, -2.0]);
        back.offset[0] += 2.0;
        // Mirrored: the corners turn, the front does not.
        let mut mirrored = front;
        mirrored.linear[0] = [-2.0, 0.0, 0.0];
        mirrored.offset[0] += 2.0;
        assert!(mirrored.is_mirrored() && !back.is_mirrored());
        let mut seen = |draw: Draw| {
            let sky = both.agree(&[]);
            let shown = both.agree(&[draw]);
            let pairs = shown.rgba.chunks(4).zip(sky.rgba.chunks(4));
            pairs.filter(|(a, b)| a != b).count()
        };
        let pixels = seen(front);
        assert!(pixels > 1000, "{class:?}: {pixels}");
        assert_eq!((seen(back), seen(mirrored)), (0, pixels), "{class:?}");
    }
}

#[test]
fn occluders_are_what_is_opaque_and_faces_the_eye() {
    use crate::support::{occluders, visible};
    let Some(mut both) = Both::new(&[(1, [Wrap::Clamp; 2], vec![255; 4])]) else { return };
    let behind = scene::backend::BoxQuery { min: [-0.25, -0.25, -4.0], max: [0.25, 0.25, -3.5] };
    for class in Class::ALL {
        both.square(0, class, u32::MAX, Some((0, 1.0)));
        let wall = wall(0, 2.0, 0.0, 2.0);
        let mut back = wall;
        (back.linear[0], back.offset[0]) = ([-2.0, 0.0, 0.0], 1.0);
        back.linear[2] = [0.0, 0.0, -2.0];
        for (wall, hides) in [(wall, class.is_opaque()), (back, class == Class::OpaqueDouble)] {
            let view = view(WIDTH, HEIGHT);
            let cull = protocol::settings::Cull::Queries;
            occluders(&mut both.gpu, view, &[wall]);
            occluders(&mut both.cpu, view, &[wall]);
            assert_eq!(visible(&mut both.gpu, view, &[behind], cull), [!hides], "{class:?}");
            assert_eq!(visible(&mut both.cpu, view, &[behind], cull), [!hides], "{class:?}");
        }
    }
}

#[test]
fn leaving_out_what_is_hidden_changes_no_bit() {
    let Some(mut both) = Both::new(&[(32, [Wrap::Repeat; 2], noise(32, 9))]) else { return };
    both.square(99, Class::OpaqueDouble, u32::MAX, None);
    let mut id = 0;
    for class in Class::ALL {
        for textured in [None, Some((0, 3.0))] {
            if textured.is_some() || !class.is_mask() {
                both.square(id, class, [RED, GREEN][id as usize % 2], textured);
                id += 1;
            }
        }
    }
    let mut random = StdRng::seed_from_u64(4);
    let mut draws = vec![wall(99, 40.0, 0.0, 5.0)];
    for item in 0..400 {
        let depth = [random.random_range(1.0..4.9), random.random_range(5.2..9.0)][item % 2];
        let size = random.random_range(0.1..0.5) * depth;
        let mut piece = wall(item as u32 % id, size, random.random_range(-0.9..0.9) * depth, depth);
        piece.offset[1] += random.random_range(-0.8..0.8) * depth;
        piece.distance = depth + random.random_range(-0.5..0.5);
        if random.random() {
            piece.linear[0][0] *= -1.0;
        }
        draws.push(piece);
    }
    draws.sort_by_key(|draw| (draw.blob, draw.item));
    let view = view(WIDTH, HEIGHT);
    let whole = shade(&mut both.gpu, view, &draws);
    for share in [0.3, 0.7, 1.0] {
        let hidden = |draw: &Draw| draw.offset[2] < -5.1;
        let culled: Vec<Draw> = draws
            .iter()
            .filter(|d| !hidden(d) || random.random_bool(1.0 - share))
            .copied()
            .collect();
        assert!(culled.len() < draws.len() - 20);
        assert!(shade(&mut both.gpu, view, &culled) == whole, "{share}");
    }
    both.agree(&draws);
}
