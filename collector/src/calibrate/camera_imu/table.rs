//! What was told and what was found, in rows.

use anyhow::Result;
use calib::camera_imu::{CameraImu, Verdict};

use super::Measured;
use crate::console::Console;

/// One quantity: name, unit, told, found, sigma.
pub(super) struct Row {
    pub name: &'static str,
    pub unit: &'static str,
    pub told: Option<f64>,
    pub found: f64,
    pub sigma: f64,
}

/// All quantities. Rotations are those from the told one to the found one, about the axes of the left camera; with nothing told the rotation
/// vector of `imu_from_left`.
pub(super) fn rows(measured: &Measured, found: &CameraImu) -> Vec<Row> {
    let s = &found.sigmas;
    let told = measured.told;
    let turn = match &told {
        Some(told) => told.rotation().inverse() * found.imu_from_left.rotation(),
        None => *found.imu_from_left.rotation(),
    }
    .scaled_axis();
    let names = [
        ["rotation about x", "rotation about y", "rotation about z"],
        ["lever arm x", "lever arm y", "lever arm z"],
        ["gyroscope bias x", "gyroscope bias y", "gyroscope bias z"],
        [
            "accelerometer bias x",
            "accelerometer bias y",
            "accelerometer bias z",
        ],
        [
            "gravity in target x",
            "gravity in target y",
            "gravity in target z",
        ],
    ];
    let shift = found.imu_from_left.translation_m();
    let mut rows = Vec::new();
    for k in 0..3 {
        rows.push(Row {
            name: names[0][k],
            unit: "deg",
            told: told.map(|_| 0.0),
            found: turn[k].to_degrees(),
            sigma: s.rotation_rad[k].to_degrees(),
        });
    }
    for k in 0..3 {
        rows.push(Row {
            name: names[1][k],
            unit: "mm",
            told: told.map(|t| 1e3 * t.translation_m()[k]),
            found: 1e3 * shift[k],
            sigma: 1e3 * s.translation_m[k],
        });
    }
    rows.push(Row {
        name: "time offset",
        unit: "ms",
        told: Some(0.0),
        found: 1e3 * found.time_offset_s,
        sigma: 1e3 * s.time_offset_s,
    });
    rows.push(Row {
        name: "drift of the offset",
        unit: "us/s",
        told: Some(0.0),
        found: 1e6 * found.time_drift,
        sigma: 1e6 * s.time_drift,
    });
    rows.push(Row {
        name: "size of the board",
        unit: "of told",
        told: Some(1.0),
        found: found.board_scale,
        sigma: s.board_scale,
    });
    for k in 0..3 {
        rows.push(Row {
            name: names[2][k],
            unit: "deg/s",
            told: None,
            found: found.gyro_bias[k].to_degrees(),
            sigma: s.gyro_bias[k].to_degrees(),
        });
    }
    for k in 0..3 {
        rows.push(Row {
            name: names[3][k],
            unit: "m/s2",
            told: None,
            found: found.accel_bias[k],
            sigma: s.accel_bias[k],
        });
    }
    let across = s.gravity_rad[0].hypot(s.gravity_rad[1]);
    for k in 0..3 {
        rows.push(Row {
            name: names[4][k],
            unit: "m/s2",
            told: None,
            found: found.gravity_in_target[k],
            // Its length is known; only its direction is not.
            sigma: across * calib::camera_imu::GRAVITY,
        });
    }
    rows
}

/// Prints the result of one camera.
pub(super) fn print(measured: &Measured, console: &mut Console<'_>) -> Result<()> {
    let found = match &measured.found {
        Ok(found) => found,
        Err(error) => {
            console.line(format!("{}: no result: {error:#}", measured.camera))?;
            return Ok(());
        }
    };
    let [given, used, doubtful] = found.pictures;
    console.line(format!(
        "{}: {}, {used} of {given} pictures with a pose, {doubtful} of them left out",
        measured.camera,
        found.verdict()
    ))?;
    console.line(format!(
        "  {:<22} {:>12} {:>12} {:>10}",
        "", "told", "found", "sigma"
    ))?;
    for row in rows(measured, found) {
        let told = row.told.map_or("-".to_owned(), |t| format!("{t:.4}"));
        console.line(format!(
            "  {:<22} {told:>12} {:>12.4} {:>10.4} {}",
            row.name, row.found, row.sigma, row.unit
        ))?;
    }
    for gate in found.gates.iter().filter(|g| g.verdict != Verdict::Pass) {
        console.line(format!("  {}  {}: {}", gate.verdict, gate.name, gate.text))?;
    }
    Ok(())
}
