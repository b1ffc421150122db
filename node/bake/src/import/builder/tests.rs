use super::*;

/// Corners of flat triangles, alpha and texture coordinate as given.
struct Soup(Vec<[f32; 3]>, f32, [f32; 2]);

impl Vertices for Soup {
    fn count(&self) -> usize {
        self.0.len()
    }
    fn position(&self, vertex: usize) -> [f64; 3] {
        self.0[vertex].map(f64::from)
    }
    fn normal(&self, _: usize) -> Option<[f32; 3]> {
        None
    }
    fn color(&self, _: usize) -> [f32; 4] {
        [1.0, 1.0, 1.0, self.1]
    }
    fn tex_coord(&self, _: usize) -> [f32; 2] {
        self.2
    }
}

fn corner(size: f32) -> Soup {
    Soup(vec![[0.0; 3], [size, 0.0, 0.0], [0.0, size, 0.0]], 1.0, [0.5; 2])
}

fn paint(alpha: Alpha, texture: Option<u32>) -> Paint {
    Paint { surface: Surface { alpha, texture, ..Surface::PLAIN }, ..Paint::PLAIN }
}

fn one() -> std::array::IntoIter<[usize; 3], 1> {
    [[0, 1, 2]].into_iter()
}

#[test]
fn a_hundred_thousand_copies_of_one_point_are_dropped_and_counted() {
    let mut builder = Builder::new("dot".into());
    let dots = Soup(vec![[3.0; 3]; 100_000], 1.0, [0.0; 2]);
    let triangles: Vec<[usize; 3]> = (0..99_998).map(|i| [i, i + 1, i + 2]).collect();
    builder.append(&Paint::PLAIN, &dots, triangles.into_iter()).unwrap();
    let Draft { mesh, surfaces } = builder.finish();
    assert_eq!((mesh.dropped_degenerate, mesh.positions.len()), (99_998, 0));
    assert!(mesh.indices.is_empty() && mesh.sections.is_empty() && surfaces.is_empty());
}

#[test]
fn sizes_far_from_one_keep_their_triangles_and_unit_normals() {
    for size in [1e-30, 1e-6, 1.0, 1e6, 1e7, 1e38] {
        let mut builder = Builder::new(String::new());
        builder.append(&Paint::PLAIN, &corner(size), one()).unwrap();
        assert_eq!(builder.finish().mesh.normals, [[0.0, 0.0, 1.0]; 3], "{size}");
    }
}

#[test]
fn positions_that_are_no_numbers_are_refused() {
    for bad in [f32::NAN, f32::INFINITY] {
        let fault = Builder::new(String::new()).append(&Paint::PLAIN, &corner(bad), one());
        assert!(matches!(fault, Err(Fault::Position { vertex: 1, .. })), "{fault:?}");
    }
}

#[test]
fn triangles_are_grouped_by_surface_and_share_no_vertex() {
    let mut builder = Builder::new(String::new());
    let (wall, pane) = (paint(Alpha::Opaque, None), paint(Alpha::Opaque, Some(7)));
    for (paint, size) in [(wall, 1.0), (pane, 2.0), (wall, 3.0), (pane, 4.0)] {
        builder.append(&paint, &corner(size), one()).unwrap();
    }
    let Draft { mesh, surfaces } = builder.finish();
    assert_eq!(surfaces, [wall.surface, pane.surface]);
    assert_eq!(mesh.indices, [[0, 1, 2], [6, 7, 8], [3, 4, 5], [9, 10, 11]]);
    let sections = [Section { end: 2, surface: 0 }, Section { end: 4, surface: 1 }];
    assert_eq!(mesh.sections, sections);
    assert_eq!(mesh.tex_coords.len(), 12);
    assert_eq!((mesh.tex_coords[0], mesh.tex_coords[3]), ([0.0; 2], [0.5; 2]));
    assert_eq!((mesh.tex_coords[6], mesh.tex_coords[9]), ([0.0; 2], [0.5; 2]));
}

#[test]
fn without_a_texture_there_are_no_texture_coordinates() {
    let mut builder = Builder::new(String::new());
    builder.append(&Paint::PLAIN, &corner(1.0), one()).unwrap();
    assert!(builder.finish().mesh.tex_coords.is_empty());
}

#[test]
fn texture_coordinates_that_are_no_numbers_become_zero() {
    let mut builder = Builder::new(String::new());
    let soup = Soup(corner(1.0).0, 1.0, [f32::NAN, 1.0]);
    builder.append(&paint(Alpha::Opaque, Some(0)), &soup, one()).unwrap();
    assert_eq!(builder.mended_tex_coords, 3);
    assert_eq!(builder.finish().mesh.tex_coords, [[0.0; 2]; 3]);
}

#[test]
fn what_blends_or_masks_with_alpha_one_everywhere_is_opaque() {
    let made = |paint: Paint, alpha: f32| {
        let mut builder = Builder::new(String::new());
        let soup = Soup(corner(1.0).0, alpha, [0.0; 2]);
        builder.append(&paint, &soup, one()).unwrap();
        let draft = builder.finish();
        (draft.surfaces[0].alpha, draft.mesh.colors[0][3])
    };
    let half = Paint { color: [1.0, 1.0, 1.0, 0.5], ..paint(Alpha::Blend, None) };
    let holed = Paint { texture_is_opaque: false, ..paint(Alpha::Blend, Some(0)) };
    assert_eq!(made(paint(Alpha::Blend, None), 1.0), (Alpha::Opaque, 255));
    assert_eq!(made(paint(Alpha::Blend, None), 0.5), (Alpha::Blend, 128));
    assert_eq!(made(half, 1.0), (Alpha::Blend, 128));
    assert_eq!(made(holed, 1.0), (Alpha::Blend, 255));
    assert_eq!(made(paint(Alpha::Opaque, None), 0.0), (Alpha::Opaque, 255));
    assert_eq!(made(paint(Alpha::Mask(0.5), None), 1.0), (Alpha::Opaque, 255));
    assert_eq!(made(paint(Alpha::Mask(1.5), None), 1.0), (Alpha::Mask(1.5), 255));
}
