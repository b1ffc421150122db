//! What a graphics driver says by itself, kept from the user.

/// Starts the program anew without the Mesa layer that chooses among devices, where that would look for a
/// Wayland display, find that there can be none, and complain on stderr. Returns where there is no need.
pub(super) fn hush() {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::process::CommandExt;

        /// Keeps the layer out, or tells it what to choose.
        const LAYER: [&str; 2] = ["NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT"];
        let var = |name: &str| std::env::var_os(name);
        let has_display =
            var("XDG_RUNTIME_DIR").is_some_and(|at| at.as_encoded_bytes()[..].starts_with(b"/"));
        if has_display || LAYER.into_iter().any(|name| var(name).is_some()) {
            return;
        }
        let Ok(program) = std::env::current_exe() else { return };
        let mut arguments = std::env::args_os();
        let mut again = std::process::Command::new(program);
        again.env(LAYER[0], "1").arg0(arguments.next().unwrap_or_default()).args(arguments);
        // It comes back only if that fails, and a driver's words are no reason to end.
        let _ = again.exec();
    }
}
