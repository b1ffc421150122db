//! Faces of scan cubes: what both backends make of them, and both alike.

use crate::faces::{
    ACROSS, Both, FULL, Face, PIXELS, SIDE, STEP, VIEW, corner, plain, point, seen,
};
use crate::support::{
    Mesh, NEAR, backend_within, draw, lit_with_depth, occluders, plain_blob, run, shade, vertex,
    view, visible,
};
use protocol::format::texture::mips;
use protocol::format::vertex::Layout;
use protocol::format::{Blob, Class, Texture, TexturedVertex, projected};
use protocol::id::BlobId;
use protocol::settings::Cull;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::cpu::CpuBackend;
use scene::backend::{
    Backend, BoxQuery, Completion, Draw, Draws, NO_ITEM, Part, Pass, Picture, Shading, Upload,
    upload_textures,
};

/// Pixels that are off by more than so many levels of a channel.
pub(crate) fn off(a: &[u8], b: &[u8], levels: u8) -> usize {
    let differs = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > levels);
    a.chunks_exact(4).zip(b.chunks_exact(4)).filter(differs).count()
}

/// The picture of a face as its bytes say.
fn decoded(face: &Face) -> Vec<u8> {
    let (blob, bytes) = face.blob();
    let parts = projected::Patch::of(&blob, &bytes);
    let pixel = |at: u32| {
        let [r, g, b] = parts.pixel(at % SIDE, at / SIDE);
        [r, g, b, u8::MAX]
    };
    (0..SIDE * SIDE).flat_map(pixel).collect()
}

#[test]
fn a_sample_s_own_eye_sees_its_picture() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(1));
    for (disparity, slope) in [(0.5, 0.0), (0.125, 3.0), (2.0, -1.75), (0.0, 0.0), (0.0, 1.0)] {
        let face = Face::whole(random, disparity, slope);
        both.face(0, &face);
        for picture in both.shade(&[seen(0, [0.0; 3])]) {
            assert_eq!(off(&picture.rgba, &decoded(&face), 1), 0, "{disparity} {slope}");
            for (at, z) in picture.depth.unwrap().into_iter().enumerate() {
                let v = (at / VIEW as usize) as f64 + 0.5;
                let expected = (disparity + slope * v / f64::from(VIEW)) * f64::from(NEAR);
                assert!((f64::from(z) - expected).abs() < 1e-5, "{at}: {z} {expected}");
            }
        }
    }
}

fn depth(picture: &Picture) -> &[f32] {
    picture.depth.as_deref().expect("asked for")
}

/// Pixels covered by one of two draws alone, by both, and of those such as differ in depth.
fn compared(a: &Picture, b: &Picture) -> [usize; 3] {
    let (a, b) = (depth(a), depth(b));
    let mut counts = [0; 3];
    for at in 0..PIXELS {
        match (a[at] > 0.0, b[at] > 0.0) {
            (true, true) => {
                counts[1] += 1;
                // Drivers move ordinary meshes away from the eye by a part of their steepness.
                let beside = if at % VIEW as usize == 0 { at + 1 } else { at - 1 };
                let below =
                    if at < VIEW as usize { at + VIEW as usize } else { at - VIEW as usize };
                let steep = (a[at] - a[beside]).abs().max((a[at] - a[below]).abs());
                counts[2] += usize::from((a[at] - b[at]).abs() > 1e-5 + steep / 16.0);
            }
            (one, other) => counts[0] += usize::from(one != other),
        }
    }
    counts
}

