//! The faces of one object, until they become a mesh.

use std::collections::HashMap;

use glam::DVec3;

use super::Pool;
use super::library::{Library, Material};
use crate::import::builder::{Builder, Draft, Fault, Vertices};
use crate::import::place;

/// What a corner of a face refers to, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Corner {
    pub(super) point: u32,
    pub(super) tex_coord: Option<u32>,
    pub(super) normal: Option<u32>,
}

/// Triangles of one material.
#[derive(Default)]
struct Part {
    material: usize,
    /// Distinct corners, in the order of first use.
    corners: Vec<Corner>,
    /// By corner, its place in `corners`; never walked through, so its order has no effect.
    places: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
}

/// Faces of one object.
#[derive(Default)]
pub(super) struct Faces {
    /// In the order of first use.
    parts: Vec<Part>,
    /// The material of the next face.
    material: usize,
    /// By material, its place in `parts`; looked up only.
    part_of: HashMap<usize, usize>,
}

/// A mesh and what belongs to it.
pub(super) struct Made {
    pub(super) draft: Draft,
    /// Where it stands.
    pub(super) origin: DVec3,
    pub(super) mended_normals: u64,
    pub(super) mended_tex_coords: u64,
}

impl Faces {
    /// The next faces are of this material, a number of the library's.
    pub(super) fn paint(&mut self, material: usize) {
        self.material = material;
    }

    pub(super) fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Adds a triangle.
    pub(super) fn push(&mut self, corners: [Corner; 3]) -> Result<(), String> {
        let next = self.parts.len();
        let number = *self.part_of.entry(self.material).or_insert(next);
        if number == next {
            self.parts.push(Part { material: self.material, ..Part::default() });
        }
        let part = &mut self.parts[number];
        let mut triangle = [0; 3];
        for (slot, corner) in triangle.iter_mut().zip(corners) {
            let next = u32::try_from(part.corners.len())
                .map_err(|_| "its object exceeds 2^32 vertices".to_owned())?;
            *slot = *part.places.entry(corner).or_insert(next);
            if *slot == next {
                part.corners.push(corner);
            }
        }
        part.triangles.push(triangle);
        Ok(())
    }

    /// Makes the mesh of all faces so far and forgets them; the material stays.
    pub(super) fn take(
        &mut self,
        name: String,
        pool: &Pool,
        library: &Library<'_>,
    ) -> Result<Made, Fault> {
        let parts = std::mem::take(&mut self.parts);
        self.part_of.clear();
        let points = parts.iter().flat_map(|part| &part.corners);
        let origin = place::origin(points.map(|corner| pool.points[corner.point as usize]));
        let mut builder = Builder::new(name);
        for Part { material, corners, places, triangles } in parts {
            drop(places);
            let material = library.material(material);
            // Without coordinates a picture's mean is the best guess at what is seen of it.
            let is_mapped = corners.iter().any(|corner| corner.tex_coord.is_some());
            let paint = if is_mapped { material.paint } else { material.unmapped() };
            let view = View { pool, corners: &corners, material, origin };
            let triangles = triangles.iter().map(|t| t.map(|corner| corner as usize));
            builder.append(&paint, &view, triangles)?;
        }
        let Builder { mended_normals, mended_tex_coords, .. } = builder;
        Ok(Made { draft: builder.finish(), origin, mended_normals, mended_tex_coords })
    }
}

/// Corners as vertices.
struct View<'a> {
    pool: &'a Pool,
    corners: &'a [Corner],
    material: &'a Material,
    origin: DVec3,
}

impl Vertices for View<'_> {
    fn count(&self) -> usize {
        self.corners.len()
    }

    fn position(&self, vertex: usize) -> [f64; 3] {
        place::relative(self.pool.points[self.corners[vertex].point as usize], self.origin)
    }

    fn normal(&self, vertex: usize) -> Option<[f32; 3]> {
        self.corners[vertex].normal.map(|normal| self.pool.normals[normal as usize])
    }

    fn color(&self, vertex: usize) -> [f32; 4] {
        let color = self.pool.colors.get(self.corners[vertex].point as usize);
        color.map_or([1.0; 4], |&[r, g, b]| [r, g, b, 1.0])
    }

    fn tex_coord(&self, vertex: usize) -> [f32; 2] {
        let coord = self.corners[vertex].tex_coord;
        self.material.looked_up(coord.map_or([0.0; 2], |at| self.pool.tex_coords[at as usize]))
    }
}
