//! Source scene to scene file.

mod built;
mod bulk;
mod bytes;
pub mod far;
mod giant;
mod grid;
mod hlod;
pub mod import;
mod keys;
mod levels;
pub mod options;
mod output;
mod pack;
mod pieces;
pub mod pipeline;
mod plan;
pub mod progress;
mod scratch;
mod seams;
mod shared;
mod slice;
pub mod source;
mod spool;
pub mod summary;
pub mod survey;
pub mod synth;
mod work;

pub use options::Options;
pub use pipeline::{BakeError, bake, bake_scene};
pub use summary::Summary;
pub use work::{WorkError, far_folder, plain_scene, working_folder};
