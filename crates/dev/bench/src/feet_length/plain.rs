//! Bundles without images: what the stages read, from the geometry of the simulator.
//!
//! - Poses are true.
//! - A tag is detected in each frame in which both eyes can show all of it and it is tilted by less
//!   than 75°, whether a leg hides it or not; its pose has the noise that its covariance states.
//! - Keyframes are selected as by the preset `fast`. Their depth is the true one of the
//!   rectified left image, with independent noise of 0.03 px of disparity; the wearer, and surfaces
//!   beyond 8 m, have no depth. There are no masks and no cloud.
//!
//! Bundles of several lengths have the same keyframes, as far as they go.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use cad_transforms::{Covariance, RigidTransform};
use camera_models::rectify::{Rectification, View};
use camera_models::{Eye, Lens};
use rayon::prelude::*;
use reconstruction::Input;
use reconstruction::pipeline::stages::rig::{self, RigOverrides};
use rig_sim::scene::surface::Class;
use scene_bundle::outputs::depth::{DepthImage, DepthKey, DepthView, DepthWriter};
use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetectionsWriter;
use scene_bundle::outputs::{
    self, CLOUD, DEPTH, KEYFRAMES, MASKS, RIG_REFINED, TAG_DETECTIONS, TRAJECTORY,
};
use scene_bundle::{Bundle, Pose, Provenance, Record, Scene, Trajectory};
use serde_json::json;

use super::detections::detections;
use super::walk::{self, Walk};
use crate::depth::frames::{inverse_depth, sample};

/// Columns and rows of one eye.
pub(super) const SIZE: [u32; 2] = [224, 126];
pub(super) const RATE_HZ: f64 = 15.0;
/// Spacing of keyframes.
const SPACING_M: f64 = 1.0;
const SPACING_DEG: f64 = 30.0;
const DISPARITY_SIGMA_PX: f64 = 0.03;
const MAX_DEPTH_M: f32 = 8.0;
const SEED: u64 = 91;
/// Depth maps in memory.
const BATCH: usize = 64;

/// A bundle of some length.
pub(super) struct PlainBundle {
    pub(super) minutes: u32,
    pub(super) path: PathBuf,
    pub(super) keyframes: usize,
    pub(super) detections: usize,
}

/// Writes a bundle for each length.
///
/// # Errors
/// The short session cannot be read, or a bundle cannot be written.
pub(super) fn write(
    walk: &Walk,
    session: &Path,
    lengths: &[u32],
    disk: &Path,
) -> Result<Vec<PlainBundle>> {
    let input = walk::open(session)?;
    let camera = Camera::new(walk, &input)?;
    let found = detections(walk, &camera.rig)?;
    let keyframes = camera.keyframes(walk)?;
    let mut bundles = Vec::new();
    for &minutes in lengths {
        let path = disk.join(format!("plain-{minutes}.scene"));
        let end_ns = 60_000_000_000 * i64::from(minutes);
        let bundle = new_bundle(walk, &input, &path, end_ns)?;
        let own = keyframes.partition_point(|key| key.time_ns < end_ns);
        let draft = bundle.begin(KEYFRAMES)?;
        outputs::keyframes::write(&draft, &keyframes[..own])?;
        draft.commit(record())?;
        let seen = found.partition_point(|own| own.time_ns < end_ns);
        let draft = bundle.begin(TAG_DETECTIONS)?;
        let mut writer = TagDetectionsWriter::new(&draft)?;
        found[..seen].iter().try_for_each(|own| writer.push(own))?;
        writer.finish()?;
        draft.commit(record())?;
        let draft = bundle.begin(CLOUD)?;
        outputs::cloud::write(&draft, &[])?;
        draft.commit(record())?;
        bundle.begin(MASKS)?.commit(record())?;
        bundles.push((
            PlainBundle {
                minutes,
                path,
                keyframes: own,
                detections: seen,
            },
            bundle,
        ));
    }
    camera.write_depth(walk, &keyframes, &bundles)?;
    Ok(bundles.into_iter().map(|(own, _)| own).collect())
}

/// A bundle with rig and true poses until a time.
///
/// # Errors
/// The session has no rig, or the bundle cannot be written.
pub(super) fn new_bundle(walk: &Walk, input: &Input, path: &Path, end_ns: i64) -> Result<Bundle> {
    let (model, _) = rig::model(input, &RigOverrides::default())?;
    let provenance = Provenance {
        session_id: input.handoff().session_id.clone(),
        handoff_blake3: input.handoff().seal.clone(),
        judgement: None,
        rig: rig::revision(input, &RigOverrides::default()),
        program: "bench".to_owned(),
        program_version: String::new(),
        started_civil_ns: 0,
        ended_civil_ns: None,
    };
    let bundle = Bundle::create_or_open(path, provenance)?;
    let draft = bundle.begin(RIG_REFINED)?;
    outputs::rig::write(&draft, &model)?;
    draft.commit(record())?;
    let covariance = Covariance::from_sigmas([0.003; 3], [0.001; 3])?;
    let pose = |time_ns: i64| {
        Ok(Pose {
            covariance: Some(covariance),
            velocity_in_world: Some(walk.velocity(time_ns)),
            ..Pose::new(time_ns, walk.world_from_rig(time_ns)?)
        })
    };
    let times = walk.frame_times().take_while(|time_ns| *time_ns < end_ns);
    let poses = times.map(pose).collect::<Result<Vec<Pose>>>()?;
    let draft = bundle.begin(TRAJECTORY)?;
    outputs::trajectory::write(&draft, &Trajectory::new(poses)?)?;
    draft.commit(record())?;
    Ok(bundle)
}

