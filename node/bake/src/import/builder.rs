//! From vertices and triangles in any format to one [`SourceMesh`]: degenerate triangles dropped,
//! vertices compacted, normals found, triangles grouped by surface.

use glam::DVec3;

use crate::source::{Alpha, Section, SourceMesh, Surface};

/// What a material lends to every vertex it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Paint {
    /// Linear RGBA in 0..=1, a factor of the vertices' own colours.
    pub(super) color: [f64; 4],
    /// What the triangles are made of.
    pub(super) surface: Surface,
    /// Whether the texture's alpha is 1 everywhere, as it is where there is none.
    pub(super) texture_is_opaque: bool,
}

impl Paint {
    /// White, without a material.
    pub(super) const PLAIN: Self =
        Self { color: [1.0; 4], surface: Surface::PLAIN, texture_is_opaque: true };

    /// Whether its surface is as good as opaque, if all vertices it covers are.
    fn may_be_opaque(&self) -> bool {
        let seen = match self.surface.alpha {
            Alpha::Mask(cutoff) => cutoff <= 1.0,
            Alpha::Opaque | Alpha::Blend => true,
        };
        seen && self.texture_is_opaque
    }
}

/// Vertices as a file has them, numbered from 0.
pub(super) trait Vertices {
    /// How many there are.
    fn count(&self) -> usize;
    /// In mesh units; may be anything.
    fn position(&self, vertex: usize) -> [f64; 3];
    /// Of any length; `None` where the faces are flat.
    fn normal(&self, vertex: usize) -> Option<[f32; 3]>;
    /// Linear RGBA; may be anything.
    fn color(&self, vertex: usize) -> [f32; 4];
    /// With (0, 0) in the top left corner; may be anything.
    fn tex_coord(&self, vertex: usize) -> [f32; 2];
}

/// Why triangles cannot be taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fault {
    /// A position is not finite, or not so in single precision.
    Position {
        /// The vertex.
        vertex: usize,
        /// Its position.
        value: [f64; 3],
    },
    /// The mesh would have more vertices or triangles than 32 bits count.
    TooLarge,
    /// The mesh would have more surfaces than 16 bits count.
    TooManySurfaces,
}

impl Fault {
    /// The same with the numbers that vertices have in the file.
    pub(super) fn numbered(self, number: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::Position { vertex, value } => Self::Position { vertex: number(vertex), value },
            other => other,
        }
    }

    /// What is wrong, and what to do.
    pub(super) fn explain(self) -> (String, &'static str) {
        match self {
            Self::Position { vertex, value } => {
                (format!("its position {vertex} is {value:?}"), "export the file again")
            }
            Self::TooLarge => ("its mesh exceeds 2^32 vertices".into(), "split the mesh"),
            Self::TooManySurfaces => {
                ("its mesh has more than 65536 surfaces".into(), "split the mesh")
            }
        }
    }
}

/// A mesh whose sections still number surfaces by themselves.
#[derive(Debug, PartialEq)]
pub(super) struct Draft {
    /// The mesh; `surface` of a section is an index into `surfaces`.
    pub(super) mesh: SourceMesh,
    /// In the order of first use.
    pub(super) surfaces: Vec<Surface>,
}

/// Makes one mesh.
pub(super) struct Builder {
    mesh: SourceMesh,
    surfaces: Vec<Surface>,
    /// Triangles of one surface: one past the last, and the surface.
    runs: Vec<Section>,
    /// Normals without a direction, replaced by that of a face.
    pub(super) mended_normals: u64,
    /// Texture coordinates that are not finite, replaced by zero.
    pub(super) mended_tex_coords: u64,
}

impl Builder {
    /// An empty mesh.
    pub(super) fn new(name: String) -> Self {
        Self {
            mesh: SourceMesh { name, ..SourceMesh::default() },
            surfaces: Vec::new(),
            runs: Vec::new(),
            mended_normals: 0,
            mended_tex_coords: 0,
        }
    }

    /// Exactly degenerate triangles so far.
    pub(super) fn dropped_degenerate(&self) -> u64 {
        self.mesh.dropped_degenerate
    }

