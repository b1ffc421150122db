//! Everything that can be checked about a scene file, checked: the `verify` verb.
//!
//! Opening has checked the header, every checksum of the skeleton and every rule of
//! [`protocol::format::check()`]; this reads all the rest.

use crate::store::{Content, Store, StoreError};
use glam::DVec3;
use protocol::format::check::check_disjoint;
use protocol::format::mesh::vertices_of;
use protocol::format::{Blob, Hlod, Transform, Vertex, Violation, check};
use protocol::id::{BlobId, HlodId};
use protocol::message::FailureKind;
use rayon::prelude::*;
use std::path::PathBuf;

/// What a sound file holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Verified {
    /// Bytes of the file.
    pub bytes: u64,
    /// Hlods whose boxes were held against their geometry.
    pub hlods: u64,
    /// Meshes whose contents were read.
    pub meshes: u64,
    /// Faces of scan cubes whose contents were read.
    pub faces: u64,
    /// Textures whose contents were read.
    pub textures: u64,
    /// Levels whose vertices were placed.
    pub levels: u64,
    /// Vertices that lie in their box, a mesh counted for each part that shows it.
    pub vertices: u64,
}

/// What is wrong with a scene file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum VerifyError {
    /// A blob or a texture is damaged or cannot be read.
    #[error(transparent)]
    Blob(#[from] StoreError),
    /// Bytes changed that no other check covers.
    #[error("{}: the digest does not match the contents; copy or bake the file again", path.display())]
    Digest {
        /// The file.
        path: PathBuf,
    },
    /// Bytes behind a texture are not zero.
    #[error("{}: the padding behind texture {texture} is not zero; copy or bake the file again", path.display())]
    TexturePadding {
        /// The file.
        path: PathBuf,
        /// The texture.
        texture: u32,
    },
    /// Bytes between blobs are not zero.
    #[error("{}: the padding behind blob {blob} is not zero; copy or bake the file again", path.display())]
    Padding {
        /// The file.
        path: PathBuf,
        /// The blob.
        blob: BlobId,
    },
    /// The skeleton breaks a rule.
    #[error("{}: the scene breaks a rule at {source}; bake it again", path.display())]
    Rule {
        /// The file.
        path: PathBuf,
        /// The rule.
        source: Violation,
    },
    /// A triangle has a longer edge than its level says, so culling could lose it.
    #[error(
        "{}: an edge of part {part} of level {level} of hlod {hlod} is longer than the level says; \
         bake the scene again",
        path.display()
    )]
    LongEdge {
        /// The file.
        path: PathBuf,
        /// The hlod.
        hlod: HlodId,
        /// Which of the hlod's levels, 0 the finest.
        level: u32,
        /// Which of the level's parts.
        part: u32,
    },
    /// Geometry leaves its box, so culling could lose it.
    #[error(
        "{}: vertex {vertex} of part {part} of level {level} of hlod {hlod} lies outside its box; \
         bake the scene again",
        path.display()
    )]
    OutsideBox {
        /// The file.
        path: PathBuf,
        /// The hlod.
        hlod: HlodId,
        /// Which of the hlod's levels, 0 the finest.
        level: u32,
        /// Which of the level's parts.
        part: u32,
        /// The vertex.
        vertex: u32,
    },
}

impl VerifyError {
    /// The class, which decides the exit code.
    pub fn kind(&self) -> FailureKind {
        match self {
            Self::Blob(error) => error.kind(),
            _ => FailureKind::BadData,
        }
    }
}

/// Reads the whole file and checks everything. Of several faults the same one is always reported.
pub fn verify(store: &Store) -> Result<Verified, VerifyError> {
    let path = || store.path().to_path_buf();
    let skeleton = store.skeleton();
    check(skeleton)
        .and_then(|()| check_disjoint(&skeleton.view_cells))
        .map_err(|source| VerifyError::Rule { path: path(), source })?;

    // Blobs come before the digest: they say where the damage is, it only says that there is some.
    let ids = (0..skeleton.blobs.len() as u32).into_par_iter().map(BlobId);
    first_error(ids.map(|id| check_blob_and_padding(store, id)))?;
    let textures = (0..skeleton.textures.len() as u32).into_par_iter();
    first_error(textures.map(|index| check_texture_and_padding(store, index)))?;
    if store.real_digest()? != store.digest() {
        return Err(VerifyError::Digest { path: path() });
    }
    let hlods = skeleton.hlods.par_iter().enumerate();
    let counts = first_error(hlods.map(|(i, hlod)| check_box(store, HlodId(i as u32), hlod)))?;
    let faces = skeleton.blobs.iter().filter(|blob| blob.is_projected()).count() as u64;
    Ok(Verified {
        bytes: store.bytes(),
        hlods: skeleton.hlods.len() as u64,
        meshes: skeleton.blobs.len() as u64 - faces,
        faces,
        textures: skeleton.textures.len() as u64,
        levels: skeleton.levels.len() as u64,
        vertices: counts.iter().sum(),
    })
}

