//! PLY, as text or binary of either byte order (Turk 1994, *The PLY Polygon File Format*): one mesh.
//!
//! Vertices may have normals and colours; faces are polygons of any size. Colours are taken as
//! sRGB-encoded, as scanners and modellers write them. Everything else is read past.

mod header;
mod values;

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::DVec3;

use self::header::{Element, Header, Kind};
use self::values::{ValueError, Values};
use super::builder::{Builder, Paint, Vertices};
use super::emit::Emitter;
use super::error::ImportError;
use super::picture::linear_of;
use super::place;
use super::polygon::triangulate;
use crate::source::{Alpha, Imported, Surface};

/// Scanners and modellers take z for up; the format itself does not say.
const UP: [f64; 3] = [0.0, 0.0, 1.0];

/// Reads the scene file at `path`.
pub(super) fn import(path: &Path, out: Emitter<'_>) -> Result<Imported, ImportError> {
    let file = File::open(path).map_err(|source| ImportError::unreadable(path, source))?;
    read(path, BufReader::new(file), out)
}

fn read(
    file: &Path,
    mut reader: impl BufRead,
    mut out: Emitter<'_>,
) -> Result<Imported, ImportError> {
    let invalid =
        |at: String, what: String, fix| ImportError::Invalid { file: file.into(), at, what, fix };
    let broken = |at: String, what: String| invalid(at, what, "export or copy the file again");
    let fault = |at: &str, error: ValueError| match error {
        ValueError::Io(source) => ImportError::unreadable(file, source),
        ValueError::Broken(what) => broken(at.to_owned(), what),
    };
    let header = header::read(&mut reader).map_err(|error| fault("header", error))?;
    if header.faces().is_none_or(|faces| faces.count == 0) {
        return Err(invalid(
            "header".into(),
            "it has vertices and no faces: it is a point cloud".into(),
            "make a surface of it first, for example with MeshLab or CloudCompare",
        ));
    }
    let mut notes = Vec::new();
    if header.has_texture {
        notes.push("textures of PLY files ignored".into());
    }
    let mut values = Values::new(reader, header.encoding);
    let mut cloud = Cloud::new(&header);
    for element in &header.elements {
        let at = |place: u64| format!("{} {place}", element.name);
        match element.kind() {
            Kind::Vertex => {
                let slots = Slots::of(element).map_err(|what| broken("header".into(), what))?;
                for place in 0..element.count {
                    let vertex = slots.read(element, &mut values);
                    let vertex = vertex.map_err(|error| fault(&at(place), error))?;
                    cloud.push(vertex).map_err(|what| broken(at(place), what))?;
                }
            }
            Kind::Face => {
                for place in 0..element.count {
                    let face = cloud.face(element, &mut values);
                    face.map_err(|error| fault(&at(place), error))?;
                }
            }
            Kind::Other => {
                // An element without properties takes no bytes, however many there are.
                for place in 0..if element.properties.is_empty() { 0 } else { element.count } {
                    let skipped = element.properties.iter().try_for_each(|p| values.skip(p));
                    skipped.map_err(|error| fault(&at(place), error))?;
                }
            }
        }
    }
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut builder = Builder::new(name.clone());
    let triangles = std::mem::take(&mut cloud.triangles);
    let used = triangles.as_flattened().iter().map(|&index| cloud.points[index as usize]);
    cloud.origin = place::origin(used);
    let paint =
        Paint { surface: Surface { alpha: Alpha::Blend, ..Surface::PLAIN }, ..Paint::PLAIN };
    let corners = triangles.iter().map(|t| t.map(|index| index as usize));
    builder.append(&paint, &cloud, corners).map_err(|fault| {
        let (what, fix) = fault.explain();
        invalid("faces".into(), what, fix)
    })?;
    let (origin, too_few) = (cloud.origin, cloud.too_few);
    drop((cloud, triangles));
    for (count, what) in [
        (builder.dropped_degenerate(), "degenerate triangles left out"),
        (builder.mended_normals, "normals without a direction replaced by those of faces"),
        (too_few, "faces of fewer than three corners skipped"),
    ] {
        if count > 0 {
            notes.push(format!("{count} {what}"));
        }
    }
    let mesh = out.mesh(builder.finish())?;
    out.finish(vec![place::placed(name, mesh, origin)], UP, notes)
}

/// What a vertex may have, by the place of the property that holds it.
const LANES: [&[&str]; 10] = [
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
];

/// Which property of a vertex is which lane, by property.
struct Slots(Vec<Option<(usize, f64)>>);

