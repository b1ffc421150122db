//! Scene files of several formats, handed to a [`Sink`] piece by piece.
//!
//! Every claim of a file is checked where it is used, against the bytes that are there: a broken file
//! is an [`ImportError`] that names the object, never a panic and never an allocation of a claimed size.

mod builder;
mod emit;
mod error;
mod format;
mod gltf;
mod obj;
mod open;
mod picture;
mod place;
mod ply;
mod polygon;
mod references;
mod stl;
mod store;
#[cfg(test)]
mod testing;
mod text;
mod texture;
mod uri;

use std::path::Path;

pub use error::{ImportError, ImportErrorKind};
pub(crate) use open::check_readable;
pub use references::references;

use self::emit::Emitter;
use self::format::Format;
use crate::source::{Imported, Sink};
#[cfg(test)]
use crate::source::{Source, SourceMesh, Texture};

/// What an import may yield at most.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImportLimits {
    /// Pixels along each side of the largest texture: a power of two. Larger pictures are reduced.
    pub texture_side: u32,
    /// Bytes of memory to work in. What is read does not depend on it.
    pub memory: u64,
    /// Name or number of the scene to read of a file that holds several; empty for its default one.
    pub scene: String,
}

impl Default for ImportLimits {
    fn default() -> Self {
        Self { texture_side: 1024, memory: 1 << 30, scene: String::new() }
    }
}

/// Reads the scene file at `path`, and the files it refers to, into `sink`.
///
/// Meshes come in the file's order; at most one batch of them is in memory.
/// External files are read from the scene's own folder only. The result does not depend on how many
/// threads there are.
///
/// # Errors
///
/// See [`ImportError`]; [`ImportError::kind`] sorts them for an exit code. What the sink took before
/// an error is of no use.
pub fn import(
    path: &Path,
    limits: &ImportLimits,
    sink: &mut dyn Sink,
) -> Result<Imported, ImportError> {
    assert!(limits.texture_side.is_power_of_two(), "a texture's side is a power of two");
    let format = Format::of(path)?;
    let out = Emitter::new(path, limits.clone(), sink);
    let mut imported = match format {
        Format::Gltf => return gltf::import(path, out),
        Format::Obj => obj::import(path, out),
        Format::Ply => ply::import(path, out),
        Format::Stl => stl::import(path, out),
    }?;
    if !limits.scene.is_empty() {
        let note = format!("{} has no scenes to choose from, all of it is read", path.display());
        imported.notes.push(note);
    }
    Ok(imported)
}

/// What the format of the scene file at `path` is called.
///
/// # Errors
///
/// Where it cannot be read, or is in no known format.
pub fn format_name(path: &Path) -> Result<&'static str, ImportError> {
    Ok(match Format::of(path)? {
        Format::Gltf => "glTF 2.0",
        Format::Obj => "OBJ",
        Format::Ply => "PLY",
        Format::Stl => "STL",
    })
}

/// Reads the scene file at `path` as a whole, with the default limits.
#[cfg(test)]
fn import_all(path: &Path) -> Result<Source, ImportError> {
    let mut whole = Source::default();
    let imported = import(path, &ImportLimits::default(), &mut Collect(&mut whole))?;
    whole.complete(imported);
    Ok(whole)
}

/// Keeps everything.
#[cfg(test)]
struct Collect<'a>(&'a mut Source);

#[cfg(test)]
impl Sink for Collect<'_> {
    fn mesh(&mut self, mesh: SourceMesh) -> std::io::Result<()> {
        self.0.meshes.push(mesh);
        Ok(())
    }

    fn more(&mut self, part: SourceMesh) -> std::io::Result<()> {
        self.0.meshes.last_mut().expect("a mesh was taken").append(part);
        Ok(())
    }

    fn texture(&mut self, texture: Texture) -> std::io::Result<()> {
        self.0.textures.push(texture);
        Ok(())
    }
}
