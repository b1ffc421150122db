//! Every byte two processes must agree on, on the wire and on disk.
//!
//! Nothing here opens a socket, reads a clock or touches a GPU: the session state machines are
//! functions of their arguments, and the file layout is a function of bytes.

pub mod camera;
pub mod codec;
pub mod file;
pub mod format;
pub mod id;
pub mod message;
pub mod path_text;
pub mod schedule;
pub mod session;
pub mod settings;
pub mod sun;
pub mod telemetry;
pub mod visible;
