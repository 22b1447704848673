//! Content of a bundle, as text and as JSON.

use std::collections::BTreeMap;
use std::fmt::Write;

use anyhow::{Context, Result};
use cad_transforms::rig::Foot;
use chrono::{DateTime, SecondsFormat};
use scene_bundle::outputs::feet::FootStatus;
use scene_bundle::outputs::{
    self, cloud, contacts, depth, feet, keyframes, rig, splats, tag_detections, trajectory,
};
use scene_bundle::{BundleError, Scene, Status, Trajectory};
use serde_json::{Value, json};

mod ground;

/// Content of a bundle.
pub(crate) struct BundleSummary<'a> {
    scene: &'a Scene,
    /// Key figures of each output, as JSON; none for outputs that only later versions know.
    facts: BTreeMap<&'a str, Value>,
    /// Errors of outputs that could not be read.
    pub(crate) problems: Vec<String>,
}

impl<'a> BundleSummary<'a> {
    pub(crate) fn of(scene: &'a Scene) -> Self {
        let (mut facts, mut problems) = (BTreeMap::new(), Vec::new());
        for name in scene.manifest().outputs.keys() {
            match facts_of(scene, name) {
                Ok(Value::Null) => {}
                Ok(found) => {
                    facts.insert(name.as_str(), found);
                }
                Err(error) => problems.push(format!("{:#}", anyhow::Error::from(error))),
            }
        }
        Self {
            scene,
            facts,
            problems,
        }
    }

    pub(crate) fn json(&self) -> Result<String> {
        let manifest =
            serde_json::to_value(self.scene.manifest()).context("writing the manifest as JSON")?;
        let summary = json!({ "manifest": manifest, "facts": self.facts, "outdated": self.scene.manifest().outdated(), "problems": self.problems });
        Ok(format!("{summary:#}\n"))
    }

    pub(crate) fn text(&self) -> String {
        let manifest = self.scene.manifest();
        let from = &manifest.provenance;
        let mut text = String::new();
        let mut line = |name: &str, what: String| {
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}", format!("{name:18} {what}").trim_end());
        };
        line("bundle", self.scene.path().display().to_string());
        line("session", from.session_id.clone());
        line("hand-off", from.handoff_blake3.clone());
        let unknown = || "not known: the bundle does not say".to_owned();
        let judged = from.judgement.as_ref();
        line(
            "verdict",
            judged.map_or_else(unknown, |judged| judged.in_short(civil)),
        );
        for beyond in judged.iter().flat_map(|judged| &judged.acceptance) {
            for metric in &beyond.metrics {
                line("", format!("{}  {}", metric.verdict, metric.text));
            }
        }
        line(
            "rig",
            format!("{}, revision {}", from.rig.name, from.rig.revision),
        );
        line(
            "made by",
            format!("{} {}", from.program, from.program_version),
        );
        let ended = from
            .ended_civil_ns
            .map_or_else(|| "not finished".to_owned(), civil);
        line(
            "begun, ended",
            format!("{}, {ended}", civil(from.started_civil_ns)),
        );
        let outdated = manifest.outdated();
        for (name, output) in &manifest.outputs {
            let (files, bytes) = size(self.scene, name);
            let short = output.hash.get(..16).unwrap_or_default();
            line("", String::new());
            line(
                name,
                format!(
                    "{} {}, {files} files, {bytes} bytes, {short}",
                    output.stage, output.stage_version
                ),
            );
            if let Some(input) = outdated.get(name.as_str()) {
                line("", format!("out of date: {input} was recomputed since"));
            }
            match self.facts.get(name.as_str()) {
                Some(Value::Object(facts)) => {
                    for (key, value) in facts {
                        let value = value
                            .as_str()
                            .map_or_else(|| value.to_string(), str::to_owned);
                        line("", format!("{}: {value}", key.replace('_', " ")));
                    }
                }
                _ => line("", "no further details of this output are known".to_owned()),
            }
        }
        let _ = writeln!(
            text,
            "\n{} outputs, {} problems",
            manifest.outputs.len(),
            self.problems.len()
        );
        text
    }
}

/// Number of files of an output, listed ones included, and their size on disk, bytes.
fn size(scene: &Scene, name: &str) -> (usize, u64) {
    let Ok(reader) = scene.output(name) else {
        return (0, 0);
    };
    let bytes = |path| std::fs::metadata(reader.file_path(path)).map_or(0, |m| m.len());
    (reader.paths().count(), reader.paths().map(bytes).sum())
}

