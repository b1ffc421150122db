//! Where an importer's meshes and textures wait on disk, so that no scene need be in memory.

use crate::bytes::{Decoder, Encoder, Torn};
use crate::source::{
    Alpha, Imported, Section, Sink, SourceMesh, SourceObject, Surface, Texture, Wrap,
};
use crate::work::{Appender, Records, Span, Work, WorkError};
use geometry::bounds::Aabb;
use geometry::weld::Repeats;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use std::io;

const MESHES: &str = "meshes";

/// What is known of a mesh that lies on disk.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MeshInfo {
    pub(crate) name: String,
    pub(crate) positions: u64,
    pub(crate) tex_coords: u64,
    pub(crate) triangles: u64,
    pub(crate) dropped_degenerate: u64,
    /// Box of all positions, in its own space.
    pub(crate) bounds: Aabb,
    sections: Vec<Section>,
    span: Span,
}

impl MeshInfo {
    /// Bytes of its positions, normals, colours, texture coordinates and triangles in memory.
    pub(crate) fn bytes(&self) -> u64 {
        28 * self.positions + 8 * self.tex_coords + 12 * self.triangles
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
    textures: Vec<TextureInfo>,
    /// Surfaces of the files before.
    surfaces: usize,
}

impl Spool {
    pub(crate) fn create(work: &Work) -> Result<Self, WorkError> {
        let file = Appender::create(&work.path(MESHES))?;
        Ok(Self { file, meshes: Vec::new(), textures: Vec::new(), surfaces: 0 })
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
        let Self { meshes, textures, .. } = self;
        Ok(Scene { meshes, textures, objects, surfaces, up, notes })
    }
}

impl Sink for Spool {
    fn mesh(&mut self, mesh: SourceMesh) -> io::Result<()> {
        let span = self.file.append(&[
            bytemuck::cast_slice(&mesh.positions),
            bytemuck::cast_slice(&mesh.normals),
            bytemuck::cast_slice(&mesh.colors),
            bytemuck::cast_slice(&mesh.tex_coords),
            bytemuck::cast_slice(&mesh.indices),
        ])?;
        let sections = mesh.sections.iter().map(|&Section { end, surface }| {
            let surface = u16::try_from(usize::from(surface) + self.surfaces);
            let surface =
                surface.map_err(|_| io::Error::other("there are more than 65536 surfaces"))?;
            Ok(Section { end, surface })
        });
        let sections = sections.collect::<io::Result<Vec<_>>>()?;
        let points = mesh.positions.iter().map(|p| Vec3::from_array(*p).as_dvec3());
        self.meshes.push(MeshInfo {
            positions: mesh.positions.len() as u64,
            tex_coords: mesh.tex_coords.len() as u64,
            triangles: mesh.indices.len() as u64,
            dropped_degenerate: mesh.dropped_degenerate,
            bounds: Aabb::of(points),
            name: mesh.name,
            sections,
            span,
        });
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

    /// Bytes the file must have.
    pub(crate) fn spooled_bytes(&self) -> u64 {
        let spans = self.meshes.iter().map(|mesh| mesh.span);
        let spans = spans.chain(self.textures.iter().map(|texture| texture.span));
        spans.map(|span| span.offset.saturating_add(span.bytes)).max().unwrap_or(0)
    }

    /// Reads a mesh back.
    pub(crate) fn mesh(&self, from: &Records, index: usize) -> Result<SourceMesh, WorkError> {
        let info = &self.meshes[index];
        let mut mesh = SourceMesh {
            name: info.name.clone(),
            positions: vec![[0.0; 3]; info.positions as usize],
            normals: vec![[0.0; 3]; info.positions as usize],
            colors: vec![[0; 4]; info.positions as usize],
            tex_coords: vec![[0.0; 2]; info.tex_coords as usize],
            indices: vec![[0; 3]; info.triangles as usize],
            sections: info.sections.clone(),
            dropped_degenerate: info.dropped_degenerate,
        };
        let mut offset = info.span.offset;
        let stretches: [&mut [u8]; 5] = [
            bytemuck::cast_slice_mut(&mut mesh.positions),
            bytemuck::cast_slice_mut(&mut mesh.normals),
            bytemuck::cast_slice_mut(&mut mesh.colors),
            bytemuck::cast_slice_mut(&mut mesh.tex_coords),
            bytemuck::cast_slice_mut(&mut mesh.indices),
        ];
        for stretch in stretches {
            from.read_into(offset, stretch)?;
            offset += stretch.len() as u64;
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
            out.put([mesh.positions, mesh.tex_coords, mesh.triangles, mesh.dropped_degenerate]);
            out.put([mesh.bounds.min.to_array(), mesh.bounds.max.to_array()]);
            let sections: Vec<[u32; 2]> =
                mesh.sections.iter().map(|s| [s.end, u32::from(s.surface)]).collect();
            out.put_slice(&sections);
            out.put(mesh.span);
        }
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
            let [positions, tex_coords, triangles, dropped_degenerate] = from.take()?;
            let [min, max]: [[f64; 3]; 2] = from.take()?;
            let sections = from.take_slice::<[u32; 2]>()?;
            scene.meshes.push(MeshInfo {
                name,
                positions,
                tex_coords,
                triangles,
                dropped_degenerate,
                bounds: Aabb { min: min.into(), max: max.into() },
                sections: sections
                    .into_iter()
                    .map(|[end, surface]| Section { end, surface: surface as u16 })
                    .collect(),
                span: from.take()?,
            });
        }
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
        assert_eq!(scene.mesh(&from, 1).unwrap(), mesh);
        assert_eq!(scene.texture(&from, 0).unwrap(), [9; 4]);
        assert_eq!(scene.spooled_bytes(), from.length());
    }
}
