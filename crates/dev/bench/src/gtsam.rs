//! `gtsam`: the back end of odometry beside GTSAM, on real motion.
//!
//! The package `gtsam` brings 30 s of EuRoC V1_01 in flight: feature tracks of the left camera, as
//! bearings without distortion, and the samples of the IMU. The ground truth of the same 30 s is
//! among the recordings (`PAWS_DATA`). Both smoothers get the same keyframes (4 per second), the
//! same bearings and samples, noise densities, robust loss and outlier limit, and the same first
//! state: pose and velocity of the ground truth, no biases. This examines the inertial part of the
//! back end on real motion. It does not examine the front end, whose images are absent, nor
//! stereo: odometry has no monocular mode, and ours runs through an entry for this exam.
//!
//! Causal poses: ours of the sliding window, GTSAM's of an optimization over everything up to each
//! keyframe. Smoothed poses: one optimization over everything.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use cad_transforms::{Covariance, RigidTransform};
use camera_models::{CameraModel, Distortion, ImuNoise, ImuSample};
use odometry::estimator::feature_tracks::{self, Bearings, FirstState, TrackPose};
use odometry::rig::{Imu, Rig, StereoCamera};
use odometry::{Config, Preset};
use scene_bundle::{Pose, Status, Trajectory};
use serde_json::{Value, json};

use crate::arguments::Arguments;
use crate::trajectory_errors::{self, HEAD, RULE};
use crate::{python, stamp};

mod gyroscope;

use gyroscope::GyroscopeRotations;

const SCRIPT: &str = "gtsam/smoother.py";
const TRUTH: &str = "03_stereo_imu/euroc_groundtruth/V1_01_easy.csv";
/// Images per keyframe: 20 Hz to 4 Hz.
const IMAGES_PER_KEYFRAME: usize = 5;
/// Keyframes of the sliding window: 5 s. Without stereo, depth comes from motion alone, which
/// needs a longer window than the product's.
const WINDOW: usize = 20;
/// Iterations per keyframe.
const ITERATIONS: usize = 10;
/// Standard deviation of a bearing, px. The tracks are another tracker's, without a stereo check:
/// their residuals at the true poses have a median of 1.05 px, and a tenth of them is above 16 px.
const OBSERVATION_SIGMA_PX: f64 = 1.0;
/// Standard deviations of the first state: position m, rotation rad, velocity m/s, biases of
/// gyroscope rad/s and accelerometer m/s². The true orientations deviate by half a degree from
/// what the accelerometer measures at rest (`bench odometry`, part `euroc`).
const FIRST_SIGMAS: [f64; 5] = [1e-3, 0.05, 0.05, 0.1, 0.15];
/// Gravity of our back end, m/s².
const GRAVITY: f64 = 9.806_65;

