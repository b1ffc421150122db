use super::super::{Draws, NO_ITEM, light};
use super::*;
use protocol::format::{Class, Vertex};
use protocol::id::HlodId;
use protocol::settings::Cull;

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
    let draws = Draws { solid, ..Draws::default() };
    Pass::Shade { view, draws, with_depth, part: Part::WHOLE }
}

/// A whole pass of what is solid.
fn items(view: View, solid: Vec<Draw>) -> Pass {
    let draws = Draws { solid, ..Draws::default() };
    Pass::Items { view, draws, part: Part::WHOLE }
}

fn occluders(view: View, draws: Vec<Draw>) -> Pass {
    Pass::Occluders { view, draws, part: Part::WHOLE }
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
        let light = light::intensity(n.map(|c| c / length));
        let expected = SrgbEncoder::new().encode_rgba([light; 3]);
        for (a, b) in picture.rgba[..4].iter().zip(&expected) {
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
