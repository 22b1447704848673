//! `feet_camera`: what the placement of the feet camera shows of the shoe tags, and what its
//! exposure blurs.
//!
//! Walks of several wearers on flat ground and stairs, ground truth only: no image is developed. A
//! tag counts as visible if it is whole and unoccluded in both eyes. Strides run from heel strike
//! to heel strike. Blur is the movement of the tag in the image during the exposure, in cells of
//! the tag, which is the same for every lens.

use anyhow::{Context as _, Result};
use cad_transforms::rig::Rig;
use charts::{Axis, Chart, Series};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{GroundTruth, Settings, Simulation, seconds};
use rig_sim::walker::{Phase, Side};
use serde::Serialize;
use serde_json::json;

use crate::arguments::Arguments;
use crate::odometry::results;
use crate::stamp;

/// A placement of the feet camera.
struct Mount {
    name: &'static str,
    /// Pitch below the horizontal, degrees.
    down_deg: f64,
    /// Whether columns run along the walk.
    is_portrait: bool,
    /// Position of the left eye ahead of the datum, m.
    ahead_m: f64,
}

const MOUNTS: [Mount; 6] = [
    Mount {
        name: "80° down, landscape, 8 cm ahead",
        down_deg: 80.0,
        is_portrait: false,
        ahead_m: 0.08,
    },
    Mount {
        name: "90° down, landscape, 8 cm ahead",
        down_deg: 90.0,
        is_portrait: false,
        ahead_m: 0.08,
    },
    Mount {
        name: "80° down, portrait, 8 cm ahead",
        down_deg: 80.0,
        is_portrait: true,
        ahead_m: 0.08,
    },
    Mount {
        name: "85° down, portrait, 15 cm ahead",
        down_deg: 85.0,
        is_portrait: true,
        ahead_m: 0.15,
    },
    Mount {
        name: "95° down, landscape, 15 cm ahead",
        down_deg: 95.0,
        is_portrait: false,
        ahead_m: 0.15,
    },
    Mount {
        name: "100° down, landscape, 20 cm ahead",
        down_deg: 100.0,
        is_portrait: false,
        ahead_m: 0.2,
    },
];
/// Scenes and seeds: seeds draw wearers.
const WALKS: [(Kind, u64); 6] = [
    (Kind::Pavement, 101),
    (Kind::Pavement, 102),
    (Kind::Plaza, 103),
    (Kind::Plaza, 104),
    (Kind::Stairs, 105),
    (Kind::Stairs, 106),
];
const SECONDS: f64 = 20.0;
const RATE_HZ: f64 = 25.0;
/// Bins of a stride.
const BINS: usize = 20;
/// Side of the tag, m: eight cells.
const TAG_M: f64 = 0.08;
/// Exposures, ms.
const EXPOSURES_MS: [f64; 8] = [0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0];
/// Interval of the finite difference of a motion, s.
const STEP_S: f64 = 1e-3;

/// Sightings of one mount.
#[derive(Clone, Debug, Default, Serialize)]
struct Sightings {
    mount: String,
    /// Visible instants and all of them, by bin of the stride.
    stride: Vec<[u32; 2]>,
    /// The same by phase: heel, flat, toe, swing.
    phases: [[u32; 2]; 4],
    /// Movements of visible tags, cells per second: flat, and in a swing.
    #[serde(skip)]
    speeds: [Vec<f64>; 2],
    /// Share of visible tags that move by less than a cell, for each exposure: flat, and in a
    /// swing.
    sharp: Vec<[f64; 2]>,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    let walks = if quick { &WALKS[..1] } else { &WALKS[..] };
    let mut all = Vec::new();
    for mount in &MOUNTS {
        let mut sightings = Sightings {
            mount: mount.name.to_owned(),
            stride: vec![[0; 2]; BINS],
            ..Sightings::default()
        };
        for &(scene, seed) in walks {
            observe(mount, scene, seed, &mut sightings)?;
        }
        let sharp = |speeds: &Vec<f64>, ms: f64| {
            let count = speeds
                .iter()
                .filter(|speed| *speed * 1e-3 * ms < 1.0)
                .count();
            count as f64 / speeds.len().max(1) as f64
        };
        let shares = EXPOSURES_MS.map(|ms| [0, 1].map(|k| sharp(&sightings.speeds[k], ms)));
        sightings.sharp = shares.to_vec();
        let share = |k: usize| 100.0 * ratio(sightings.phases[k]);
        println!(
            "{:<34} all {:5.1} %, heel {:5.1} %, flat {:5.1} %, toe {:5.1} %, swing {:5.1} %",
            mount.name,
            100.0 * ratio(sum(&sightings.phases)),
            share(0),
            share(1),
            share(2),
            share(3)
        );
        all.push(sightings);
    }
    let stamp = stamp::stamp("feet_camera", args)?;
    let files = charts_of(&all, &stamp::line(&stamp));
    let report = json!({
        "benchmark": "feet_camera",
        "stamp": stamp,
        "exposures_ms": EXPOSURES_MS,
        "mounts": all,
    });
    let table = ("feet_camera.json".to_owned(), format!("{report:#}\n"));
    results::write(&out, files.into_iter().chain([table]).collect())
}

