//! The device: which adapter, and what goes wrong with it.

use std::sync::{Arc, Mutex, PoisonError};

use wgpu::{Adapter, AdapterInfo, Backends, DeviceType, ErrorFilter};

use crate::error::GpuError;

/// Which adapters may be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Adapters {
    /// GPUs only.
    #[default]
    Gpus,
    /// Software that computes on the processor too (Mesa's lavapipe), for tests.
    SoftwareToo,
}

/// A device. Copies share it.
///
/// ```
/// use splats_gpu::{Adapters, Gpu};
///
/// match Gpu::open(Adapters::SoftwareToo) {
///     Ok(gpu) => assert!(!gpu.name().is_empty()),
///     Err(error) => eprintln!("skipped: {error}"),
/// }
/// ```
#[derive(Clone, Debug)]
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    name: String,
    lost: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the best adapter: a GPU of its own before one in the processor, before software.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] and [`GpuError::OnlySoftware`] where there is none to use,
    /// [`GpuError::Adapter`] if it does not open.
    pub fn open(adapters: Adapters) -> Result<Self, GpuError> {
        let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
        description.backends = Backends::VULKAN | Backends::METAL | Backends::DX12;
        let instance = wgpu::Instance::new(description);
        let found = pollster::block_on(instance.enumerate_adapters(Backends::all()));
        let adapter = choose(found, adapters)?;
        let info = adapter.get_info();
        let name = format!("{} ({})", info.name, info.backend);
        let own = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: own.max_buffer_size,
            max_storage_buffer_binding_size: own.max_storage_buffer_binding_size,
            ..wgpu::Limits::default()
        };
        let request = wgpu::DeviceDescriptor {
            label: Some("splats"),
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let opened = pollster::block_on(adapter.request_device(&request));
        let (device, queue) = opened.map_err(|error| GpuError::Adapter {
            name: name.clone(),
            reason: error.to_string(),
        })?;
        let lost = Arc::new(Mutex::new(None));
        let to = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            let mut lost = to.lock().unwrap_or_else(PoisonError::into_inner);
            lost.get_or_insert_with(|| format!("{reason:?}, {message}"));
        });
        // Outside of an attempt nothing fails on a device that works; the default would panic.
        let to = Arc::clone(&lost);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let mut lost = to.lock().unwrap_or_else(PoisonError::into_inner);
            lost.get_or_insert_with(|| error.to_string());
        }));
        Ok(Self {
            device,
            queue,
            name,
            lost,
        })
    }

    /// Name of the adapter and its interface.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Makes the device unusable, as a reset of the GPU does. For tests.
    pub fn lose(&self) {
        self.device.destroy();
    }

    /// Work on the device; its errors are those of this call.
    pub(crate) fn attempt<T>(
        &self,
        what: &'static str,
        work: impl FnOnce() -> T,
    ) -> Result<T, GpuError> {
        self.check()?;
        let filters = [
            ErrorFilter::OutOfMemory,
            ErrorFilter::Internal,
            ErrorFilter::Validation,
        ];
        let scopes = filters.map(|filter| self.device.push_error_scope(filter));
        let out = work();
        let mut first = None;
        // Scopes end in the order in which they began, reversed.
        for scope in scopes.into_iter().rev() {
            first = pollster::block_on(scope.pop()).or(first);
        }
        self.check()?;
        match first {
            None => Ok(out),
            Some(wgpu::Error::OutOfMemory { .. }) => Err(GpuError::OutOfMemory {
                what,
                name: self.name.clone(),
            }),
            Some(error) => Err(GpuError::Failed {
                name: self.name.clone(),
                what,
                reason: error.to_string(),
            }),
        }
    }

    /// Waits until all work is done.
    pub(crate) fn wait(&self) -> Result<(), GpuError> {
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        polled
            .map(|_| ())
            .map_err(|error| self.lost(error.to_string()))
    }

    /// Waits until the work of a submission is done.
    pub(crate) fn wait_for(
        &self,
        submission_index: Option<wgpu::SubmissionIndex>,
    ) -> Result<(), GpuError> {
        let timeout = None;
        let polled = self.device.poll(wgpu::PollType::Wait {
            submission_index,
            timeout,
        });
        self.check()?;
        polled
            .map(|_| ())
            .map_err(|error| self.lost(error.to_string()))
    }

    /// Whether the device is there.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        // Calls back where the device is lost; whether work is done does not matter here.
        let _ = self.device.poll(wgpu::PollType::Poll);
        let lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        match &*lost {
            None => Ok(()),
            Some(reason) => Err(self.lost(reason.clone())),
        }
    }

    pub(crate) fn lost(&self, reason: String) -> GpuError {
        GpuError::Lost {
            name: self.name.clone(),
            reason,
        }
    }
}

fn choose(found: Vec<Adapter>, adapters: Adapters) -> Result<Adapter, GpuError> {
    let infos: Vec<AdapterInfo> = found.iter().map(Adapter::get_info).collect();
    let types: Vec<DeviceType> = infos.iter().map(|info| info.device_type).collect();
    match best(&types, adapters) {
        Some(index) => found.into_iter().nth(index).ok_or(GpuError::NoAdapter),
        None if infos.is_empty() => Err(GpuError::NoAdapter),
        None => {
            let names: Vec<String> = infos.into_iter().map(|info| info.name).collect();
            let names = names.join(", ");
            Err(GpuError::OnlySoftware { names })
        }
    }
}

/// Index of the adapter to use; the first of equal ones.
fn best(types: &[DeviceType], adapters: Adapters) -> Option<usize> {
    let order = [
        DeviceType::DiscreteGpu,
        DeviceType::IntegratedGpu,
        DeviceType::VirtualGpu,
        DeviceType::Other,
        DeviceType::Cpu,
    ];
    let usable = match adapters {
        Adapters::Gpus => &order[..order.len() - 1],
        Adapters::SoftwareToo => &order[..],
    };
    usable
        .iter()
        .find_map(|wanted| types.iter().position(|found| found == wanted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn software_is_refused_unless_asked_for() {
        let software = [DeviceType::Cpu];
        assert_eq!(best(&software, Adapters::Gpus), None);
        assert_eq!(best(&software, Adapters::SoftwareToo), Some(0));
        let both = [
            DeviceType::Cpu,
            DeviceType::IntegratedGpu,
            DeviceType::DiscreteGpu,
        ];
        assert_eq!(best(&both, Adapters::Gpus), Some(2));
        assert_eq!(best(&both, Adapters::SoftwareToo), Some(2));
        assert_eq!(best(&[], Adapters::SoftwareToo), None);
    }

    #[test]
    fn missing_adapters_have_errors_of_their_own() {
        assert_eq!(
            choose(Vec::new(), Adapters::Gpus).unwrap_err(),
            GpuError::NoAdapter
        );
    }
}
