//! What has been read of a PLY file, until it becomes a mesh.

use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::Path;

use glam::DVec3;

use super::header::{Element, Header, Kind, Property};
use super::values::{ValueError, Values};
use crate::import::builder::{Builder, Draft, Paint, Vertices};
use crate::import::emit::Emitter;
use crate::import::error::ImportError;
use crate::import::picture::linear_of;
use crate::import::place;
use crate::import::polygon::triangulate;
use crate::import::texture::{self, Had};
use crate::source::{Alpha, Surface, Wrap};

/// What a vertex may have, by the place of the property that holds it.
const LANES: [&[&str]; 12] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx", "normal_x"],
    &["ny", "normal_y"],
    &["nz", "normal_z"],
    &["red", "diffuse_red", "r"],
    &["green", "diffuse_green", "g"],
    &["blue", "diffuse_blue", "b"],
    &["alpha", "diffuse_alpha", "a"],
    &["s", "u", "texture_u", "texture_s"],
    &["t", "v", "texture_v", "texture_t"],
];
const COLOR: std::ops::Range<usize> = 6..10;

/// Which of these a property holds.
fn lane_of(property: &Property) -> Option<usize> {
    let named = |names: &&[&str]| names.contains(&property.name.as_str());
    LANES.iter().position(named).filter(|_| property.list.is_none())
}

/// Which property is which lane, and what stands for 1; by property.
type Slots = Vec<Option<(usize, f64)>>;

/// Each lane is held by the first property that says so.
fn slots(element: &Element, is_wanted: impl Fn(usize) -> bool) -> Slots {
    let mut found = [false; LANES.len()];
    let slot = |property: &Property| {
        let lane = lane_of(property).filter(|&lane| is_wanted(lane))?;
        if std::mem::replace(&mut found[lane], true) {
            return None;
        }
        let full = if COLOR.contains(&lane) { property.scalar.full() } else { 1.0 };
        Some((lane, full))
    };
    element.properties.iter().map(slot).collect()
}

/// Lanes that are there.
fn has(slots: &Slots, wanted: std::ops::Range<usize>) -> bool {
    wanted.into_iter().all(|lane| slots.iter().flatten().any(|(found, _)| *found == lane))
}

/// How a vertex is read.
pub(super) struct VertexSlots(Slots);

impl VertexSlots {
    pub(super) fn of(element: &Element) -> Self {
        Self(slots(element, |_| true))
    }

    /// Whether it says where a vertex stands.
    pub(super) fn check(&self) -> Result<(), String> {
        match (0..3).find(|&lane| !has(&self.0, lane..lane + 1)) {
            None => Ok(()),
            Some(lane) => Err(format!("its vertices have no {}", LANES[lane][0])),
        }
    }
}

/// How a face is read.
pub(super) struct FaceSlots(Slots);

impl FaceSlots {
    pub(super) fn of(element: &Element) -> Self {
        Self(slots(element, |lane| COLOR.contains(&lane)))
    }
}

/// What a corner shows that is not its vertex's.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Own {
    /// As stored.
    color: Option<[f32; 4]>,
    tex_coord: Option<[f32; 2]>,
}

/// What has been read.
pub(super) struct Cloud {
    points: Vec<DVec3>,
    /// One a point, or none at all.
    normals: Vec<[f32; 3]>,
    /// As stored, one a point, or none at all.
    colors: Vec<[f32; 4]>,
    /// One a point, or none at all.
    tex_coords: Vec<[f32; 2]>,
    /// Of vertices: normals, colours, texture coordinates.
    has: [bool; 3],
    triangles: Vec<[u32; 3]>,
    /// By triangle, what its corners have of their own; none at all where no face has anything.
    own: Vec<[Own; 3]>,
    /// By triangle, the number of its texture; none at all where no face has one.
    textures: Vec<u32>,
    faces_have: bool,
    too_few: u64,
    guessed: u64,
}

