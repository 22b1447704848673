//! Detections of shoe tags against the truth: recall, errors and their stated sigmas, time.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use boards::Dictionary;
use cad_transforms::RigidTransform;
use cad_transforms::rig::Rig;
use camera_models::Lens;
use feet::Config;
use feet::shoe::{Shoe, ShoeTag, Side as FootSide};
use feet::tag_tracker::{Camera, Detection, Frame, RigState, TagTracker};
use fiducials::{Motion, Tag};
use imaging::ImageView;
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use rig_sim::camera::{Quality, Shutter};
use rig_sim::scene::wearer::Part;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{FrameSource as _, Settings, Simulation, seconds};
use rig_sim::walker::{Phase, Side};
use serde::Serialize;

use super::gait;

const EXAMPLE_RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
/// Walks: scene, light, seed.
const WALKS: [(Kind, Lighting, u64); 6] = [
    (Kind::Pavement, Lighting::Day, 201),
    (Kind::Stairs, Lighting::Day, 202),
    (Kind::Trail, Lighting::LowSun, 203),
    (Kind::Corridor, Lighting::Flicker, 204),
    (Kind::Plaza, Lighting::Night, 205),
    (Kind::Room, Lighting::Day, 206),
];
const SECONDS: f64 = 10.0;
const RATE_HZ: f64 = 15.0;
const SIZE: [u32; 2] = [672, 376];

/// Errors of the sightings of one walk.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Row {
    walk: String,
    frames: usize,
    /// Tags that are whole and visible in both eyes, and those of them that were found.
    visible: usize,
    found: usize,
    /// The same while the foot is flat.
    visible_flat: usize,
    found_flat: usize,
    /// Detections of tags of which nothing is visible in either eye.
    invented: usize,
    /// Detections that are more than 5 cm wrong.
    wrong: usize,
    /// Root mean square errors while flat: of the tag in the plane and along its normal, mm, its
    /// tilt, degrees, and of the middle of the sole, mm.
    plane_mm: f64,
    normal_mm: f64,
    tilt_deg: f64,
    sole_mm: f64,
    /// 95th percentile of the error of the middle of the sole, mm.
    sole_p95_mm: f64,
    /// Mean squared error in stated sigmas, per dimension.
    nees: f64,
    /// Share of sightings within two and three sigmas (of six dimensions).
    within_three_sigmas: f64,
    /// Mean time per stereo frame, ms.
    ms: f64,
    /// Contacts and swings from these sightings.
    gait: gait::Row,
}

/// All walks.
pub(super) fn run(quick: bool) -> Result<Vec<Row>> {
    let walks = if quick { &WALKS[..1] } else { &WALKS[..] };
    let mut rows = Vec::new();
    for &(scene, light, seed) in walks {
        let row = walk(scene, light, seed)?;
        println!("{}", serde_json::to_string(&row)?);
        rows.push(row);
    }
    Ok(rows)
}