fn facts_of(scene: &Scene, name: &str) -> Result<Value, BundleError> {
    let reader = scene.output(name)?;
    Ok(match name {
        outputs::RIG | outputs::RIG_REFINED => {
            let rig = rig::read(&reader)?;
            let cameras: Vec<&str> = rig.cameras.iter().map(|c| c.name.as_str()).collect();
            let imus: Vec<&str> = rig.imus.iter().map(|i| i.name.as_str()).collect();
            json!({ "cameras": cameras.join(", "), "imus": imus.join(", ") })
        }
        outputs::TRAJECTORY | outputs::TRAJECTORY_CAUSAL | outputs::TRAJECTORY_ODOM => {
            of_trajectory(&trajectory::read(&reader)?)
        }
        outputs::KEYFRAMES => {
            let mut of_camera: BTreeMap<u8, u64> = BTreeMap::new();
            let keyframes = keyframes::read(&reader)?;
            for keyframe in &keyframes {
                *of_camera.entry(keyframe.camera).or_default() += 1;
            }
            let counts: Vec<String> = of_camera.values().map(u64::to_string).collect();
            json!({ "keyframes": keyframes.len(), "by_camera": counts.join(", ") })
        }
        outputs::MASKS => {
            let masks = reader.paths().filter(|path| path.ends_with(".png"));
            json!({ "masks": masks.count() })
        }
        outputs::DEPTH => {
            let index = depth::read_index(&reader)?;
            let views = index
                .views
                .iter()
                .map(|v| format!("{} {}x{}", v.camera, v.model.width, v.model.height));
            json!({ "images": index.images.len(), "views": views.collect::<Vec<_>>().join(", ") })
        }
        outputs::TAG_DETECTIONS => {
            let mut of_foot: BTreeMap<Foot, u64> = BTreeMap::new();
            let detections = tag_detections::read(&reader)?;
            for detection in &detections {
                *of_foot.entry(detection.foot).or_default() += 1;
            }
            let counts = |foot: Foot| of_foot.get(&foot).copied().unwrap_or_default();
            json!({
                "detections": detections.len(),
                "left_foot": counts(Foot::Left),
                "right_foot": counts(Foot::Right),
            })
        }
        outputs::FEET => {
            let mut of_status: BTreeMap<FootStatus, u64> = BTreeMap::new();
            let poses = feet::read(&reader)?;
            for pose in &poses {
                *of_status.entry(pose.status).or_default() += 1;
            }
            let counts = of_status.iter();
            let counts = counts.map(|(status, count)| format!("{count} {}", status.name()));
            let statuses = counts.collect::<Vec<_>>().join(", ");
            json!({ "poses": poses.len(), "statuses": statuses })
        }
        outputs::CONTACTS => {
            let contacts = contacts::read(&reader)?;
            let left = contacts.iter().filter(|contact| contact.foot == Foot::Left);
            let left = left.count();
            json!({ "left_foot": left, "right_foot": contacts.len() - left })
        }
        outputs::TERRAIN => ground::of_terrain(&reader)?,
        outputs::MAPS => ground::of_maps(&reader)?,
        outputs::COLLISION => ground::of_collision(&reader)?,
        outputs::SPLATS => {
            let scene = splats::read(&reader)?;
            for number in 0..scene.sectors.len() {
                splats::read_sector(&reader, &scene, number)?;
            }
            splats::read_sky(&reader, &scene)?;
            let coverage = splats::read_coverage(&reader, &scene)?;
            let held_out = scene.held_out();
            let mut facts = json!({
                "gaussians": scene.count(),
                "sectors": scene.sectors.len(),
                "degree": scene.degree,
                "views": scene.views.len(),
                "steps": scene.training.steps,
                "coverage": coverage.is_some(),
                "held_out_psnr_db": held_out.map(|mean| (mean.psnr_db * 100.0).round() / 100.0),
                "held_out_ssim": held_out.map(|mean| (mean.ssim * 1e4).round() / 1e4),
            });
            if let Some(lpips) = held_out.and_then(|mean| mean.lpips) {
                facts["held_out_lpips"] = json!((lpips * 1e4).round() / 1e4);
            }
            facts
        }
        outputs::CLOUD => json!({ "points": cloud::read(&reader)?.len() }),
        _ => Value::Null,
    })
}

fn of_trajectory(trajectory: &Trajectory) -> Value {
    let mut by_status: BTreeMap<Status, usize> = BTreeMap::new();
    for pose in trajectory.poses() {
        *by_status.entry(pose.status).or_default() += 1;
    }
    let by_status: Vec<String> = by_status
        .iter()
        .map(|(status, count)| format!("{count} {}", status.name().replace('_', " ")))
        .collect();
    json!({
        "poses": trajectory.len(),
        "seconds": trajectory.duration_ns() as f64 * 1e-9,
        "path_length_m": (trajectory.path_length_m() * 1e3).round() / 1e3,
        "statuses": by_status.join(", "),
        "spans": trajectory.spans().len(),
    })
}

/// Civil time, ns since 1970, as RFC 3339 to the second.
fn civil(ns: i64) -> String {
    DateTime::from_timestamp_nanos(ns).to_rfc3339_opts(SecondsFormat::Secs, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn civil_times_are_those_of_the_calendar() {
        // As `date -u -d @SECONDS` prints them.
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (-1, "1969-12-31T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_795_233_797, "2026-11-21T04:03:17Z"),
        ] {
            assert_eq!(civil(seconds * 1_000_000_000 + 999_999_999), text);
        }
    }
}