/// The problem that both solve.
struct Problem {
    rig: Rig,
    imu: Vec<ImuSample>,
    sets: Vec<Bearings>,
    first: FirstState,
    truth: Trajectory,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter with GTSAM in `PAWS_GTSAM_PYTHON`, no ground truth in `PAWS_DATA`,
/// a file of another form, or an I/O error. A worse result than GTSAM's is a result.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    let Ok([truth]) = harness::data::sets([TRUTH]).inspect_err(|reason| eprintln!("{reason}"))
    else {
        return Ok(());
    };
    let found = python::ask_in(python::GTSAM, SCRIPT, &json!({ "where": true }))?;
    let file = found["file"].as_str().context("the file of tracks")?;
    let mut problem = Problem::read(Path::new(file), &truth)?;
    if quick {
        problem.sets.truncate(problem.sets.len() / 3);
    }
    let config = config();
    let [causal, smoothed] = feature_tracks::estimate(
        &problem.rig,
        &config,
        &problem.first,
        &problem.imu,
        &problem.sets,
    )
    .context("samples of the IMU are missing")?;
    let answer = python::ask_in(python::GTSAM, SCRIPT, &problem.question(&config))?;
    let reported = |poses: &[TrackPose]| ours(poses, |p| p.covariance);
    let plain = |poses: &[TrackPose]| ours(poses, |p| p.solver_covariance);
    let times: Vec<i64> = problem.sets.iter().map(|s| s.time_ns).collect();
    let rows = [
        ("ours, reported sigmas", "causal", reported(&causal)?),
        ("ours, solver's sigmas", "causal", plain(&causal)?),
        ("GTSAM", "causal", theirs(&answer["causal"], &times)?),
        ("ours, reported sigmas", "smoothed", reported(&smoothed)?),
        ("ours, solver's sigmas", "smoothed", plain(&smoothed)?),
        ("GTSAM", "smoothed", theirs(&answer["smoothed"], &times)?),
    ];
    let gyroscope = GyroscopeRotations::fit(&problem.truth, &problem.imu)?;
    let against = |truth: &Trajectory| -> Vec<Value> {
        let row = |(who, poses, trajectory): &(&str, &str, Trajectory)| {
            let errors = trajectory_errors::errors(trajectory, truth);
            json!({ "estimator": who, "poses": poses, "errors": errors })
        };
        rows.iter().map(row).collect()
    };
    // How far the two agree with each other.
    let apart =
        trajectory_errors::errors(&reported(&smoothed)?, &theirs(&answer["smoothed"], &times)?);
    let report = json!({
        "benchmark": "gtsam",
        "smoothed_ours_against_gtsam": apart,
        "stamp": stamp::stamp("gtsam", args)?,
        "gtsam": found["version"],
        "keyframes": problem.sets.len(),
        "observations": problem.sets.iter().map(|s| s.tracks.len()).sum::<usize>(),
        "rotation_difference_deg": gyroscope.difference_rad.to_degrees(),
        "rotation_change_difference_deg": gyroscope.change_rad.map(f64::to_degrees),
        "rows": against(&problem.truth),
        "rows_gyroscope": against(&gyroscope.truth),
    });
    let table = table(&report);
    print!("{table}");
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    for (name, text) in [("gtsam.json", format!("{report:#}\n")), ("gtsam.md", table)] {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

fn config() -> Config {
    let mut config = Config::preset(Preset::Balanced);
    config.backend.window_size = WINDOW;
    config.backend.max_iterations = ITERATIONS;
    config.backend.observation_sigma_px = OBSERVATION_SIGMA_PX;
    config
}

impl Problem {
    /// # Errors
    /// A file of another form.
    fn read(tracks: &Path, truth: &Path) -> Result<Self> {
        let text =
            fs::read_to_string(tracks).with_context(|| format!("reading {}", tracks.display()))?;
        let mut meta = BTreeMap::new();
        let mut imu = Vec::new();
        let mut images: BTreeMap<i64, Vec<(u64, [f64; 2])>> = BTreeMap::new();
        for line in text.lines().skip(1) {
            let fields: Vec<&str> = line.split(',').collect();
            let number = |at: usize| -> Result<f64> {
                let field = fields.get(at).copied().unwrap_or_default();
                let file = tracks.display();
                field.parse().with_context(|| {
                    format!("found {field:?} in column {at}, expected a number in {file}")
                })
            };
            match fields[0] {
                "meta" => {
                    let entry = (fields.get(20), fields.get(21));
                    let (Some(key), Some(value)) = entry else {
                        continue;
                    };
                    meta.insert((*key).to_owned(), (*value).to_owned());
                }
                "imu" => imu.push(ImuSample {
                    time_ns: nanoseconds(fields[1])?,
                    gyro: [number(6)?, number(7)?, number(8)?],
                    accel: [number(9)?, number(10)?, number(11)?],
                }),
                _ => images
                    .entry(nanoseconds(fields[1])?)
                    .or_default()
                    .push((number(5)? as u64, [number(18)?, number(19)?])),
            }
        }
        let known = |key: &str| -> Result<f64> {
            let value = meta.get(key).with_context(|| format!("{key} is absent"))?;
            value.parse().with_context(|| format!("reading {key}"))
        };
        let focal = [known("camera_fx")?, known("camera_fy")?];
        let center = [known("camera_cx")?, known("camera_cy")?];
        let translation = ["T_ci_tx", "T_ci_ty", "T_ci_tz"].map(known);
        let [tx, ty, tz] = translation;
        let [qw, qx, qy, qz] = ["T_ci_qw", "T_ci_qx", "T_ci_qy", "T_ci_qz"].map(known);
        // EuRoC's T_BS: body from camera.
        let imu_from_camera = RigidTransform::from_wxyz([qw?, qx?, qy?, qz?], [tx?, ty?, tz?])?;
        let (truth, velocity) = ground_truth(truth)?;
        let sets = images.into_iter().step_by(IMAGES_PER_KEYFRAME);
        let sets: Vec<Bearings> = sets
            .map(|(time_ns, tracks)| Bearings {
                time_ns,
                tracks: (tracks.into_iter())
                    .map(|(id, at)| (id, [0, 1].map(|k| (focal[k] * at[k] + center[k]) as f32)))
                    .collect(),
            })
            .collect();
        let first = sets.first().context("there are no tracks")?;
        // Times of the tracks are rounded to 0.1 µs.
        let at = (truth.poses().iter())
            .find(|p| p.time_ns.abs_diff(first.time_ns) < 1000)
            .context("the ground truth has no pose at the first bearings")?;
        Ok(Self {
            first: FirstState {
                world_from_imu: at.world_from_rig,
                velocity,
                sigmas: FIRST_SIGMAS,
            },
            rig: rig([focal[0], focal[1], center[0], center[1]], imu_from_camera),
            imu,
            sets,
            truth,
        })
    }

    /// The same for GTSAM.
    fn question(&self, config: &Config) -> Value {
        let parts = |t: &RigidTransform| {
            let q = t.rotation().quaternion();
            json!([[q.w, q.i, q.j, q.k], t.translation_m()])
        };
        let lens = &self.rig.cameras[0].left;
        let noise = self.rig.imus[0].noise;
        let [gyro_times, accel_times] = config.inertial.noise_inflation;
        json!({
            "times": self.sets.iter().map(|s| s.time_ns).collect::<Vec<_>>(),
            "tracks": self.sets.iter().map(|s| &s.tracks).collect::<Vec<_>>(),
            "imu": self.imu.iter().map(|s| {
                let [a, b, c] = s.gyro;
                let [x, y, z] = s.accel;
                (s.time_ns, a, b, c, x, y, z)
            }).collect::<Vec<_>>(),
            "intrinsics": [lens.fx, lens.fy, lens.cx, lens.cy],
            "imu_from_camera": parts(&self.rig.cameras[0].rig_from_left),
            "first_pose": parts(&self.first.world_from_imu),
            "first_velocity": self.first.velocity,
            "sigmas": self.first.sigmas,
            "noise": {
                "gyro": noise.gyro_noise_density * gyro_times,
                "accel": noise.accel_noise_density * accel_times,
                "gyro_walk": noise.gyro_random_walk * gyro_times,
                "accel_walk": noise.accel_random_walk * accel_times,
            },
            "gravity": GRAVITY,
            "huber_sigma": config.backend.huber_sigma,
            "observation_sigma_px": config.backend.observation_sigma_px,
            "rounds": ITERATIONS,
        })
    }
}

/// The rig: its left camera without distortion; the right one is not used. Noise as in EuRoC's
/// `sensor.yaml`.
fn rig([fx, fy, cx, cy]: [f64; 4], imu_from_camera: RigidTransform) -> Rig {
    let lens = CameraModel::new((752, 480), [fx, fy, cx, cy], Distortion::None);
    Rig {
        cameras: vec![StereoCamera {
            name: "camera".to_owned(),
            left: lens,
            right: lens,
            rig_from_left: imu_from_camera,
            covariance: None,
            right_from_left: RigidTransform::identity(),
            right_from_left_covariance: None,
            line_s: 0.0,
        }],
        imus: vec![Imu {
            name: "imu".to_owned(),
            rig_from_imu: RigidTransform::identity(),
            noise: ImuNoise {
                gyro_noise_density: 1.6968e-4,
                gyro_random_walk: 1.9393e-5,
                accel_noise_density: 2e-3,
                accel_random_walk: 3e-3,
            },
            rate_hz: 200.0,
            range: [f64::INFINITY; 2],
        }],
    }
}

/// Seconds with a fraction as nanoseconds, without rounding through a float.
fn nanoseconds(text: &str) -> Result<i64> {
    let (seconds, fraction) = text.split_once('.').unwrap_or((text, ""));
    let digits = format!("{fraction:0<9}");
    let digits = digits.get(..9).context("a time with a fraction")?;
    Ok(1_000_000_000 * seconds.parse::<i64>()? + digits.parse::<i64>()?)
}

/// True poses, and the velocity of the first one, m/s.
fn ground_truth(path: &Path) -> Result<(Trajectory, [f64; 3])> {
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    let mut poses = Vec::new();
    let mut velocity = None;
    for line in text.lines().filter(|l| !l.starts_with('#')) {
        let (time, rest) = line.split_once(',').context("a row without a time")?;
        let v: Vec<f64> = (rest.split(',').map(|v| v.trim().parse())).collect::<Result<_, _>>()?;
        ensure!(v.len() >= 10, "a row of {} has no velocity", path.display());
        let pose = RigidTransform::from_wxyz([v[3], v[4], v[5], v[6]], [v[0], v[1], v[2]])?;
        poses.push(Pose::new(time.parse()?, pose));
        velocity = velocity.or(Some([v[7], v[8], v[9]]));
    }
    let velocity = velocity.context("there is no ground truth")?;
    Ok((Trajectory::new(poses)?, velocity))
}

fn ours(
    poses: &[TrackPose],
    covariance: impl Fn(&TrackPose) -> nalgebra::Matrix6<f64>,
) -> Result<Trajectory> {
    let poses = poses
        .iter()
        .map(|p| tracked(p.time_ns, p.world_from_imu, &covariance(p)));
    Ok(Trajectory::new(poses.collect::<Result<_>>()?)?)
}

fn theirs(answer: &Value, times: &[i64]) -> Result<Trajectory> {
    let rows = answer.as_array().context("GTSAM's poses")?;
    ensure!(rows.len() == times.len(), "GTSAM gave {} poses", rows.len());
    let poses = rows.iter().zip(times).map(|(row, time_ns)| {
        let wxyz: [f64; 4] = serde_json::from_value(row["wxyz"].clone())?;
        let position: [f64; 3] = serde_json::from_value(row["position"].clone())?;
        let covariance: Vec<f64> = serde_json::from_value(row["covariance"].clone())?;
        ensure!(covariance.len() == 36, "a covariance of 6 rows");
        let pose = RigidTransform::from_wxyz(wxyz, position)?;
        tracked(
            *time_ns,
            pose,
            &nalgebra::Matrix6::from_row_slice(&covariance),
        )
    });
    Ok(Trajectory::new(poses.collect::<Result<_>>()?)?)
}

fn tracked(time_ns: i64, pose: RigidTransform, of: &nalgebra::Matrix6<f64>) -> Result<Pose> {
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| of[(i, j)]));
    Ok(Pose {
        covariance: Some(Covariance::from_rows(rows).context("a covariance")?),
        status: Status::Tracked,
        ..Pose::new(time_ns, pose)
    })
}

