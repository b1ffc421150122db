//! The wgpu backend: the only crate that names wgpu.
//!
//! [`WgpuBackend`] implements [`scene::backend::Backend`] on Vulkan, Metal, DX12 or a software Vulkan
//! driver. Depth made by an occluder pass never leaves the device.

mod awaited;
mod backend;
mod device;
mod draws;
mod fault;
mod geometry_memory;
mod mesh_pipelines;
mod pipelines;
mod queries;
mod ranges;
mod readback;
mod recorder;
mod squares;
mod staging;
mod stream_buffer;
mod targets;
mod textures;

pub use backend::WgpuBackend;
pub use device::{Adapter, AdapterReport, adapters};