fn ratio([part, all]: [u32; 2]) -> f64 {
    f64::from(part) / f64::from(all.max(1))
}

fn sum(counts: &[[u32; 2]]) -> [u32; 2] {
    counts.iter().fold([0; 2], |[a, b], [c, d]| [a + c, b + d])
}

/// A rig with the feet camera alone, and an upright tag on a wedge of 20 degrees on each shoe.
fn rig(mount: &Mount) -> Result<Rig> {
    let down = mount.down_deg.to_radians();
    // Forward when level: x right, y down, z ahead.
    let level = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
        0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0,
    ));
    let pitched = Rotation3::from_axis_angle(&Vector3::y_axis(), down) * level;
    let turn = match mount.is_portrait {
        true => std::f64::consts::FRAC_PI_2,
        false => 0.0,
    };
    let rotation = pitched * Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
    let left = UnitQuaternion::from_rotation_matrix(&rotation);
    // Upright for the wearer who looks down, its upper end raised by the wedge.
    let flat = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
        0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0,
    ));
    let wedge = Rotation3::from_axis_angle(&Vector3::y_axis(), -20.0_f64.to_radians());
    let tag = UnitQuaternion::from_rotation_matrix(&(wedge * flat));
    let wxyz = |q: &UnitQuaternion<f64>| format!("[{}, {}, {}, {}]", q.w, q.i, q.j, q.k);
    let joint = |parent: &str, child: &str, rotation: &str, translation: [f64; 3]| {
        format!(
            "[[parent_from_child]]\nparent = {parent:?}\nchild = {child:?}\n\
             rotation_wxyz = {rotation}\ntranslation_m = {translation:?}\n\n"
        )
    };
    let same = "[1, 0, 0, 0]";
    let mut text = "format = 1\nname = \"feet camera\"\nrevision = \"1\"\n\n[provenance]\n\
                    kind = \"nominal\"\nnote = \"a placement to compare\"\n\n"
        .to_owned();
    let place = [mount.ahead_m, 0.0315, -0.02];
    text += &joint("rig", "feet/left", &wxyz(&left), place);
    text += &joint("feet/left", "feet/right", same, [0.063, 0.0, 0.0]);
    text += &joint("feet/left", "feet/imu", same, [0.0315, 0.0, 0.0]);
    for (id, foot) in ["left_foot", "right_foot"].into_iter().enumerate() {
        text += &format!(
            "[[shoe_tag]]\nfamily = \"36h11\"\nid = {id}\nfoot = {foot:?}\nsize_m = {TAG_M}\n\
             rotation_wxyz = {}\ntranslation_m = [0.08, 0, 0.085]\n\n",
            wxyz(&tag)
        );
    }
    Ok(Rig::parse(&text)?)
}

fn observe(mount: &Mount, scene: Kind, seed: u64, sightings: &mut Sightings) -> Result<()> {
    let settings = Settings {
        kind: scene,
        lighting: Lighting::Day,
        seed,
        seconds: SECONDS,
        rate_hz: RATE_HZ,
        width: 224,
        height: 126,
        quality: Quality::FAST,
    };
    let simulation = Simulation::new(&settings, &rig(mount)?).context("preparing the walk")?;
    let mut ground_truth = simulation.ground_truth(0);
    for number in 0..settings.frame_count() {
        let time_ns = settings.frame_ns(number);
        let visible = visible(&mut ground_truth, time_ns);
        for side in [Side::Left, Side::Right] {
            let Some(stride) = stride(&simulation, side, seconds(time_ns)) else {
                continue;
            };
            let phase = simulation.walker().foot(side, seconds(time_ns)).phase;
            let is_visible = visible[side as usize];
            let bin = (stride * BINS as f64) as usize;
            for count in [
                &mut sightings.stride[bin.min(BINS - 1)],
                &mut sightings.phases[phase as usize],
            ] {
                count[0] += u32::from(is_visible);
                count[1] += 1;
            }
            if is_visible {
                let speed = speed(&simulation, side, seconds(time_ns));
                match phase {
                    Phase::Flat => sightings.speeds[0].push(speed),
                    Phase::Swing => sightings.speeds[1].push(speed),
                    Phase::Heel | Phase::Toe => {}
                }
            }
        }
    }
    Ok(())
}

