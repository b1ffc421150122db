//! A source scene: what every importer yields and every later stage of the bake reads.

use glam::{DVec3, Vec3};
pub use protocol::format::Wrap;

/// Most triangles of a mesh that are handed on or read back at once. Always the same, so that no
/// scene depends on the memory it was baked in.
pub const PART_TRIANGLES: usize = 1 << 16;

/// One mesh, in its own coordinates. Any number of objects may place it.
///
/// An importer guarantees: `positions`, `normals` and `colors` are equally long, every number is
/// finite, every index is below that length, and no triangle is exactly degenerate (a repeated
/// index, or an area that is zero in `f64`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SourceMesh {
    /// The file's own name for it, or a made-up one that says where it stands ("mesh 3").
    pub name: String,
    /// Vertex positions, in mesh units.
    pub positions: Vec<[f32; 3]>,
    /// What single precision leaves of the positions, to be added to them: one a position, or none at
    /// all where it leaves nothing.
    pub remainders: Vec<[f32; 3]>,
    /// Unit normals, one a position. Where the file has none, vertices are duplicated and each
    /// triangle gets its face normal (glTF 2.0, section 3.7.2.1, "flat normals").
    pub normals: Vec<[f32; 3]>,
    /// Linear RGBA, 8 bits a channel, one a position: vertex colour times base colour factor. A
    /// texture's colour multiplies it when drawn. Alpha is 255 where the surface is opaque.
    pub colors: Vec<[u8; 4]>,
    /// Texture coordinates, (0, 0) being the top left corner of a picture: one a position, or none at
    /// all where no surface of the mesh has a texture.
    pub tex_coords: Vec<[f32; 2]>,
    /// Triangles, counter-clockwise seen from the front. None at all, if every triangle that the
    /// file holds is degenerate.
    pub indices: Vec<[u32; 3]>,
    /// What the triangles are made of: runs that cover `indices` one after the other. A vertex is
    /// used by triangles of one surface alone.
    pub sections: Vec<Section>,
    /// Triangles the file holds that are left out of `indices` because they are exactly
    /// degenerate.
    pub dropped_degenerate: u64,
}

/// A run of triangles of one surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Section {
    /// One past its last triangle.
    pub end: u32,
    /// Index into [`Imported::surfaces`].
    pub surface: u16,
}

/// How alpha acts (glTF 2.0, section 3.9.4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    /// Not at all.
    Opaque,
    /// What has less alpha than this is not there.
    Mask(f32),
    /// Mixed with what lies behind.
    Blend,
}

/// What triangles are made of, apart from their colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// How alpha acts.
    pub alpha: Alpha,
    /// Seen from behind as well. Formats that do not say so are double-sided.
    pub double_sided: bool,
    /// Number of the texture, as the [`Sink`] took it.
    pub texture: Option<u32>,
}

impl Surface {
    /// An opaque surface seen from both sides.
    pub const PLAIN: Self = Self { alpha: Alpha::Opaque, double_sided: true, texture: None };
}

/// A base colour picture, already no larger than the bake's limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// The file's own name for it, or a made-up one.
    pub name: String,
    /// Pixels along each side: a power of two.
    pub side: u32,
    /// sRGB-encoded RGBA, `4 * side * side` bytes, top row first.
    pub rgba: Vec<u8>,
    /// Horizontally and vertically.
    pub wrap: [Wrap; 2],
}

impl SourceMesh {
    /// Where a vertex stands, in mesh units: within 2^-48 of its distance from the origin.
    pub fn position(&self, vertex: usize) -> DVec3 {
        let position = Vec3::from_array(self.positions[vertex]).as_dvec3();
        match self.remainders.get(vertex) {
            Some(&remainder) => position + Vec3::from_array(remainder).as_dvec3(),
            None => position,
        }
    }

    /// Adds a position. It must be finite in single precision, too.
    pub(crate) fn push_position(&mut self, position: DVec3) {
        let rounded = position.as_vec3();
        let remainder = (position - rounded.as_dvec3()).as_vec3();
        if remainder != Vec3::ZERO || !self.remainders.is_empty() {
            self.remainders.resize(self.positions.len(), [0.0; 3]);
            self.remainders.push(remainder.to_array());
        }
        self.positions.push(rounded.to_array());
    }

    /// Triangles the file holds for this mesh, the dropped ones counted.
    pub fn triangles(&self) -> u64 {
        self.indices.len() as u64 + self.dropped_degenerate
    }

    /// The triangles of `range` and what they use, without a name. `stamps` is as long as the
    /// positions, all `u32::MAX` before and after.
    pub(crate) fn part(&self, range: std::ops::Range<usize>, stamps: &mut [u32]) -> Self {
        let mut part = Self::default();
        let mut used = Vec::new();
        part.indices.extend(self.indices[range.clone()].iter().map(|triangle| {
            triangle.map(|index| {
                let stamp = &mut stamps[index as usize];
                if *stamp == u32::MAX {
                    *stamp = used.len() as u32;
                    used.push(index as usize);
                }
                *stamp
            })
        }));
        used.iter().for_each(|&index| stamps[index] = u32::MAX);
        part.positions.extend(used.iter().map(|&index| self.positions[index]));
        if !self.remainders.is_empty() {
            part.remainders.extend(used.iter().map(|&index| self.remainders[index]));
        }
        part.normals.extend(used.iter().map(|&index| self.normals[index]));
        part.colors.extend(used.iter().map(|&index| self.colors[index]));
        if !self.tex_coords.is_empty() {
            part.tex_coords.extend(used.iter().map(|&index| self.tex_coords[index]));
        }
        for &Section { end, surface } in &self.sections {
            let end = (end as usize).min(range.end).saturating_sub(range.start) as u32;
            if end > part.sections.last().map_or(0, |section: &Section| section.end) {
                part.sections.push(Section { end, surface });
            }
        }
        part
    }