/// Triangles of a face from an eye that stands elsewhere: as projected ones and as ordinary ones, which lie
/// at the same places. Some cross the near plane, some lie behind the eye.
#[test]
fn a_moved_eye_sees_what_an_ordinary_mesh_shows() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(2));
    both.mesh(1, &corner());
    let (mut sums, mut crossing, mut behind) = ([0; 3], 0, 0);
    for round in 0..150 {
        let c = [[0.3, -0.2, 0.25], [0.1, 0.2, 2.0], [-0.5, 0.1, -0.75]][round % 3];
        let corners: Vec<[u32; 3]> = (0..3)
            .map(|_| {
                let disparity = 2.0f64.powf(random.random_range(-3.0..1.0));
                let mut place = || random.random_range(0..=FULL);
                [place(), place(), (disparity / STEP) as u32]
            })
            .collect();
        let points = [0, 1, 2].map(|k| point(c, corners[k]));
        both.face(0, &Face::new(random, corners));
        let pictures = both.shade(&[seen(0, c)]).into_iter();
        for (a, b) in pictures.zip(both.shade(&[plain(1, 1, points)])) {
            assert!(depth(&a).iter().all(|&z| z < 1.0 + 1e-6), "{round}: before the near plane");
            let counts = compared(&a, &b);
            sums = std::array::from_fn(|k| sums[k] + counts[k]);
            let depths = points.map(|p| -p[2]);
            let hidden = depths.iter().filter(|&&depth| depth < f64::from(NEAR)).count();
            behind += usize::from(hidden == 3);
            crossing += usize::from(hidden % 3 != 0 && counts[1] > 20);
            assert!(hidden < 3 || counts[0] + counts[1] == 0, "{round}: seen behind the eye");
        }
    }
    eprintln!(
        "{sums:?} pixels: one alone, both, at another depth; {crossing} cross, {behind} behind"
    );
    let [alone, common, other] = sums;
    assert!(common > 20_000 && crossing > 10 && behind > 4, "{common} {crossing} {behind}");
    assert!(alone * 1000 <= common && other * 1000 <= common, "{alone} {other} of {common}");
}

/// The texture stays where the sample saw it: a slanted plane, half of whose picture is white.
#[test]
fn the_picture_lies_where_the_sample_saw_it() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(3));
    let mut face = Face::whole(random, 0.125, 1.5);
    let color = |white: bool| [if white { 0xff } else { 0 }; 4];
    for (at, tile) in face.tiles.iter_mut().enumerate() {
        let [a, b, c, d] = color((at / ACROSS + at % ACROSS).is_multiple_of(2));
        *tile = Some([[a, b, c, d, 0, 0, 0, 0]; 16]);
    }
    both.face(0, &face);
    let c = [0.2, 0.35, 0.3];
    for picture in both.shade(&[seen(0, c)]) {
        let (mut checked, mut wrong) = (0, 0);
        for at in 0..PIXELS {
            let z = f64::from(depth(&picture)[at]);
            if z == 0.0 {
                continue;
            }
            // The point at this pixel, from the sample.
            let z = f64::from(NEAR) / z;
            let center = |at: usize| (at as f64 + 0.5) / f64::from(VIEW) * 2.0 - 1.0;
            let (x, y) = (center(at % VIEW as usize), -center(at / VIEW as usize));
            let from_sample = [x * z - c[0], y * z - c[1], -z - c[2]];
            let place = [from_sample[0], -from_sample[1]]
                .map(|side| (side / -from_sample[2] + 1.0) * f64::from(SIDE) / 2.0);
            let tiles = place.map(|at| at / f64::from(projected::TILE));
            if tiles.iter().any(|at| (at - at.round()).abs() < 0.1) {
                continue;
            }
            checked += 1;
            let white = (tiles[0] as u32 + tiles[1] as u32).is_multiple_of(2);
            wrong += usize::from(picture.rgba[4 * at] != color(white)[0]);
        }
        assert!(checked > 800 && wrong == 0, "{wrong} of {checked}");
    }
}

