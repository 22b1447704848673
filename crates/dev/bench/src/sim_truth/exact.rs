//! Depth images of scenes whose surfaces are known exactly, on the walk and beside it.
//!
//! Cameras are those of the walk, moved in the horizontal plane and rotated about the vertical axis
//! (PAWS-Sim's offsets end at 3 m and 30 degrees). Views with a surface nearer than half a metre,
//! as in an obstacle, are left out. What is compared are Gaussians of 1.5 cm distance: the renderer
//! and the lenses, not a reconstruction.

use std::f64::consts::TAU;
use std::sync::Arc;

use anyhow::{Result, ensure};
use camera_models::{CameraModel, Distortion};
use rayon::prelude::*;
use serde_json::{Value, json};
use simulation::testing::{DepthErrors, SyntheticScene, offset_pose};
use simulation::{
    CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, Quality, ResidencyConfig,
};

use crate::meter::quantile;

const SPACING_M: f64 = 0.015;
/// Size and intrinsics of the images.
const SIZE: (u32, u32) = (768, 576);
const INTRINSICS: [f64; 4] = [416.0, 424.0, 377.9, 293.1];
const OFFSETS_M: [f64; 5] = [0.0, 0.1, 0.3, 1.0, 3.0];
/// Rotations of the views of an offset, one after the other, degrees.
const YAWS_DEG: [f64; 5] = [0.0, 10.0, -10.0, 30.0, -30.0];
/// Directions of an offset, and cameras of the walk that are moved.
const DIRECTIONS: usize = 10;
const CAMERAS: usize = 3;
/// Nothing is nearer to a camera, m.
const CLEARANCE_M: f64 = 0.5;
/// Farthest surfaces that are compared, m.
const TO_M: f64 = 5.0;
/// Goals of the median and of the 95th percentile, m.
pub(super) const GOALS_M: [f64; 2] = [0.01, 0.03];

/// Lenses of all kinds, with a field of view as that of the rig.
fn lenses() -> [Distortion; 4] {
    [
        Distortion::None,
        Distortion::RadTan5 {
            k1: -0.12,
            k2: 0.02,
            p1: 1e-3,
            p2: -5e-4,
            k3: 0.0,
        },
        Distortion::KannalaBrandt4 {
            k1: 0.02,
            k2: -0.01,
            k3: 0.0,
            k4: 0.0,
        },
        Distortion::DoubleSphere {
            xi: -0.1,
            alpha: 0.5,
        },
    ]
}

/// # Errors
/// None that a scene of this program has.
pub(super) fn measure(quick: bool) -> Result<Vec<Value>> {
    let scenes = [
        SyntheticScene::stairs()?,
        SyntheticScene::kerb(0.12)?,
        SyntheticScene::room()?,
    ];
    let mut rows = Vec::new();
    for scene in &scenes[..if quick { 1 } else { scenes.len() }] {
        let gaussians = scene.with_spacing(SPACING_M)?;
        let store = Arc::new(GaussianStore::new(gaussians, ResidencyConfig::default()));
        for distortion in lenses() {
            // Other lenses take the tiles of the exact renderer with both.
            let qualities = match distortion {
                Distortion::None => &[Quality::Exact, Quality::Detail][..],
                _ => &[Quality::Exact],
            };
            for quality in qualities {
                let mut config = CameraConfig::new(CameraModel::new(SIZE, INTRINSICS, distortion))?;
                config.quality = *quality;
                let batch = CameraBatch::new(store.clone(), config)?;
                for offset_m in OFFSETS_M {
                    let mut row = of_offset(scene, &batch, offset_m, quick)?;
                    row["scene"] = scene.scene.name.clone().into();
                    row["lens"] = match distortion {
                        Distortion::None => "pinhole".into(),
                        _ => distortion.name().into(),
                    };
                    row["quality"] = match quality {
                        Quality::Exact => "exact".into(),
                        Quality::Detail => "detail".into(),
                    };
                    println!("  {row}");
                    rows.push(row);
                }
            }
        }
    }
    Ok(rows)
}

fn of_offset(
    scene: &SyntheticScene,
    batch: &CameraBatch,
    offset_m: f64,
    quick: bool,
) -> Result<Value> {
    let references = &scene.scene.sectors[0].references;
    let every = references.len().div_ceil(if quick { 1 } else { CAMERAS });
    let mut requests = Vec::new();
    for (number, pose) in references.iter().step_by(every.max(1)).enumerate() {
        // Without an offset only rotations differ.
        let directions = if offset_m == 0.0 {
            YAWS_DEG.len()
        } else {
            DIRECTIONS
        };
        for direction in 0..directions {
            let along_rad = TAU * direction as f64 / DIRECTIONS as f64;
            let yaw_deg = YAWS_DEG[(direction + number) % YAWS_DEG.len()];
            let pose = offset_pose(pose, offset_m, along_rad, yaw_deg.to_radians())?;
            requests.push(FrameRequest::new(0, pose));
        }
    }
    let depths: Result<Vec<DepthErrors>> = requests
        .par_iter()
        .map(|request| {
            let mut frames = Frames::default();
            batch.render(&[*request], &mut frames)?;
            let (model, truth) = (&batch.config().model, &scene.surfaces[0]);
            Ok(DepthErrors::new(&frames, request, model, truth, TO_M))
        })
        .collect();
    let (mut errors_m, mut missing, mut views) = (Vec::new(), 0, 0);
    for own in depths?
        .into_iter()
        .filter(|own| own.nearest_m >= CLEARANCE_M)
    {
        views += 1;
        missing += own.missing;
        errors_m.extend(own.errors_m);
    }
    ensure!(!errors_m.is_empty(), "no surface at {offset_m} m");
    errors_m.sort_by(f64::total_cmp);
    let [median, p95] = [0.5, 0.95].map(|share| 1e3 * quantile(&errors_m, share));
    Ok(json!({
        "offset_m": offset_m,
        "views": views,
        "views_tried": requests.len(),
        "pixels": errors_m.len(),
        "no_depth_share": missing as f64 / (missing + errors_m.len()) as f64,
        "median_mm": median,
        "p95_mm": p95,
        "goals_mm": GOALS_M.map(|goal| 1e3 * goal),
    }))
}
