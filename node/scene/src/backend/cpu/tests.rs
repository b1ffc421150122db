use super::super::{Draws, NO_ITEM, Shading, light, normal};
use super::*;
use protocol::format::vertex::Layout;
use protocol::format::{Class, Vertex, projected};
use protocol::id::HlodId;
use protocol::settings::Cull;
use protocol::sun::Sun;

const SIZE: PictureSize = PictureSize { width: 20, height: 10 };

/// Looks along +z with x to the right and y up; both half angles 45 degrees at square pictures.
fn view(size: PictureSize) -> View {
    let aspect = size.width as f32 / size.height as f32;
    let clip_from_eye = [
        [1.0 / aspect, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 0.1, 0.0],
    ];
    View { size, clip_from_eye }
}

/// `cells * cells` squares, two triangles each, over the unit square of a grid of step `1 / cells`.
fn sheet(cells: u32, normal: [f32; 3], color: u32) -> (u32, u32, Vec<u8>) {
    let side = cells + 1;
    let mut bytes = Vec::new();
    for i in 0..side * side {
        let position = Vertex::pack_position([i % side, i / side, 0]);
        let vertex = Vertex { position, normal: Vertex::pack_normal(normal), color };
        bytes.extend_from_slice(bytemuck::bytes_of(&vertex));
    }
    for i in 0..cells * cells {
        let a = i / cells * side + i % cells;
        let [a, b, c, d] = [a, a + 1, a + side, a + side + 1].map(|i| i as u16);
        bytes.extend([a, b, d, a, d, c].into_iter().flat_map(u16::to_le_bytes));
    }
    (side * side, 2 * cells * cells, bytes)
}

/// A sheet that fills the picture of [`view`] at depth `z`.
fn filling(blob: u32, item: u32, cells: u32, z: f32, size: PictureSize) -> Draw {
    let aspect = size.width as f32 / size.height as f32;
    let (x, y) = (2.2 * z * aspect, 2.2 * z);
    Draw {
        blob: BlobId(blob),
        item: HlodId(item),
        linear: [[x / cells as f32, 0.0, 0.0], [0.0, y / cells as f32, 0.0], [0.0, 0.0, 1.0]],
        offset: [-x / 2.0, -y / 2.0, z],
        distance: z,
        disparity_step: 0.0,
    }
}

fn backend_with(size: PictureSize, sheets: &[(u32, u32, Vec<u8>)]) -> CpuBackend {
    let mut backend = CpuBackend::new(size);
    for (id, (vertices, triangles, bytes)) in sheets.iter().enumerate() {
        let classes = Class::OpaqueDouble.all(*triangles);
        let blob = Blob { vertices: *vertices, triangles: *triangles, classes, ..Blob::default() };
        let upload = backend.upload(BlobId(id as u32), &blob, bytes).unwrap();
        assert_eq!(upload, Upload::Done);
    }
    backend
}

/// A whole pass of what is solid.
fn shade(view: View, solid: Vec<Draw>, with_depth: bool) -> Pass {
    shade_as(Shading::default(), view, solid, with_depth)
}

/// Likewise of other pixels than those under the default sun.
fn shade_as(shading: Shading, view: View, solid: Vec<Draw>, with_depth: bool) -> Pass {
    let draws = Draws { solid, ..Draws::default() };
    Pass::Shade { view, shading, draws, with_depth, part: Part::WHOLE }
}

/// A whole pass of what is solid.
fn items(view: View, solid: Vec<Draw>) -> Pass {
    let draws = Draws { solid, ..Draws::default() };
    Pass::Items { view, draws, part: Part::WHOLE }
}

fn occluders(view: View, draws: Vec<Draw>) -> Pass {
    Pass::Occluders { view, draws, adds: false, part: Part::WHOLE }
}

fn run(backend: &mut CpuBackend, pass: Pass) -> Completion {
    let ticket = backend.submit(pass).unwrap();
    let mut completions = Vec::new();
    backend.poll(&mut completions).unwrap();
    assert_eq!(completions.len(), 1, "{ticket:?}");
    completions.pop().unwrap()
}

#[test]
fn nothing_drawn_is_sky() {
    let mut backend = CpuBackend::new(SIZE);
    let view = view(SIZE);
    let pass = shade(view, vec![], true);
    let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
    let sky = SrgbEncoder::new().encode_rgba(light::SKY);
    assert!(picture.rgba.chunks(4).all(|pixel| pixel == sky));
    assert_eq!(picture.depth.unwrap(), vec![0.0; 200]);
    let pass = shade_as(Shading::Normals, view, vec![], true);
    let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
    assert!(picture.rgba.chunks(4).all(|pixel| pixel == [128, 128, 128, 255]));
    let pass = items(view, vec![]);
    let Completion::Items { items, .. } = run(&mut backend, pass) else { panic!() };
    assert_eq!(items, vec![NO_ITEM; 200]);
    assert!(backend.poll(&mut Vec::new()).is_ok());
}

