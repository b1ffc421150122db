//! From a glTF mesh to one drafted mesh: its primitives, merged.

use std::borrow::Cow;
use std::ops::Range;
use std::rc::Rc;

use super::accessor::{Accessor, Elements, Numbers, Role};
use super::buffers::Resources;
use super::document::{Primitive, label};
use super::material::{Mapping, Material};
use super::triangles::Topology;
use crate::import::builder::{Builder, Draft, Paint, Vertices};
use crate::import::error::ImportError;
use crate::import::picture;
use crate::source::{Alpha, PART_TRIANGLES};

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
    /// Primitives of which something is seen, and those whose alpha hides all.
    pub(super) seen: u64,
    pub(super) unseen: u64,
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
        self.seen += other.seen;
        self.unseen += other.unseen;
    }
}

/// Some triangles of a mesh that are read at once: several small primitives, or a stretch of a large
/// one. How a mesh is divided depends on the file alone.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Portion {
    /// Number of the mesh.
    pub(super) mesh: usize,
    primitives: Range<usize>,
    /// Of each primitive: all, unless there is one alone.
    triangles: Range<usize>,
    /// Corners it has as far as its claims tell.
    corners: u64,
    /// Whether no other portion of the mesh comes before it, and none behind it.
    pub(super) is_first: bool,
    pub(super) is_last: bool,
}

impl Portion {
    /// Bytes that [`read`] needs for it at most, as far as its claims tell.
    pub(super) fn bytes(&self) -> u64 {
        // A corner with everything, read and drafted.
        const CORNER_BYTES: u64 = 80;
        self.corners.saturating_mul(CORNER_BYTES)
    }
}

/// The portions of mesh `number`, at least one.
pub(super) fn portions(resources: &Resources<'_>, number: usize) -> Vec<Portion> {
    let mesh = &resources.document.meshes[number];
    let count = |accessor: usize| {
        resources.document.accessors.get(accessor).map_or(0, |accessor| accessor.count as u64)
    };
    // A claim beyond the bytes there are is not worth dividing: reading it will say so.
    let honest = resources.total_bytes();
    const MOST: u64 = 3 * PART_TRIANGLES as u64;
    let portion = |primitives, triangles, corners| Portion {
        mesh: number,
        primitives,
        triangles,
        corners,
        is_first: false,
        is_last: false,
    };
    let mut portions: Vec<Portion> = Vec::new();
    for (place, primitive) in mesh.primitives.iter().enumerate() {
        let corners = primitive.indices.or(primitive.attributes.position).map_or(0, count);
        let is_list = primitive.mode.unwrap_or(LIST) == LIST;
        match portions.last_mut() {
            Some(last) if last.triangles == ALL && last.corners.saturating_add(corners) <= MOST => {
                last.primitives.end = place + 1;
                last.corners += corners;
            }
            _ if is_list && corners > MOST && corners <= honest => {
                let triangles = (corners / 3) as usize;
                portions.extend((0..triangles).step_by(PART_TRIANGLES).map(|start| {
                    let some = start..triangles.min(start + PART_TRIANGLES);
                    let corners = 3 * some.len() as u64;
                    portion(place..place + 1, some, corners)
                }));
            }
            _ => portions.push(portion(place..place + 1, ALL, corners)),
        }
    }
    if portions.is_empty() {
        portions.push(portion(0..0, ALL, 0));
    }
    portions.first_mut().expect("there is one").is_first = true;
    portions.last_mut().expect("there is one").is_last = true;
    portions
}

/// Triangles that mesh `number` claims, where the bytes are there that it claims them of.
pub(super) fn triangles(resources: &Resources<'_>, number: usize) -> u64 {
    let (document, honest) = (resources.document, resources.total_bytes());
    let of = |primitive: &Primitive| {
        let corners = primitive.indices.or(primitive.attributes.position)?;
        let count = document.accessors.get(corners)?.count;
        let topology = Topology::of(primitive.mode.unwrap_or(LIST))?;
        (count as u64 <= honest).then(|| topology.triangles(count) as u64)
    };
    document.meshes[number].primitives.iter().filter_map(of).fold(0, u64::saturating_add)
}

