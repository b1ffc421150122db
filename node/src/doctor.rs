//! What this machine can render with, in words.

use crate::choose::choose_backend;
use protocol::message::WIRE_VERSION;
use protocol::settings::{BackendChoice, PictureSize};
use scene::backend::UNLIMITED;
use std::fmt::Write;

/// A report for a person: versions, adapters with limits and features, and what `auto` would take.
pub fn report() -> String {
    let mut out = format!(
        "occluster {}, wire version {WIRE_VERSION}, {} {}\n",
        env!("CARGO_PKG_VERSION"),
        std::env::consts::OS,
        std::env::consts::ARCH
    );
    let mut line = |text: String| {
        let _ = writeln!(out, "{text}");
    };
    line(format!("cores: {}", std::thread::available_parallelism().map_or(1, usize::from)));
    let adapters = gpu::adapters();
    if adapters.is_empty() {
        line("adapters: none; the embedded CPU backend works without one".to_owned());
        line("  for a software Vulkan driver on Debian: apt-get install mesa-vulkan-drivers libvulkan1".to_owned());
    }
    for adapter in &adapters {
        line(format!(
            "adapter: {} ({}, {}, {})",
            adapter.name, adapter.kind, adapter.backend, adapter.driver
        ));
        let limits: Vec<String> =
            adapter.limits.iter().map(|(name, value)| format!("{name} {value}")).collect();
        line(format!("  limits: {}", limits.join(", ")));
        line(format!("  features: {}", adapter.features.join(", ")));
        if !adapter.missing.is_empty() {
            line(format!("  missing: {}", adapter.missing.join(", ")));
        }
    }
    match choose_backend(BackendChoice::Auto, PictureSize { width: 64, height: 64 }, UNLIMITED) {
        Ok(backend) => {
            line(format!("would use: {} ({})", backend.info().name, backend.info().driver))
        }
        Err(error) => line(format!("would use: nothing: {error}")),
    }
    out
}

#[cfg(test)]
mod tests {
    #[test]
    fn says_what_would_be_used() {
        let report = super::report();
        assert!(report.contains("would use: gpu") || report.contains("would use: cpu"), "{report}");
    }
}