    /// Adds triangles of one material; they share no vertex with those added before. `triangles`
    /// must be numbers of `vertices`.
    pub(super) fn append(
        &mut self,
        paint: &Paint,
        vertices: &impl Vertices,
        triangles: impl ExactSizeIterator<Item = [usize; 3]>,
    ) -> Result<(), Fault> {
        let first = self.mesh.positions.len();
        let mut places = Places::new(self, paint, vertices, triangles.len());
        for triangle in triangles {
            let mut points = [DVec3::ZERO; 3];
            for (point, &vertex) in points.iter_mut().zip(&triangle) {
                let value = vertices.position(vertex);
                *point = DVec3::from(value);
                if !point.as_vec3().is_finite() {
                    return Err(Fault::Position { vertex, value });
                }
            }
            let area = (points[1] - points[0]).cross(points[2] - points[0]);
            // Exactly zero: nothing that has an area, however small, is left out.
            if area == DVec3::ZERO {
                places.builder.mesh.dropped_degenerate += 1;
                continue;
            }
            let face_normal = unit(area);
            let mut emitted = [0; 3];
            for (slot, &vertex) in emitted.iter_mut().zip(&triangle) {
                *slot = places.place(vertex, face_normal).ok_or(Fault::TooLarge)?;
            }
            places.builder.mesh.indices.push(emitted);
        }
        self.end_run(paint, first)
    }

    /// Closes the run of triangles whose vertices begin at `first`.
    fn end_run(&mut self, paint: &Paint, first: usize) -> Result<(), Fault> {
        let end = u32::try_from(self.mesh.indices.len()).map_err(|_| Fault::TooLarge)?;
        if end == self.runs.last().map_or(0, |run| run.end) {
            return Ok(());
        }
        let mut surface = paint.surface;
        if paint.may_be_opaque() && self.mesh.colors[first..].iter().all(|color| color[3] == 255) {
            surface.alpha = Alpha::Opaque;
        }
        let known = self.surfaces.iter().position(|&known| known == surface);
        let number = known.unwrap_or_else(|| {
            self.surfaces.push(surface);
            self.surfaces.len() - 1
        });
        let surface = u16::try_from(number).map_err(|_| Fault::TooManySurfaces)?;
        match self.runs.last_mut() {
            Some(run) if run.surface == surface => run.end = end,
            _ => self.runs.push(Section { end, surface }),
        }
        Ok(())
    }

    /// The mesh, one section a surface.
    pub(super) fn finish(self) -> Draft {
        let Self { mut mesh, surfaces, runs, .. } = self;
        mesh.sections = runs;
        if mesh.sections.len() > surfaces.len() {
            group(&mut mesh, surfaces.len());
        }
        // Growth by doubling leaves up to half of a large mesh unused.
        mesh.positions.shrink_to_fit();
        mesh.remainders.shrink_to_fit();
        mesh.normals.shrink_to_fit();
        mesh.colors.shrink_to_fit();
        mesh.tex_coords.shrink_to_fit();
        mesh.indices.shrink_to_fit();
        Draft { mesh, surfaces }
    }
}

/// Brings the triangles of each surface together, in the order they had.
fn group(mesh: &mut SourceMesh, surfaces: usize) {
    let mut by_surface: Vec<Vec<[u32; 3]>> = vec![Vec::new(); surfaces];
    let mut start = 0;
    for run in &mesh.sections {
        by_surface[usize::from(run.surface)].extend(&mesh.indices[start..run.end as usize]);
        start = run.end as usize;
    }
    mesh.indices.clear();
    mesh.sections.clear();
    for (surface, triangles) in by_surface.into_iter().enumerate() {
        mesh.indices.extend(triangles);
        let end = mesh.indices.len() as u32;
        mesh.sections.push(Section { end, surface: surface as u16 });
    }
}

/// The unit vector along `v`, which must be finite and not zero.
pub(super) fn unit(v: DVec3) -> [f32; 3] {
    // Scaled first, so that neither a square underflows nor a sum overflows.
    let scaled = v / v.abs().max_element();
    (scaled / scaled.length()).to_array().map(|lane| lane as f32)
}

