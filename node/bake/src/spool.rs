//! Where an importer's meshes and textures wait on disk, so that no scene need be in memory.

use crate::bulk::{self, SAMPLES, Sample};
use crate::bytes::{Decoder, Encoder, Torn};
use crate::source::{
    Alpha, Imported, PART_TRIANGLES, Section, Sink, SourceMesh, SourceObject, Surface, Texture,
    Wrap,
};
use crate::work::{Appender, Records, Span, Work, WorkError};
use geometry::bounds::Aabb;
use geometry::weld::Repeats;
use glam::{DAffine3, DMat3, DVec3};
use std::io;
use std::ops::Range;

const MESHES: &str = "meshes";

/// What is known of a mesh that lies on disk.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MeshInfo {
    pub(crate) name: String,
    pub(crate) positions: u64,
    pub(crate) remainders: u64,
    pub(crate) tex_coords: u64,
    pub(crate) triangles: u64,
    pub(crate) dropped_degenerate: u64,
    /// Box of all positions, in its own space.
    pub(crate) bounds: Aabb,
    /// Its parts: those from this one of [`Scene::parts`] on, up to the next mesh's.
    first_part: u32,
}

/// What is known of some triangles of a mesh that lie on disk, at most [`PART_TRIANGLES`].
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct PartInfo {
    positions: u32,
    remainders: u32,
    tex_coords: u32,
    triangles: u32,
    /// Its sections: those from this one of [`Scene::sections`] on.
    first_section: u32,
    sections: u32,
    span: Span,
    samples: [Sample; SAMPLES],
}

impl MeshInfo {
    /// Bytes of its positions, remainders, normals, colours, texture coordinates and triangles in memory.
    pub(crate) fn bytes(&self) -> u64 {
        28 * self.positions + 12 * self.remainders + 8 * self.tex_coords + 12 * self.triangles
    }
}

/// What is known of a texture that lies on disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TextureInfo {
    pub(crate) side: u32,
    pub(crate) wrap: [Wrap; 2],
    span: Span,
}

/// Takes what importers read to the working folder.
#[derive(Debug)]
pub(crate) struct Spool {
    file: Appender,
    meshes: Vec<MeshInfo>,
    parts: Vec<PartInfo>,
    sections: Vec<[u32; 2]>,
    textures: Vec<TextureInfo>,
    /// Surfaces of the files before.
    surfaces: usize,
}

impl Spool {
    pub(crate) fn create(work: &Work) -> Result<Self, WorkError> {
        let file = Appender::create(&work.path(MESHES))?;
        Ok(Self {
            file,
            meshes: Vec::new(),
            parts: Vec::new(),
            sections: Vec::new(),
            textures: Vec::new(),
            surfaces: 0,
        })
    }

    /// Meshes and textures so far: the numbers of the next file begin there.
    pub(crate) fn counts(&self) -> (usize, usize) {
        (self.meshes.len(), self.textures.len())
    }

    /// Another file follows, whose surfaces stand behind so many of earlier ones.
    pub(crate) fn next_file(&mut self, surfaces: usize) {
        self.surfaces = surfaces;
    }

    /// Completes the scene.
    pub(crate) fn finish(mut self, imported: Imported) -> Result<Scene, WorkError> {
        self.file.flush()?;
        let Imported { objects, surfaces, up, notes } = imported;
        let Self { meshes, parts, sections, textures, .. } = self;
        Ok(Scene { meshes, parts, sections, textures, objects, surfaces, up, notes })
    }

