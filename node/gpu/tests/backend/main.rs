//! The wgpu backend on whatever adapter there is. `GPU_TESTS=require` fails without one, `off` skips,
//! `auto` (the default) skips and says so.

mod against_cpu;
mod boxes;
mod budget;
mod degenerate;
mod materials;
mod memory;
mod parts;
mod pictures;
mod slivers;
mod support;
