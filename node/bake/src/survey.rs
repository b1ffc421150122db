//! What a source scene holds and what looks wrong in it, on one page, before anyone bakes it.

use crate::import::{ImportError, ImportLimits, format_name, import};
use crate::source::{Alpha, Imported, Sink, SourceMesh, Texture};
use glam::DVec3;
use std::collections::{BTreeSet, HashMap, HashSet};
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// An object is a stray where it lies so many times as far from the middle as nine of ten others reach.
const STRAY: f64 = 100.0;
/// Strays that are named.
const NAMED: usize = 5;
/// Scene units that no scene on Earth spans, and that hardly one does.
const VAST: f64 = 1e8;
const TINY: f64 = 1e-3;

/// A box; nothing is in it where the least corner is not below the greatest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Least corner.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
}

impl Extent {
    const NOTHING: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    fn with(self, point: DVec3) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    fn middle(&self) -> DVec3 {
        self.min + (self.max - self.min) / 2.0
    }

    fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|k| {
            let pick =
                |axis: usize| if k >> axis & 1 == 0 { self.min[axis] } else { self.max[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        })
    }
}

/// What a scene file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Survey {
    /// The file.
    pub file: PathBuf,
    /// Its format.
    pub format: &'static str,
    /// Its size, bytes.
    pub bytes: u64,
    /// Objects that show a mesh.
    pub objects: u64,
    /// Distinct meshes.
    pub meshes: u64,
    /// Triangles, each instance counted.
    pub triangles: u64,
    /// Triangles, each mesh counted once.
    pub distinct_triangles: u64,
    /// Around all of it, scene units.
    pub extent: Extent,
    /// Upwards.
    pub up: [f64; 3],
    /// Kinds of surface that triangles have: opaque, masked, blended.
    pub surfaces: [u64; 3],
    /// Pictures, and bytes of their texels as they are baked.
    pub textures: [u64; 2],
    /// What will be left out or mended.
    pub notes: Vec<String>,
    /// What looks wrong.
    pub doubts: Vec<String>,
}

/// Reads the scene file at `path`, keeping none of it.
///
/// # Errors
///
/// Those of [`import()`]: what cannot be baked.
pub fn survey(path: &Path, limits: &ImportLimits) -> Result<Survey, ImportError> {
    let mut seen = Seen::default();
    let imported = import(path, limits, &mut seen)?;
    let bytes = std::fs::metadata(path).map(|about| about.len());
    let bytes = bytes.map_err(|source| ImportError::Read { file: path.into(), source })?;
    let placed = placed(&imported, &seen);
    let extent = placed.iter().fold(Extent::NOTHING, |all, of| all.with(of.min).with(of.max));
    let kind = |alpha: Alpha| match alpha {
        Alpha::Opaque => 0,
        Alpha::Mask(_) => 1,
        Alpha::Blend => 2,
    };
    let mut surfaces = [0; 3];
    let used = seen.surfaces.iter().map(|&number| imported.surfaces[usize::from(number)]);
    used.for_each(|surface| surfaces[kind(surface.alpha)] += 1);
    Ok(Survey {
        file: path.into(),
        format: format_name(path)?,
        bytes,
        objects: imported.objects.len() as u64,
        meshes: seen.meshes.len() as u64,
        triangles: imported.objects.iter().map(|o| seen.meshes[o.mesh].triangles).sum(),
        distinct_triangles: seen.meshes.iter().map(|mesh| mesh.triangles).sum(),
        extent,
        up: imported.up,
        surfaces,
        textures: seen.textures,
        doubts: doubts(&imported, &seen, &placed, extent),
        notes: imported.notes,
    })
}

/// Around each object, scene units.
fn placed(imported: &Imported, seen: &Seen) -> Vec<Extent> {
    let around = |object: &crate::source::SourceObject| {
        let corners = seen.meshes[object.mesh].extent.corners();
        let corners = corners.map(|corner| object.world_from_mesh.transform_point3(corner));
        corners.into_iter().fold(Extent::NOTHING, Extent::with)
    };
    imported.objects.iter().map(around).collect()
}