/// Copies an output into another bundle.
///
/// # Errors
/// It cannot be read or written.
pub(super) fn copy_output(name: &str, from: &Path, to: &Path) -> Result<()> {
    let from = Scene::open(from)?;
    let reader = from.output(name)?;
    let provenance = Scene::open(to)?.manifest().provenance.clone();
    let bundle = Bundle::create_or_open(to, provenance)?;
    let draft = bundle.begin(name)?;
    for file in reader.paths() {
        draft.write(file, &reader.read(file)?)?;
    }
    draft.commit(record())?;
    Ok(())
}

fn record() -> Record {
    Record {
        stage: "bench".to_owned(),
        stage_version: 1,
        settings: json!({}),
        inputs: BTreeMap::new(),
    }
}

/// The feet camera, rectified.
struct Camera {
    rig: RigModel,
    rectification: Rectification,
    view: DepthView,
}

impl Camera {
    fn new(walk: &Walk, input: &Input) -> Result<Self> {
        let (rig, _) = rig::model(input, &RigOverrides::default())?;
        ensure!(rig.cameras.len() == 1, "a rig of the feet camera alone");
        let rectification = Rectification::new(&walk.simulation.calibration(0), View::Filled)?;
        let view = DepthView {
            camera: rig.cameras[0].name.clone(),
            model: rectification.camera,
            view_from_left: rectification.rectified_from_left,
        };
        Ok(Self {
            rig,
            rectification,
            view,
        })
    }

    fn keyframes(&self, walk: &Walk) -> Result<Vec<Keyframe>> {
        let rig_from_left = self.rig.cameras[0].rig_from_left;
        let mut last: Option<RigidTransform> = None;
        let mut found = Vec::new();
        for (frame, time_ns) in (0..).zip(walk.frame_times()) {
            let now = walk.world_from_rig(time_ns)?;
            let is_near = last.is_some_and(|last| {
                let motion = last.inverse() * now;
                motion.distance_m() < SPACING_M && motion.angle_rad().to_degrees() < SPACING_DEG
            });
            if is_near {
                continue;
            }
            last = Some(now);
            found.push(Keyframe {
                set: frame,
                frame,
                time_ns,
                camera: 0,
                world_from_left: now * rig_from_left,
            });
        }
        Ok(found)
    }

    /// Writes the depth maps of all bundles; each is computed once.
    fn write_depth(
        &self,
        walk: &Walk,
        keyframes: &[Keyframe],
        bundles: &[(PlainBundle, Bundle)],
    ) -> Result<()> {
        let drafts = bundles.iter().map(|(_, bundle)| bundle.begin(DEPTH));
        let drafts = drafts.collect::<Result<Vec<_>, _>>()?;
        let writers = drafts
            .iter()
            .map(|draft| DepthWriter::new(draft, vec![self.view.clone()]));
        let writers = writers.collect::<Result<Vec<_>, _>>()?;
        let numbers: Vec<usize> = (0..keyframes.len()).collect();
        numbers.par_chunks(BATCH).try_for_each(|batch| {
            let mut truth = walk.simulation.ground_truth(0);
            batch.iter().try_for_each(|&number| {
                let keyframe = &keyframes[number];
                let seen = truth.render(0, keyframe.time_ns);
                let image = self.depth(&seen, keyframe.frame)?;
                let key = DepthKey {
                    view: 0,
                    time_ns: keyframe.time_ns,
                    frame: keyframe.frame,
                    set: keyframe.set,
                };
                let mut own = bundles.iter().zip(&writers);
                own.try_for_each(|((bundle, _), writer)| match number < bundle.keyframes {
                    true => writer.write(key, &image).context("writing a depth map"),
                    false => Ok(()),
                })
            })
        })?;
        for writer in writers {
            writer.finish()?;
        }
        for draft in drafts {
            draft.commit(record())?;
        }
        Ok(())
    }

    fn depth(&self, seen: &rig_sim::camera::truth::Truth, frame: u64) -> Result<DepthImage> {
        let recorded = &self.rig.cameras[0].left;
        let width = recorded.width as usize;
        let lens = Lens::new(recorded);
        let inverse = inverse_depth(seen, &lens, &self.view.view_from_left, width);
        let map = self.rectification.map(Eye::Left);
        let model = &self.view.model;
        let focal_baseline = model.fx * self.rectification.baseline_m;
        let pixels = (0..).zip(map.x.iter().zip(&map.y)).map(|(pixel, (x, y))| {
            let depth = 1.0 / sample(&inverse, width, *x, *y);
            let nearest = [x.round(), y.round()];
            let is_inside = nearest.iter().all(|v| *v >= 0.0);
            let place = nearest[1] as usize * width + nearest[0] as usize;
            let class = seen.class.get(place).filter(|_| is_inside);
            let is_known = depth > 0.0 && depth < MAX_DEPTH_M;
            if !is_known || class.is_none_or(|class| *class == Class::Person) {
                return (f32::NAN, f32::NAN);
            }
            let z = f64::from(depth);
            let sigma = z * z * DISPARITY_SIGMA_PX / focal_baseline;
            let noise = counter_random::bell(SEED, frame, pixel);
            ((z + sigma * noise) as f32, sigma as f32)
        });
        let (depth_m, sigma_m): (Vec<f32>, Vec<f32>) = pixels.unzip();
        Ok(DepthImage::from_metres(
            model.width,
            model.height,
            &depth_m,
            &sigma_m,
        ))
    }
}