    /// Appends a part whose vertices are numbered from 0.
    #[cfg(test)]
    pub(crate) fn append(&mut self, part: Self) {
        let (first, triangles) = (self.positions.len(), self.indices.len() as u32);
        if !self.tex_coords.is_empty() || !part.tex_coords.is_empty() {
            self.tex_coords.resize(first, [0.0; 2]);
            self.tex_coords.extend(&part.tex_coords);
            self.tex_coords.resize(first + part.positions.len(), [0.0; 2]);
        }
        if !self.remainders.is_empty() || !part.remainders.is_empty() {
            self.remainders.resize(first, [0.0; 3]);
            self.remainders.extend(&part.remainders);
            self.remainders.resize(first + part.positions.len(), [0.0; 3]);
        }
        self.positions.extend(part.positions);
        self.normals.extend(part.normals);
        self.colors.extend(part.colors);
        self.indices.extend(part.indices.iter().map(|t| t.map(|index| index + first as u32)));
        let moved = |s: Section| Section { end: s.end + triangles, ..s };
        self.sections.extend(part.sections.into_iter().map(moved));
        self.dropped_degenerate += part.dropped_degenerate;
    }
}

/// One placed mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceObject {
    /// The file's own name for it, or a made-up one that says where it stands ("node 7").
    pub name: String,
    /// Number of the mesh it shows, as the [`Sink`] took it.
    pub mesh: usize,
    /// Where it stands: finite, and invertible in exact arithmetic (its determinant is not zero).
    /// See [`SourceObject::is_mirrored`].
    pub world_from_mesh: glam::DAffine3,
}

impl SourceObject {
    /// Whether the transform is a reflection. A mesh is shared by objects of both kinds, so its
    /// indices stay as they are; whoever maps it to the world exchanges two indices of every
    /// triangle of a mirrored object. Normals need no such care: the inverse transpose keeps them
    /// on the outside.
    pub fn is_mirrored(&self) -> bool {
        self.world_from_mesh.matrix3.determinant() < 0.0
    }
}

/// Takes what an importer reads, piece by piece, so that no scene need be in memory as a whole.
///
/// Meshes and textures are numbered in the order of the calls, from 0 in each scene file: by these
/// numbers [`SourceObject::mesh`] and [`Surface::texture`] refer to them.
pub trait Sink {
    /// Takes the next mesh.
    fn mesh(&mut self, mesh: SourceMesh) -> std::io::Result<()>;
    /// Takes more triangles of the mesh that was taken last. They share no vertex with those before:
    /// their vertices are numbered from 0 again.
    fn more(&mut self, part: SourceMesh) -> std::io::Result<()>;
    /// Takes the next texture.
    fn texture(&mut self, texture: Texture) -> std::io::Result<()>;
}

/// What an import leaves to say once its meshes and textures are with the [`Sink`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imported {
    /// Objects, in the order of a depth-first walk over the file's nodes.
    pub objects: Vec<SourceObject>,
    /// Distinct surfaces. The first is [`Surface::PLAIN`].
    pub surfaces: Vec<Surface>,
    /// The up direction of the scene's axes, unit length.
    pub up: [f64; 3],
    /// What was skipped or simplified, one sentence each, for the summary.
    pub notes: Vec<String>,
}

/// A whole source scene in memory, for tests.
#[cfg(test)]
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Source {
    /// Distinct meshes: in the file's order, then those an importer had to make for single objects.
    pub meshes: Vec<SourceMesh>,
    /// Objects, in the order of a depth-first walk over the file's nodes.
    pub objects: Vec<SourceObject>,
    /// Distinct surfaces. The first is [`Surface::PLAIN`].
    pub surfaces: Vec<Surface>,
    /// Base colour pictures, each used by a surface.
    pub textures: Vec<Texture>,
    /// The up direction of the scene's axes, unit length.
    pub up: [f64; 3],
    /// What was skipped or simplified, one sentence each, for the summary.
    pub notes: Vec<String>,
}

#[cfg(test)]
impl Source {
    /// Adds what an import says last to a scene that already holds its meshes and textures.
    pub(crate) fn complete(&mut self, imported: Imported) {
        let Imported { objects, surfaces, up, notes } = imported;
        *self = Self { objects, surfaces, up, notes, ..std::mem::take(self) };
    }

    /// Triangles the file shows: each instance counted, degenerate ones too.
    pub fn triangles(&self) -> u64 {
        self.objects.iter().map(|object| self.meshes[object.mesh].triangles()).sum()
    }

    /// Triangles the file holds: each mesh counted once, degenerate ones too.
    pub fn unique_triangles(&self) -> u64 {
        self.meshes.iter().map(SourceMesh::triangles).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_scene_counts_nothing() {
        assert_eq!(Source::default().triangles(), 0);
        assert_eq!(Source::default().unique_triangles(), 0);
    }

    #[test]
    fn instances_count_each_and_unique_triangles_once() {
        let mesh = SourceMesh {
            indices: vec![[0, 1, 2]; 3],
            dropped_degenerate: 2,
            ..SourceMesh::default()
        };
        let object = SourceObject {
            name: String::new(),
            mesh: 0,
            world_from_mesh: glam::DAffine3::IDENTITY,
        };
        let source = Source {
            meshes: vec![mesh],
            objects: vec![object.clone(), object.clone(), object],
            ..Source::default()
        };
        assert_eq!(source.triangles(), 15);
        assert_eq!(source.unique_triangles(), 5);
    }
}