/// A mesh, where it stands, and what is to be said of it.
pub(super) struct Made {
    pub(super) draft: Draft,
    pub(super) origin: DVec3,
    pub(super) notes: Vec<String>,
}

impl Cloud {
    pub(super) fn new(header: &Header) -> Self {
        let of_kind = |kind| header.elements.iter().find(|element| element.kind() == kind);
        let vertex = of_kind(Kind::Vertex).map(|element| VertexSlots::of(element).0);
        let has = |lanes| vertex.as_ref().is_some_and(|slots| has(slots, lanes));
        let has = [has(3..6), has(6..9), has(10..12)];
        let faces_have = of_kind(Kind::Face).is_some_and(|element| {
            let is_own = |property: &Property| {
                property.is_tex_coords()
                    || lane_of(property).is_some_and(|lane| COLOR.contains(&lane))
            };
            element.properties.iter().any(is_own)
        });
        Self {
            points: Vec::new(),
            normals: Vec::new(),
            colors: Vec::new(),
            tex_coords: Vec::new(),
            has,
            triangles: Vec::new(),
            own: Vec::new(),
            textures: Vec::new(),
            faces_have,
            too_few: 0,
            guessed: 0,
        }
    }

    /// Reads a vertex. It may stand nowhere, as long as no face has it.
    pub(super) fn vertex(
        &mut self,
        slots: &VertexSlots,
        element: &Element,
        values: &mut Values<impl BufRead>,
    ) -> Result<(), ValueError> {
        let mut lanes = [1.0; LANES.len()];
        for (property, slot) in element.properties.iter().zip(&slots.0) {
            match slot {
                Some((lane, full)) => lanes[*lane] = values.scalar(property.scalar)? / full,
                None => values.skip(property)?,
            }
        }
        self.points.push(DVec3::new(lanes[0], lanes[1], lanes[2]));
        let [has_normals, has_colors, has_tex_coords] = self.has;
        if has_normals {
            self.normals.push([3, 4, 5].map(|lane| lanes[lane] as f32));
        }
        if has_colors {
            self.colors.push(color(&lanes));
        }
        if has_tex_coords {
            self.tex_coords.push([lanes[10] as f32, lanes[11] as f32]);
        }
        Ok(())
    }

    /// Reads a face.
    pub(super) fn face(
        &mut self,
        slots: &FaceSlots,
        element: &Element,
        values: &mut Values<impl BufRead>,
    ) -> Result<(), ValueError> {
        let mut corners: Vec<u32> = Vec::new();
        let mut tex_coords: Vec<f32> = Vec::new();
        let mut lanes = [1.0; LANES.len()];
        let mut texture = 0;
        for (property, slot) in element.properties.iter().zip(&slots.0) {
            match (property.list, slot) {
                (Some(length), _) if property.is_indices() => {
                    for _ in 0..values.length(length)? {
                        corners.push(self.index(values.scalar(property.scalar)?)?);
                    }
                }
                (Some(length), _) if property.is_tex_coords() => {
                    for _ in 0..values.length(length)? {
                        tex_coords.push(values.scalar(property.scalar)? as f32);
                    }
                }
                (None, Some((lane, full))) => lanes[*lane] = values.scalar(property.scalar)? / full,
                (None, None) if property.name == "texnumber" => {
                    texture = values.scalar(property.scalar)? as u32;
                }
                _ => values.skip(property)?,
            }
        }
        self.too_few += u64::from(corners.len() < 3);
        let points: Vec<DVec3> = corners.iter().map(|&i| self.points[i as usize]).collect();
        let division = triangulate(&points);
        self.guessed += u64::from(division.is_guess);
        for triangle in division.triangles {
            self.triangles.push(triangle.map(|place| corners[place]));
            if self.faces_have {
                let color = has(&slots.0, 6..9).then(|| color(&lanes));
                self.own.push(triangle.map(|place| Own {
                    color,
                    tex_coord: tex_coords.as_chunks::<2>().0.get(place).copied(),
                }));
                self.textures.push(texture);
            }
        }
        Ok(())
    }