#[test]
fn a_face_has_no_normals_and_hides_those_behind_it() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(12));
    both.face(0, &Face::whole(random, 0.25, 0.0));
    both.mesh(1, &Mesh::square([0.0, 0.0, 1.0], !0));
    let wall = draw(1, 11, [9.0; 3], [-9.0, -4.0, -3.0]);
    for picture in both.pictures(Shading::Normals, &[wall, seen(0, [0.0; 3])]) {
        for (at, pixel) in picture.rgba.chunks(4).enumerate() {
            let left = at % (VIEW as usize) < VIEW as usize / 2;
            assert_eq!(pixel, [128, 128, if left { 255 } else { 128 }, 255], "{at}");
        }
    }
}

#[test]
fn what_is_at_infinity_lies_over_the_sky_and_behind_all_else() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(4));
    let face = Face::whole(random, 0.0, 0.0);
    both.face(0, &face);
    both.mesh(1, &Mesh::square([0.0, 0.0, 1.0], 0xff00_00ff));
    // However far the eye went.
    let far = seen(0, [300.0, -20.0, 1000.0]);
    for picture in both.shade(&[far]) {
        assert_eq!(off(&picture.rgba, &decoded(&face), 1), 0);
        assert_eq!(picture.depth.unwrap(), vec![0.0; PIXELS]);
    }
    let wall = draw(1, 7, [1e6, 2e6, 1.0], [0.0, -1e6, -9e5]);
    for order in [[far, wall], [wall, far]] {
        for items in both.items(&order) {
            for (at, item) in items.into_iter().enumerate() {
                let right = at % VIEW as usize >= VIEW as usize / 2;
                assert_eq!(item, if right { 7 } else { 0 }, "{at}");
            }
        }
    }
}

#[test]
fn near_and_far_of_both_kinds_hide_each_other_in_any_order() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(5));
    both.face(0, &Face::whole(random, 0.25, 0.0));
    both.mesh(1, &Mesh::square([0.0, 0.0, 1.0], !0));
    // The face lies at 4; a square before it over the left, one behind it over all.
    let near = draw(1, 11, [9.0; 3], [-9.0, -4.0, -3.0]);
    let far = draw(1, 12, [40.0; 3], [-20.0, -20.0, -5.0]);
    let face = seen(0, [0.0; 3]);
    for order in [[near, far, face], [face, near, far], [far, face, near]] {
        for items in both.items(&order) {
            for (at, item) in items.into_iter().enumerate() {
                let left = at % (VIEW as usize) < VIEW as usize / 2;
                assert_eq!(item, if left { 11 } else { 0 }, "{at}");
            }
        }
    }
    // As an occluder it hides what lies behind.
    let boxes = [3.0, 5.0].map(|z| BoxQuery { min: [-1.0, -1.0, -z - 0.5], max: [1.0, 1.0, -z] });
    let seen = |backend: &mut dyn FnMut() -> Vec<bool>| assert_eq!(backend(), [true, false]);
    let (view, draws) = (view(VIEW, VIEW), [face]);
    seen(&mut || {
        occluders(&mut both.cpu, view, &draws);
        visible(&mut both.cpu, view, &boxes, Cull::Queries)
    });
    if let Some(gpu) = &mut both.gpu {
        seen(&mut || {
            occluders(gpu, view, &draws);
            visible(gpu, view, &boxes, Cull::Queries)
        });
    }
}

#[test]
fn tiles_that_are_not_stored_do_not_bleed() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(6));
    // One tile and the square above it; its picture is white, all around is missing.
    let [low, high] = [FULL / 4, FULL / 2];
    let disparity = (0.5 / STEP) as u32;
    let corner = |u, v| [u, v, disparity];
    let corners = [corner(low, low), corner(high, low), corner(low, high), corner(high, high)];
    let [a, b, c, d] = corners;
    let mut face = Face::new(random, vec![a, c, b, b, c, d]);
    face.tiles.fill(None);
    face.tiles[ACROSS + 1] = Some([[0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]; 16]);
    both.face(0, &face);
    // From near by, so that a pixel of the picture covers many.
    for picture in both.shade(&[seen(0, [0.5, -0.5, 1.25])]) {
        let covered: Vec<usize> = (0..PIXELS).filter(|&at| depth(&picture)[at] > 0.0).collect();
        assert!(covered.len() > 1000, "{}", covered.len());
        assert!(covered.iter().all(|&at| picture.rgba[4 * at..4 * at + 4] == [255; 4]));
    }
}

