//! `sensor.yaml` files. Unknown values are left out with a comment.

use cad_transforms::RigidTransform;
use session_archive::manifest::{Camera, Imu};
use session_archive::record::CameraCalibration;

/// The description of one eye.
pub(super) fn camera(
    camera: &Camera,
    frame: &str,
    body: &str,
    calibration: Option<&CameraCalibration>,
    body_from_eye: Option<&RigidTransform>,
) -> String {
    let mut text = head("camera", frame, &camera.source, body);
    text.push_str(&placed(body_from_eye));
    let (width, height) = (camera.width / 2, camera.height);
    text.push_str(&format!(
        "rate_hz: {}\nresolution: [{width}, {height}]\ncamera_model: pinhole\n",
        camera.rate_hz
    ));
    let Some(c) = calibration.filter(|c| c.k.len() == 9) else {
        text.push_str("# The session holds no calibration of this camera.\n");
        return text;
    };
    let intrinsics = [c.k[0], c.k[4], c.k[2], c.k[5]];
    text.push_str(&format!(
        "intrinsics: {} # fu, fv, cu, cv\n",
        numbers(&intrinsics)
    ));
    match (c.distortion_model.as_str(), &c.d[..]) {
        ("", _) => text.push_str("distortion_model: none\n"),
        ("plumb_bob", [k1, k2, p1, p2, rest @ ..]) => {
            let k3 = rest.first().copied().unwrap_or(0.0);
            text.push_str("distortion_model: radial-tangential\n");
            let four = numbers(&[*k1, *k2, *p1, *p2]);
            text.push_str(&format!("distortion_coefficients: {four}\n"));
            if k3 != 0.0 {
                text.push_str(&format!(
                    "# This format does not support the third radial coefficient: k3 = {k3}\n"
                ));
            }
        }
        ("kannala_brandt", d) => {
            text.push_str("distortion_model: equidistant\n");
            text.push_str(&format!("distortion_coefficients: {}\n", numbers(d)));
        }
        (model, d) => {
            text.push_str(&format!("distortion_model: {model}\n"));
            text.push_str(&format!("distortion_coefficients: {}\n", numbers(d)));
        }
    }
    text
}

/// The description of an IMU.
pub(super) fn imu(imu: &Imu, body: &str, body_from_imu: Option<&RigidTransform>) -> String {
    let mut text = head("imu", &imu.name, &imu.source, body);
    text.push_str(&placed(body_from_imu));
    text.push_str(&format!("rate_hz: {}\n", imu.rate_hz));
    match imu.noise {
        None => text.push_str("# The session holds no noise densities of this IMU.\n"),
        Some(noise) => text.push_str(&format!(
            "gyroscope_noise_density: {:?} # rad/s/sqrt(Hz)\n\
             gyroscope_random_walk: {:?} # rad/s^2/sqrt(Hz)\n\
             accelerometer_noise_density: {:?} # m/s^2/sqrt(Hz)\n\
             accelerometer_random_walk: {:?} # m/s^3/sqrt(Hz)\n",
            noise.gyro_noise_density,
            noise.gyro_random_walk,
            noise.accel_noise_density,
            noise.accel_random_walk
        )),
    }
    text
}

fn head(kind: &str, frame: &str, source: &str, body: &str) -> String {
    let source = source.replace(['\n', '\r'], " ");
    format!("%YAML:1.0\nsensor_type: {kind}\ncomment: {frame} ({source}); body frame: {body}\n")
}

fn placed(body_from_sensor: Option<&RigidTransform>) -> String {
    let Some(transform) = body_from_sensor else {
        return "# The session has no extrinsics of this sensor.\n".to_owned();
    };
    let r = transform.rotation_rows();
    let t = transform.translation_m();
    let row = |i: usize| numbers(&[r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]]);
    let [a, b, c] = [0, 1, 2].map(|i| row(i).trim_matches(['[', ']']).to_owned());
    format!(
        "T_BS: # takes points from the sensor to the body\n  cols: 4\n  rows: 4\n  \
         data: [{a},\n         {b},\n         {c},\n         0.0, 0.0, 0.0, 1.0]\n"
    )
}

/// `[1.0, 0.5]`, every digit kept and always with a point.
fn numbers(values: &[f64]) -> String {
    format!("{values:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rotation of 90 degrees about z takes the x axis to the y axis. With another order of
    /// quaternion components it would be about another axis.
    #[test]
    fn stored_quaternion_becomes_the_correct_matrix() {
        let half = 0.5_f64.sqrt();
        let turn = RigidTransform::from_wxyz([half, 0.0, 0.0, half], [1.0, 2.0, 3.0]).unwrap();
        let text = placed(Some(&turn));
        let data = text.split_once("data: [").unwrap().1;
        let values: Vec<f64> = data
            .trim_end_matches("]\n")
            .split(',')
            .map(|v| v.trim().parse::<f64>().unwrap().round() + 0.0)
            .collect();
        #[rustfmt::skip]
        assert_eq!(values, [
            0.0, -1.0, 0.0, 1.0,
            1.0, 0.0, 0.0, 2.0,
            0.0, 0.0, 1.0, 3.0,
            0.0, 0.0, 0.0, 1.0,
        ]);
    }
}