    /// Reads strips of triangles, each of which shares two corners with the one before and turns the other way; -1
    /// ends a strip.
    pub(super) fn strips(
        &mut self,
        element: &Element,
        values: &mut Values<impl BufRead>,
    ) -> Result<(), ValueError> {
        for property in &element.properties {
            let Some(length) = property.list.filter(|_| property.is_indices()) else {
                values.skip(property)?;
                continue;
            };
            let mut strip: Vec<u32> = Vec::new();
            for _ in 0..values.length(length)? {
                let value = values.scalar(property.scalar)?;
                if value == -1.0 {
                    strip.clear();
                    continue;
                }
                strip.push(self.index(value)?);
                if let [.., a, b, c] = strip[..] {
                    let turns = strip.len().is_multiple_of(2);
                    self.triangles.push(if turns { [b, a, c] } else { [a, b, c] });
                    self.own_nothing();
                }
            }
        }
        Ok(())
    }

    /// The last triangle has nothing of its own, where others have.
    fn own_nothing(&mut self) {
        if self.faces_have {
            self.own.push([Own { color: None, tex_coord: None }; 3]);
            self.textures.push(0);
        }
    }

    /// The vertex of a number that was read.
    fn index(&self, value: f64) -> Result<u32, ValueError> {
        // A cast saturates, and what is no whole number or below zero comes back changed.
        let index = value as u32;
        let has = self.points.len();
        if f64::from(index) != value || index as usize >= has {
            let what = format!("it refers to vertex {value} of the {has} before it");
            return Err(ValueError::Broken(what));
        }
        let point = self.points[index as usize];
        if !point.is_finite() {
            let what = format!("it refers to vertex {value}, which stands at {point}");
            return Err(ValueError::Broken(what));
        }
        Ok(index)
    }

    /// Makes the mesh; `textures` names the pictures of the scene at `file`.
    pub(super) fn finish(
        mut self,
        file: &Path,
        name: &str,
        textures: &[String],
        out: &mut Emitter<'_>,
    ) -> Result<Made, ImportError> {
        let mut notes = Vec::new();
        let triangles = std::mem::take(&mut self.triangles);
        let used = triangles.as_flattened().iter().map(|&index| self.points[index as usize]);
        let origin = place::origin(used);
        // Triangles by texture; all are of the first where none says.
        let mut by_texture: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for at in 0..triangles.len() {
            by_texture.entry(self.textures.get(at).copied().unwrap_or(0)).or_default().push(at);
        }
        let is_mapped = self.has[2] || self.own.iter().flatten().any(|own| own.tex_coord.is_some());
        let mut builder = Builder::new(name.to_owned());
        for (texture, members) in by_texture {
            let mut paint = Paint {
                surface: Surface { alpha: Alpha::Blend, ..Surface::PLAIN },
                ..Paint::PLAIN
            };
            if let Some(picture) = textures.get(texture as usize) {
                if is_mapped {
                    lay_on(&mut paint, file, picture, out, &mut notes)?;
                } else {
                    notes.push(format!("{picture:?} ignored: there are no texture coordinates"));
                }
            }
            let of_texture: Vec<[u32; 3]> = members.iter().map(|&at| triangles[at]).collect();
            let own: Vec<[Own; 3]> = match self.faces_have {
                true => members.iter().map(|&at| self.own[at]).collect(),
                false => Vec::new(),
            };
            let view = View { cloud: &self, triangles: &of_texture, own: &own, origin };
            let corners = (0..of_texture.len()).map(|at| view.corners(at));
            builder.append(&paint, &view, corners).map_err(|fault| {
                let (what, fix) = fault.explain();
                ImportError::Invalid { file: file.into(), at: "faces".into(), what, fix }
            })?;
        }
        for (count, what) in [
            (builder.dropped_degenerate(), "degenerate triangles left out"),
            (builder.mended_normals, "normals without a direction replaced by those of faces"),
            (builder.mended_tex_coords, "texture coordinates that are no numbers replaced by zero"),
            (self.guessed, "polygons that cross themselves divided by guess"),
            (self.too_few, "faces of fewer than three corners skipped"),
        ] {
            if count > 0 {
                notes.push(format!("{count} {what}"));
            }
        }
        Ok(Made { draft: builder.finish(), origin, notes })
    }
}

