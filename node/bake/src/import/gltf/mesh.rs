//! From a glTF mesh to one drafted mesh: its primitives, merged.

use std::borrow::Cow;
use std::ops::Range;

use super::accessor::{Accessor, Elements, Role};
use super::buffers::Resources;
use super::document::{Mesh, Primitive, label};
use super::material::{Mapping, Material};
use super::triangles::Topology;
use crate::import::builder::{Builder, Draft, Vertices};
use crate::import::error::ImportError;

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
    /// Texture coordinates that are not finite, replaced by zero.
    pub(super) mended_tex_coords: u64,
    /// Primitives with a texture and no coordinates for it.
    pub(super) without_tex_coords: u64,
}

impl Tally {
    pub(super) fn add(&mut self, other: &Self) {
        self.points_and_lines += other.points_and_lines;
        self.without_positions += other.without_positions;
        self.morphed += other.morphed;
        self.leftover_corners += other.leftover_corners;
        self.degenerate += other.degenerate;
        self.mended_normals += other.mended_normals;
        self.mended_tex_coords += other.mended_tex_coords;
        self.without_tex_coords += other.without_tex_coords;
    }
}

/// Reads mesh `number`; `material` gives what a primitive's material lends.
pub(super) fn read<'a>(
    resources: &Resources<'_>,
    number: usize,
    mesh: &Mesh,
    material: impl Fn(Option<usize>) -> &'a Material,
) -> Result<(Draft, Tally), ImportError> {
    let name = mesh.name.clone().unwrap_or_else(|| format!("mesh {number}"));
    let mut builder = Builder::new(name);
    let mut tally = Tally::default();
    for (place, primitive) in mesh.primitives.iter().enumerate() {
        let at = format!("{}, primitive {place}", label("mesh", number, mesh.name.as_ref()));
        let material = material(primitive.material);
        append(resources, &at, primitive, material, &mut builder, &mut tally)?;
    }
    tally.degenerate = builder.dropped_degenerate();
    tally.mended_normals = builder.mended_normals;
    tally.mended_tex_coords = builder.mended_tex_coords;
    Ok((builder.finish(), tally))
}

/// Bytes that [`read`] needs for a mesh at most, as far as its claims tell.
pub(super) fn estimate(resources: &Resources<'_>, mesh: &Mesh) -> u64 {
    // A corner with everything, read and drafted.
    const CORNER_BYTES: u64 = 80;
    let count = |accessor: &usize| {
        resources.document.accessors.get(*accessor).map_or(0, |accessor| accessor.count as u64)
    };
    let corners = |primitive: &Primitive| {
        primitive.indices.as_ref().or(primitive.attributes.get("POSITION")).map_or(0, count)
    };
    let corners = mesh.primitives.iter().map(corners).fold(0, u64::saturating_add);
    corners.saturating_mul(CORNER_BYTES)
}