    /// Writes a part of the latest mesh.
    fn part(&mut self, part: &SourceMesh) -> io::Result<()> {
        let info = self.meshes.last_mut().expect("a mesh was begun");
        info.positions += part.positions.len() as u64;
        info.remainders += part.remainders.len() as u64;
        info.tex_coords += part.tex_coords.len() as u64;
        info.triangles += part.indices.len() as u64;
        info.dropped_degenerate += part.dropped_degenerate;
        if info.positions.max(info.triangles) > u64::from(u32::MAX) {
            return Err(io::Error::other("a mesh exceeds 2^32 vertices; split it"));
        }
        let points = (0..part.positions.len()).map(|vertex| part.position(vertex));
        info.bounds = info.bounds.union(Aabb::of(points));
        let first_section = self.sections.len() as u32;
        for &Section { end, surface } in &part.sections {
            let surface = u32::from(surface) + self.surfaces as u32;
            if surface > u32::from(u16::MAX) {
                return Err(io::Error::other("there are more than 65536 surfaces"));
            }
            self.sections.push([end, surface]);
        }
        let span = self.file.append(&[
            bytemuck::cast_slice(&part.positions),
            bytemuck::cast_slice(&part.remainders),
            bytemuck::cast_slice(&part.normals),
            bytemuck::cast_slice(&part.colors),
            bytemuck::cast_slice(&part.tex_coords),
            bytemuck::cast_slice(&part.indices),
        ])?;
        self.parts.push(PartInfo {
            positions: part.positions.len() as u32,
            remainders: part.remainders.len() as u32,
            tex_coords: part.tex_coords.len() as u32,
            triangles: part.indices.len() as u32,
            first_section,
            sections: part.sections.len() as u32,
            span,
            samples: bulk::samples(part),
        });
        Ok(())
    }
}

impl Sink for Spool {
    fn mesh(&mut self, mut mesh: SourceMesh) -> io::Result<()> {
        self.meshes.push(MeshInfo {
            name: std::mem::take(&mut mesh.name),
            positions: 0,
            remainders: 0,
            tex_coords: 0,
            triangles: 0,
            dropped_degenerate: 0,
            bounds: Aabb::EMPTY,
            first_part: self.parts.len() as u32,
        });
        self.more(mesh)
    }

    fn more(&mut self, part: SourceMesh) -> io::Result<()> {
        let triangles = part.indices.len();
        if triangles <= PART_TRIANGLES {
            return self.part(&part);
        }
        let mut stamps = vec![u32::MAX; part.positions.len()];
        for start in (0..triangles).step_by(PART_TRIANGLES) {
            let end = triangles.min(start + PART_TRIANGLES);
            self.part(&part.part(start..end, &mut stamps))?;
        }
        let info = self.meshes.last_mut().expect("a mesh was begun");
        info.dropped_degenerate += part.dropped_degenerate;
        Ok(())
    }

    fn texture(&mut self, texture: Texture) -> io::Result<()> {
        let span = self.file.append(&[&texture.rgba])?;
        self.textures.push(TextureInfo { side: texture.side, wrap: texture.wrap, span });
        Ok(())
    }
}

/// A whole source scene, its meshes and textures on disk.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Scene {
    pub(crate) meshes: Vec<MeshInfo>,
    /// Mesh after mesh.
    parts: Vec<PartInfo>,
    /// Part after part: one past the last triangle, counted within the part, and the surface.
    sections: Vec<[u32; 2]>,
    pub(crate) textures: Vec<TextureInfo>,
    pub(crate) objects: Vec<SourceObject>,
    pub(crate) surfaces: Vec<Surface>,
    pub(crate) up: [f64; 3],
    pub(crate) notes: Vec<String>,
}

impl Scene {
    /// The file its meshes and textures lie in.
    pub(crate) fn open(work: &Work) -> Result<Records, WorkError> {
        Records::open(&work.path(MESHES))
    }

    /// Forgets the meshes' file.
    pub(crate) fn forget(work: &Work) {
        work.forget(MESHES);
    }

    /// Whether the file holds all meshes and textures as they were written.
    pub(crate) fn is_whole(&self, work: &Work) -> bool {
        let textures = self.textures.iter().map(|texture| texture.span);
        let spans = self.parts.iter().map(|part| part.span).chain(textures);
        Self::open(work).is_ok_and(|file| file.holds(spans))
    }

    /// Numbers of a mesh's parts.
    pub(crate) fn parts_of(&self, mesh: usize) -> Range<usize> {
        let end = self.meshes.get(mesh + 1).map_or(self.parts.len(), |m| m.first_part as usize);
        self.meshes[mesh].first_part as usize..end
    }

    /// Samples of a mesh's triangles, each with how many it stands for.
    pub(crate) fn samples_of(&self, mesh: usize) -> impl Iterator<Item = (Sample, f64)> {
        let parts = self.parts[self.parts_of(mesh)].iter().filter(|part| part.triangles > 0);
        parts.flat_map(|part| {
            part.samples.map(|sample| (sample, f64::from(part.triangles) / SAMPLES as f64))
        })
    }

