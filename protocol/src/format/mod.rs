//! The scene file. FORMAT.md draws every byte.
//!
//! A small skeleton (always resident) and large geometry and pixels, in one file that is written to a
//! temporary name, synced and renamed. All numbers are little-endian; sections start at multiples of
//! 64 bytes, so that a mapped file can be read in place.

pub mod check;
pub mod class;
mod far_field;
#[cfg(test)]
mod fixture;
pub mod inspect;
mod layout;
pub mod mesh;
pub mod projected;
pub mod read;
pub mod skeleton;
pub mod texture;
pub mod vertex;
pub mod write;

pub use check::{Rule, Violation, check};
pub use class::Class;
pub use far_field::{Cube, Method, ViewCell};
pub use inspect::{Inspection, summary};
pub use layout::{ALIGNMENT, FORMAT_VERSION, Section};
pub use read::{FormatError, ReadError, SceneFile, digest, parse, read_blob};
pub use read::{read_skeleton, read_skeleton_of};
pub use skeleton::{Blob, Criteria, Hlod, Level, Part, SceneInfo, Skeleton, Transform};
pub use texture::{Texture, Wrap};
pub use vertex::{TexturedVertex, Vertex, Vertices};
pub use write::{Finished, SceneWriter, Tables, WriteError, WriterState};

/// BLAKE3 of the whole file's content, see FORMAT.md.
pub type Digest = [u8; 32];

/// "No such thing" in an index field.
pub const NONE: u32 = u32::MAX;