fn table(report: &Value) -> String {
    let mut text = format!(
        "# Real motion: the back end beside GTSAM {}\n\n\
         30 s of EuRoC V1_01 in flight: feature tracks of the left camera and IMU samples that the package `gtsam` brings; ground truth from the recordings. {} keyframes, {} bearings.\n\
         The tracks are monocular and the images absent: this examines the inertial part of the back end on real motion, not the front end, and not stereo.\n\
         NEES is over its dimensions, 1 is right; silently wrong is beyond three stated sigmas.\n",
        report["gtsam"].as_str().unwrap_or_default(),
        report["keyframes"],
        report["observations"],
    );
    let _ = write!(
        text,
        "\nAgainst the ground truth of the file:\n\n{}",
        rows(&report["rows"])
    );
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let _ = write!(
        text,
        "\nThe orientations of this file are not accurate (OpenVINS computes them again): their changes over 5 s differ from the gyroscope's by {:.2}° (root mean square; largest {:.2}°), whose noise is 0.02° over that time.\n\
         With one rotation and one bias fitted to them, they differ from the gyroscope's orientations by {:.2}°.\n\
         Against the positions of the file with these orientations:\n\n{}",
        number(&report["rotation_change_difference_deg"][0]),
        number(&report["rotation_change_difference_deg"][1]),
        number(&report["rotation_difference_deg"]),
        rows(&report["rows_gyroscope"]),
    );
    let _ = writeln!(
        text,
        "\nSmoothed poses of ours against GTSAM's: {:.1} mm, {:.2}°.",
        1e3 * report["smoothed_ours_against_gtsam"]["ate_m"]
            .as_f64()
            .unwrap_or(f64::NAN),
        report["smoothed_ours_against_gtsam"]["rotation_deg"]
            .as_f64()
            .unwrap_or(f64::NAN),
    );
    text
}

fn rows(of: &Value) -> String {
    let mut text = format!("| estimator | poses | {HEAD} |\n|---|---|{RULE}|\n");
    for row in of.as_array().into_iter().flatten() {
        let _ = writeln!(
            text,
            "| {} | {} | {} |",
            row["estimator"].as_str().unwrap_or_default(),
            row["poses"].as_str().unwrap_or_default(),
            trajectory_errors::columns(&row["errors"]),
        );
    }
    text
}