/// Whether the left and the right tag are visible in both eyes.
fn visible(ground_truth: &mut GroundTruth<'_>, time_ns: i64) -> [bool; 2] {
    let mut visible = [true; 2];
    for eye in 0..2 {
        let truth = ground_truth.render(eye, time_ns);
        let tags = ground_truth.tags(eye, &truth);
        for (id, visible) in visible.iter_mut().enumerate() {
            *visible &= tags.iter().any(|tag| tag.id == id && tag.is_visible());
        }
    }
    visible
}

/// Time since the last heel strike as a share of the stride; `None` while the wearer stands.
fn stride(simulation: &Simulation, side: Side, time_s: f64) -> Option<f64> {
    let falls = simulation.walker().contacts(side);
    let next = falls.partition_point(|fall| fall.strike_s <= time_s);
    let (last, next) = (falls.get(next.checked_sub(1)?)?, falls.get(next)?);
    let seconds = next.strike_s - last.strike_s;
    (seconds < 1.6).then(|| (time_s - last.strike_s) / seconds)
}

/// Movement of the middle of a tag in the left eye, cells per second.
fn speed(simulation: &Simulation, side: Side, time_s: f64) -> f64 {
    let tag = &simulation.scene().wearer.tags[side as usize];
    let in_eye = |t: f64| {
        let foot = simulation.walker().foot(side, t);
        let world = foot.position + foot.rotation * tag.position;
        let rig = simulation.walker().rig(t);
        let (position, rotation) = simulation.cameras()[0].world_from_eye(0, &rig, None);
        rotation.inverse() * (world - position)
    };
    let [before, after] = [-0.5, 0.5].map(|k| in_eye(time_s + k * STEP_S));
    let [a, b] = [before, after].map(|p| p.xy() / p.z);
    let z = 0.5 * (before.z + after.z);
    (b - a).norm() / STEP_S * z / (TAG_M / 8.0)
}

fn charts_of(all: &[Sightings], foot: &str) -> Vec<(String, String)> {
    let mut stride = Chart::new("Shoe tags in view over a stride")
        .subtitle("whole tag in both eyes; six simulated walks, day, without images")
        .x_axis(Axis::linear("since heel strike, share of the stride", "%"))
        .y_axis(Axis::linear("in view", "%").include(0.0).include(100.0))
        .footnote(foot);
    for sightings in all {
        let points = sightings.stride.iter().enumerate().map(|(bin, count)| {
            let middle = 100.0 * (bin as f64 + 0.5) / BINS as f64;
            (middle, 100.0 * ratio(*count))
        });
        stride = stride.series(Series::line(&sightings.mount, points));
    }
    let mut blur = Chart::new("Shoe tags that blur by less than a cell")
        .subtitle("tags in view, 80 mm; all placements")
        .x_axis(Axis::log("exposure", "ms"))
        .y_axis(
            Axis::linear("of tags in view", "%")
                .include(0.0)
                .include(100.0),
        )
        .footnote(foot);
    for (k, name) in ["foot flat", "swing"].into_iter().enumerate() {
        let count: usize = all.iter().map(|s| s.speeds[k].len()).sum();
        let points = EXPOSURES_MS.iter().enumerate().map(|(i, ms)| {
            let sharp = |s: &Sightings| s.sharp[i][k] * s.speeds[k].len() as f64;
            (
                *ms,
                100.0 * all.iter().map(sharp).sum::<f64>() / count.max(1) as f64,
            )
        });
        blur = blur.series(Series::line(name, points));
    }
    vec![
        ("feet_camera-stride.svg".to_owned(), stride.to_svg(760, 420)),
        ("feet_camera-blur.svg".to_owned(), blur.to_svg(760, 380)),
    ]
}