/// Stands for all triangles of a primitive.
const ALL: Range<usize> = 0..usize::MAX;
/// The mode of a primitive that does not name one.
const LIST: u64 = 4;

/// Reads a portion; `material` gives what a primitive's material lends.
pub(super) fn read<'a>(
    resources: &Resources<'_>,
    portion: &Portion,
    material: impl Fn(Option<usize>) -> &'a Material,
) -> Result<(Draft, Tally), ImportError> {
    let number = portion.mesh;
    let mesh = &resources.document.meshes[number];
    let name = mesh.name.clone().unwrap_or_else(|| format!("mesh {number}"));
    let mut builder = Builder::new(name);
    let mut tally = Tally::default();
    for place in portion.primitives.clone() {
        let primitive = &mesh.primitives[place];
        let at = format!("{}, primitive {place}", label("mesh", number, mesh.name.as_ref()));
        let material = material(primitive.material);
        let triangles = portion.triangles.clone();
        append(resources, &at, primitive, triangles, material, &mut builder, &mut tally)?;
    }
    tally.degenerate = builder.dropped_degenerate();
    tally.mended_normals = builder.mended_normals;
    tally.mended_tex_coords = builder.mended_tex_coords;
    Ok((builder.finish(), tally))
}

fn append(
    resources: &Resources<'_>,
    at: &str,
    primitive: &Primitive,
    some: Range<usize>,
    material: &Material,
    builder: &mut Builder,
    tally: &mut Tally,
) -> Result<(), ImportError> {
    let mode = primitive.mode.unwrap_or(LIST);
    let topology = match Topology::of(mode) {
        Some(topology) => topology,
        None if mode < LIST => {
            tally.points_and_lines += 1;
            return Ok(());
        }
        None => return Err(resources.broken(at, format!("its mode {mode} does not exist"))),
    };
    let open = |attribute: &str, accessor: Option<usize>, role| {
        let open = |a| Accessor::open(resources, &format!("{at}, {attribute}"), a, role);
        accessor.map(open).transpose()
    };
    let attributes = &primitive.attributes;
    let Some(positions) = open("POSITION", attributes.position, Role::Position)? else {
        tally.without_positions += 1;
        return Ok(());
    };
    let set = material.mapping.map_or(0, |mapping| mapping.set);
    let coords = material.mapping.and_then(|mapping| attributes.tex_coord(mapping.set));
    let set = format!("TEXCOORD_{set}");
    let others = [
        ("NORMAL", open("NORMAL", attributes.normal, Role::Normal)?),
        ("COLOR_0", open("COLOR_0", attributes.color, Role::Color)?),
        (set.as_str(), open(&set, coords, Role::TexCoord)?),
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
    // What is true of the whole primitive is counted with its first triangles.
    let is_begun = some.start > 0;
    let all = indices.as_ref().map_or(count, |indices| indices.count);
    let wanted = match some == ALL {
        true => 0..all,
        false => 3 * some.start..3 * some.end,
    };
    let corners = Corners::load(resources, at, indices, wanted, count)?;
    if !is_begun {
        tally.morphed += u64::from(!primitive.targets.is_empty());
        if topology == Topology::List {
            tally.leftover_corners += (all % 3) as u64;
        }
    }

    let used = corners.vertices.clone();
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
    };
    let mut paint = Cow::Borrowed(&material.paint);
    if let (Some(mapping), None) = (material.mapping, &vertices.tex_coords) {
        // The mean of a picture is the best guess at what is seen of it.
        tally.without_tex_coords += u64::from(!is_begun);
        let paint = paint.to_mut();
        paint.surface.texture = None;
        paint.texture_is_opaque = true;
        paint.color.iter_mut().zip(mapping.mean).for_each(|(lane, mean)| *lane *= mean);
    }
    if corners.count > 0 {
        let is_seen = is_seen(&paint, material.mapping, &vertices);
        tally.seen += u64::from(is_seen);
        tally.unseen += u64::from(!is_seen);
    }
    let triangles = (0..topology.triangles(corners.count))
        .map(|t| topology.corners(t).map(|corner| corners.vertex(corner)));
    builder.append(&paint, &vertices, triangles).map_err(|fault| {
        let (what, fix) = fault.numbered(|vertex| used.number(vertex)).explain();
        resources.invalid(at.into(), what, fix)
    })
}