/// Triangles anywhere on a face, and a picture with holes.
pub(crate) fn random_face(random: &mut StdRng, triangles: usize) -> Face {
    let mut corners = Vec::new();
    for _ in 0..triangles {
        let middle = [0; 2].map(|_: u32| random.random_range(0..FULL * 3 / 4));
        let disparity = random.random_range(0.0..1.5);
        for _ in 0..3 {
            let [u, v] = middle.map(|at| at + random.random_range(0..FULL / 4));
            corners.push([u, v, ((disparity + random.random_range(0.0..0.2)) / STEP) as u32]);
        }
    }
    let mut face = Face::new(random, corners);
    // Soft blocks: the driver's corners lie on another raster.
    for block in face.tiles.iter_mut().flatten().flatten() {
        let bits = random.random_range(0..1u16 << 5) << 6 | 0x8410;
        block[..2].copy_from_slice(&bits.to_le_bytes());
        block[2..4].copy_from_slice(&(bits ^ 0x0842).to_le_bytes());
    }
    for _ in 0..3 {
        let hole = random.random_range(0..face.tiles.len());
        face.tiles[hole] = None;
    }
    face
}

#[test]
fn random_faces_look_alike() {
    let (mut both, random) = (Both::new(), &mut StdRng::seed_from_u64(7));
    let (mut colors, mut depths, mut covered) = (0, 0, 0);
    for round in 0..20 {
        let mut draws = Vec::new();
        for id in 0..4 {
            both.face(id, &random_face(random, 30));
            let c = std::array::from_fn(|_| random.random_range(-0.5..0.5));
            draws.push(seen(id, c));
        }
        let pictures = both.shade(&draws);
        let [a, b] = &pictures[..] else { return };
        colors += off(&a.rgba, &b.rgba, 3);
        let [alone, common, other] = compared(a, b);
        (depths, covered) = (depths + alone + other, covered + common);
        let items = both.items(&draws);
        let different = items[0].iter().zip(&items[1]).filter(|(a, b)| a != b).count();
        assert!(different * 100 <= PIXELS, "{round}: {different} show another item");
        assert!(items[0].contains(&3));
    }
    eprintln!("{colors} colours and {depths} depths of {covered} pixels differ");
    assert!(covered > 20_000 && colors * 50 <= covered && depths * 200 <= covered);
}

/// A square of a texture of noise, as blob `id`.
fn textured_square(backend: &mut impl Backend, id: u32) {
    let rgba: Vec<u8> = (0..4 * 64u32).map(|i| (i * i / 5 + 40 * i) as u8 | 0x80).collect();
    let bytes = mips(8, &rgba);
    let length = bytes.len() as u64;
    let record = Texture { offset: 0, bytes: length, side: 8, wrap: 0, crc: 0, reserved: 0 };
    assert_eq!(upload_textures(backend, &[(record, &bytes)]).expect("sound"), Upload::Done);
    let vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]].map(|at| TexturedVertex {
        plain: vertex(at, [0.0, 0.0, 1.0], !0),
        tex_coord: [at[0] as f32, at[1] as f32],
        texture: 0,
        cutoff: 0.0,
    });
    let mut bytes = bytemuck::cast_slice(&vertices).to_vec();
    bytes.extend_from_slice(bytemuck::cast_slice(&[0u16, 1, 2, 1, 3, 2]));
    let layout = Layout::Textured as u32;
    let blob = Blob { layout, ..plain_blob(4, 2) };
    assert_eq!(backend.upload(BlobId(id), &blob, &bytes).expect("a sound blob"), Upload::Done);
}

