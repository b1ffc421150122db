//! Which renderer a node uses.

use gpu::{Adapter, WgpuBackend};
use protocol::settings::{BackendChoice, PictureSize};
use scene::backend::cpu::CpuBackend;
use scene::backend::{Backend, BackendError};
use scene::occludee::Rules;

/// No renderer of the kind asked for.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{0}; install a driver (on Debian: mesa-vulkan-drivers) or use --backend cpu")]
pub struct ChooseError(BackendError);

/// Starts the renderer `choice` asks for, and logs which it is. Its meshes and textures take at most
/// `budget_bytes`.
///
/// `Auto` takes a GPU, else a software Vulkan driver, else the CPU backend; a driver that refuses is
/// passed over.
pub fn choose_backend(
    choice: BackendChoice,
    size: PictureSize,
    budget_bytes: u64,
) -> Result<Box<dyn Backend>, ChooseError> {
    let on = |adapter| match WgpuBackend::new(size, adapter, &Rules::default(), budget_bytes) {
        Ok(backend) => Ok(Box::new(backend) as Box<dyn Backend>),
        Err(error) => Err(error),
    };
    let cpu = || Box::new(CpuBackend::new(size).with_budget(budget_bytes)) as Box<dyn Backend>;
    let backend =
        match choice {
            BackendChoice::Cpu => cpu(),
            BackendChoice::Gpu => first_of(&[Adapter::HardwareOnly, Adapter::SoftwareOnly], on)
                .map_err(ChooseError)?,
            BackendChoice::Auto => first_of(&[Adapter::HardwareOnly, Adapter::SoftwareOnly], on)
                .unwrap_or_else(|_| cpu()),
        };
    let info = backend.info();
    tracing::info!("renderer: {} ({})", info.name, info.driver);
    Ok(backend)
}

/// The first adapter that starts, else the error of the last that is there at all.
fn first_of<B>(
    adapters: &[Adapter],
    mut start: impl FnMut(Adapter) -> Result<B, BackendError>,
) -> Result<B, BackendError> {
    let mut refusal = BackendError::NoAdapter("no graphics driver answered".into());
    for &adapter in adapters {
        match start(adapter) {
            Ok(backend) => return Ok(backend),
            Err(BackendError::NoAdapter(_)) => {}
            Err(error) => {
                tracing::warn!("passed over: {error}");
                refusal = error;
            }
        }
    }
    Err(refusal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::backend::UNLIMITED;

    #[test]
    fn an_adapter_that_refuses_is_passed_over() {
        let order = [Adapter::HardwareOnly, Adapter::SoftwareOnly];
        let none = || BackendError::NoAdapter("none".into());
        let broken = || BackendError::Device("lost".into());
        let hardware_broken = |adapter| match adapter {
            Adapter::HardwareOnly => Err(broken()),
            other => Ok(other),
        };
        assert_eq!(first_of(&order, hardware_broken).unwrap(), Adapter::SoftwareOnly);
        let only_broken = |adapter| match adapter {
            Adapter::HardwareOnly => Err::<(), _>(broken()),
            _ => Err(none()),
        };
        assert!(matches!(first_of(&order, only_broken), Err(BackendError::Device(_))));
        let nothing = first_of(&order, |_| Err::<(), _>(none()));
        assert!(matches!(nothing, Err(BackendError::NoAdapter(_))));
    }

    #[test]
    fn the_cpu_backend_needs_no_driver() {
        let size = PictureSize { width: 1, height: 1 };
        let backend = choose_backend(BackendChoice::Cpu, size, UNLIMITED).unwrap();
        assert_eq!(backend.info().name, "cpu");
    }
}
