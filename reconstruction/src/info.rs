//! What `paws-reconstruct info` prints.

use std::fmt::Write;

use reconstruction::Input;
use session_archive::time::NS_PER_S;

/// A screen of text, each line ended.
pub(crate) fn text(input: &Input) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write(input, &mut out);
    out
}

fn write(input: &Input, out: &mut String) -> std::fmt::Result {
    let (manifest, handoff, index) = (input.manifest(), input.handoff(), input.index());
    writeln!(out, "session     {} {}", manifest.session_id, manifest.name)?;
    write!(
        out,
        "recorded    {} by {}",
        manifest.started_civil, manifest.software
    )?;
    match &manifest.stopped {
        Some(stop) => {
            let seconds = (stop.at - manifest.started) as f64 / NS_PER_S as f64;
            writeln!(out, ", {seconds:.1} s, ended by {}", stop.reason)?;
        }
        None => writeln!(out, ", cut off")?,
    }
    let files = || handoff.files.iter().chain(&handoff.derived);
    let bytes: u64 = files().map(|f| f.bytes).sum();
    writeln!(
        out,
        "handed over {} by {}: {}, {} files, {:.1} MB, every byte as sealed",
        handoff.sealed,
        handoff.software,
        handoff.verdict,
        files().count(),
        bytes as f64 / 1e6,
    )?;
    for (camera, entry) in manifest.cameras.iter().zip(&index.cameras) {
        let eyes = ["left", "right"].map(|eye| format!("{}/{eye}", camera.name));
        let calibrated = eyes.iter().all(|eye| input.calibration(eye).is_some());
        let keys = entry
            .frames
            .iter()
            .zip(0..)
            .filter(|(f, position)| f.key == *position);
        write!(
            out,
            "camera      {}: {} stereo frames of 2 x {}x{} {}, {} key frames, {} at {:.2} Hz, {}calibrated",
            camera.name,
            entry.frames.len(),
            camera.width / 2,
            camera.height,
            camera.colour,
            keys.count(),
            camera.codec,
            camera.rate_hz,
            if calibrated { "" } else { "not " },
        )?;
        match entry.undecodable {
            0 => writeln!(out)?,
            lost => writeln!(out, ", {lost} more frames without a key frame")?,
        }
    }
    for (imu, entry) in manifest.imus.iter().zip(&index.imus) {
        let samples: u64 = entry.batches.iter().map(|b| u64::from(b.samples)).sum();
        writeln!(
            out,
            "IMU         {}: {samples} samples at {:.2} Hz",
            imu.name, imu.rate_hz
        )?;
    }
    let full = index
        .sets
        .iter()
        .filter(|s| s.frames.iter().all(Option::is_some))
        .count();
    writeln!(
        out,
        "frame sets  {}, {full} of them with every camera",
        index.sets.len()
    )?;
    writeln!(out, "transforms  {}", input.transforms().len())
}