/// Textured meshes and faces in one pass, each from its own buffer.
#[test]
fn textures_and_pictures_take_turns() {
    let mut both = Both::new();
    // So little that every face has a buffer of its own.
    both.gpu = both.gpu.and_then(|_| backend_within(VIEW, VIEW, 20_000));
    textured_square(&mut both.cpu, 3);
    both.gpu.as_mut().into_iter().for_each(|gpu| textured_square(gpu, 3));
    let random = &mut StdRng::seed_from_u64(11);
    (0..3).for_each(|id| both.face(id, &random_face(random, 40)));
    let square = |x: f32, y: f32| draw(3, 3, [1.0; 3], [x, y, -2.0]);
    let face = |id: u32| seen(id, [0.0, 0.1 * f64::from(id), 0.0]);
    let draws =
        [square(-1.5, -1.5), face(0), face(1), square(0.5, -1.5), face(2), square(0.5, 0.5)];
    let items = both.items(&draws);
    assert!((0..4).all(|item| items[0].contains(&item)));
    let pictures = both.shade(&draws);
    let [a, b] = &pictures[..] else { return };
    let colors = off(&a.rgba, &b.rgba, 3);
    assert!(colors * 50 <= PIXELS, "{colors} colours differ");
}

/// The same draws whole and in two parts.
fn parts_change_nothing(backend: &mut impl Backend) {
    let random = &mut StdRng::seed_from_u64(8);
    let view = view(VIEW, VIEW);
    (0..4).for_each(|id| assert_eq!(random_face(random, 40).upload(backend, id), Upload::Done));
    Mesh::cube(0xff80_4020).upload(backend, 4);
    let mut draws: Vec<Draw> = (0..4).map(|id| seen(id, [0.1 * f64::from(id), 0.0, 0.1])).collect();
    draws.insert(2, draw(4, 4, [1.0; 3], [-0.5, -0.5, -2.0]));
    let solid = |draws: &[Draw]| Draws { solid: draws.to_vec(), ..Draws::default() };
    let kinds: [fn(_, Draws, Part) -> Pass; 2] =
        [lit_with_depth, |view, draws, part| Pass::Items { view, draws, part }];
    for kind in kinds {
        let whole = run(backend, kind(view, solid(&draws), Part::WHOLE));
        for cut in 1..5 {
            let [first, second] = [&draws[..cut], &draws[cut..]].map(solid);
            let opens = Part { opens: true, closes: false };
            backend.submit(kind(view, first, opens)).expect("a sound part");
            let parts = run(backend, kind(view, second, Part { opens: false, closes: true }));
            let same = match (&whole[0], &parts[0]) {
                (
                    Completion::Picture { picture: a, .. },
                    Completion::Picture { picture: b, .. },
                ) => a == b,
                (Completion::Items { items: a, .. }, Completion::Items { items: b, .. }) => {
                    assert!((0..5).all(|item| a.contains(&item)) && a.contains(&NO_ITEM));
                    a == b
                }
                other => panic!("two pictures expected, not {other:?}"),
            };
            assert!(same, "cut at {cut}");
        }
    }
}

#[test]
fn parts_change_no_bit() {
    let mut both = Both::new();
    parts_change_nothing(&mut both.cpu);
    both.gpu.as_mut().into_iter().for_each(parts_change_nothing);
}

