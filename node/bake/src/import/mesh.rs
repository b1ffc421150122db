//! From a glTF mesh to one [`SourceMesh`]: primitives merged, vertices compacted, normals found.

use glam::DVec3;

use super::accessor::{Accessor, Role};
use super::buffers::Resources;
use super::document::{Mesh, Primitive, label};
use super::error::ImportError;
use super::material::Surface;
use super::triangles::Topology;
use crate::source::SourceMesh;

/// What was left out or mended while meshes were read; sums over any number of meshes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tally {
    /// Primitives of points or lines.
    pub(super) points_and_lines: u64,
    /// Primitives without positions, which the format says to skip.
    pub(super) without_positions: u64,
    /// Primitives whose morph targets are ignored.
    pub(super) morphed: u64,
    /// Corners that are left over at the end of a triangle list.
    pub(super) leftover_corners: u64,
    /// Exactly degenerate triangles.
    pub(super) degenerate: u64,
    /// Normals without a direction, replaced by that of a face.
    pub(super) mended_normals: u64,
}

impl Tally {
    pub(super) fn add(&mut self, other: &Self) {
        self.points_and_lines += other.points_and_lines;
        self.without_positions += other.without_positions;
        self.morphed += other.morphed;
        self.leftover_corners += other.leftover_corners;
        self.degenerate += other.degenerate;
        self.mended_normals += other.mended_normals;
    }
}

/// Reads mesh `number`; `surface` gives what a primitive's material lends.
pub(super) fn read(
    resources: &Resources<'_>,
    number: usize,
    mesh: &Mesh,
    surface: impl Fn(Option<usize>) -> Surface,
) -> Result<(SourceMesh, Tally), ImportError> {
    let name = mesh.name.clone().unwrap_or_else(|| format!("mesh {number}"));
    let mut out = SourceMesh { name, ..SourceMesh::default() };
    let mut tally = Tally::default();
    for (place, primitive) in mesh.primitives.iter().enumerate() {
        let at = format!("{}, primitive {place}", label("mesh", number, mesh.name.as_ref()));
        append(resources, &at, primitive, surface(primitive.material), &mut out, &mut tally)?;
    }
    tally.degenerate = out.dropped_degenerate;
    // Growth by doubling leaves up to half of a large mesh unused.
    out.positions.shrink_to_fit();
    out.normals.shrink_to_fit();
    out.colors.shrink_to_fit();
    out.indices.shrink_to_fit();
    Ok((out, tally))
}

fn append(
    resources: &Resources<'_>,
    at: &str,
    primitive: &Primitive,
    surface: Surface,
    out: &mut SourceMesh,
    tally: &mut Tally,
) -> Result<(), ImportError> {
    let topology = match primitive.mode.unwrap_or(4) {
        0..=3 => {
            tally.points_and_lines += 1;
            return Ok(());
        }
        4 => Topology::List,
        5 => Topology::Strip,
        6 => Topology::Fan,
        mode => return Err(resources.broken(at, format!("its mode {mode} does not exist"))),
    };
    let open = |attribute: &str, role| {
        let accessor = primitive.attributes.get(attribute);
        accessor
            .map(|&accessor| {
                Accessor::open(resources, &format!("{at}, {attribute}"), accessor, role)
            })
            .transpose()
    };
    let Some(positions) = open("POSITION", Role::Position)? else {
        tally.without_positions += 1;
        return Ok(());
    };
    let normals = open("NORMAL", Role::Normal)?;
    let colors = open("COLOR_0", Role::Color)?;
    for (attribute, accessor) in [("NORMAL", &normals), ("COLOR_0", &colors)] {
        if let Some(accessor) =
            accessor.as_ref().filter(|accessor| accessor.count != positions.count)
        {
            let what = format!(
                "it has {} positions and {} of {attribute}",
                positions.count, accessor.count
            );
            return Err(resources.broken(at, what));
        }
    }
    let indices = match primitive.indices {
        Some(accessor) => {
            Some(Accessor::open(resources, &format!("{at}, indices"), accessor, Role::Indices)?)
        }
        None => None,
    };
    let corners = indices.as_ref().map_or(positions.count, |indices| indices.count);
    let triangles = topology.triangles(corners);
    tally.morphed += u64::from(!primitive.targets.is_empty());
    tally.leftover_corners += if topology == Topology::List { (corners % 3) as u64 } else { 0 };

    let vertex = |corner: usize| -> Result<usize, ImportError> {
        let Some(indices) = &indices else { return Ok(corner) };
        let index = indices.index(corner) as usize;
        if index < positions.count {
            return Ok(index);
        }
        let what = format!(
            "its index {index}, at place {corner}, is beyond its {} positions",
            positions.count
        );
        Err(resources.broken(at, what))
    };
    let mut vertices =
        Vertices::new(&positions, normals.as_ref(), colors.as_ref(), surface, triangles, out);
    out.indices.reserve(triangles);
    for t in 0..triangles {
        let mut triangle = [0; 3];
        for (slot, corner) in triangle.iter_mut().zip(topology.corners(t)) {
            *slot = vertex(corner)?;
        }
        let mut points = [DVec3::ZERO; 3];
        for (point, &vertex) in points.iter_mut().zip(&triangle) {
            let position = positions.vector::<3>(vertex);
            *point = DVec3::from(position.map(f64::from));
            if !point.is_finite() {
                return Err(resources.broken(at, format!("its position {vertex} is {position:?}")));
            }
        }
        let area = (points[1] - points[0]).cross(points[2] - points[0]);
        // Exactly zero: nothing that has an area, however small, is left out.
        if area == DVec3::ZERO {
            out.dropped_degenerate += 1;
            continue;
        }
        let face_normal = unit(area);
        let mut emitted = [0; 3];
        for (slot, &vertex) in emitted.iter_mut().zip(&triangle) {
            *slot = vertices.place(vertex, face_normal, out).ok_or_else(|| {
                resources.invalid(
                    at.into(),
                    "its mesh exceeds 2^32 vertices".into(),
                    "split the mesh",
                )
            })?;
        }
        out.indices.push(emitted);
    }
    tally.mended_normals += vertices.mended_normals;
    Ok(())
}

