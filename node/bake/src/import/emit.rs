//! What importers share on their way out: numbering, the table of surfaces, the sink's own faults.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DAffine3, DVec3};

use super::ImportLimits;
use super::builder::Draft;
use super::error::ImportError;
use crate::source::{Alpha, Imported, Sink, SourceMesh, SourceObject, Surface, Texture};

/// The largest coordinate in the world, and the largest scale. Of two points so far apart the square
/// of their distance is still a number in single precision, in which renderers and simplifiers work.
const MOST_COORDINATE: f64 = 1e18;
/// What is smaller than this is nothing, and measuring it needs numbers that no computer has.
const LEAST_SIZE: f64 = 1e-30;
/// The least size of an object as a share of how far away it stands: double precision leaves it four
/// bits then.
const LEAST_SHARE: f64 = 1.0 / (1u64 << 48) as f64;

/// The note of a scene of which nothing is seen.
pub(super) const ALL_UNSEEN: &str = "all of it is transparent: alpha is 0, or below the cutoff";

/// Hands meshes and textures to a sink and counts them.
pub(super) struct Emitter<'a> {
    file: &'a Path,
    /// What an import may yield at most.
    pub(super) limits: ImportLimits,
    sink: &'a mut dyn Sink,
    /// By mesh: the largest coordinate along each axis, without its sign.
    reaches: Vec<DVec3>,
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
            reaches: Vec::new(),
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
        let reach = reach(&mesh);
        self.sink.mesh(mesh).map_err(|source| self.refused(source))?;
        self.reaches.push(reach);
        Ok(self.reaches.len() - 1)
    }

    /// Hands out more triangles of the mesh that was handed out last.
    pub(super) fn more(&mut self, draft: Draft) -> Result<(), ImportError> {
        let part = self.numbered(draft)?;
        if let Some(last) = self.reaches.last_mut() {
            *last = last.max(reach(&part));
        }
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

    /// Ends the import; a scene without one triangle is an error, and so is an object that reaches
    /// beyond [`MOST_COORDINATE`]. One smaller than [`LEAST_SIZE`] is left out.
    pub(super) fn finish(
        self,
        mut objects: Vec<SourceObject>,
        up: [f64; 3],
        mut notes: Vec<String>,
    ) -> Result<Imported, ImportError> {
        let is_said = notes.iter().any(|note| note == ALL_UNSEEN);
        if self.unseen > 0 && self.unseen == self.triangles && !is_said {
            notes.push(ALL_UNSEEN.into());
        }
        let empty = |notes| Err(ImportError::Empty { file: self.file.into(), notes });
        if self.triangles == 0 {
            return empty(notes);
        }
        objects.iter().try_for_each(|object| self.hold_place(object))?;
        let all = objects.len();
        objects.retain(|object| {
            let far = far(&object.world_from_mesh, self.reaches[object.mesh]).max_element();
            // Of a mesh that has lost all its triangles another note tells.
            far == 0.0 || far >= LEAST_SIZE
        });
        objects.iter().try_for_each(|object| self.hold_shape(object))?;
        let left_out = all - objects.len();
        if left_out > 0 {
            notes.push(format!("{left_out} objects smaller than {LEAST_SIZE:e} left out"));
            if objects.is_empty() {
                return empty(notes);
            }
        }
        Ok(Imported { objects, surfaces: self.surfaces, up, notes })
    }

    /// Refuses an object that stands, reaches or is scaled beyond what can be drawn.
    fn hold_place(&self, object: &SourceObject) -> Result<(), ImportError> {
        let place = &object.world_from_mesh;
        // A scale is held as well, whatever it scales.
        let reach = self.reaches[object.mesh].max(DVec3::ONE);
        let far = (far(place, reach) + place.translation.abs()).to_array();
        // Said so that what is no number is refused, too.
        if far.iter().all(|lane| *lane <= MOST_COORDINATE) {
            return Ok(());
        }
        let far = far.into_iter().fold(0.0, f64::max);
        Err(ImportError::Invalid {
            file: self.file.into(),
            at: format!("object {:?}", object.name),
            what: format!("it reaches {far:e} units far, and {MOST_COORDINATE:e} is the most"),
            fix: "scale the scene down",
        })
    }

    /// Refuses an object that is too small to keep its shape where it stands.
    fn hold_shape(&self, object: &SourceObject) -> Result<(), ImportError> {
        let size = far(&object.world_from_mesh, self.reaches[object.mesh]).max_element();
        let away = object.world_from_mesh.translation.abs().max_element();
        if size == 0.0 || size >= away * LEAST_SHARE {
            return Ok(());
        }
        Err(ImportError::Invalid {
            file: self.file.into(),
            at: format!("object {:?}", object.name),
            what: format!("it stands {away:e} units away, where its {size:e} units are no more"),
            fix: "move it nearer to the origin",
        })
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

/// Triangles of a mesh whose corners all have an alpha of which nothing is seen, whatever their textures have.
fn unseen(mesh: &SourceMesh, alpha: impl Fn(u16) -> Alpha) -> u64 {
    let mut first = 0;
    let mut count = 0;
    for section in &mesh.sections {
        let triangles = &mesh.indices[first..section.end as usize];
        first = section.end as usize;
        let is_hidden = |stored: u8| match alpha(section.surface) {
            Alpha::Opaque => false,
            Alpha::Mask(cutoff) => f32::from(stored) / 255.0 < cutoff,
            Alpha::Blend => stored == 0,
        };
        let is_unseen = |triangle: &&[u32; 3]| {
            triangle.iter().all(|&c| mesh.colors.get(c as usize).is_some_and(|c| is_hidden(c[3])))
        };
        count += triangles.iter().filter(is_unseen).count() as u64;
    }
    count
}

/// The largest coordinate of each axis, without its sign.
fn reach(mesh: &SourceMesh) -> DVec3 {
    let far = |far: DVec3, point: &[f32; 3]| far.max(DVec3::from(point.map(f64::from)).abs());
    mesh.positions.iter().fold(DVec3::ZERO, far)
}

/// How far from where an object stands it reaches, of a mesh that reaches so far.
fn far(world_from_mesh: &DAffine3, reach: DVec3) -> DVec3 {
    let matrix = &world_from_mesh.matrix3;
    let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    columns.iter().zip(reach.to_array()).map(|(column, reach)| column.abs() * reach).sum()
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

    #[test]
    fn objects_may_reach_so_far_and_no_farther() {
        let placed = |point: [f32; 3], world_from_mesh: DAffine3| {
            let mut sink = Full(9, Vec::new());
            let mut out = Emitter::new(Path::new("a.glb"), ImportLimits::default(), &mut sink);
            let mesh = SourceMesh {
                positions: vec![point],
                indices: vec![[0; 3]],
                ..SourceMesh::default()
            };
            let mesh = out.mesh(Draft { mesh, surfaces: Vec::new() }).unwrap();
            let object = SourceObject { name: "hall".into(), mesh, world_from_mesh };
            out.finish(vec![object], [0.0, 0.0, 1.0], Vec::new()).map_err(|error| error.to_string())
        };
        let scaled = |scale: f64| DAffine3::from_scale(DVec3::splat(scale));
        assert!(placed([0.0, -1e18, 0.0], DAffine3::IDENTITY).is_ok());
        assert!(placed([2.0, 0.0, 0.0], scaled(0.5e18)).is_ok());
        assert!(placed([2.0, 0.0, 0.0], scaled(0.5e-30)).is_ok());
        let at = |away: f64| DAffine3::from_translation(DVec3::new(0.0, -away, 0.0));
        assert!(placed([1.0; 3], at(2e14)).is_ok());
        let message = placed([1.0; 3], at(3e14)).unwrap_err();
        assert!(message.contains("object \"hall\": it stands 3e14 units away"), "{message}");
        let message = placed([2.0, 0.0, 0.0], scaled(0.4e-30)).unwrap_err();
        assert!(message.contains("1 objects smaller than 1e-30 left out"), "{message}");
        for (point, place) in [
            ([0.0, -2e18, 0.0], DAffine3::IDENTITY),
            ([2.0, 0.0, 0.0], scaled(0.6e18)),
            ([0.0; 3], scaled(1e20)),
            ([1.0; 3], DAffine3::from_translation(DVec3::new(0.0, 0.0, 1e300))),
            ([1e38; 3], scaled(1e300)),
            ([1.0; 3], scaled(f64::NAN)),
        ] {
            let message = placed(point, place).unwrap_err();
            assert!(message.contains("object \"hall\": it reaches"), "{message}");
        }
    }
}
