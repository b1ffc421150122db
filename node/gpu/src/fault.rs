//! Errors of the device, which arrive through callbacks, kept until the next call can return them.

use scene::backend::BackendError;
use std::sync::{Arc, Mutex, PoisonError};

/// The first error a device reported. It stays: a device that failed once is not used further.
#[derive(Debug, Clone, Default)]
pub(crate) struct Fault(Arc<Mutex<Option<String>>>);

impl Fault {
    /// Listens to a device. Without a handler of its own, wgpu would panic on the first error.
    pub(crate) fn listen(device: &wgpu::Device) -> Self {
        let fault = Self::default();
        let uncaptured = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            uncaptured.set(error.to_string());
        }));
        let lost = fault.clone();
        device.set_device_lost_callback(move |reason, message| {
            // Dropping the device calls this too.
            if reason != wgpu::DeviceLostReason::Destroyed {
                lost.set(format!("device lost: {message}"));
            }
        });
        fault
    }

    /// Remembers an error unless there is an earlier one, of which it is likely a consequence.
    pub(crate) fn set(&self, message: String) {
        tracing::error!("graphics device: {message}");
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(message);
    }

    /// The error, if there was any.
    pub(crate) fn check(&self) -> Result<(), BackendError> {
        match &*self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(message) => Err(BackendError::Device(message.clone())),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_first_error() {
        let fault = Fault::default();
        assert!(fault.check().is_ok());
        fault.set("out of memory".into());
        fault.clone().set("invalid buffer".into());
        let message = fault.check().unwrap_err().to_string();
        assert!(message.contains("out of memory"), "{message}");
    }
}
