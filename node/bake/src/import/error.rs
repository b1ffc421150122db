//! What can go wrong while a source scene is read, said so that a person can act on it.

use std::io;
use std::path::{Path, PathBuf};

/// What sort of fault an [`ImportError`] is; a verb turns it into an exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImportErrorKind {
    /// A file that was named is not there.
    NotFound,
    /// A file is there but the system cannot read it.
    Io,
    /// The file was read and its content is no scene, or a broken or unsupported one.
    BadData,
}

/// Why a source scene was not imported. Every message names the file, the object inside it, what
/// is wrong and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The scene file itself is missing.
    #[error("{}: there is no such file; check the path", file.display())]
    NotFound {
        /// The scene file.
        file: PathBuf,
    },
    /// A file that the scene refers to is missing.
    #[error("{}: {at} refers to {uri:?}, and there is no such file; put it where the scene looks for it", file.display())]
    MissingResource {
        /// The scene file.
        file: PathBuf,
        /// The object that refers to it.
        at: String,
        /// The reference as the scene spells it.
        uri: String,
    },
    /// The system refused to read a file.
    #[error("{}: cannot be read; check that it is a readable file", file.display())]
    Read {
        /// The file that was being read.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is in no format this importer knows.
    #[error("{}: {what}; give a scene as glTF 2.0 (.glb, .gltf), OBJ (.obj), PLY (.ply) or STL (.stl)", file.display())]
    UnknownFormat {
        /// The scene file.
        file: PathBuf,
        /// What was found instead.
        what: String,
    },
    /// The GLB framing is broken: truncated, or lengths that do not add up.
    #[error("{}: broken GLB container: {what}; export or copy the file again", file.display())]
    Container {
        /// The scene file.
        file: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The JSON does not parse, or is not shaped like glTF 2.0.
    #[error("{}: the glTF JSON is malformed; export the file again", file.display())]
    Json {
        /// The scene file.
        file: PathBuf,
        /// Where, by line and column, and why.
        source: serde_json::Error,
    },
    /// The scene says that it cannot be understood without extensions that are not supported.
    #[error("{}: requires the unsupported extension {names}; {fix} (supported: {supported})", file.display())]
    RequiredExtension {
        /// The scene file.
        file: PathBuf,
        /// The unsupported extensions, comma separated.
        names: String,
        /// How to be rid of the first of them.
        fix: &'static str,
        /// What would have been accepted, comma separated.
        supported: String,
    },
    /// A URI leads out of the scene's own folder, or to another machine.
    #[error("{}: {at} refers to {uri:?}, which {why}; only files inside the scene's own folder are read", file.display())]
    OutsideFolder {
        /// The scene file.
        file: PathBuf,
        /// The object that refers to it.
        at: String,
        /// The reference as the scene spells it.
        uri: String,
        /// How it leaves the folder.
        why: &'static str,
    },
    /// A data URI holds no data.
    #[error("{}: {at}: its data URI {what}; export the file again", file.display())]
    DataUri {
        /// The scene file.
        file: PathBuf,
        /// The object that holds it.
        at: String,
        /// What is wrong with it.
        what: &'static str,
    },
    /// An object of the scene contradicts the format or the bytes that stand there.
    #[error("{}: {at}: {what}; {fix}", file.display())]
    Invalid {
        /// The scene file.
        file: PathBuf,
        /// Which object: kind, number and name.
        at: String,
        /// What is wrong with it.
        what: String,
        /// What to do about it.
        fix: &'static str,
    },
    /// What was read could not be handed on.
    #[error("{}: what was read of it cannot be stored; check the space and the rights where the result is written", file.display())]
    Sink {
        /// The scene file.
        file: PathBuf,
        /// What the receiver said.
        source: io::Error,
    },
    /// The scene is well formed and shows not one triangle.
    #[error("{}: the scene shows no triangles{}; check that the meshes were exported and stand in the default scene", file.display(), explain(notes))]
    Empty {
        /// The scene file.
        file: PathBuf,
        /// What was skipped on the way.
        notes: Vec<String>,
    },
}

impl ImportError {
    /// The scene file itself is missing or cannot be read.
    pub(super) fn unreadable(file: &Path, source: io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::NotFound => Self::NotFound { file: file.into() },
            _ => Self::Read { file: file.into(), source },
        }
    }

    /// What sort of fault this is.
    pub fn kind(&self) -> ImportErrorKind {
        match self {
            Self::NotFound { .. } | Self::MissingResource { .. } => ImportErrorKind::NotFound,
            Self::Read { .. } | Self::Sink { .. } => ImportErrorKind::Io,
            _ => ImportErrorKind::BadData,
        }
    }

    /// Whether the fault is that a named file is not there.
    pub fn is_missing_input(&self) -> bool {
        self.kind() == ImportErrorKind::NotFound
    }
}

fn explain(notes: &[String]) -> String {
    if notes.is_empty() { String::new() } else { format!(" ({})", notes.join("; ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_follow_the_cause() {
        let file = PathBuf::from("hall.glb");
        assert!(ImportError::NotFound { file: file.clone() }.is_missing_input());
        let denied = ImportError::Read {
            file: file.clone(),
            source: io::ErrorKind::PermissionDenied.into(),
        };
        assert_eq!(denied.kind(), ImportErrorKind::Io);
        let empty = ImportError::Empty { file, notes: vec!["2 line primitives skipped".into()] };
        assert_eq!(empty.kind(), ImportErrorKind::BadData);
        assert!(
            empty
                .to_string()
                .starts_with("hall.glb: the scene shows no triangles (2 line primitives skipped);")
        );
    }
}