impl Slots {
    fn of(element: &Element) -> Result<Self, String> {
        let mut found = [false; LANES.len()];
        let slot = |property: &header::Property| {
            let lane = LANES.iter().position(|names| names.contains(&property.name.as_str()))?;
            if property.list.is_some() || std::mem::replace(&mut found[lane], true) {
                return None;
            }
            let full = if lane < 6 { 1.0 } else { property.scalar.full() };
            Some((lane, full))
        };
        let slots = element.properties.iter().map(slot).collect();
        match found[..3].iter().position(|found| !found) {
            None => Ok(Self(slots)),
            Some(lane) => Err(format!("its vertices have no {}", LANES[lane][0])),
        }
    }

    fn read(
        &self,
        element: &Element,
        values: &mut Values<impl BufRead>,
    ) -> Result<[f64; LANES.len()], ValueError> {
        let mut lanes = [1.0; LANES.len()];
        for (property, slot) in element.properties.iter().zip(&self.0) {
            match slot {
                Some((lane, full)) => lanes[*lane] = values.scalar(property.scalar)? / full,
                None => values.skip(property)?,
            }
        }
        Ok(lanes)
    }
}

/// What has been read.
struct Cloud {
    points: Vec<DVec3>,
    /// One a point, or none at all.
    normals: Vec<[f32; 3]>,
    /// As stored, one a point, or none at all.
    colors: Vec<[f32; 4]>,
    has: [bool; 2],
    triangles: Vec<[u32; 3]>,
    origin: DVec3,
    too_few: u64,
}

impl Cloud {
    fn new(header: &Header) -> Self {
        let vertex = header.elements.iter().find(|element| element.kind() == Kind::Vertex);
        let has = |lanes: &[&[&str]]| {
            lanes.iter().all(|names| {
                vertex
                    .is_some_and(|v| v.properties.iter().any(|p| names.contains(&p.name.as_str())))
            })
        };
        Self {
            points: Vec::new(),
            normals: Vec::new(),
            colors: Vec::new(),
            has: [has(&LANES[3..6]), has(&LANES[6..9])],
            triangles: Vec::new(),
            origin: DVec3::ZERO,
            too_few: 0,
        }
    }

    fn push(&mut self, lanes: [f64; LANES.len()]) -> Result<(), String> {
        let point = DVec3::new(lanes[0], lanes[1], lanes[2]);
        if !point.is_finite() {
            return Err(format!("it stands at {point}"));
        }
        self.points.push(point);
        let [has_normals, has_colors] = self.has;
        if has_normals {
            self.normals.push([3, 4, 5].map(|lane| lanes[lane] as f32));
        }
        if has_colors {
            self.colors.push([6, 7, 8, 9].map(|lane| lanes[lane] as f32));
        }
        Ok(())
    }

    fn face(
        &mut self,
        element: &Element,
        values: &mut Values<impl BufRead>,
    ) -> Result<(), ValueError> {
        let mut corners: Vec<u32> = Vec::new();
        for property in &element.properties {
            match property.list {
                Some(length) if property.is_indices() => {
                    for _ in 0..values.length(length)? {
                        corners.push(self.index(values.scalar(property.scalar)?)?);
                    }
                }
                _ => values.skip(property)?,
            }
        }
        self.too_few += u64::from(corners.len() < 3);
        let points: Vec<DVec3> = corners.iter().map(|&i| self.points[i as usize]).collect();
        self.triangles.extend(triangulate(&points).iter().map(|t| t.map(|place| corners[place])));
        Ok(())
    }

    fn index(&self, value: f64) -> Result<u32, ValueError> {
        // A cast saturates, and what is no whole number or below zero comes back changed.
        let index = value as u32;
        if f64::from(index) == value && (index as usize) < self.points.len() {
            return Ok(index);
        }
        let has = self.points.len();
        Err(ValueError::Broken(format!("it refers to vertex {value} of the {has} before it")))
    }
}

impl Vertices for Cloud {
    fn count(&self) -> usize {
        self.points.len()
    }

    fn position(&self, vertex: usize) -> [f64; 3] {
        place::relative(self.points[vertex], self.origin)
    }

    fn normal(&self, vertex: usize) -> Option<[f32; 3]> {
        self.normals.get(vertex).copied()
    }

    fn color(&self, vertex: usize) -> [f32; 4] {
        let Some(&[r, g, b, alpha]) = self.colors.get(vertex) else { return [1.0; 4] };
        let [r, g, b] = [r, g, b].map(|lane| linear_of(f64::from(lane).clamp(0.0, 1.0)) as f32);
        [r, g, b, alpha]
    }

    fn tex_coord(&self, _: usize) -> [f32; 2] {
        [0.0; 2]
    }
}

#[cfg(test)]
mod tests;
