//! What importers share on their way out: numbering, the table of surfaces, the sink's own faults.

use std::collections::BTreeMap;
use std::path::Path;

use super::ImportLimits;
use super::builder::Draft;
use super::error::ImportError;
use crate::source::{Alpha, Imported, Sink, SourceMesh, SourceObject, Surface, Texture};

/// Hands meshes and textures to a sink and counts them.
pub(super) struct Emitter<'a> {
    file: &'a Path,
    /// What an import may yield at most.
    pub(super) limits: ImportLimits,
    sink: &'a mut dyn Sink,
    meshes: usize,
    textures: u32,
    /// Triangles that have an area, each mesh counted once.
    triangles: u64,
    /// Those of them that let all through.
    unseen: u64,
    surfaces: Vec<Surface>,
    /// By what makes a surface: its number.
    numbers: BTreeMap<(u8, u32, bool, Option<u32>), u16>,
}

impl<'a> Emitter<'a> {
    /// Nothing handed out yet; `file` is the scene, for messages.
    pub(super) fn new(file: &'a Path, limits: ImportLimits, sink: &'a mut dyn Sink) -> Self {
        let surfaces = vec![Surface::PLAIN];
        let numbers = BTreeMap::from([(key(Surface::PLAIN), 0)]);
        Self {
            file,
            limits,
            sink,
            meshes: 0,
            textures: 0,
            triangles: 0,
            unseen: 0,
            surfaces,
            numbers,
        }
    }

    /// Hands out a mesh; its number.
    pub(super) fn mesh(&mut self, draft: Draft) -> Result<usize, ImportError> {
        let mesh = self.numbered(draft)?;
        self.sink.mesh(mesh).map_err(|source| self.refused(source))?;
        self.meshes += 1;
        Ok(self.meshes - 1)
    }

    /// Hands out more triangles of the mesh that was handed out last.
    pub(super) fn more(&mut self, draft: Draft) -> Result<(), ImportError> {
        let part = self.numbered(draft)?;
        self.sink.more(part).map_err(|source| self.refused(source))
    }

    /// The mesh of a draft, with the import's numbers of its surfaces.
    fn numbered(&mut self, draft: Draft) -> Result<SourceMesh, ImportError> {
        let Draft { mut mesh, surfaces } = draft;
        let numbers = surfaces
            .into_iter()
            .map(|surface| self.surface(surface))
            .collect::<Result<Vec<u16>, _>>()?;
        for section in &mut mesh.sections {
            section.surface = numbers[usize::from(section.surface)];
        }
        self.triangles += mesh.indices.len() as u64;
        self.unseen += unseen(&mesh, |surface| self.surfaces[usize::from(surface)].alpha);
        Ok(mesh)
    }

    /// Hands out a texture; its number.
    pub(super) fn texture(&mut self, texture: Texture) -> Result<u32, ImportError> {
        debug_assert!(texture.side <= self.limits.texture_side);
        self.sink.texture(texture).map_err(|source| self.refused(source))?;
        self.textures += 1;
        Ok(self.textures - 1)
    }

    /// Ends the import; a scene without one triangle is an error.
    pub(super) fn finish(
        self,
        objects: Vec<SourceObject>,
        up: [f64; 3],
        mut notes: Vec<String>,
    ) -> Result<Imported, ImportError> {
        if self.unseen > 0 {
            let (unseen, all) = (self.unseen, self.triangles);
            notes
                .push(format!("{unseen} of {all} triangles have an alpha of 0: they are not seen"));
        }
        if self.triangles == 0 {
            return Err(ImportError::Empty { file: self.file.into(), notes });
        }
        Ok(Imported { objects, surfaces: self.surfaces, up, notes })
    }

    /// The number of a surface, which joins the table if it is new.
    fn surface(&mut self, surface: Surface) -> Result<u16, ImportError> {
        if let Some(&number) = self.numbers.get(&key(surface)) {
            return Ok(number);
        }
        let number = u16::try_from(self.surfaces.len()).map_err(|_| ImportError::Invalid {
            file: self.file.into(),
            at: "materials".into(),
            what: "they make more than 65536 different surfaces".into(),
            fix: "join textures or split the scene",
        })?;
        self.numbers.insert(key(surface), number);
        self.surfaces.push(surface);
        Ok(number)
    }