fn doubts(imported: &Imported, seen: &Seen, placed: &[Extent], extent: Extent) -> Vec<String> {
    let mut doubts = Vec::new();
    let sum = |of: fn(&Mesh) -> u64| seen.meshes.iter().map(of).sum::<u64>();
    for (count, what) in [
        (sum(|mesh| mesh.degenerate), "triangles without an area"),
        (sum(|mesh| mesh.doubled), "triangles that lie on another with the same corners"),
        (
            sum(|mesh| mesh.flipped),
            "edges whose two triangles disagree on which side is out: some faces are flipped",
        ),
    ] {
        if count > 0 {
            doubts.push(format!("{count} {what}"));
        }
    }
    let strays = strays(placed);
    if !strays.is_empty() {
        let names = strays.iter().take(NAMED).map(|&at| format!("{:?}", imported.objects[at].name));
        let more = if strays.len() > NAMED { " and others" } else { "" };
        let names = names.collect::<Vec<_>>().join(", ");
        doubts.push(format!("{} objects lie far from all others: {names}{more}", strays.len()));
    }
    let size = (extent.max - extent.min).max_element();
    if !(TINY..=VAST).contains(&size) {
        doubts.push(format!("its size is {size:.3e}: check the units"));
    }
    let away = extent.middle().abs().max_element();
    if away > 1e6 * size {
        doubts.push(format!("it lies {away:.3e} from the origin, and is {size:.3e} large"));
    }
    doubts
}

/// Objects that lie far from the middle of all, measured by how far nine of ten reach.
fn strays(placed: &[Extent]) -> Vec<usize> {
    if placed.len() < 3 {
        return Vec::new();
    }
    let middle_of = |axis: usize| {
        let mut all: Vec<f64> = placed.iter().map(|extent| extent.middle()[axis]).collect();
        *all.select_nth_unstable_by(placed.len() / 2, f64::total_cmp).1
    };
    let middle = DVec3::new(middle_of(0), middle_of(1), middle_of(2));
    let reach = |extent: &Extent| {
        extent.corners().map(|corner| (corner - middle).length()).into_iter().fold(0.0, f64::max)
    };
    let mut all: Vec<f64> = placed.iter().map(reach).collect();
    let usual = *all.select_nth_unstable_by(placed.len() * 9 / 10, f64::total_cmp).1;
    let lies_far =
        |extent: &Extent| (extent.middle() - middle).length() > STRAY * usual.max(1e-300);
    // Where a tenth lies far it is a part of the scene.
    (0..placed.len()).filter(|&at| lies_far(&placed[at])).collect()
}

/// What is kept of a mesh.
struct Mesh {
    extent: Extent,
    triangles: u64,
    degenerate: u64,
    doubled: u64,
    flipped: u64,
}

/// What is kept of what an importer hands out.
#[derive(Default)]
struct Seen {
    meshes: Vec<Mesh>,
    /// Numbers of those that triangles have.
    surfaces: BTreeSet<u16>,
    /// How many, and bytes.
    textures: [u64; 2],
}

impl Sink for Seen {
    fn mesh(&mut self, mesh: SourceMesh) -> std::io::Result<()> {
        self.meshes.push(Mesh {
            extent: Extent::NOTHING,
            triangles: 0,
            degenerate: 0,
            doubled: 0,
            flipped: 0,
        });
        self.more(mesh)
    }

    fn more(&mut self, part: SourceMesh) -> std::io::Result<()> {
        let Some(mesh) = self.meshes.last_mut() else { return Ok(()) };
        let points = (0..part.positions.len()).map(|vertex| part.position(vertex));
        mesh.extent = points.fold(mesh.extent, Extent::with);
        mesh.triangles += part.triangles();
        self.surfaces.extend(part.sections.iter().map(|section| section.surface));
        mesh.degenerate += part.dropped_degenerate;
        let [doubled, flipped] = doubled_and_flipped(&part);
        mesh.doubled += doubled;
        mesh.flipped += flipped;
        Ok(())
    }

    fn texture(&mut self, texture: Texture) -> std::io::Result<()> {
        let [count, bytes] = &mut self.textures;
        *count += 1;
        *bytes += texture.rgba.len() as u64;
        Ok(())
    }
}

/// Triangles whose corners are those of one before, and edges along which two triangles run the same way. Corners in
/// one place are one.
fn doubled_and_flipped(part: &SourceMesh) -> [u64; 2] {
    let mut places: HashMap<[u64; 3], u32> = HashMap::new();
    let corner: Vec<u32> = (0..part.positions.len())
        .map(|vertex| {
            let place = part.position(vertex).to_array().map(|lane| (lane + 0.0).to_bits());
            let next = places.len() as u32;
            *places.entry(place).or_insert(next)
        })
        .collect();
    let mut known = HashSet::new();
    let mut doubled = 0;
    let mut ways: HashMap<[u32; 2], [u32; 2]> = HashMap::new();
    for triangle in &part.indices {
        let corners = triangle.map(|index| corner[index as usize]);
        let mut sorted = corners;
        sorted.sort_unstable();
        if !known.insert(sorted) {
            doubled += 1;
            continue;
        }
        for side in 0..3 {
            let [a, b] = [corners[side], corners[(side + 1) % 3]];
            ways.entry([a.min(b), a.max(b)]).or_default()[usize::from(a > b)] += 1;
        }
    }
    let flipped = ways.values().filter(|ways| matches!(ways, [2, 0] | [0, 2])).count();
    [doubled, flipped as u64]
}

