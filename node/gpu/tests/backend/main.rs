//! The wgpu backend on whatever adapter there is. `GPU_TESTS=require` fails without one, `off` skips,
//! `auto` (the default) skips and says so.

mod against_cpu;
mod boxes;
mod budget;
mod degenerate;
mod faces;
mod materials;
mod memory;
mod parts;
mod pictures;
mod projected;
mod relit;
mod slivers;
mod support;
