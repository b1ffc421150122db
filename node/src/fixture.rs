//! A small scene file for tests: a root over solid boxes, all instances of one cube.

use protocol::format::{Class, Finished, Hlod, Level, NONE, Part, SceneInfo, SceneWriter, Tables};
use protocol::format::{TexturedVertex, Transform, Vertex, Vertices, Wrap};
use std::path::Path;

/// A solid box, and the bounds its hlod claims, which may be wider.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Piece {
    /// Corners of the solid.
    pub(crate) solid: [[f64; 3]; 2],
    /// Corners of the hlod's bounds.
    pub(crate) bounds: [[f64; 3]; 2],
}

impl Piece {
    /// A box within tight bounds.
    pub(crate) fn tight(min: [f64; 3], max: [f64; 3]) -> Self {
        Self { solid: [min, max], bounds: [min, max] }
    }
}

/// A street along x with a wall on its far side and a lattice of 5 x 4 x 3 boxes behind the wall,
/// some of them touching it.
pub(crate) fn street() -> Vec<Piece> {
    let mut pieces = Vec::new();
    for i in 0..6 {
        let x = f64::from(i) * 4.0;
        pieces.push(Piece::tight([x, 5.0, 0.0], [x + 4.0, 6.0, 5.0]));
    }
    for (i, j, k) in (0..60).map(|n| (n % 5, n / 5 % 4, n / 20)) {
        let at = [f64::from(i) * 5.0 + 0.5, f64::from(j) * 3.0 + 6.0, f64::from(k) * 1.5];
        pieces.push(Piece::tight(at, at.map(|c| c + 1.25)));
    }
    pieces
}

/// The cube of side 1 that all pieces are.
fn cube() -> (Vec<Vertex>, Vec<u16>) {
    let corner = |bits: u32| [bits & 1, bits >> 1 & 1, bits >> 2];
    let vertex = |bits| Vertex {
        position: Vertex::pack_position(corner(bits)),
        normal: Vertex::pack_normal(corner(bits).map(|c| c as f32 - 0.5)),
        color: 0xff00_0000 | (0x20_3040 * (bits + 1)),
    };
    // Two triangles for each face: corner bits that differ along two axes, the third fixed.
    let mut indices = Vec::new();
    for (fixed, u, v) in [(1, 2, 4), (2, 1, 4), (4, 1, 2)] {
        for base in [0, fixed] {
            indices.extend([base, base | u, base | v, base | u, base | u | v, base | v]);
        }
    }
    ((0..8).map(vertex).collect(), indices)
}

/// Makes a cube of side 1 a solid.
fn placement([min, max]: [[f64; 3]; 2]) -> Transform {
    let mut linear = [[0.0; 3]; 3];
    for k in 0..3 {
        linear[k][k] = max[k] - min[k];
    }
    Transform { linear, translation: min }
}

/// No edge of a piece is longer than the diagonal of its solid.
fn longest_edge(piece: &Piece) -> f32 {
    let [min, max] = piece.solid;
    let squared: f64 = (0..3).map(|k| (max[k] - min[k]).powi(2)).sum();
    (squared.sqrt() as f32).next_up()
}

/// The box of bounds.
fn hull(pieces: &[Piece]) -> [[f64; 3]; 2] {
    let extreme = |pick: fn(f64, f64) -> f64, corner: usize| {
        let corners = pieces.iter().map(|piece| piece.bounds[corner]);
        corners.reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k]))).unwrap()
    };
    [extreme(f64::min, 0), extreme(f64::max, 1)]
}

/// Writes the scene of `pieces`; each is a leaf whose item id is its place plus 1. `textured` boxes are
/// opaque by half, and else have holes or blend.
pub(crate) fn write(path: &Path, pieces: &[Piece], textured: bool) -> Finished {
    write_with_textures(path, pieces, u32::from(textured))
}