#[test]
fn a_sheet_is_lit_from_either_side() {
    for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]] {
        let mut backend = backend_with(SIZE, &[sheet(3, normal, 0xff00_80ff)]);
        let draws = vec![filling(0, 5, 3, 2.0, SIZE)];
        let pass = shade(view(SIZE), draws, true);
        let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
        // The viewer's side faces -z, away from the sun.
        let lit = [1.0, 128.0 / 255.0, 0.0].map(|c| c * light::AMBIENT);
        let expected = SrgbEncoder::new().encode_rgba(lit);
        assert!(picture.rgba.chunks(4).all(|pixel| pixel == expected), "{:?}", &picture.rgba[..4]);
        assert!(picture.depth.unwrap().iter().all(|&z| (z - 0.05).abs() < 1e-7));
        // A sun behind the viewer.
        let shading = Shading::Lit { sun: [0.0, 0.0, -1.0] };
        let pass = shade_as(shading, view(SIZE), vec![filling(0, 5, 3, 2.0, SIZE)], false);
        let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
        assert!(picture.rgba.chunks(4).all(|pixel| pixel == [255, 188, 0, 255]));
    }
}

#[test]
fn a_mirrored_or_stretched_placement_keeps_normals_upright() {
    // A slope with normal (0, 0.6, -0.8), stretched along y: the surface turns, and the normal with it.
    let mut backend = backend_with(SIZE, &[sheet(1, [0.0, 0.6, -0.8], !0)]);
    for mirror in [1.0, -1.0] {
        let mut draw = filling(0, 0, 1, 2.0, SIZE);
        draw.linear[0][0] *= mirror;
        draw.offset[0] *= mirror;
        let stretch = draw.linear[1][1];
        let pass = shade(view(SIZE), vec![draw], false);
        let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
        let n = [0.0, 0.6 / stretch, -0.8];
        let length = (n[1] * n[1] + n[2] * n[2]).sqrt();
        let light = light::intensity(n.map(|c| c / length), Sun::default().unit());
        let expected = SrgbEncoder::new().encode_rgba([light; 3]);
        for (a, b) in picture.rgba[..4].iter().zip(&expected) {
            assert!(a.abs_diff(*b) <= 1, "{:?} {expected:?}", &picture.rgba[..4]);
        }
        let pass = shade_as(Shading::Normals, view(SIZE), vec![draw], false);
        let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
        let expected = normal::encode(n.map(|c| c / length));
        for (a, b) in picture.rgba[..3].iter().zip(&expected) {
            assert!(a.abs_diff(*b) <= 1, "{:?} {expected:?}", &picture.rgba[..4]);
        }
    }
}

#[test]
fn the_nearest_owns_a_pixel_and_hides_boxes() {
    let mut backend = backend_with(SIZE, &[sheet(3, [0.0, 0.0, 1.0], 7)]);
    let view = view(SIZE);
    let draws = vec![filling(0, 4, 3, 2.0, SIZE), filling(0, 9, 3, 3.0, SIZE)];
    let pass = items(view, draws.clone());
    let Completion::Items { items, .. } = run(&mut backend, pass) else { panic!() };
    assert_eq!(items, vec![4; 200]);
    run(&mut backend, occluders(view, draws));
    let cube = |z: f32| BoxQuery { min: [-0.5, -0.5, z], max: [0.5, 0.5, z + 1.0] };
    let boxes = vec![cube(2.5), cube(1.5), cube(2.0), cube(2.0001), cube(-3.0)];
    for _ in 0..2 {
        let pass = Pass::QueryBoxes { view, boxes: boxes.clone(), method: Cull::Queries };
        let Completion::Boxes { visible, first, last, .. } = run(&mut backend, pass) else {
            panic!()
        };
        assert_eq!((visible, first, last), (vec![false, true, true, false, false], 0, true));
    }
    run(&mut backend, occluders(view, vec![]));
    let pass = Pass::QueryBoxes { view, boxes, method: Cull::Queries };
    let Completion::Boxes { visible, .. } = run(&mut backend, pass) else { panic!() };
    assert_eq!(visible, [true, true, true, true, false]);
}

#[test]
#[should_panic(expected = "not uploaded")]
fn an_evicted_mesh_cannot_be_drawn() {
    let mut backend = backend_with(SIZE, &[sheet(1, [0.0, 0.0, 1.0], 7)]);
    backend.evict(BlobId(0));
    let draws = vec![filling(0, 4, 1, 2.0, SIZE)];
    let _ = backend.submit(items(view(SIZE), draws));
}

/// Pixels of a face's side: one tile.
const SIDE: u32 = projected::TILE;
/// Disparity of a unit of its grid.
const STEP: f32 = 1.0 / 1024.0;