    fn refused(&self, source: std::io::Error) -> ImportError {
        ImportError::Sink { file: self.file.into(), source }
    }
}

/// Triangles of a mesh that blend and whose corners all have an alpha of 0.
fn unseen(mesh: &SourceMesh, alpha: impl Fn(u16) -> Alpha) -> u64 {
    let mut first = 0;
    let mut count = 0;
    for section in &mesh.sections {
        let triangles = &mesh.indices[first..section.end as usize];
        first = section.end as usize;
        if alpha(section.surface) == Alpha::Blend {
            let is_unseen = |triangle: &&[u32; 3]| {
                triangle
                    .iter()
                    .all(|&c| mesh.colors.get(c as usize).is_some_and(|color| color[3] == 0))
            };
            count += triangles.iter().filter(is_unseen).count() as u64;
        }
    }
    count
}

/// A surface as something that has an order.
fn key(surface: Surface) -> (u8, u32, bool, Option<u32>) {
    let (mode, cutoff) = match surface.alpha {
        Alpha::Opaque => (0, 0),
        Alpha::Mask(cutoff) => (1, cutoff.to_bits()),
        Alpha::Blend => (2, 0),
    };
    (mode, cutoff, surface.double_sided, surface.texture)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::ImportErrorKind;
    use crate::source::Section;

    /// Takes a number of meshes, then is full.
    struct Full(usize, Vec<SourceMesh>);

    impl Sink for Full {
        fn mesh(&mut self, mesh: SourceMesh) -> std::io::Result<()> {
            if self.1.len() == self.0 {
                return Err(std::io::ErrorKind::StorageFull.into());
            }
            self.1.push(mesh);
            Ok(())
        }

        fn more(&mut self, part: SourceMesh) -> std::io::Result<()> {
            self.mesh(part)
        }

        fn texture(&mut self, _: Texture) -> std::io::Result<()> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
    }

    fn draft(surfaces: Vec<Surface>) -> Draft {
        let sections = (0..surfaces.len() as u16)
            .map(|surface| Section { end: u32::from(surface) + 1, surface })
            .collect();
        let indices = vec![[0, 1, 2]; surfaces.len()];
        Draft { mesh: SourceMesh { indices, sections, ..SourceMesh::default() }, surfaces }
    }

    #[test]
    fn a_full_sink_is_a_fault_of_the_system_not_of_the_scene() {
        let mut sink = Full(1, Vec::new());
        let mut out = Emitter::new(Path::new("a.glb"), ImportLimits::default(), &mut sink);
        assert_eq!(out.mesh(draft(Vec::new())).unwrap(), 0);
        let error = out.mesh(draft(Vec::new())).unwrap_err();
        assert_eq!(error.kind(), ImportErrorKind::Io);
        assert!(error.to_string().starts_with("a.glb: "), "{error}");
        assert_eq!(out.more(draft(Vec::new())).unwrap_err().kind(), ImportErrorKind::Io);
    }

    #[test]
    fn equal_surfaces_of_different_meshes_share_a_number_and_the_plain_one_is_the_first() {
        let mut sink = Full(3, Vec::new());
        let mut out = Emitter::new(Path::new("a.glb"), ImportLimits::default(), &mut sink);
        let glass = Surface { alpha: Alpha::Blend, ..Surface::PLAIN };
        let leaf = Surface { alpha: Alpha::Mask(0.5), texture: Some(3), ..glass };
        for surfaces in [vec![glass, leaf], vec![leaf, Surface::PLAIN], vec![glass]] {
            out.mesh(draft(surfaces)).unwrap();
        }
        let imported = out.finish(Vec::new(), [0.0, 1.0, 0.0], Vec::new()).unwrap();
        assert_eq!(imported.surfaces, [Surface::PLAIN, glass, leaf]);
        let numbers = |mesh: &SourceMesh| -> Vec<u16> {
            mesh.sections.iter().map(|section| section.surface).collect()
        };
        assert_eq!(
            sink.1.iter().map(numbers).collect::<Vec<_>>(),
            [vec![1, 2], vec![2, 0], vec![1]]
        );
    }
}