    /// Triangles of a part.
    pub(crate) fn part_triangles(&self, part: usize) -> u32 {
        self.parts[part].triangles
    }

    /// Reads a mesh back.
    pub(crate) fn mesh(&self, from: &Records, mesh: usize) -> Result<SourceMesh, WorkError> {
        self.some_parts(from, self.parts_of(mesh))
    }

    /// Reads some parts of a mesh back, as one.
    pub(crate) fn some_parts(
        &self,
        from: &Records,
        parts: Range<usize>,
    ) -> Result<SourceMesh, WorkError> {
        let infos = &self.parts[parts];
        let sum = |count: fn(&PartInfo) -> u32| infos.iter().map(|i| count(i) as usize).sum();
        let (positions, triangles): (usize, usize) = (sum(|i| i.positions), sum(|i| i.triangles));
        let has_remainders = infos.iter().any(|info| info.remainders > 0);
        let is_textured = infos.iter().any(|info| info.tex_coords > 0);
        let mut mesh = SourceMesh {
            name: String::new(),
            positions: vec![[0.0; 3]; positions],
            remainders: vec![[0.0; 3]; if has_remainders { positions } else { 0 }],
            normals: vec![[0.0; 3]; positions],
            colors: vec![[0; 4]; positions],
            tex_coords: vec![[0.0; 2]; if is_textured { positions } else { 0 }],
            indices: vec![[0; 3]; triangles],
            sections: Vec::with_capacity(sum(|i| i.sections)),
            dropped_degenerate: 0,
        };
        let (mut vertex, mut triangle) = (0, 0);
        for info in infos {
            let end = vertex + info.positions as usize;
            let indices = &mut mesh.indices[triangle..][..info.triangles as usize];
            // A part without remainders or coordinates leaves them zero.
            let rest = mesh.remainders.get_mut(vertex..vertex + info.remainders as usize);
            let coords = mesh.tex_coords.get_mut(vertex..vertex + info.tex_coords as usize);
            from.read_into(
                info.span,
                &mut [
                    bytemuck::cast_slice_mut(&mut mesh.positions[vertex..end]),
                    bytemuck::cast_slice_mut(rest.unwrap_or_default()),
                    bytemuck::cast_slice_mut(&mut mesh.normals[vertex..end]),
                    bytemuck::cast_slice_mut(&mut mesh.colors[vertex..end]),
                    bytemuck::cast_slice_mut(coords.unwrap_or_default()),
                    bytemuck::cast_slice_mut(indices),
                ],
            )?;
            if vertex > 0 {
                indices.as_flattened_mut().iter_mut().for_each(|index| *index += vertex as u32);
            }
            let own = &self.sections[info.first_section as usize..][..info.sections as usize];
            mesh.sections.extend(own.iter().map(|&[end, surface]| Section {
                end: end + triangle as u32,
                surface: surface as u16,
            }));
            (vertex, triangle) = (end, triangle + info.triangles as usize);
        }
        Ok(mesh)
    }

    /// Reads a texture's pixels back.
    pub(crate) fn texture(&self, from: &Records, index: usize) -> Result<Vec<u8>, WorkError> {
        from.read(self.textures[index].span)
    }

    /// By surface: what becomes of repeated triangles.
    pub(crate) fn repeats(&self) -> Vec<Repeats> {
        let of = |surface: &Surface| match (surface.alpha, surface.double_sided) {
            (Alpha::Blend, _) => Repeats::All,
            (_, false) => Repeats::EachWay,
            (_, true) => Repeats::One,
        };
        self.surfaces.iter().map(of).collect()
    }