/// Gives vertices their places in the mesh, on first use: what no triangle uses takes no room.
struct Places<'a, V> {
    builder: &'a mut Builder,
    paint: &'a Paint,
    vertices: &'a V,
    textured: bool,
    /// By vertex, its latest copy in the mesh.
    latest: Vec<u32>,
    /// By copy, counted from `first`: the copy of the same vertex before it. Only where faces are
    /// flat has a vertex more than one.
    earlier: Vec<u32>,
    first: usize,
}

const NONE: u32 = u32::MAX;

/// How many copies of a flat-shaded vertex are compared before a new one is made. It bounds the
/// time spent at the hub of a wide fan; a corner of a box has three.
const COPIES_COMPARED: usize = 8;

impl<'a, V: Vertices> Places<'a, V> {
    fn new(builder: &'a mut Builder, paint: &'a Paint, vertices: &'a V, triangles: usize) -> Self {
        let textured = paint.surface.texture.is_some();
        let mesh = &mut builder.mesh;
        let first = mesh.positions.len();
        let most = vertices.count().min(triangles.saturating_mul(3));
        mesh.positions.reserve(most);
        mesh.normals.reserve(most);
        mesh.colors.reserve(most);
        mesh.indices.reserve(triangles);
        if textured {
            // What came before has no texture.
            mesh.tex_coords.resize(first, [0.0; 2]);
            mesh.tex_coords.reserve(most);
        }
        let latest = vec![NONE; vertices.count()];
        Self { builder, paint, vertices, textured, latest, earlier: Vec::new(), first }
    }

    /// The place of `vertex` in the mesh for a face with this normal; `None` if places run out.
    fn place(&mut self, vertex: usize, face_normal: [f32; 3]) -> Option<u32> {
        let latest = self.latest[vertex];
        let normal = self.vertices.normal(vertex);
        if latest != NONE {
            if normal.is_some() {
                return Some(latest);
            }
            let mut copy = latest;
            for _ in 0..COPIES_COMPARED {
                if copy == NONE {
                    break;
                }
                if self.builder.mesh.normals[copy as usize] == face_normal {
                    return Some(copy);
                }
                copy = self.earlier[copy as usize - self.first];
            }
        }
        let color = self.color(vertex);
        let mesh = &mut self.builder.mesh;
        let place = u32::try_from(mesh.positions.len()).ok().filter(|&place| place != NONE)?;
        self.latest[vertex] = place;
        self.earlier.push(latest);
        mesh.push_position(DVec3::from(self.vertices.position(vertex)));
        mesh.colors.push(color);
        if self.textured || !self.builder.mesh.tex_coords.is_empty() {
            let coord = self.tex_coord(vertex);
            self.builder.mesh.tex_coords.push(coord);
        }
        let normal = normal.map_or(face_normal, |normal| self.mended(normal, face_normal));
        self.builder.mesh.normals.push(normal);
        Some(place)
    }

    fn mended(&mut self, normal: [f32; 3], face_normal: [f32; 3]) -> [f32; 3] {
        let normal = DVec3::from(normal.map(f64::from));
        if normal.is_finite() && normal != DVec3::ZERO {
            return unit(normal);
        }
        self.builder.mended_normals += 1;
        face_normal
    }

    fn color(&self, vertex: usize) -> [u8; 4] {
        let own = self.vertices.color(vertex);
        std::array::from_fn(|lane| {
            if lane == 3 && self.paint.surface.alpha == Alpha::Opaque {
                return u8::MAX;
            }
            // A cast from NaN gives 0.
            (f64::from(own[lane]).clamp(0.0, 1.0) * self.paint.color[lane] * 255.0).round() as u8
        })
    }

    fn tex_coord(&mut self, vertex: usize) -> [f32; 2] {
        if !self.textured {
            return [0.0; 2];
        }
        let coord = self.vertices.tex_coord(vertex);
        if coord.iter().all(|lane| lane.is_finite()) {
            return coord;
        }
        self.builder.mended_tex_coords += 1;
        [0.0; 2]
    }
}

#[cfg(test)]
mod tests;
