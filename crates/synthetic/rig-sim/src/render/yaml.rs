//! `sensor.yaml` files of an ASL folder. The body is the camera's IMU.

use cad_transforms::RigidTransform;
use camera_models::Distortion;

use super::RenderError;
use crate::camera::Shutter;
use crate::imu::Imu;
use crate::simulation::Simulation;

/// Description of an eye, 0 left, 1 right.
pub(super) fn camera(
    simulation: &Simulation,
    number: usize,
    eye: usize,
) -> Result<String, RenderError> {
    let camera = &simulation.cameras()[number];
    let (model, imu_from_eye) = simulation.nominal_eye(number, eye);
    let (name, coefficients) = match model.distortion {
        Distortion::None => ("none", Vec::new()),
        Distortion::Radial2 { k1, k2 } => ("radial-tangential", vec![k1, k2, 0.0, 0.0]),
        Distortion::RadTan4 { k1, k2, p1, p2 }
        | Distortion::RadTan5 {
            k1,
            k2,
            p1,
            p2,
            k3: 0.0,
        } => ("radial-tangential", vec![k1, k2, p1, p2]),
        Distortion::KannalaBrandt4 { k1, k2, k3, k4 } => ("equidistant", vec![k1, k2, k3, k4]),
        Distortion::RadTan5 { .. }
        | Distortion::Rational8 { .. }
        | Distortion::DoubleSphere { .. }
        | Distortion::Eucm { .. } => {
            let camera = camera.name.clone();
            return Err(RenderError::Lens { camera });
        }
    };
    let shutter = match camera.shutter {
        Shutter::Global => "global shutter".to_owned(),
        Shutter::Rolling { line_s } => {
            format!(
                "rolling shutter, {line_s} s from row to row; times are those of the middle row"
            )
        }
    };
    let mut text = head("camera", &camera.name, &shutter);
    text.push_str(&placed(&imu_from_eye));
    text.push_str(&format!(
        "rate_hz: {:?}\nresolution: [{}, {}]\ncamera_model: pinhole\n\
         intrinsics: {:?} # fu, fv, cu, cv\ndistortion_model: {name}\n\
         distortion_coefficients: {coefficients:?}\n",
        simulation.settings().rate_hz,
        model.width,
        model.height,
        [model.fx, model.fy, model.cx, model.cy],
    ));
    Ok(text)
}

/// Description of an IMU.
pub(super) fn imu(camera: &str, imu: &Imu) -> String {
    let model = imu.model();
    let mut text = head("imu", camera, "noise as simulated");
    text.push_str(&placed(&RigidTransform::identity()));
    let ([gyro, accel], [gyro_walk, accel_walk]) = (model.noise_density, model.random_walk);
    text.push_str(&format!(
        "rate_hz: {:?}\n\
         gyroscope_noise_density: {gyro:?} # rad/s/sqrt(Hz)\n\
         gyroscope_random_walk: {gyro_walk:?} # rad/s^2/sqrt(Hz)\n\
         accelerometer_noise_density: {accel:?} # m/s^2/sqrt(Hz)\n\
         accelerometer_random_walk: {accel_walk:?} # m/s^3/sqrt(Hz)\n",
        model.rate_hz
    ));
    text
}

/// Description of the true state.
pub(super) fn state(camera: &str) -> String {
    let mut text = head("visual-inertial", camera, "exact");
    text.push_str(&placed(&RigidTransform::identity()));
    text
}

/// Description of a ground-truth layer of an eye (0 left, 1 right).
pub(super) fn truth(camera: &str, eye: usize, layer: &str, meaning: &str) -> String {
    let side = ["left", "right"][eye];
    head(
        layer,
        camera,
        &format!("what the {side} eye sees: {meaning}"),
    )
}

fn head(kind: &str, camera: &str, comment: &str) -> String {
    format!("%YAML:1.0\nsensor_type: {kind}\ncomment: {camera}, simulated; {comment}\n")
}

fn placed(body_from_sensor: &RigidTransform) -> String {
    let r = body_from_sensor.rotation_rows();
    let t = body_from_sensor.translation_m();
    let row = |i: usize| {
        format!(
            "{:?}, {:?}, {:?}, {:?}",
            r[3 * i],
            r[3 * i + 1],
            r[3 * i + 2],
            t[i]
        )
    };
    format!(
        "T_BS: # takes points from the sensor to the body\n  cols: 4\n  rows: 4\n  \
         data: [{},\n         {},\n         {},\n         0.0, 0.0, 0.0, 1.0]\n",
        row(0),
        row(1),
        row(2)
    )
}
