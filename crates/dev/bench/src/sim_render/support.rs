//! PSNR of views by their distance and angle from recorded ones, and its prediction.
//!
//! Samples of the scene itself are its held-out views, which lie on the path. Views away from it
//! have a ground truth only in the benchmark `splats`, one of each distance and angle per walk:
//! their losses against the held-out views of the same walk are predicted from the other walks.

use std::fs;
use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};
use simulation::{Deviation, SupportMap, SupportSample, support_samples};

use super::opened_scene::OpenedScene;

/// Mean absolute error that a prediction may have, dB.
const GOAL_DB: f64 = 1.5;
/// Fewest samples that a map is fitted to.
const MIN_SAMPLES: usize = 8;

pub(super) fn measure(scene: &OpenedScene, out: &Path) -> Result<Value> {
    let held_out = support_samples(&scene.scene.sectors[0])?;
    // Neighbors are the two eyes of an instant: groups of them alternate.
    let groups: Vec<Vec<SupportSample>> = held_out.chunks(2).map(<[_]>::to_vec).collect();
    Ok(json!({
        "goal_mae_db": GOAL_DB,
        "held_out": {
            "samples": held_out,
            "mae_db_of_map_and_mean": unseen_error(&groups)?,
        },
        "off_path": off_path(out)?,
    }))
}

/// Views away from the path of the walks of `splats.json`.
fn off_path(out: &Path) -> Result<Value> {
    let Ok(text) = fs::read_to_string(out.join("splats.json")) else {
        println!("  no splats.json in the output folder: without views away from the path");
        return Ok(Value::Null);
    };
    let report: Value = serde_json::from_str(&text)?;
    let rows = report["walks"]["rows"].as_array();
    let walks: Vec<(&Value, Vec<SupportSample>)> = rows
        .map_or(&[][..], Vec::as_slice)
        .iter()
        .map(|row| (row, relative_samples(row)))
        .filter(|(_, samples)| !samples.is_empty())
        .collect();
    let groups: Vec<Vec<SupportSample>> = walks.iter().map(|(_, own)| own.clone()).collect();
    let rows: Vec<Value> = walks
        .iter()
        .map(|(row, samples)| json!({ "walk": row["walk"], "samples": samples }))
        .collect();
    Ok(json!({ "walks": rows, "mae_db_of_map_and_mean": unseen_error(&groups)? }))
}

/// PSNR of the views of a walk minus that of its held-out instants, dB.
fn relative_samples(row: &Value) -> Vec<SupportSample> {
    let views = row["off_path"].as_array().map_or(&[][..], Vec::as_slice);
    let sample = |view: &Value| {
        Some(SupportSample {
            distance_m: view["offset_m"].as_f64()?,
            angle_rad: view["angle_deg"].as_f64()?.to_radians(),
            psnr_db: view["psnr_db"].as_f64()? - row["instants"]["psnr_db"].as_f64()?,
        })
    };
    views.iter().filter_map(sample).collect()
}

/// Mean absolute errors on each group of a map that was fitted to all others and of their mean, dB;
/// none for fewer samples than a map needs.
fn unseen_error(groups: &[Vec<SupportSample>]) -> Result<Option<[f64; 2]>> {
    let (mut sums, mut count) = ([0.0; 2], 0);
    for (number, group) in groups.iter().enumerate() {
        let others = groups
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != number);
        let others: Vec<SupportSample> = others.flat_map(|(_, group)| group.clone()).collect();
        if others.len() < MIN_SAMPLES {
            return Ok(None);
        }
        let map = SupportMap::fit(&others)?;
        let mean_db = others.iter().map(|other| other.psnr_db).sum::<f64>() / others.len() as f64;
        for sample in group {
            let deviation = Deviation {
                distance_m: sample.distance_m,
                angle_rad: sample.angle_rad,
                index: 0,
            };
            let predicted = [map.support_db(&deviation), mean_db];
            for (sum, predicted_db) in sums.iter_mut().zip(predicted) {
                *sum += (predicted_db - sample.psnr_db).abs();
            }
            count += 1;
        }
    }
    Ok((count > 0).then(|| sums.map(|sum| sum / f64::from(count))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_is_predicted_from_the_others_alone() {
        let sample = |distance_m: f64, psnr_db: f64| SupportSample {
            distance_m,
            angle_rad: 0.0,
            psnr_db,
        };
        let of_level = |level: f64| -> Vec<SupportSample> {
            (0..8)
                .map(|i| sample(f64::from(i), level - f64::from(i)))
                .collect()
        };
        let equal = [of_level(30.0), of_level(30.0)];
        let [map, mean] = unseen_error(&equal).unwrap().unwrap();
        assert!(map < 0.01 && (mean - 2.0).abs() < 0.01);
        let unequal = [of_level(30.0), of_level(26.0)];
        let [map, _] = unseen_error(&unequal).unwrap().unwrap();
        assert!((map - 4.0).abs() < 0.01);
        assert_eq!(unseen_error(&equal[..1]).unwrap(), None);
    }

    #[test]
    fn views_are_compared_with_held_out_ones_of_their_walk() {
        let row = json!({
            "instants": { "psnr_db": 21.0 },
            "off_path": [{ "offset_m": 3.0, "angle_deg": 180.0, "psnr_db": 17.5 }],
        });
        let samples = relative_samples(&row);
        assert_eq!(samples.len(), 1);
        assert_eq!((samples[0].distance_m, samples[0].psnr_db), (3.0, -3.5));
        assert_eq!(samples[0].angle_rad, std::f64::consts::PI);
    }
}