    /// As bytes, for the working folder.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = Encoder::default();
        out.put(self.meshes.len() as u64);
        for mesh in &self.meshes {
            out.put_text(&mesh.name);
            let MeshInfo { positions, remainders, tex_coords, triangles, .. } = *mesh;
            out.put([positions, remainders, tex_coords, triangles, mesh.dropped_degenerate]);
            out.put([mesh.bounds.min.to_array(), mesh.bounds.max.to_array()]);
            out.put(mesh.first_part);
        }
        out.put_slice(&self.parts);
        out.put_slice(&self.sections);
        out.put(self.textures.len() as u64);
        for texture in &self.textures {
            out.put(texture.side);
            out.put(Wrap::pack(texture.wrap));
            out.put(texture.span);
        }
        out.put(self.objects.len() as u64);
        for object in &self.objects {
            out.put_text(&object.name);
            out.put(object.mesh as u64);
            out.put(object.world_from_mesh.matrix3.to_cols_array());
            out.put(object.world_from_mesh.translation.to_array());
        }
        out.put(self.surfaces.len() as u64);
        for surface in &self.surfaces {
            let (alpha, cutoff) = match surface.alpha {
                Alpha::Opaque => (0u32, 0.0f32),
                Alpha::Mask(cutoff) => (1, cutoff),
                Alpha::Blend => (2, 0.0),
            };
            out.put((alpha | u32::from(surface.double_sided) << 8, cutoff).0);
            out.put(cutoff);
            out.put(surface.texture.unwrap_or(u32::MAX));
        }
        out.put(self.up);
        out.put(self.notes.len() as u64);
        self.notes.iter().for_each(|note| out.put_text(note));
        out.0
    }

    /// From what [`Scene::encode`] made.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, Torn> {
        let from = &mut Decoder(bytes);
        let mut scene = Self::default();
        for _ in 0..from.take_count()? {
            let name = from.take_text()?;
            let [positions, remainders, tex_coords, triangles, dropped_degenerate] = from.take()?;
            let [min, max]: [[f64; 3]; 2] = from.take()?;
            scene.meshes.push(MeshInfo {
                name,
                positions,
                remainders,
                tex_coords,
                triangles,
                dropped_degenerate,
                bounds: Aabb { min: min.into(), max: max.into() },
                first_part: from.take()?,
            });
        }
        scene.parts = from.take_slice()?;
        scene.sections = from.take_slice()?;
        for _ in 0..from.take_count()? {
            let side = from.take()?;
            let wrap = Wrap::unpack(from.take()?).ok_or(Torn)?;
            scene.textures.push(TextureInfo { side, wrap, span: from.take()? });
        }
        for _ in 0..from.take_count()? {
            let name = from.take_text()?;
            let mesh = from.take::<u64>()? as usize;
            let matrix3 = DMat3::from_cols_array(&from.take()?);
            let translation = DVec3::from_array(from.take()?);
            let world_from_mesh = DAffine3 { matrix3, translation };
            scene.objects.push(SourceObject { name, mesh, world_from_mesh });
        }
        for _ in 0..from.take_count()? {
            let word: u32 = from.take()?;
            let cutoff: f32 = from.take()?;
            let alpha = match word & 0xff {
                0 => Alpha::Opaque,
                1 => Alpha::Mask(cutoff),
                2 => Alpha::Blend,
                _ => return Err(Torn),
            };
            let texture = Some(from.take::<u32>()?).filter(|&texture| texture != u32::MAX);
            scene.surfaces.push(Surface { alpha, double_sided: word >> 8 & 1 == 1, texture });
        }
        scene.up = from.take()?;
        for _ in 0..from.take_count()? {
            scene.notes.push(from.take_text()?);
        }
        if from.0.is_empty() { Ok(scene) } else { Err(Torn) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_comes_back_whole() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(&folder.path().join("a.occ")).unwrap();
        let mut spool = Spool::create(&work).unwrap();
        let mesh = SourceMesh {
            name: "roof".into(),
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            remainders: vec![[1e-9; 3], [0.0; 3], [-1e-9, 0.0, 0.0]],
            normals: vec![[0.0, 0.0, 1.0]; 3],
            colors: vec![[1, 2, 3, 4]; 3],
            tex_coords: vec![[0.5, 0.25]; 3],
            indices: vec![[0, 1, 2]],
            sections: vec![Section { end: 1, surface: 1 }],
            dropped_degenerate: 2,
        };
        spool.mesh(SourceMesh::default()).unwrap();
        spool.mesh(mesh.clone()).unwrap();
        let wrap = [Wrap::Mirror, Wrap::Clamp];
        let texture = Texture { name: "brick".into(), side: 1, rgba: vec![9; 4], wrap };
        spool.texture(texture).unwrap();
        let surfaces = [Alpha::Opaque, Alpha::Mask(0.5), Alpha::Blend].map(|alpha| Surface {
            alpha,
            double_sided: alpha == Alpha::Blend,
            texture: (alpha == Alpha::Blend).then_some(0),
        });
        let world_from_mesh = DAffine3::from_translation(DVec3::new(1e7, 0.1, -3.0));
        let imported = Imported {
            objects: vec![SourceObject { name: "house".into(), mesh: 1, world_from_mesh }],
            surfaces: surfaces.to_vec(),
            up: [0.0, 0.0, 1.0],
            notes: vec!["a note".into()],
        };
        let scene = spool.finish(imported).unwrap();
        let bytes = scene.encode();
        assert_eq!(Scene::decode(&bytes).as_ref(), Ok(&scene));
        assert!((0..bytes.len()).all(|end| Scene::decode(&bytes[..end]).is_err()));
        let from = Scene::open(&work).unwrap();
        let kept = SourceMesh { name: String::new(), dropped_degenerate: 0, ..mesh };
        assert_eq!(scene.mesh(&from, 1).unwrap(), kept);
        assert_eq!((&*scene.meshes[1].name, scene.meshes[1].dropped_degenerate), ("roof", 2));
        assert_eq!(scene.texture(&from, 0).unwrap(), [9; 4]);
        assert!(scene.is_whole(&work));
        let path = work.path(MESHES);
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[at] ^= 1;
            std::fs::write(&path, flipped).unwrap();
            assert!(!scene.is_whole(&work), "byte {at}");
        }
    }

    #[test]
    fn a_large_mesh_lies_in_parts_and_comes_back_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(&folder.path().join("a.occ")).unwrap();
        let mut spool = Spool::create(&work).unwrap();
        // A fan: every triangle has the hub.
        let count = PART_TRIANGLES as u32 + 700;
        let at = |i: u32| [(f64::from(i) * 1e-4).cos() as f32, (f64::from(i) * 1e-4).sin() as f32];
        let rim: Vec<[f32; 2]> = (0..count + 2).map(at).collect();
        let fan = SourceMesh {
            positions: rim.iter().map(|[x, y]| [*x, *y, 0.0]).collect(),
            normals: vec![[0.0, 0.0, 1.0]; rim.len()],
            colors: vec![[7; 4]; rim.len()],
            tex_coords: rim,
            indices: (0..count).map(|i| [0, i + 1, i + 2]).collect(),
            sections: [(600, 2), (count - 5, 1), (count, 2)]
                .map(|(end, surface)| Section { end, surface })
                .to_vec(),
            dropped_degenerate: 3,
            ..SourceMesh::default()
        };
        spool.mesh(fan.clone()).unwrap();
        let more = SourceMesh { tex_coords: Vec::new(), ..fan.clone() };
        spool.more(more).unwrap();
        let scene = spool.finish(Imported::default()).unwrap();
        assert_eq!((scene.parts_of(0), scene.meshes[0].dropped_degenerate), (0..4, 6));
        assert_eq!(scene.meshes[0].triangles, 2 * u64::from(count));
        let back = scene.mesh(&Scene::open(&work).unwrap(), 0).unwrap();
        let corners = |mesh: &SourceMesh, triangle: u32| {
            let section = mesh.sections.iter().find(|section| triangle < section.end);
            let corners = mesh.indices[triangle as usize].map(|index| {
                let coords = mesh.tex_coords[index as usize];
                (mesh.positions[index as usize], coords, mesh.colors[index as usize])
            });
            (section.unwrap().surface, corners)
        };
        for triangle in 0..count {
            assert_eq!(corners(&back, triangle), corners(&fan, triangle), "{triangle}");
            let (surface, again) = corners(&back, triangle + count);
            let (expected, corners) = corners(&fan, triangle);
            assert_eq!(surface, expected);
            assert!(again.iter().zip(corners).all(|(a, b)| a.0 == b.0 && a.1 == [0.0; 2]));
        }
    }
}