/// All results, or the error that comes first in the table, whatever the threads do.
fn first_error<T: Send>(
    results: impl IndexedParallelIterator<Item = Result<T, VerifyError>>,
) -> Result<Vec<T>, VerifyError> {
    let mut all = Vec::new();
    results.collect_into_vec(&mut all);
    all.into_iter().collect()
}

fn check_blob_and_padding(store: &Store, id: BlobId) -> Result<(), VerifyError> {
    store.load_blob(id)?;
    if store.padding_behind(Content::Blob(id))?.iter().any(|&b| b != 0) {
        return Err(VerifyError::Padding { path: store.path().to_path_buf(), blob: id });
    }
    Ok(())
}

fn check_texture_and_padding(store: &Store, index: u32) -> Result<(), VerifyError> {
    store.load_texture(index)?;
    if store.padding_behind(Content::Texture(index))?.iter().any(|&b| b != 0) {
        let path = store.path().to_path_buf();
        return Err(VerifyError::TexturePadding { path, texture: index });
    }
    Ok(())
}

/// Places every vertex of every part of every level; returns how many.
///
/// A hlod's box lies inside its parent's, so its own levels suffice.
fn check_box(store: &Store, id: HlodId, hlod: &Hlod) -> Result<u64, VerifyError> {
    let skeleton = store.skeleton();
    let mut count = 0;
    for (level_index, level) in skeleton.levels_of(hlod).iter().enumerate() {
        for (part_index, part) in skeleton.parts_of(level).iter().enumerate() {
            let id_of_mesh = BlobId(part.blob);
            let (mesh, bytes) = (skeleton.blob(id_of_mesh), store.load_blob(id_of_mesh)?);
            let transform = skeleton.transform_of(part);
            let stray = |v: Vertex| !holds(hlod, &transform, position(mesh, &v));
            if let Some(vertex) = vertices_of(mesh, &bytes).position(stray) {
                return Err(VerifyError::OutsideBox {
                    path: store.path().to_path_buf(),
                    hlod: id,
                    level: level_index as u32,
                    part: part_index as u32,
                    vertex: vertex as u32,
                });
            }
            if longest_edge(mesh, &bytes, &transform) > f64::from(level.longest_edge) {
                return Err(VerifyError::LongEdge {
                    path: store.path().to_path_buf(),
                    hlod: id,
                    level: level_index as u32,
                    part: part_index as u32,
                });
            }
            count += u64::from(mesh.vertices);
        }
    }
    Ok(count)
}

/// Length of the longest edge of a mesh that is placed.
fn longest_edge(blob: &Blob, bytes: &[u8], transform: &Transform) -> f64 {
    let place = |vertex| DVec3::from_array(transform.apply(position(blob, &vertex)));
    let places: Vec<DVec3> = vertices_of(blob, bytes).map(place).collect();
    let triangles = bytes[blob.vertex_bytes()..].chunks_exact(6).take(blob.triangles as usize);

    let longest_of = |triangle: &[u8]| {
        let corner =
            |k: usize| usize::from(u16::from_le_bytes([triangle[2 * k], triangle[2 * k + 1]]));
        let [a, b, c] = [0, 1, 2].map(|k| places[corner(k)]);
        a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
    };
    triangles.map(longest_of).fold(0.0, f64::max).sqrt()
}

/// Mesh-space position of a vertex.
pub(crate) fn position(blob: &Blob, vertex: &Vertex) -> [f64; 3] {
    let grid = vertex.grid();
    std::array::from_fn(|k| blob.origin[k] + f64::from(grid[k]) * blob.step)
}