/// Whether alpha leaves anything to be seen of a surface.
fn is_seen(paint: &Paint, mapping: Option<Mapping>, vertices: &Loaded) -> bool {
    let is_enough = |alpha: f64| match paint.surface.alpha {
        Alpha::Opaque => true,
        Alpha::Mask(cutoff) => alpha >= f64::from(cutoff),
        // What eight bits hold.
        Alpha::Blend => alpha * 255.0 >= 0.5,
    };
    let textured = mapping.filter(|_| paint.surface.texture.is_some());
    // The mean of a picture tells only whether it has any alpha.
    let picture = textured.map_or(1.0, |mapping| f64::from(mapping.mean[3] > picture::UNSEEN_MEAN));
    let factor = paint.color[3] * picture;
    is_enough(factor)
        && (vertices.colors.is_none() || {
            let mut own = (0..vertices.count()).map(|vertex| vertices.color(vertex)[3]);
            own.any(|alpha| is_enough(factor * f64::from(alpha)))
        })
}

/// The vertices that follow each other, by their places among those in use.
struct Corners {
    indices: Option<Elements>,
    count: usize,
    vertices: Numbers,
}

/// Vertices from the lowest to the highest index are read as one, up to so many times the corners.
const WIDE: usize = 64;

impl Corners {
    /// The corners of `range`, which must be there, of a primitive with so many vertices.
    fn load(
        resources: &Resources<'_>,
        at: &str,
        indices: Option<Accessor>,
        range: Range<usize>,
        vertices: usize,
    ) -> Result<Self, ImportError> {
        let count = range.len();
        let Some(indices) = indices else {
            return Ok(Self { indices: None, count, vertices: Numbers::Range(range) });
        };
        let start = range.start;
        let indices = indices.load(resources, Numbers::Range(range))?;

        let (mut low, mut high) = (usize::MAX, 0);
        for corner in 0..count {
            let index = indices.index(corner) as usize;
            if index >= vertices {
                let corner = start + corner;
                let what = format!(
                    "its index {index}, at place {corner}, is beyond its {vertices} positions"
                );
                return Err(resources.broken(at, what));
            }
            low = low.min(index);
            high = high.max(index + 1);
        }

        let range = low.min(high)..high;
        let vertices = match range.len() > WIDE.saturating_mul(count) {
            true => Numbers::Picked(picked(&indices, count)),
            false => Numbers::Range(range),
        };
        Ok(Self { indices: Some(indices), count, vertices })
    }

    fn vertex(&self, corner: usize) -> usize {
        let Some(indices) = &self.indices else { return corner };
        self.vertices.place(indices.index(corner) as usize)
    }
}

/// The vertices that so many corners name, in rising order.
fn picked(indices: &Elements, corners: usize) -> Rc<[u32]> {
    let mut picked: Vec<u32> = (0..corners).map(|corner| indices.index(corner)).collect();
    picked.sort_unstable();
    picked.dedup();
    picked.into()
}

/// Attributes of the vertices in use of one primitive.
struct Loaded {
    positions: Elements,
    normals: Option<Elements>,
    colors: Option<Elements>,
    tex_coords: Option<Elements>,
    mapping: Option<Mapping>,
}

impl Vertices for Loaded {
    fn count(&self) -> usize {
        self.positions.len()
    }

    fn position(&self, vertex: usize) -> [f64; 3] {
        self.positions.vector(vertex).map(f64::from)
    }

    fn normal(&self, vertex: usize) -> Option<[f32; 3]> {
        self.normals.as_ref().map(|normals| normals.vector(vertex))
    }

    fn color(&self, vertex: usize) -> [f32; 4] {
        self.colors.as_ref().map_or([1.0; 4], |colors| colors.vector(vertex))
    }

    fn tex_coord(&self, vertex: usize) -> [f32; 2] {
        let coord = self.tex_coords.as_ref().map(|coords| coords.vector(vertex));
        match (coord, &self.mapping) {
            (Some(coord), Some(mapping)) => mapping.apply(coord),
            _ => [0.0; 2],
        }
    }
}
