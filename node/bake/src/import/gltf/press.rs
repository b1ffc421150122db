//! Objects whose transform presses space flat, made into meshes of their own.
//!
//! A scale of zero along one axis is legal and visible (a box pressed into a decal), yet such a
//! transform has no inverse, so no normal can be mapped through it. The pressed shape is worked
//! out here once, and the object is left with a plain translation.

use glam::{DAffine3, DMat3, DVec3};

use crate::import::builder::Draft;
use crate::import::builder::unit;
use crate::source::{Section, SourceMesh};

/// Whether a transform needs [`press`].
pub(super) fn is_flat(transform: &DAffine3) -> bool {
    transform.matrix3.determinant() == 0.0
}

/// A mesh mapped through `matrix`, with the normals of its faces; what collapses to a line counts as
/// degenerate. `None` where a position leaves the range of `f32`, or an index that of `u32`.
pub(super) fn press(draft: &Draft, matrix: DMat3) -> Option<Draft> {
    let Draft { mesh, surfaces } = draft;
    let mut pressed = SourceMesh {
        name: mesh.name.clone(),
        dropped_degenerate: mesh.dropped_degenerate,
        ..SourceMesh::default()
    };
    let mut start = 0;
    for section in &mesh.sections {
        for triangle in &mesh.indices[start..section.end as usize] {
            let points = triangle.map(|vertex| matrix * mesh.position(vertex as usize));
            if points.iter().any(|point| !point.as_vec3().is_finite()) {
                return None;
            }
            let [a, b, c] = points;
            let area = (b - a).cross(c - a);
            if area == DVec3::ZERO {
                pressed.dropped_degenerate += 1;
                continue;
            }
            let first = u32::try_from(pressed.positions.len()).ok()?;
            pressed.indices.push([first, first.checked_add(1)?, first.checked_add(2)?]);
            points.into_iter().for_each(|point| pressed.push_position(point));
            pressed.normals.extend([unit(area); 3]);
            pressed.colors.extend(triangle.map(|vertex| mesh.colors[vertex as usize]));
            if !mesh.tex_coords.is_empty() {
                pressed.tex_coords.extend(triangle.map(|vertex| mesh.tex_coords[vertex as usize]));
            }
        }
        start = section.end as usize;
        let end = pressed.indices.len() as u32;
        if end > pressed.sections.last().map_or(0, |section: &Section| section.end) {
            pressed.sections.push(Section { end, surface: section.surface });
        }
    }
    Some(Draft { mesh: pressed, surfaces: surfaces.clone() })
}
