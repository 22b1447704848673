//! Properties of known devices that sessions do not contain.

use camera_models::ImuNoise;
use session_archive::manifest;

use crate::pipeline::Report;

/// Noise of an unknown IMU: above that of consumer parts, so that its measurements are not weighted
/// too much. White noise is about twice the largest of their data sheets: gyroscope 0.03 °/s/√Hz
/// (5.2e-4 rad/s/√Hz; InvenSense ITG-3200, ST L3GD20), accelerometer 400 µg/√Hz (3.9e-3 m/s²/√Hz;
/// InvenSense MPU-6050). Data sheets do not state random walks: these are three to five times
/// those of EuRoC's ADIS16448 (1.9e-5 rad/s²/√Hz and 3e-3 m/s³/√Hz, its `sensor.yaml`).
pub(super) const UNKNOWN_NOISE: ImuNoise = ImuNoise {
    gyro_noise_density: 1e-3,
    gyro_random_walk: 1e-4,
    accel_noise_density: 1e-2,
    accel_random_walk: 1e-2,
};
/// Its rate, Hz.
pub(super) const UNKNOWN_RATE_HZ: f64 = 200.0;

/// Data-sheet noise of the parts in ZED cameras, as in the simulated rig.
const ZED_NOISE: ImuNoise = ImuNoise {
    gyro_noise_density: 1.2e-4,
    gyro_random_walk: 2e-6,
    accel_noise_density: 1.6e-3,
    accel_random_walk: 3e-5,
};
/// rad/s and m/s²: 1000 deg/s and 8 g of 9.8189 m/s² (zed-open-capture).
const ZED_RANGE: [f64; 2] = [1000.0 * std::f64::consts::PI / 180.0, 8.0 * 9.8189];
/// A ZED Mini reads the 376 rows of its fastest mode in the time of one frame of it, 1/100 s, less
/// a pause: as in the simulated rig, never compared with a device. Rows, s.
const ZED_MINI_READOUT: (u32, f64) = (376, 0.0085);

/// Known properties of an IMU.
pub(super) struct KnownImu {
    data_sheet_noise: Option<ImuNoise>,
    /// rad/s and m/s².
    pub(super) range: Option<[f64; 2]>,
}

/// Letters and digits of a name, in lower case.
fn plain(name: &str) -> String {
    let kept = name.chars().filter(char::is_ascii_alphanumeric);
    kept.map(|c| c.to_ascii_lowercase()).collect()
}

/// The IMU in a camera of this model. `source` is what delivered its samples.
pub(super) fn imu(model: Option<&str>, source: &str) -> KnownImu {
    let named = [model.unwrap_or_default(), source].map(plain);
    let is_zed = named.iter().any(|name| name.starts_with("zed"));
    match is_zed {
        true => KnownImu {
            data_sheet_noise: Some(ZED_NOISE),
            range: Some(ZED_RANGE),
        },
        false => KnownImu {
            data_sheet_noise: None,
            range: None,
        },
    }
}

impl KnownImu {
    /// The noise of an IMU, with a note on its source: that of the calibration in force when the
    /// session was recorded, or else of its data sheet, or else [`UNKNOWN_NOISE`].
    pub(super) fn noise(&self, imu: &manifest::Imu, report: &mut Report) -> ImuNoise {
        let recorded = imu.noise.map(|noise| ImuNoise {
            gyro_noise_density: noise.gyro_noise_density,
            gyro_random_walk: noise.gyro_random_walk,
            accel_noise_density: noise.accel_noise_density,
            accel_random_walk: noise.accel_random_walk,
        });
        let is_valid = |noise: &ImuNoise| {
            let ImuNoise {
                gyro_noise_density,
                gyro_random_walk,
                accel_noise_density,
                accel_random_walk,
            } = *noise;
            [
                gyro_noise_density,
                gyro_random_walk,
                accel_noise_density,
                accel_random_walk,
            ]
            .iter()
            .all(|density| density.is_finite() && *density > 0.0)
        };
        let (noise, source) = match (recorded.filter(is_valid), self.data_sheet_noise) {
            (Some(noise), _) => (noise, "that of the recorded calibration"),
            (None, Some(noise)) => (
                noise,
                "assumed to be that of data sheets of parts in ZED cameras",
            ),
            (None, None) => (
                UNKNOWN_NOISE,
                "not known, and assumed to be above that of consumer parts",
            ),
        };
        let name = &imu.name;
        report
            .notes
            .push(format!("IMU {name}: its noise is {source}"));
        noise
    }
}

/// Readout line time of a camera of this model, s, with a note where it is assumed.
pub(super) fn line_s(model: Option<&str>, camera: &manifest::Camera, report: &mut Report) -> f64 {
    let name = &camera.name;
    let (rows, readout_s) = ZED_MINI_READOUT;
    match model.map(plain).as_deref() {
        // Global shutter (data sheet).
        Some("zedxmini" | "zedx") => 0.0,
        Some("zedmini") if camera.height == rows => {
            let line_s = readout_s / f64::from(rows);
            report.notes.push(format!(
                "camera {name}: readout line time {:.1} us, as assumed for a ZED Mini",
                1e6 * line_s
            ));
            line_s
        }
        _ => {
            let note = format!("camera {name}: a global shutter is assumed");
            report.notes.push(note);
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(source: &str, noise: Option<manifest::ImuNoise>) -> manifest::Imu {
        manifest::Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 200.0,
            tick: session_archive::time::TickLength::NANOSECOND,
            source: source.to_owned(),
            noise,
        }
    }

    /// EuRoC's ADIS16448.
    const RECORDED: manifest::ImuNoise = manifest::ImuNoise {
        gyro_noise_density: 1.6968e-4,
        gyro_random_walk: 1.9393e-5,
        accel_noise_density: 2e-3,
        accel_random_walk: 3e-3,
    };

    #[test]
    fn recorded_noise_precedes_data_sheet_and_default() {
        let noise = |source: &str, recorded| {
            let mut report = Report::default();
            let noise = imu(None, source).noise(&listed(source, recorded), &mut report);
            (noise, report.notes.concat())
        };
        for source in ["asl data set", "ZED Mini"] {
            let (found, note) = noise(source, Some(RECORDED));
            assert_eq!(found.gyro_noise_density, 1.6968e-4);
            assert_eq!(found.accel_random_walk, 3e-3);
            assert!(note.contains("recorded calibration"), "{note}");
        }
        assert_eq!(noise("ZED Mini", None).0, ZED_NOISE);
        let (unknown, note) = noise("asl data set", None);
        assert_eq!(unknown, UNKNOWN_NOISE);
        assert!(note.contains("not known"), "{note}");
        let zero = manifest::ImuNoise {
            accel_noise_density: 0.0,
            ..RECORDED
        };
        assert_eq!(noise("asl data set", Some(zero)).0, UNKNOWN_NOISE);
    }

    #[test]
    fn unknown_noise_is_above_that_of_consumer_parts() {
        let ImuNoise {
            gyro_noise_density,
            gyro_random_walk,
            accel_noise_density,
            accel_random_walk,
        } = UNKNOWN_NOISE;
        let dps = std::f64::consts::PI / 180.0;
        assert!(gyro_noise_density > 1.5 * 0.03 * dps);
        assert!(accel_noise_density > 1.5 * 400e-6 * 9.80665);
        assert!(gyro_random_walk > RECORDED.gyro_random_walk);
        assert!(accel_random_walk > RECORDED.accel_random_walk);
    }
}
