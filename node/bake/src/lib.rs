//! Source scene to scene file.

mod hlod;
pub mod import;
mod levels;
pub mod options;
mod output;
mod pack;
mod pieces;
pub mod pipeline;
pub mod progress;
pub mod source;
pub mod summary;
pub mod synth;

pub use options::Options;
pub use pipeline::{BakeError, bake, bake_source};
pub use summary::Summary;
