//! What the hub knows of cameras and IMUs before their first samples.

use video::EncoderSettings;

use crate::sources::{ImuInfo, TimestampRelation};
use crate::sync::clock::ClockConfig;

/// Description of a camera for the hub.
#[derive(Clone, Debug)]
pub struct CameraSetup {
    /// Its name.
    pub name: String,
    /// Trigger group: cameras with the same one expose simultaneously; `None` is free-running.
    pub trigger: Option<String>,
    /// Nominal rate.
    pub rate_hz: f64,
    /// Its device clock.
    pub clock: ClockConfig,
    /// Width of its frame counter in bits, if it wraps.
    pub number_bits: Option<u8>,
    /// An image that does not change is no fault.
    pub still: bool,
    /// Properties of its host timestamps, if its frames carry them.
    pub stamped: Option<TimestampRelation>,
    /// Encoder settings.
    pub encoder: EncoderSettings,
    /// Its IMU.
    pub imu: Option<ImuSetup>,
}

/// Description of an IMU for the hub.
#[derive(Clone, Debug)]
pub struct ImuSetup {
    /// Its name, as in `feet/imu`.
    pub name: String,
    /// Rate and scales.
    pub info: ImuInfo,
    /// Its device clock.
    pub clock: ClockConfig,
    /// Width of its sample counter in bits, if it wraps.
    pub number_bits: Option<u8>,
}
