//! Properties of known devices that sessions do not contain.

use camera_models::ImuNoise;
use session_archive::manifest;

use crate::pipeline::Report;

/// Noise of an unknown IMU: worse than that of any part sold for this purpose, so that its
/// measurements are not weighted too much.
pub(super) const UNKNOWN_NOISE: ImuNoise = ImuNoise {
    gyro_noise_density: 5e-4,
    gyro_random_walk: 2e-5,
    accel_noise_density: 5e-3,
    accel_random_walk: 5e-4,
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
    noise: Option<ImuNoise>,
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
            noise: Some(ZED_NOISE),
            range: Some(ZED_RANGE),
        },
        false => KnownImu {
            noise: None,
            range: None,
        },
    }
}

impl KnownImu {
    /// Its noise, with a note on the source.
    pub(super) fn noise(&self, name: &str, report: &mut Report) -> ImuNoise {
        let (noise, of) = match self.noise {
            Some(noise) => (noise, "that of data sheets of parts in ZED cameras"),
            None => (UNKNOWN_NOISE, "a large one for an unknown device"),
        };
        report
            .notes
            .push(format!("IMU {name}: its noise is assumed to be {of}"));
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
