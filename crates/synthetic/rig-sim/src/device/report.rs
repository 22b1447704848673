//! The ZED Mini's input report: an IMU sample as its microcontroller sends it.
//!
//! 62 bytes of a read of 64, packed, little endian (Stereolabs' zed-open-capture,
//! `sensorcapture_def.hpp`): 0 kind of report, 1 whether the IMU is invalid, 2 ticks of 1/25600 s,
//! 10 gyro x y z, 16 accelerometer x y z, 22 whether a frame was exposed since the previous report,
//! 23 whether that flag is valid, 24 frame count, 28 temperature in 0.01 °C. Fields of larger
//! models only are 0, except for the temperatures at 58, which carry the value for "not valid".
//! Never compared with a real device.

use super::DeviceImu;

/// Length of a read.
pub const REPORT_BYTES: usize = 64;
/// Value of an invalid temperature, 0.01 °C.
const NO_TEMPERATURE: i16 = -27315;

impl DeviceImu {
    /// The report that carries the sample.
    pub fn report(&self) -> [u8; REPORT_BYTES] {
        let mut bytes = [0; REPORT_BYTES];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(2, &self.ticks.to_le_bytes());
        for (k, value) in self.gyro.iter().chain(&self.accel).enumerate() {
            put(10 + 2 * k, &value.to_le_bytes());
        }
        put(22, &[u8::from(self.frame_sync), 1]);
        put(24, &self.frame_sync_count.to_le_bytes());
        put(28, &self.temperature.to_le_bytes());
        put(58, &NO_TEMPERATURE.to_le_bytes());
        put(60, &NO_TEMPERATURE.to_le_bytes());
        bytes
    }
}
