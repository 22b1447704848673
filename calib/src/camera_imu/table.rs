//! Nominal and estimated values in rows.

use anyhow::Result;
use cad_transforms::so3;
use calib::camera_imu::{CameraImu, Verdict};
use console_output::Console;

use super::result::CameraResult;

/// One quantity, in a readable unit.
pub(super) struct Row {
    pub(crate) name: String,
    pub(crate) unit: &'static str,
    pub(crate) nominal: Option<f64>,
    pub(crate) found: f64,
    pub(crate) sigma: f64,
}

/// Three axes of a quantity; `scale` converts SI to the unit.
fn axes(
    name: &str,
    (unit, scale): (&'static str, f64),
    nominal: Option<[f64; 3]>,
    found: [f64; 3],
    sigma: [f64; 3],
) -> impl Iterator<Item = Row> {
    ["x", "y", "z"]
        .into_iter()
        .enumerate()
        .map(move |(k, axis)| Row {
            name: format!("{name} {axis}"),
            unit,
            nominal: nominal.map(|t| scale * t[k]),
            found: scale * found[k],
            sigma: scale * sigma[k],
        })
}

/// All quantities. A rotation is the one from nominal to estimate, about the axes of the left
/// camera; without a nominal value it is the rotation vector of `imu_from_left`.
pub(super) fn rows(result: &CameraResult, found: &CameraImu) -> Vec<Row> {
    let s = &found.sigmas;
    let nominal = result.nominal;
    let turn = match &nominal {
        Some(nominal) => nominal.rotation().inverse() * found.imu_from_left.rotation(),
        None => *found.imu_from_left.rotation(),
    };
    let degrees = 1.0_f64.to_degrees();
    let one = |name: &str, unit, nominal: f64, found: f64, sigma: f64| Row {
        name: name.to_owned(),
        unit,
        nominal: Some(nominal),
        found,
        sigma,
    };
    let mut rows: Vec<Row> = axes(
        "rotation about",
        ("deg", degrees),
        nominal.map(|_| [0.0; 3]),
        so3::log(&turn).into(),
        s.rotation_rad,
    )
    .collect();
    rows.extend(axes(
        "lever arm",
        ("mm", 1e3),
        nominal.map(|t| t.translation_m()),
        found.imu_from_left.translation_m(),
        s.translation_m,
    ));
    rows.extend([
        one(
            "time offset",
            "ms",
            0.0,
            1e3 * found.time_offset_s,
            1e3 * s.time_offset_s,
        ),
        one(
            "drift of the offset",
            "us/s",
            0.0,
            1e6 * found.time_drift,
            1e6 * s.time_drift,
        ),
        one(
            "board scale error",
            "%",
            0.0,
            100.0 * (found.board_scale - 1.0),
            100.0 * s.board_scale,
        ),
    ]);
    rows.extend(axes(
        "gyroscope bias",
        ("deg/s", degrees),
        None,
        found.gyro_bias,
        s.gyro_bias,
    ));
    rows.extend(axes(
        "accelerometer bias",
        ("m/s2", 1.0),
        None,
        found.accel_bias,
        s.accel_bias,
    ));
    // Its magnitude is known; only its direction is estimated.
    let across = s.gravity_rad[0].hypot(s.gravity_rad[1]) * calib::camera_imu::GRAVITY;
    rows.extend(axes(
        "gravity in target",
        ("m/s2", 1.0),
        None,
        found.gravity_in_target,
        [across; 3],
    ));
    rows
}

/// Prints the result of one camera.
pub(super) fn print(result: &CameraResult, console: &mut Console<'_>) -> Result<()> {
    let found = match &result.found {
        Ok(found) => found,
        Err(error) => {
            console.line(format!("{}: no result: {error:#}", result.camera))?;
            return Ok(());
        }
    };
    let [given, used, rejected] = found.views;
    console.line(format!(
        "{}: {}, {used} of {given} images with a pose, {rejected} of them left out",
        result.camera,
        found.verdict()
    ))?;
    console.line(format!(
        "  {:<22} {:>12} {:>12} {:>10}",
        "", "nominal", "estimate", "sigma"
    ))?;
    for row in rows(result, found) {
        let nominal = row.nominal.map_or("-".to_owned(), |t| format!("{t:.4}"));
        console.line(format!(
            "  {:<22} {nominal:>12} {:>12.4} {:>10.4} {}",
            row.name, row.found, row.sigma, row.unit
        ))?;
    }
    for gate in found.gates.iter().filter(|g| g.verdict != Verdict::Pass) {
        console.line(format!("  {}  {}: {}", gate.verdict, gate.name, gate.text))?;
    }
    Ok(())
}