fn append(
    resources: &Resources<'_>,
    at: &str,
    primitive: &Primitive,
    material: &Material,
    builder: &mut Builder,
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
    let set = material.mapping.map(|mapping| format!("TEXCOORD_{}", mapping.set));
    let others = [
        ("NORMAL", open("NORMAL", Role::Normal)?),
        ("COLOR_0", open("COLOR_0", Role::Color)?),
        match &set {
            Some(set) => (set.as_str(), open(set, Role::TexCoord)?),
            None => ("", None),
        },
    ];
    let count = positions.count;
    for (attribute, accessor) in &others {
        if let Some(accessor) = accessor.as_ref().filter(|accessor| accessor.count != count) {
            let what = format!("it has {count} positions and {} of {attribute}", accessor.count);
            return Err(resources.broken(at, what));
        }
    }
    let indices = match primitive.indices {
        Some(accessor) => {
            Some(Accessor::open(resources, &format!("{at}, indices"), accessor, Role::Indices)?)
        }
        None => None,
    };
    tally.morphed += u64::from(!primitive.targets.is_empty());
    let corners = Corners::load(resources, at, indices, count)?;
    if topology == Topology::List {
        tally.leftover_corners += (corners.count() % 3) as u64;
    }

    let used = corners.range.clone();
    let load = |accessor: Option<Accessor>| {
        accessor.map(|accessor| accessor.load(resources, used.clone())).transpose()
    };
    let [(_, normals), (_, colors), (_, tex_coords)] = others;
    let vertices = Loaded {
        positions: positions.load(resources, used.clone())?,
        normals: load(normals)?,
        colors: load(colors)?,
        tex_coords: load(tex_coords)?,
        mapping: material.mapping,
        first: used.start,
    };
    let mut paint = Cow::Borrowed(&material.paint);
    if let (Some(mapping), None) = (material.mapping, &vertices.tex_coords) {
        // The mean of a picture is the best guess at what is seen of it.
        tally.without_tex_coords += 1;
        let paint = paint.to_mut();
        paint.surface.texture = None;
        paint.texture_is_opaque = true;
        paint.color.iter_mut().zip(mapping.mean).for_each(|(lane, mean)| *lane *= mean);
    }
    let triangles = (0..topology.triangles(corners.count()))
        .map(|t| topology.corners(t).map(|corner| corners.vertex(corner)));
    builder.append(&paint, &vertices, triangles).map_err(|fault| {
        let (what, fix) = fault.numbered_from(vertices.first).explain();
        resources.invalid(at.into(), what, fix)
    })
}

/// The vertices that follow each other, by number from the first one in use.
struct Corners {
    indices: Option<Elements>,
    /// Vertices in use: those between the lowest and the highest index.
    range: Range<usize>,
}

impl Corners {
    fn load(
        resources: &Resources<'_>,
        at: &str,
        indices: Option<Accessor>,
        vertices: usize,
    ) -> Result<Self, ImportError> {
        let Some(indices) = indices else { return Ok(Self { indices: None, range: 0..vertices }) };
        let indices = indices.load_all(resources)?;
        let (mut low, mut high) = (usize::MAX, 0);
        for corner in 0..indices.len() {
            let index = indices.index(corner) as usize;
            if index >= vertices {
                let what = format!(
                    "its index {index}, at place {corner}, is beyond its {vertices} positions"
                );
                return Err(resources.broken(at, what));
            }
            low = low.min(index);
            high = high.max(index + 1);
        }
        Ok(Self { indices: Some(indices), range: low.min(high)..high })
    }

    fn count(&self) -> usize {
        self.indices.as_ref().map_or(self.range.len(), Elements::len)
    }

    fn vertex(&self, corner: usize) -> usize {
        let vertex = self.indices.as_ref().map_or(corner, |all| all.index(corner) as usize);
        vertex - self.range.start
    }
}

/// Attributes of one primitive, from its vertex `first` on.
struct Loaded {
    positions: Elements,
    normals: Option<Elements>,
    colors: Option<Elements>,
    tex_coords: Option<Elements>,
    mapping: Option<Mapping>,
    first: usize,
}

impl Vertices for Loaded {
    fn count(&self) -> usize {
        self.positions.len()
    }

    fn position(&self, vertex: usize) -> [f32; 3] {
        self.positions.vector(self.first + vertex)
    }

    fn normal(&self, vertex: usize) -> Option<[f32; 3]> {
        self.normals.as_ref().map(|normals| normals.vector(self.first + vertex))
    }

    fn color(&self, vertex: usize) -> [f32; 4] {
        self.colors.as_ref().map_or([1.0; 4], |colors| colors.vector(self.first + vertex))
    }

    fn tex_coord(&self, vertex: usize) -> [f32; 2] {
        let coord = self.tex_coords.as_ref().map(|coords| coords.vector(self.first + vertex));
        match (coord, &self.mapping) {
            (Some(coord), Some(mapping)) => mapping.apply(coord),
            _ => [0.0; 2],
        }
    }
}
