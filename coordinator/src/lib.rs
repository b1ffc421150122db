//! Seats the nodes, paces the phases, moves the camera, writes the log.

pub mod camera_path;
pub mod config;
pub mod launch;
pub mod log;
mod net;
pub mod out_folder;
pub mod record;
pub mod run;
mod tally;