fn walk(scene: Kind, light: Lighting, seed: u64) -> Result<Row> {
    let rig = Rig::parse(EXAMPLE_RIG)?;
    let settings = Settings {
        kind: scene,
        lighting: light,
        seed,
        seconds: SECONDS,
        rate_hz: RATE_HZ,
        width: SIZE[0],
        height: SIZE[1],
        quality: Quality::ACCURATE,
    };
    let simulation = Arc::new(Simulation::new(&settings, &rig).context("preparing the walk")?);
    let position = (simulation.cameras().iter()).position(|camera| camera.name == "feet");
    let position = position.context("the rig has a camera of the feet")?;
    let calibration = simulation.calibration(position);
    let sim_camera = &simulation.cameras()[position];
    let camera = Camera {
        lenses: [Lens::new(&calibration.left), Lens::new(&calibration.right)],
        rig_from_eye: sim_camera.rig_from_eye,
        line_s: match sim_camera.shutter {
            Shutter::Global => 0.0,
            Shutter::Rolling { line_s } => line_s,
        },
    };
    let shoes = shoes(&simulation)?;
    let mut tracker = TagTracker::new(shoes.clone(), vec![camera], Config::default());
    let mut renderer = simulation.frames(position);
    let mut ground_truth = simulation.ground_truth(position);
    let mut row = Row {
        walk: format!("{} {} {seed}", scene.name(), light.name()),
        frames: settings.frame_count() as usize,
        ..Row::default()
    };
    let mut observed = [Vec::new(), Vec::new()];
    let (mut squares, mut nees, mut flat, mut soles, mut within) =
        (Vector6::<f64>::zeros(), 0.0, 0, Vec::new(), 0);
    for number in 0..settings.frame_count() {
        let time_ns = settings.frame_ns(number);
        let image = renderer.render_frame(number, time_ns);
        let grays = [image.gray(0), image.gray(1)];
        let [left, right] = [0, 1].map(|k: usize| {
            ImageView::packed(SIZE[0] as usize, SIZE[1] as usize, &grays[k]).expect("whole images")
        });
        let rig_state = simulation.walker().rig(seconds(time_ns));
        let world_from_rig = transform(&rig_state.position, &rig_state.rotation)?;
        let frame = Frame {
            camera: 0,
            time_ns,
            images: [left, right],
            exposure_s: f64::from(image.exposure.seconds),
            rig: Some(RigState {
                world_from_rig,
                motion: Motion {
                    linear: rig_state.velocity.into(),
                    angular: (rig_state.rotation * rig_state.angular_rate).into(),
                },
            }),
        };
        let begin = Instant::now();
        let sightings = tracker.add(&frame);
        row.ms += 1e3 * begin.elapsed().as_secs_f64() / row.frames as f64;
        let mut shares = vec![[0.0; 2]; shoes.len()];
        for eye in 0..2 {
            let truth = ground_truth.render(eye, time_ns);
            for tag in ground_truth.tags(eye, &truth) {
                shares[tag.id][eye] = tag.visible_share;
            }
        }
        for seen in &sightings {
            let foot_from_tag = &shoes[seen.shoe].tags[seen.tag].foot_from_tag;
            observed[seen.shoe].push(gait::observation(&world_from_rig, seen, foot_from_tag)?);
        }
        for (shoe, side) in [Side::Left, Side::Right].into_iter().enumerate() {
            let is_flat = simulation.walker().foot(side, seconds(time_ns)).phase == Phase::Flat;
            let seen = sightings.iter().find(|seen| seen.shoe == shoe);
            if shares[shoe] == [1.0; 2] {
                row.visible += 1;
                row.found += usize::from(seen.is_some());
                row.visible_flat += usize::from(is_flat);
                row.found_flat += usize::from(is_flat && seen.is_some());
            }
            let Some(seen) = seen else { continue };
            row.invented += usize::from(shares[shoe] == [0.0; 2]);
            let error = error(&simulation, &world_from_rig, seen)?;
            let sole = sole_error(&shoes[shoe].tags[0], &error);
            row.wrong += usize::from(error.fixed_rows::<3>(3).norm() > 0.05);
            if is_flat {
                flat += 1;
                squares += error.component_mul(&error);
                let inverse = seen.fit.covariance.try_inverse().context("a covariance")?;
                let square = (error.transpose() * inverse * error)[0];
                nees += square / 6.0;
                // 99.73 % of a chi-squared distribution with six degrees of freedom.
                within += usize::from(square < 20.06);
                soles.push(1e3 * sole);
            }
        }
    }
    let rms = (squares / f64::from(flat)).map(f64::sqrt);
    row.tilt_deg = rms[0].hypot(rms[1]).to_degrees();
    row.plane_mm = 1e3 * rms[3].hypot(rms[4]);
    row.normal_mm = 1e3 * rms[5];
    row.nees = nees / f64::from(flat);
    row.within_three_sigmas = within as f64 / f64::from(flat);
    soles.sort_by(f64::total_cmp);
    row.sole_mm = (soles.iter().map(|e| e * e).sum::<f64>() / f64::from(flat)).sqrt();
    row.sole_p95_mm = soles
        .get(soles.len() * 95 / 100)
        .copied()
        .unwrap_or(f64::NAN);
    row.gait = gait::errors(&simulation, &observed);
    Ok(row)
}

pub(super) fn transform(
    position: &Vector3<f64>,
    rotation: &UnitQuaternion<f64>,
) -> Result<RigidTransform> {
    let q = rotation;
    let wxyz = [q.w, q.i, q.j, q.k];
    Ok(RigidTransform::from_wxyz(wxyz, (*position).into())?)
}

fn shoes(simulation: &Simulation) -> Result<Vec<Shoe>> {
    let tags = simulation.scene().wearer.tags.iter();
    tags.map(|tag| {
        let printed = Tag::new(Dictionary::AprilTag36h11, tag.id as u32, tag.size_m);
        Ok(Shoe {
            side: match tag.side {
                Side::Left => FootSide::Left,
                Side::Right => FootSide::Right,
            },
            tags: vec![ShoeTag {
                tag: printed.context("a tag of the dictionary")?,
                foot_from_tag: transform(&tag.position, &tag.rotation)?,
            }],
        })
    })
    .collect()
}

/// Error of a sighting as a small motion of the tag in its own axes: rotation, translation.
fn error(
    simulation: &Simulation,
    world_from_rig: &RigidTransform,
    seen: &Detection,
) -> Result<Vector6<f64>> {
    let wearer = &simulation.scene().wearer;
    let (position, rotation) = wearer.pose(
        Part::Tag(seen.shoe),
        simulation.walker(),
        seconds(seen.time_ns),
    );
    let truth = world_from_rig.inverse() * transform(&position, &rotation)?;
    let error = truth.inverse() * seen.fit.reference_from_tag;
    let ([a, b, c], [x, y, z]) = (error.rotation_vector(), error.translation_m());
    Ok(Vector6::new(a, b, c, x, y, z))
}

/// Distance of the middle of the sole from the true one, m.
fn sole_error(tag: &ShoeTag, error: &Vector6<f64>) -> f64 {
    let sole = Vector3::from(tag.foot_from_tag.inverse().translation_m());
    let turn = error.fixed_rows::<3>(0).into_owned();
    (error.fixed_rows::<3>(3) + turn.cross(&sole)).norm()
}