impl Display for Survey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, format, bytes, objects, meshes, textures: [pictures, texels], .. } = self;
        let Self { triangles, distinct_triangles, extent: Extent { min, max }, .. } = self;
        let size = *max - *min;
        let mib = |bytes: u64| bytes as f64 / (1u64 << 20) as f64;
        writeln!(f, "{}: {format}, {:.1} MiB", file.display(), mib(*bytes))?;
        writeln!(f, "  objects     {objects} of {meshes} meshes")?;
        writeln!(f, "  triangles   {triangles} ({distinct_triangles} distinct)")?;
        writeln!(f, "  size        {:.6} x {:.6} x {:.6}", size.x, size.y, size.z)?;
        writeln!(f, "  from        {:.6} {:.6} {:.6}", min.x, min.y, min.z)?;
        writeln!(f, "  to          {:.6} {:.6} {:.6}", max.x, max.y, max.z)?;
        let up = ["x", "y", "z"][(0..3).find(|&axis| self.up[axis] != 0.0).unwrap_or(2)];
        writeln!(f, "  up          {up}, {}", units(format, size.max_element()))?;
        let [opaque, masked, blended] = self.surfaces;
        writeln!(f, "  surfaces    {opaque} opaque, {masked} with holes, {blended} transparent")?;
        writeln!(f, "  textures    {pictures}, {:.1} MiB of texels", mib(*texels))?;
        for (title, lines) in [("left out or mended", &self.notes), ("looks wrong", &self.doubts)] {
            if lines.is_empty() {
                writeln!(f, "  {title}: nothing")?;
                continue;
            }
            writeln!(f, "  {title}:")?;
            lines.iter().try_for_each(|line| writeln!(f, "    {line}"))?;
        }
        Ok(())
    }
}

/// What a unit is, by format or by guess.
fn units(format: &str, size: f64) -> &'static str {
    match size {
        _ if format.starts_with("glTF") => "units are metres, as the format says",
        ..2.0e3 => "units are not said, by the size metres are likely",
        2.0e3..1.0e7 => "units are not said, by the size millimetres are likely",
        _ => "units are not said, and the size tells nothing",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Survey {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("yard.obj");
        std::fs::write(&file, text).unwrap();
        survey(&file, &ImportLimits::default()).unwrap()
    }

    /// Unit squares of two triangles in the plane z = 0, at these places along x.
    fn squares(places: &[f64]) -> String {
        let square = |(n, x): (usize, &f64)| {
            format!(
                "o part {n}\nv {x} 0 0\nv {} 0 0\nv {} 1 0\nv {x} 1 0\nf -4 -3 -2\nf -4 -2 -1\n",
                x + 1.0,
                x + 1.0
            )
        };
        places.iter().enumerate().map(square).collect()
    }

    #[test]
    fn a_sound_scene_raises_no_doubt() {
        let survey = of(&squares(&[0.0, 1.0, 2.0, 3.0]));
        let Survey { objects, meshes, triangles, ref extent, .. } = survey;
        assert_eq!((objects, meshes, triangles), (4, 4, 8));
        assert_eq!((extent.min, extent.max), (DVec3::ZERO, DVec3::new(4.0, 1.0, 0.0)));
        assert!(survey.doubts.is_empty() && survey.notes.is_empty());
        let page = survey.to_string();
        for words in ["OBJ", "8 (8 distinct)", "4.000000 x 1.000000", "looks wrong: nothing"] {
            assert!(page.contains(words), "{page}");
        }
    }

    #[test]
    fn what_looks_wrong_is_said() {
        let doubt = |text: &str| of(text).doubts.join("; ");
        let square = squares(&[0.0]);
        assert!(doubt(&format!("{square}f 1 2 2\n")).contains("1 triangles without an area"));
        assert!(doubt(&format!("{square}f 1 3 2\n")).contains("1 triangles that lie on another"));
        let flipped = square.replace("f -4 -2 -1", "f -1 -2 -4");
        assert!(doubt(&flipped).contains("1 edges whose two triangles disagree"));
        let stray = doubt(&squares(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 1e6]));
        assert!(stray.contains("1 objects lie far from all others: \"part 10\""), "{stray}");
        assert!(doubt(&squares(&[0.0, 1e9])).contains("check the units"));
        assert!(doubt(&squares(&[1e8])).contains("from the origin"));
    }
}