/// The same with so many textures. Where there are several, each box has a mesh of its own, with two of them.
pub(crate) fn write_with_textures(path: &Path, pieces: &[Piece], textures: u32) -> Finished {
    let mut writer = SceneWriter::create(path).unwrap();
    let (vertices, indices) = cube();
    let triangles = (indices.len() / 3) as u32;
    // Two triangles of each face begin at the corner 0, and so on: faces differ in their texture.
    let with_texture = |place: u32, plain: &Vertex| TexturedVertex {
        plain: *plain,
        tex_coord: [plain.grid()[0] as f32 * 3.0, (plain.grid()[1] + plain.grid()[2]) as f32],
        texture: (place + plain.grid()[0]) % textures,
        cutoff: 0.5,
    };
    let count = if textures > 1 { pieces.len() as u32 } else { 1 };
    for place in 0..count {
        let with_textures: Vec<TexturedVertex> = match textures {
            0 => Vec::new(),
            _ => vertices.iter().map(|plain| with_texture(place, plain)).collect(),
        };
        let (vertices, classes) = match textures {
            0 => (Vertices::Plain(&vertices), Class::OpaqueDouble.all(triangles)),
            _ => (Vertices::Textured(&with_textures), [2, 4, 1, 2, 1, 2]),
        };
        writer.add_blob([0.0; 3], 1.0, vertices, &indices, classes).unwrap();
    }
    if textures == 1 {
        let pixels = [[255u8, 200, 90, 255], [40, 80, 255, 60]].as_flattened().repeat(2);
        writer.add_texture(2, [Wrap::Repeat; 2], &pixels).unwrap();
    }
    for texture in 0..if textures > 1 { textures } else { 0 } {
        // Of different sides, and of colours that tell which is which.
        let side = 16 << (texture % 3);
        let mut noise = texture + 1;
        let mut pixel = |_| {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let [_, a, b, c] = noise.to_le_bytes();
            [(texture * 37) as u8, a, b / 2, c | 0x7f]
        };
        let pixels: Vec<u8> = (0..side * side).flat_map(&mut pixel).collect();
        writer.add_texture(side, [Wrap::Repeat; 2], &pixels).unwrap();
    }
    let all = triangles * pieces.len() as u32;
    let [min, max] = hull(pieces);
    let mut hlods = vec![Hlod {
        min,
        max,
        parent: NONE,
        first_child: 1,
        child_count: pieces.len() as u32,
        first_level: 0,
        level_count: 0,
        object: NONE,
        source_triangles: u64::from(all),
    }];
    let (mut levels, mut parts, mut transforms) = (Vec::new(), Vec::new(), Vec::new());
    for (place, piece) in (0..).zip(pieces) {
        transforms.push(placement(piece.solid));
        let longest_edge = longest_edge(piece);
        levels.push(Level {
            error: 0.0,
            first_part: place,
            part_count: 1,
            triangles,
            longest_edge,
        });
        parts.push(Part { blob: place % count, transform: place });
        hlods.push(Hlod {
            min: piece.bounds[0],
            max: piece.bounds[1],
            parent: 0,
            first_child: 0,
            child_count: 0,
            first_level: place,
            level_count: 1,
            object: place,
            source_triangles: u64::from(triangles),
        });
    }
    let info = SceneInfo {
        up: [0.0, 0.0, 1.0],
        source_triangles: u64::from(all),
        unique_triangles: u64::from(triangles),
        objects: pieces.len() as u32,
        seed: 1,
        ..SceneInfo::default()
    };
    writer.finish(Tables { info, hlods, levels, parts, transforms, ..Tables::default() }).unwrap()
}

/// Writes the scene of `alone`, leaves 2 and on, and `together`, the leaves behind them below hlod 1, whose
/// one level is `coarse` and errs by `error`. Every box is a blob of its own, in the order of the hlods.
pub(crate) fn write_with_stand_in(
    path: &Path,
    alone: &[Piece],
    together: &[Piece],
    coarse: Piece,
    error: f64,
) -> Finished {
    let mut writer = SceneWriter::create(path).unwrap();
    let (vertices, indices) = cube();
    let triangles = (indices.len() / 3) as u32;
    let classes = Class::OpaqueDouble.all(triangles);
    let all = [alone, together].concat();
    let (first, end) = (2 + alone.len() as u32, 2 + all.len() as u32);
    let source = |pieces: &[Piece]| u64::from(triangles) * pieces.len() as u64;

    let hlod = |[min, max]: [[f64; 3]; 2], parent, children: std::ops::Range<u32>| Hlod {
        min,
        max,
        parent,
        first_child: children.start,
        child_count: children.len() as u32,
        first_level: 0,
        level_count: 0,
        object: NONE,
        source_triangles: 0,
    };
    let group = hull(&[together, &[coarse]].concat());
    let hull_of_all = hull(&[&all[..], &[coarse]].concat());
    let mut hlods = vec![
        Hlod { source_triangles: source(&all), ..hlod(hull_of_all, NONE, 1..first) },
        Hlod { source_triangles: source(together), level_count: 1, ..hlod(group, 0, first..end) },
    ];
    let (mut levels, mut parts, mut transforms) = (Vec::new(), Vec::new(), Vec::new());
    for (place, piece) in (0..).zip([&[coarse], &all[..]].concat()) {
        let vertices = Vertices::Plain(&vertices);
        let blob = writer.add_blob([0.0; 3], 1.0, vertices, &indices, classes).unwrap().0;
        let error = if place == 0 { error } else { 0.0 };
        let longest_edge = longest_edge(&piece);
        levels.push(Level { error, first_part: place, part_count: 1, triangles, longest_edge });
        parts.push(Part { blob, transform: place });
        transforms.push(placement(piece.solid));
        if place > 0 {
            let parent = u32::from(place as usize > alone.len());
            hlods.push(Hlod {
                first_level: place,
                level_count: 1,
                object: place - 1,
                source_triangles: u64::from(triangles),
                ..hlod(piece.bounds, parent, 0..0)
            });
        }
    }
    let info = SceneInfo {
        up: [0.0, 0.0, 1.0],
        source_triangles: source(&all),
        unique_triangles: source(&all),
        objects: all.len() as u32,
        seed: 1,
        ..SceneInfo::default()
    };
    writer.finish(Tables { info, hlods, levels, parts, transforms, ..Tables::default() }).unwrap()
}