/// The placed point lies in the box, but for rounding.
///
/// A coordinate is a sum of three products and a shift of `p`, itself a sum: each term meets at most
/// five roundings, so it is off by less than 6u of the sum of magnitudes, u = 2^-53 (Higham 2002,
/// section 3.1). Whoever made the box may have rounded as much the other way: 12u < 8 EPSILON.
fn holds(hlod: &Hlod, transform: &Transform, p: [f64; 3]) -> bool {
    let placed = transform.apply(p);
    (0..3).all(|k| {
        let terms = (0..3).map(|j| (transform.linear[j][k] * p[j]).abs());
        let slack = 8.0 * f64::EPSILON * (terms.sum::<f64>() + transform.translation[k].abs());
        hlod.min[k] - slack <= placed[k] && placed[k] <= hlod.max[k] + slack
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;
    use protocol::format::read_skeleton;

    /// The error after the fixture's boxes were changed before it was written.
    fn with_hlods(change: impl FnOnce(&mut [Hlod])) -> Result<Verified, VerifyError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.occ");
        fixture::write_with(&path, 1, change);
        verify(&Store::open(&path).unwrap())
    }

    #[test]
    fn a_sound_file_is_counted() {
        let (_folder, store) = fixture::store();
        let verified = verify(&store).unwrap();
        assert_eq!(verified.bytes, std::fs::metadata(store.path()).unwrap().len());
        assert_eq!((verified.hlods, verified.meshes, verified.levels), (3, 2, 3));
        assert_eq!((verified.vertices, verified.textures, verified.faces), (3 + 4 + 4, 1, 1));
    }

    #[test]
    fn every_flipped_bit_is_found() {
        let (folder, store) = fixture::store();
        let sound = std::fs::read(store.path()).unwrap();
        let path = folder.path().join("flipped.occ");
        for at in 0..sound.len() {
            let mut bytes = sound.clone();
            bytes[at] ^= 1 << (at % 8);
            std::fs::write(&path, &bytes).unwrap();
            let found = Store::open(&path)
                .is_err_and(|e| matches!(e, crate::store::OpenError::Bad { .. }))
                || Store::open(&path).is_ok_and(|s| verify(&s).is_err());
            assert!(found, "byte {at}");
        }
    }

    #[test]
    fn nonzero_padding_is_named() {
        let (folder, store) = fixture::store();
        let mut bytes = std::fs::read(store.path()).unwrap();
        let blob = store.skeleton().blobs[0];
        bytes[448 + (blob.offset + blob.bytes) as usize] = 1;
        let path = folder.path().join("padded.occ");
        std::fs::write(&path, &bytes).unwrap();
        let error = verify(&Store::open(&path).unwrap()).unwrap_err();
        assert!(matches!(error, VerifyError::Padding { blob: BlobId(0), .. }), "{error}");
    }

    #[test]
    fn a_damaged_texture_and_the_padding_behind_it_are_named() {
        let (folder, store) = fixture::store();
        let path = folder.path().join("spoilt.occ");
        let start = read_skeleton(store.path()).unwrap().pixels.start as usize;
        let spoilt = |at: usize| {
            let mut bytes = std::fs::read(store.path()).unwrap();
            bytes[start + at] ^= 1;
            std::fs::write(&path, &bytes).unwrap();
            verify(&Store::open(&path).unwrap()).unwrap_err()
        };
        let damaged = StoreError::DamagedTexture { path: path.clone(), texture: 0 };
        assert_eq!(spoilt(3), VerifyError::Blob(damaged));
        assert_eq!(spoilt(4), VerifyError::TexturePadding { path: path.clone(), texture: 0 });
    }

    #[test]
    fn a_false_digest_is_named() {
        let (folder, store) = fixture::store();
        let mut bytes = std::fs::read(store.path()).unwrap();
        bytes[40] ^= 1;
        bytes[28..32].fill(0);
        let crc = crc32c(&bytes[..448]);
        bytes[28..32].copy_from_slice(&crc.to_le_bytes());
        let path = folder.path().join("renamed.occ");
        std::fs::write(&path, &bytes).unwrap();
        let error = verify(&Store::open(&path).unwrap()).unwrap_err();
        assert!(matches!(error, VerifyError::Digest { .. }), "{error}");
    }

    /// CRC32C bit by bit: a second opinion on the header's checksum.
    fn crc32c(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| {
                (c >> 1) ^ (0x82f6_3b78 & (c & 1).wrapping_neg())
            })
        })
    }

    #[test]
    fn geometry_outside_its_box_is_named() {
        let outside = |hlods: fn(&mut [Hlod])| match with_hlods(hlods) {
            Err(VerifyError::OutsideBox { hlod, level, vertex, .. }) => (hlod.0, level, vertex),
            other => panic!("{other:?}"),
        };
        // The turned instance: its second vertex lies at y = 1, its third at x = 4.
        assert_eq!(outside(|h| h[2].max[1] = 0.999), (2, 0, 1));
        assert_eq!(outside(|h| h[2].min[0] = 4.001), (2, 0, 2));
        assert_eq!(outside(|h| h[1].max[2] = 0.5), (1, 0, 3));
        // The least reported is the first in the table.
        assert_eq!(outside(|h| (h[1].max[2], h[2].max[1]) = (0.5, 0.5)), (1, 0, 3));
    }

    #[test]
    fn an_edge_longer_than_its_level_says_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.occ");
        fixture::write_with_levels(&path, |levels| levels[2].longest_edge = 1.4);
        let error = verify(&Store::open(&path).unwrap()).unwrap_err();
        // The diagonal of the turned unit square is longer.
        assert!(
            matches!(error, VerifyError::LongEdge { hlod: HlodId(2), level: 0, part: 0, .. }),
            "{error}"
        );
    }

    #[test]
    fn rounding_of_a_box_is_forgiven_and_no_more() {
        assert!(with_hlods(|h| h[2].max[1] = 1.0 - f64::EPSILON).is_ok());
        assert!(with_hlods(|h| h[2].max[1] = 1.0 - 1e-12).is_err());
    }
}
