//! Where the stage `splats` trains: on the processor, or on a GPU.
//!
//! Contract: the GPU is opened before the first stage. A program built without the feature `gpu`
//! has none, and reports an error if one is requested. Software that computes on the processor is
//! used only if its name is given.

use serde_json::{Value, json};
use splats::TrainingDevice;
#[cfg(feature = "gpu")]
use splats_gpu::{Adapters, Gpu, GpuError, GpuTrainer};

use crate::pipeline::StageError;

/// Where to train.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceName {
    /// The processor.
    #[default]
    Cpu,
    /// A GPU.
    Gpu,
    /// The kernels of the GPU, on the processor where there is no GPU.
    Software,
}

/// Why a device cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// Build with `--features gpu`.
    #[error(
        "training on a GPU: found a program built without it, expected one built with `--features gpu`"
    )]
    NotBuilt,
    /// Error of the GPU.
    #[cfg(feature = "gpu")]
    #[error("training on a GPU: {0}: `--device cpu` trains on the processor")]
    Gpu(#[from] GpuError),
}

/// Where to train.
#[derive(Clone, Debug, Default)]
pub struct Device {
    #[cfg(feature = "gpu")]
    gpu: Option<Gpu>,
    /// Whether a training goes on on the processor if the GPU fails.
    pub falls_back: bool,
}

#[cfg(feature = "gpu")]
impl Device {
    /// Opens a device.
    ///
    /// # Errors
    /// [`DeviceError::Gpu`] where there is none.
    pub fn open(name: DeviceName, falls_back: bool) -> Result<Self, DeviceError> {
        let gpu = match name {
            DeviceName::Cpu => None,
            DeviceName::Gpu => Some(Gpu::open(Adapters::Gpus)?),
            DeviceName::Software => Some(Gpu::open(Adapters::SoftwareToo)?),
        };
        Ok(Self { gpu, falls_back })
    }

    /// The device as a setting: null is the processor.
    pub(super) fn setting(&self) -> Value {
        json!(self.gpu.as_ref().map(|_| "gpu"))
    }

    /// Name of the GPU.
    pub(super) fn name(&self) -> Option<&str> {
        self.gpu.as_ref().map(Gpu::name)
    }

    /// What runs the steps; `None` is the processor.
    pub(super) fn trainer(&self) -> Result<Option<Box<dyn TrainingDevice>>, StageError> {
        let Some(gpu) = &self.gpu else {
            return Ok(None);
        };
        Ok(Some(Box::new(GpuTrainer::new(gpu)?)))
    }
}

#[cfg(not(feature = "gpu"))]
impl Device {
    /// Succeeds only for the processor.
    ///
    /// # Errors
    /// [`DeviceError::NotBuilt`].
    pub fn open(name: DeviceName, falls_back: bool) -> Result<Self, DeviceError> {
        match name {
            DeviceName::Cpu => Ok(Self { falls_back }),
            DeviceName::Gpu | DeviceName::Software => Err(DeviceError::NotBuilt),
        }
    }

    /// Null.
    pub(super) fn setting(&self) -> Value {
        json!(null)
    }

    /// None.
    pub(super) fn name(&self) -> Option<&str> {
        None
    }

    /// The processor.
    pub(super) fn trainer(&self) -> Result<Option<Box<dyn TrainingDevice>>, StageError> {
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_always_there() {
        let device = Device::open(DeviceName::Cpu, false).expect("the processor");
        assert!(device.name().is_none() && device.setting().is_null());
        assert!(device.trainer().expect("the processor").is_none());
    }

    /// Without the feature an error that names it; with it a device, or an error with the
    /// option for none.
    #[test]
    fn a_gpu_is_there_or_named_in_the_error() {
        for name in [DeviceName::Gpu, DeviceName::Software] {
            match Device::open(name, false) {
                Ok(device) => assert!(cfg!(feature = "gpu") && device.name().is_some()),
                Err(error) => {
                    let said = error.to_string();
                    let without = said.ends_with("`--features gpu`");
                    let with = said.ends_with("`--device cpu` trains on the processor");
                    assert!(if cfg!(feature = "gpu") { with } else { without }, "{said}");
                }
            }
        }
    }
}
