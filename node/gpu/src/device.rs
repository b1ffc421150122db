//! Which adapter, and a device on it.

use crate::fault::Fault;
use scene::backend::BackendError;
use wgpu::{DeviceType, Features};

/// What kind of adapter may be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Adapter {
    /// A GPU, else a software driver.
    #[default]
    Any,
    /// A GPU or nothing.
    HardwareOnly,
    /// A software driver or nothing.
    SoftwareOnly,
}

/// One adapter in words, for `occluster doctor`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterReport {
    /// Name of the adapter.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: String,
    /// Graphics interface, for example `vulkan`.
    pub backend: String,
    /// Limits that matter here, by name.
    pub limits: Vec<(&'static str, u64)>,
    /// What it has of the features that matter here.
    pub features: Vec<&'static str>,
    /// What it lacks of them.
    pub missing: Vec<&'static str>,
}

/// A device and what is known of it.
pub(crate) struct Device {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) limits: wgpu::Limits,
    pub(crate) name: String,
    pub(crate) driver: String,
    /// Boxes can mark themselves in one draw (`--cull boxes`).
    pub(crate) can_mark_boxes: bool,
    /// Triangles without an area may leave fragments of undefined depth.
    pub(crate) needs_guard: bool,
    /// It renders on the CPU.
    pub(crate) is_software: bool,
    pub(crate) fault: Fault,
}

const EARLY_DEPTH_TEST: &str = "early depth test (--cull boxes)";
const FRAGMENT_STORES: &str = "stores from fragments (--cull boxes)";

/// All adapters of this machine, the one that [`Adapter::Any`] takes first. Honours `WGPU_BACKEND` and
/// `WGPU_ADAPTER_NAME`; empty where there is no driver.
pub fn adapters() -> Vec<AdapterReport> {
    candidates(Adapter::Any).iter().map(report).collect()
}

impl Device {
    /// Opens the best adapter of the kind asked for. `frugal`: memory counts more than speed.
    ///
    /// Errors: `NoAdapter` where there is none, `Device` where the driver refuses.
    pub(crate) fn open(choice: Adapter, frugal: bool) -> Result<Self, BackendError> {
        let adapter = candidates(choice).into_iter().next().ok_or_else(|| {
            BackendError::NoAdapter(match choice {
                Adapter::Any => "no graphics driver answered".to_owned(),
                Adapter::HardwareOnly => "no hardware graphics driver answered".to_owned(),
                Adapter::SoftwareOnly => "no software graphics driver answered".to_owned(),
            })
        })?;
        let can_mark_boxes = lacking(&adapter).is_empty();
        let limits = adapter.limits();
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("occluster"),
            required_features: adapter.features() & Features::SHADER_EARLY_DEPTH_TEST,
            required_limits: limits.clone(),
            // In blocks of 8 MiB and more; else of 128, most of which a small budget leaves empty.
            memory_hints: match frugal {
                true => wgpu::MemoryHints::MemoryUsage,
                false => wgpu::MemoryHints::Performance,
            },
            ..Default::default()
        }))
        .map_err(|e| BackendError::Device(e.to_string()))?;
        let info = adapter.get_info();
        Ok(Self {
            fault: Fault::listen(&device),
            device,
            queue,
            limits,
            // Mesa's driver is known to; hardware sets triangles up after it snaps their corners.
            needs_guard: info.device_type == DeviceType::Cpu,
            is_software: info.device_type == DeviceType::Cpu,
            driver: driver(&info),
            name: info.name,
            can_mark_boxes,
        })
    }

    /// Waits until `submission` is done, and by default for all that was submitted; memory that is no
    /// longer used is free then.
    pub(crate) fn wait_for(
        &self,
        submission: Option<wgpu::SubmissionIndex>,
    ) -> Result<(), BackendError> {
        let wait = wgpu::PollType::Wait { submission_index: submission, timeout: None };
        self.device.poll(wait).map_err(|e| BackendError::Device(e.to_string()))?;
        self.fault.check()
    }

    /// The error for what this adapter cannot do.
    pub(crate) fn unsupported(&self, reason: String) -> BackendError {
        BackendError::Unsupported { adapter: self.name.clone(), reason }
    }
}

/// Adapters of a kind, best first, in the driver's order among equals.
fn candidates(choice: Adapter) -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    // The defaults of unoptimised builds ask for validation layers; `WGPU_VALIDATION=1` still does.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor.with_env());
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let wanted = std::env::var("WGPU_ADAPTER_NAME").ok().map(|name| name.to_lowercase());
    adapters.retain(|adapter| {
        let info = adapter.get_info();
        let software = info.device_type == DeviceType::Cpu;
        let kind = match choice {
            Adapter::Any => true,
            Adapter::HardwareOnly => !software,
            Adapter::SoftwareOnly => software,
        };
        kind && wanted.as_ref().is_none_or(|name| info.name.to_lowercase().contains(name))
    });
    adapters.sort_by_key(|adapter| rank(adapter.get_info().device_type));
    adapters
}

/// Place in the order of preference.
fn rank(kind: DeviceType) -> u8 {
    match kind {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    }
}

fn lacking(adapter: &wgpu::Adapter) -> Vec<&'static str> {
    let mut missing = Vec::new();
    if !adapter.features().contains(Features::SHADER_EARLY_DEPTH_TEST) {
        missing.push(EARLY_DEPTH_TEST);
    }
    let flags = adapter.get_downlevel_capabilities().flags;
    if !flags.contains(wgpu::DownlevelFlags::FRAGMENT_WRITABLE_STORAGE) {
        missing.push(FRAGMENT_STORES);
    }
    missing
}

fn driver(info: &wgpu::AdapterInfo) -> String {
    [info.driver.as_str(), info.driver_info.as_str()]
        .into_iter()
        .filter(|part| !part.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

fn report(adapter: &wgpu::Adapter) -> AdapterReport {
    let (info, limits, missing) = (adapter.get_info(), adapter.limits(), lacking(adapter));
    let kind = match info.device_type {
        DeviceType::DiscreteGpu => "discrete",
        DeviceType::IntegratedGpu => "integrated",
        DeviceType::VirtualGpu => "virtual",
        DeviceType::Cpu => "software",
        DeviceType::Other => "other",
    };
    AdapterReport {
        driver: driver(&info),
        kind: kind.to_owned(),
        backend: info.backend.to_string(),
        limits: vec![
            ("largest picture side, pixels", u64::from(limits.max_texture_dimension_2d)),
            ("largest buffer, bytes", limits.max_buffer_size),
            ("largest storage binding, bytes", limits.max_storage_buffer_binding_size),
        ],
        features: [EARLY_DEPTH_TEST, FRAGMENT_STORES]
            .into_iter()
            .filter(|feature| !missing.contains(feature))
            .collect(),
        missing,
        name: info.name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prefers_hardware_and_takes_software_last() {
        let mut kinds = [
            DeviceType::Cpu,
            DeviceType::Other,
            DeviceType::IntegratedGpu,
            DeviceType::VirtualGpu,
            DeviceType::DiscreteGpu,
        ];
        kinds.sort_by_key(|&kind| rank(kind));
        assert_eq!(kinds[0], DeviceType::DiscreteGpu);
        assert_eq!(kinds[1], DeviceType::IntegratedGpu);
        assert_eq!(kinds[4], DeviceType::Cpu);
    }
}