/// A budget that holds some of them, uploads in all orders, and pictures that stay the same.
fn keeps_within(backend: &mut impl Backend, budget: u64) {
    let random = &mut StdRng::seed_from_u64(9);
    let view = view(VIEW, VIEW);
    let faces: Vec<Face> = (0..30).map(|i| random_face(random, 1 + 13 * i % 40)).collect();
    let bytes = |id: u32| faces[id as usize].blob().1.len() as u64;
    let mut pictures = vec![None; faces.len()];
    let (mut held, mut full) = (Vec::<u32>::new(), 0);
    for round in 0..200 {
        let id = random.random_range(0..faces.len() as u32);
        let before = backend.held_bytes();
        match faces[id as usize].upload(backend, id) {
            Upload::Done => {
                held.retain(|&other| other != id);
                held.push(id);
            }
            Upload::Full => {
                assert_eq!(backend.held_bytes(), before);
                full += 1;
                while !held.is_empty() && random.random_bool(0.8) {
                    let gone = held.swap_remove(random.random_range(0..held.len()));
                    backend.evict(BlobId(gone));
                }
            }
        }
        let least: u64 = held.iter().map(|&id| bytes(id) - 2).sum();
        assert!(backend.held_bytes() <= budget && backend.held_bytes() >= least, "{round}");
        let Some(&id) = held.last() else { continue };
        let now = shade(backend, view, &[seen(id, [0.2, 0.1, 0.1])]);
        let before: &mut Option<Picture> = &mut pictures[id as usize];
        assert!(before.get_or_insert_with(|| now.clone()) == &now, "{round}: blob {id}");
    }
    assert!(full > 10, "{full}");
    held.into_iter().for_each(|id| backend.evict(BlobId(id)));
    // The largest that there is room for; a triangle takes 30 bytes.
    let tiles = (ACROSS * ACROSS) as u32;
    let of_picture = projected::image_bytes(Layout::Projected, [SIDE, tiles]);
    let triangles = (budget - 32 - of_picture) / 30;
    let corners = |triangles: u64| vec![[0; 3]; 3 * triangles as usize];
    let largest = Face::new(random, corners(triangles));
    assert_eq!(largest.upload(backend, 50), Upload::Done);
    assert!(backend.held_bytes() <= budget);
    assert_eq!(faces[1].upload(backend, 51), Upload::Full);
    backend.evict(BlobId(50));
    let beyond = Face::new(random, corners(triangles + 4));
    assert_eq!(beyond.upload(backend, 50), Upload::Full);
}

#[test]
fn faces_stay_within_a_budget_and_come_back_as_they_were() {
    let budget = 24_000;
    keeps_within(&mut CpuBackend::new(view(VIEW, VIEW).size).with_budget(budget), budget);
    let Some(mut gpu) = backend_within(VIEW, VIEW, budget) else { return };
    keeps_within(&mut gpu, budget);
}

fn refuses_what_is_no_face(backend: &mut impl Backend) {
    let (blob, bytes) = Face::whole(&mut StdRng::seed_from_u64(10), 1.0, 0.0).blob();
    let [side, tiles] = blob.image;
    for image in [[0, tiles], [side - 1, tiles], [side * 2, tiles], [side, tiles + 1], [8, 0]] {
        let refused = backend.upload(BlobId(0), &Blob { image, ..blob }, &bytes);
        assert!(refused.is_err(), "{image:?}");
    }
    for class in Class::ALL.into_iter().filter(|&class| class != Class::OpaqueDouble) {
        let refused = Blob { classes: class.all(2), ..blob };
        assert!(backend.upload(BlobId(0), &refused, &bytes).is_err(), "{class:?}");
    }
    assert!(backend.upload(BlobId(0), &blob, &bytes[..bytes.len() - 4]).is_err());
    assert_eq!(backend.upload(BlobId(0), &blob, &bytes).expect("a face"), Upload::Done);
    let normals = Blob { layout: Layout::ProjectedNormals as u32, ..blob };
    assert!(backend.upload(BlobId(0), &normals, &bytes).is_err(), "it has no normals");
    let whole = [&bytes[..], &vec![0; tiles as usize * projected::TILE_BYTES]].concat();
    assert_eq!(backend.upload(BlobId(0), &normals, &whole).expect("a face"), Upload::Done);
}

#[test]
fn bytes_that_are_no_face_are_refused() {
    let mut both = Both::new();
    refuses_what_is_no_face(&mut both.cpu);
    both.gpu.as_mut().into_iter().for_each(refuses_what_is_no_face);
}