/// Gives a paint the picture of this name, or leaves a note.
fn lay_on(
    paint: &mut Paint,
    file: &Path,
    name: &str,
    out: &mut Emitter<'_>,
    notes: &mut Vec<String>,
) -> Result<(), ImportError> {
    let path = match super::picture(file, name) {
        Ok(path) => path,
        Err(ImportError::MissingResource { .. } | ImportError::OutsideFolder { .. }) => {
            notes.push(format!("{name:?} is missing in the scene's folder, it shows no picture"));
            return Ok(());
        }
        Err(error) => return Err(error),
    };
    match texture::read(&path, name, [Wrap::Repeat; 2], out)? {
        Ok(Had::Plain([r, g, b])) => paint.color = [r, g, b, 1.0],
        Ok(Had::Texture { number, .. }) => paint.surface.texture = Some(number),
        Err(why) => notes.push(format!("{name:?} cannot be decoded ({why}), it shows no picture")),
    }
    Ok(())
}

/// Colour and alpha as stored; white where one is no number.
fn color(lanes: &[f64; LANES.len()]) -> [f32; 4] {
    let color = [6, 7, 8, 9].map(|lane| lanes[lane] as f32);
    if color.iter().all(|lane| lane.is_finite()) { color } else { [1.0; 4] }
}

/// The triangles of one texture as the builder sees them: with vertices of the cloud, or each with corners of its own.
struct View<'a> {
    cloud: &'a Cloud,
    triangles: &'a [[u32; 3]],
    own: &'a [[Own; 3]],
    origin: DVec3,
}

impl View<'_> {
    /// The vertices of a triangle.
    fn corners(&self, triangle: usize) -> [usize; 3] {
        match self.own.is_empty() {
            true => self.triangles[triangle].map(|index| index as usize),
            false => [0, 1, 2].map(|corner| 3 * triangle + corner),
        }
    }

    /// The vertex in the cloud.
    fn index(&self, vertex: usize) -> usize {
        match self.own.is_empty() {
            true => vertex,
            false => self.triangles.as_flattened()[vertex] as usize,
        }
    }

    fn own(&self, vertex: usize) -> Option<Own> {
        self.own.as_flattened().get(vertex).copied()
    }
}

impl Vertices for View<'_> {
    fn count(&self) -> usize {
        if self.own.is_empty() { self.cloud.points.len() } else { 3 * self.triangles.len() }
    }

    fn position(&self, vertex: usize) -> [f64; 3] {
        place::relative(self.cloud.points[self.index(vertex)], self.origin)
    }

    fn normal(&self, vertex: usize) -> Option<[f32; 3]> {
        self.cloud.normals.get(self.index(vertex)).copied()
    }

    /// A vertex's goes before a face's.
    fn color(&self, vertex: usize) -> [f32; 4] {
        let of_vertex = self.cloud.colors.get(self.index(vertex)).copied();
        let stored = of_vertex.or_else(|| self.own(vertex)?.color);
        let Some([r, g, b, alpha]) = stored else { return [1.0; 4] };
        let [r, g, b] = [r, g, b].map(|lane| linear_of(f64::from(lane).clamp(0.0, 1.0)) as f32);
        [r, g, b, alpha]
    }

    /// A face's goes before a vertex's, which has one for all its faces. Files count from the bottom left.
    fn tex_coord(&self, vertex: usize) -> [f32; 2] {
        let own = self.own(vertex).and_then(|own| own.tex_coord);
        let [u, v] = own
            .or_else(|| self.cloud.tex_coords.get(self.index(vertex)).copied())
            .unwrap_or_default();
        [u, 1.0 - v]
    }
}