/// The unit vector along `v`, which must be finite and not zero.
pub(super) fn unit(v: DVec3) -> [f32; 3] {
    // Scaled first, so that neither a square underflows nor a sum overflows.
    let scaled = v / v.abs().max_element();
    (scaled / scaled.length()).to_array().map(|lane| lane as f32)
}

/// Gives the vertices of one primitive their places in the merged mesh, on first use: what no
/// triangle uses takes no room.
struct Vertices<'a> {
    positions: &'a Accessor<'a>,
    normals: Option<&'a Accessor<'a>>,
    colors: Option<&'a Accessor<'a>>,
    surface: Surface,
    /// By vertex of the primitive, its latest copy in the mesh.
    latest: Vec<u32>,
    /// By copy, counted from `first`: the copy of the same vertex before it. Only where faces are
    /// flat has a vertex more than one.
    earlier: Vec<u32>,
    first: usize,
    mended_normals: u64,
}

const NONE: u32 = u32::MAX;

/// How many copies of a flat-shaded vertex are compared before a new one is made. It bounds the
/// time spent at the hub of a wide fan; a corner of a box has three.
const COPIES_COMPARED: usize = 8;

impl<'a> Vertices<'a> {
    fn new(
        positions: &'a Accessor<'a>,
        normals: Option<&'a Accessor<'a>>,
        colors: Option<&'a Accessor<'a>>,
        surface: Surface,
        triangles: usize,
        out: &mut SourceMesh,
    ) -> Self {
        if normals.is_some() {
            let most = positions.count.min(triangles.saturating_mul(3));
            out.positions.reserve(most);
            out.normals.reserve(most);
            out.colors.reserve(most);
        }
        let (latest, first) = (vec![NONE; positions.count], out.positions.len());
        Self {
            positions,
            normals,
            colors,
            surface,
            latest,
            earlier: Vec::new(),
            first,
            mended_normals: 0,
        }
    }

    /// The place of `vertex` in `out` for a face with this normal; `None` if places run out.
    fn place(&mut self, vertex: usize, face_normal: [f32; 3], out: &mut SourceMesh) -> Option<u32> {
        let latest = self.latest[vertex];
        if self.normals.is_some() {
            if latest != NONE {
                return Some(latest);
            }
        } else {
            let mut copy = latest;
            for _ in 0..COPIES_COMPARED {
                if copy == NONE {
                    break;
                }
                if out.normals[copy as usize] == face_normal {
                    return Some(copy);
                }
                copy = self.earlier[copy as usize - self.first];
            }
            self.earlier.push(latest);
        }
        let place = u32::try_from(out.positions.len()).ok().filter(|&place| place != NONE)?;
        self.latest[vertex] = place;
        out.positions.push(self.positions.vector(vertex));
        out.normals.push(self.normal(vertex, face_normal));
        out.colors.push(self.color(vertex));
        Some(place)
    }

    fn normal(&mut self, vertex: usize, face_normal: [f32; 3]) -> [f32; 3] {
        let Some(normals) = self.normals else { return face_normal };
        let normal = DVec3::from(normals.vector::<3>(vertex).map(f64::from));
        if normal.is_finite() && normal != DVec3::ZERO {
            return unit(normal);
        }
        self.mended_normals += 1;
        face_normal
    }

    fn color(&self, vertex: usize) -> [u8; 4] {
        let own = self.colors.map_or([1.0; 4], |colors| colors.vector::<4>(vertex));
        std::array::from_fn(|lane| {
            if lane == 3 && self.surface.opaque {
                return u8::MAX;
            }
            // A cast from NaN gives 0.
            (f64::from(own[lane]).clamp(0.0, 1.0) * self.surface.color[lane] * 255.0).round() as u8
        })
    }
}
