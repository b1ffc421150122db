//! The scene file with far fields while it is written.

use super::cell::FarFieldOf;
use super::summary::CellSummary;
use super::{FarError, Settings};
use farfield::cells::MARGIN;
use farfield::cube::BakedFace;
use farfield::patches::BakedPatch;
use protocol::format::projected::{NewPatch, SUBPIXELS, TILE};
use protocol::format::{Cube, Method, NONE, SceneWriter, Tables, Vertex, ViewCell};
use scene::store::Store;
use std::collections::HashMap;
use std::path::Path;

/// The vertices that indices name, in the order they do, and the indices into those.
fn own_vertices(indices: &[u32]) -> (Vec<u32>, Vec<u16>) {
    let mut used = Vec::new();
    let mut places = HashMap::new();
    let local = indices.iter().map(|&vertex| {
        *places.entry(vertex).or_insert_with(|| {
            used.push(vertex);
            used.len() as u16 - 1
        })
    });
    let local = local.collect();
    (used, local)
}

/// The file with far fields while it is written.
pub(super) struct FarFile<'a> {
    store: &'a Store,
    writer: SceneWriter,
    /// By blob of the scene, its number in this file; none for cubes it had before.
    blobs: Vec<u32>,
    cells: Vec<ViewCell>,
    cubes: Vec<Cube>,
}

impl<'a> FarFile<'a> {
    pub(super) fn begin(store: &'a Store, working: &Path, output: &Path) -> Result<Self, FarError> {
        let mut writer = SceneWriter::create_at(working, output)?;
        let mut blobs = Vec::new();
        for (blob, id) in store.skeleton().blobs.iter().zip(0..) {
            if blob.is_projected() {
                blobs.push(NONE);
                continue;
            }
            let bytes = store.load_blob(protocol::id::BlobId(id))?;
            blobs.push(writer.copy_blob(blob, &bytes)?.0);
        }
        Ok(Self { store, writer, blobs, cells: Vec::new(), cubes: Vec::new() })
    }

    /// Writes a cell's cubes, or notes that its far field is cheaper as geometry.
    pub(super) fn add(
        &mut self,
        made: FarFieldOf,
        settings: &Settings,
    ) -> Result<CellSummary, FarError> {
        let mut summary = made.summary;
        let first_cube = self.cubes.len() as u32;
        let cubes = if summary.kept { &made.cubes[..] } else { &[] };
        for cube in cubes {
            let mut patches = [0; 7];
            for (face, start) in cube.faces.iter().zip(&mut patches) {
                *start = self.writer.blob_count();
                if let Some(face) = face {
                    summary.bytes += self.add_face(face)?;
                }
            }
            patches[6] = self.writer.blob_count();
            self.cubes.push(Cube {
                eye: cube.eye.to_array(),
                patches,
                side: settings.side,
                parent: cube.parent.map_or(NONE, |parent| first_cube + parent as u32),
                triangles: cube.triangles() as u32,
            });
        }
        self.cells.push(ViewCell {
            min: summary.min,
            max: summary.max,
            first_cube,
            cube_count: cubes.len() as u32,
            method: if summary.kept { settings.method } else { Method::None } as u32,
            margin: MARGIN,
            objective: summary.objective.last().copied().unwrap_or(0.0),
        });
        Ok(summary)
    }

    /// Writes the patches of a face; returns their bytes.
    fn add_face(&mut self, face: &BakedFace) -> Result<u64, FarError> {
        let mut bytes = 0;
        for BakedPatch { triangles, window, picture } in &face.patches {
            let at = window.at.map(|tile| tile * TILE);
            let triangles = face.mesh.triangles[triangles.clone()].as_flattened();
            let (used, indices) = own_vertices(triangles);
            let local = |&vertex: &u32| {
                let [u, v, disparity] = face.mesh.vertices[vertex as usize];
                Vertex::pack_position([u - at[0] * SUBPIXELS, v - at[1] * SUBPIXELS, disparity])
            };
            let vertices: Vec<[u32; 2]> = used.iter().map(local).collect();
            let blob = self.writer.add_patch(&NewPatch {
                step: face.mesh.step,
                at,
                side: window.across * TILE,
                vertices: &vertices,
                indices: &indices,
                table: &picture.table,
                tiles: picture.tiles.as_chunks().0,
                normals: picture.normals.as_ref().map(|normals| normals.as_chunks().0),
            })?;
            bytes += self.writer.blob(blob).bytes;
        }
        Ok(bytes)
    }

    pub(super) fn finish(mut self, key: [u8; 32]) -> Result<u64, FarError> {
        let skeleton = self.store.skeleton();
        for (texture, index) in skeleton.textures.iter().zip(0..) {
            self.writer.copy_texture(texture, &self.store.load_texture(index)?)?;
        }
        let mut tables = Tables {
            info: skeleton.info,
            hlods: skeleton.hlods.clone(),
            levels: skeleton.levels.clone(),
            parts: skeleton.parts.clone(),
            transforms: skeleton.transforms.clone(),
            view_cells: self.cells,
            cubes: self.cubes,
        };
        tables.info.key = key;
        for part in &mut tables.parts {
            part.blob = self.blobs[part.blob as usize];
        }
        Ok(self.writer.finish(tables)?.bytes)
    }
}