/// A square of a face from row `top` down, its disparity there and at the lower edge; a noisy picture.
fn face(top: u32, disparities: [u32; 2]) -> (Blob, Vec<u8>) {
    let (full, [above, below]) = (SIDE * projected::SUBPIXELS, disparities);
    let corners = [[0, top, above], [full, top, above], [0, full, below], [full, full, below]];
    let mut bytes: Vec<u8> = corners
        .map(Vertex::pack_position)
        .as_flattened()
        .iter()
        .flat_map(|w| w.to_le_bytes())
        .collect();
    bytes.extend([0u16, 2, 1, 1, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(
        (0..projected::TILE_BYTES as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8),
    );
    let (classes, layout) = (Class::OpaqueDouble.all(2), Layout::Projected as u32);
    let image = [SIDE, 1];
    (Blob { vertices: 4, triangles: 2, classes, layout, image, ..Blob::default() }, bytes)
}

/// The face that looks along +z from a sample at `c`, x to its right.
fn seen_from(c: [f32; 3]) -> Draw {
    let unit = 2.0 / (SIDE * projected::SUBPIXELS) as f32;
    Draw {
        blob: BlobId(0),
        item: HlodId(0),
        linear: [[unit, 0.0, 0.0], [0.0, -unit, 0.0], c.map(|c| c * STEP)],
        offset: [-1.0, 1.0, 1.0],
        distance: 1.0,
        disparity_step: STEP,
    }
}

#[test]
fn a_face_is_its_picture_to_the_eye_that_took_it() {
    let size = PictureSize { width: SIDE, height: SIDE };
    for disparities in [[512, 512], [0, 0], [40, 900]] {
        let (blob, bytes) = face(0, disparities);
        let mut backend = CpuBackend::new(size);
        assert_eq!(backend.upload(BlobId(0), &blob, &bytes).unwrap(), Upload::Done);
        assert_eq!(backend.held_bytes(), bytes.len() as u64);
        let pass = shade(view(size), vec![seen_from([0.0; 3])], true);
        let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
        let parts = projected::Patch::of(&blob, &bytes);
        for (at, rgba) in (0..).zip(picture.rgba.chunks(4)) {
            let expected = parts.pixel(at % SIDE, at / SIDE);
            assert!(rgba.iter().zip(&expected).all(|(a, b)| a.abs_diff(*b) <= 1), "{at}");
        }
        let pass = shade_as(Shading::Normals, view(size), vec![seen_from([0.0; 3])], false);
        let Completion::Picture { picture: normals, .. } = run(&mut backend, pass) else {
            panic!()
        };
        assert!(normals.rgba.chunks(4).all(|pixel| pixel == [128, 128, 128, 255]));
        let [above, below] = disparities.map(|disparity| disparity as f32 * STEP * 0.1);
        for (at, z) in (0..).zip(picture.depth.unwrap()) {
            let share = (f32::from(at / SIDE as u16) + 0.5) / SIDE as f32;
            assert!((z - above - (below - above) * share).abs() < 1e-6, "{at}: {z}");
        }
    }
}

#[test]
fn a_face_reaches_from_behind_the_eye_to_the_horizon() {
    // The plane 1 below the sample: half of its picture, from infinity to a distance of 1. The eye went
    // on by 3.
    let (blob, bytes) = face(SIDE * projected::SUBPIXELS / 2, [0, 1024]);
    let square = PictureSize { width: 40, height: 40 };
    let mut backend = CpuBackend::new(square);
    assert_eq!(backend.upload(BlobId(0), &blob, &bytes).unwrap(), Upload::Done);
    let pass = shade(view(square), vec![seen_from([0.0, 0.0, -3.0])], true);
    let Completion::Picture { picture, .. } = run(&mut backend, pass) else { panic!() };
    for (at, z) in (0..).zip(picture.depth.unwrap()) {
        let ndc_y = 1.0 - (f32::from(at / 40u16) + 0.5) / 20.0;
        let expected = (0.1 * -ndc_y).max(0.0);
        assert!((z - expected).abs() < 0.1 / 20.0 / 128.0, "{at}: {z} {expected}");
    }
}

#[test]
fn a_damaged_face_is_refused() {
    let (blob, bytes) = face(0, [1, 1]);
    let refused = |blob: Blob, bytes: &[u8]| {
        let upload = CpuBackend::new(SIZE).upload(BlobId(0), &blob, bytes);
        matches!(upload, Err(BackendError::Device(_)))
    };
    assert!(!refused(blob, &bytes));
    assert!(refused(blob, &bytes[..bytes.len() - 1]));
    for image in [[0, 1], [24, 1], [32, 1], [16, 2], [8192, 1]] {
        assert!(refused(Blob { image, ..blob }, &bytes), "{image:?}");
    }
    assert!(refused(Blob { classes: Class::MaskDouble.all(2), ..blob }, &bytes));
    let mut wild = bytes.clone();
    wild[4 * 8 + 2 * 6] = 2;
    assert!(refused(blob, &wild), "a tile that is not stored");
    wild = bytes;
    wild[4 * 8] = 4;
    assert!(refused(blob, &wild), "a vertex that is not there");
}
