//! The JSON document, and the origin of the numbers in one sentence.

use anyhow::Result;
use calib::allan::{Coefficient, Value};
use calib::imu_noise::{AXES, Axis, Severity};
use serde_json::{Value as Json, json};
use session_archive::manifest::Manifest;

use super::result::{DOCUMENT, ImuResult};
use super::table::summary;
use crate::software::SOFTWARE;

/// Version of the document; incremented when a key changes its meaning.
const VERSION: u32 = 1;

/// Origin of the numbers, for the header of other files.
pub(super) fn origin(manifest: &Manifest, imu: &ImuResult) -> String {
    format!(
        "Noise of {} ({}), by `paws calib imu` of {SOFTWARE}\nfrom session {} of {}: {}.\nUncertainties and curves: {DOCUMENT}.",
        imu.recording.name,
        imu.recording.source,
        manifest.session_id,
        manifest.started_civil,
        summary(imu)
    )
}

pub(super) fn json(manifest: &Manifest, all: &[ImuResult]) -> Result<Vec<u8>> {
    let document = json!({
        "format": "paws-imu-noise",
        "format_version": VERSION,
        "software": SOFTWARE,
        "session_id": manifest.session_id,
        "started_civil": manifest.started_civil.to_string(),
        "units": "SI, rad and s; N per square root of Hz, K per s and square root of Hz; sigma is one standard deviation",
        "imus": all.iter().map(one).collect::<Vec<Json>>(),
    });
    let mut bytes = serde_json::to_vec_pretty(&document)?;
    bytes.push(b'\n');
    Ok(bytes)
}

fn one(imu: &ImuResult) -> Json {
    let remarks = imu.found.findings.iter().map(|remark| {
        let weight = match remark.severity {
            Severity::Note => "note",
            Severity::Warn => "warn",
            Severity::Fail => "refusal",
        };
        json!({ "weight": weight, "kind": remark.kind, "text": remark.text })
    });
    json!({
        "config": imu.found.config,
        "name": imu.recording.name,
        "source": imu.recording.source,
        "samples": imu.recording.samples.len(),
        "rate_hz": imu.found.rate_hz,
        "used_s": imu.found.used_s,
        "refused": imu.found.is_rejected(),
        "remarks": remarks.collect::<Vec<Json>>(),
        "axes": imu.found.axes.iter().map(axis).collect::<Vec<Json>>(),
    })
}

fn axis(axis: &Axis) -> Json {
    let Some(fit) = &axis.fit else {
        return json!({ "axis": AXES[axis.index], "mean": axis.mean, "refused": true });
    };
    let value = |coefficient| match fit.value(coefficient) {
        Value::Known {
            value,
            sigma,
            interval,
        } => json!({ "value": value, "sigma": sigma, "interval_95": interval }),
        Value::Below(limit) => json!({ "below_95": limit }),
    };
    let points = fit.points.iter().zip(&axis.curve.points).map(|(p, c)| {
        json!({
            "tau_s": p.tau_s,
            "deviation": p.deviation,
            "interval_95": p.interval,
            "freedom": p.freedom,
            "terms": c.terms,
            "model": fit.deviation(p.tau_s),
        })
    });
    json!({
        "axis": AXES[axis.index],
        "mean": axis.mean,
        "quantisation": value(Coefficient::Quantisation),
        "white": value(Coefficient::White),
        "instability": value(Coefficient::Instability),
        "walk": value(Coefficient::Walk),
        "fitted_from_s": fit.from_s,
        "misfit": fit.misfit,
        "curve": points.collect::<Vec<Json>>(),
    })
}
