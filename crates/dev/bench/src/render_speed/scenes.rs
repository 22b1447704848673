//! Scenes to render: Gaussians trained on images of simulated walks, and the poses of the walks.
//!
//! A scene starts at the true depths of its keyframes and is trained at half size, with growth by
//! the errors that images show, up to a limit, and without the check that decides the number of
//! Gaussians in the stage `splats`; nothing thins it afterwards. Scenes are kept in the folder
//! `bench-render` of the target folder and trained again where they are missing.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use cad_transforms::RigidTransform;
use cad_transforms::rig::Rig;
use rayon::prelude::*;
use rig_sim::camera::Quality;
use rig_sim::scene::surface::Class;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation, seconds};
use splats::{
    Background, Camera, Exposure, RenderConfig, Scene, Shutter, Sky, StartConfig, TrainConfig,
    Trainer, TrainingView, files, points_from_views, splats_from_points,
};

use crate::meter;
use crate::terrain::walks::transform;

const EXAMPLE_RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
const RATE_HZ: f64 = 15.0;
const SIZE: [u32; 2] = [448, 252];
const SECONDS: f64 = 40.0;
/// Keyframes are at least this far apart.
const SPACING_M: f64 = 0.8;
const SPACING_DEG: f64 = 25.0;
/// Time between the two poses that give the motion of a rolling shutter.
const STEP_NS: i64 = 10_000_000;
/// Disparity error of depths, px, and baseline and focal length of the stereo cameras that would
/// have it.
const DISPARITY_SIGMA_PX: f32 = 0.15;
const FOCAL_BASELINE_PX_M: f32 = 15.0;
/// Farthest depth that a start uses, m.
const MAX_DEPTH_M: f32 = 25.0;
/// Texels along an edge of the sky.
const SKY_SIZE: usize = 32;
/// Steps of a training, and its largest number of Gaussians.
const STEPS: usize = 800;
const MAX_SPLATS: usize = 200_000;
const START_POINTS: usize = 130_000;
/// The red, green and blue of the sky before training.
const SKY_COLOR: [f32; 3] = [0.6, 0.7, 0.9];

/// A simulated walk. No test and no other benchmark uses these seeds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    pub(super) kind: Kind,
    pub(super) seed: u64,
}

/// The walks of the benchmark.
pub(super) const WALKS: [Walk; 3] = [
    walk(Kind::Pavement, 411),
    walk(Kind::Plaza, 412),
    walk(Kind::Trail, 413),
];

/// The walks on which the defaults of `DetailConfig` were chosen.
pub(super) const TUNING: [Walk; 1] = [walk(Kind::Pavement, 421)];

const fn walk(kind: Kind, seed: u64) -> Walk {
    Walk { kind, seed }
}

/// A reconstructed walk.
pub(super) struct Reconstruction {
    pub(super) scene: Scene,
    /// Poses of a camera that looks ahead, `world_from_camera`.
    pub(super) path: Vec<RigidTransform>,
    /// PSNR of training views after training, dB.
    pub(super) psnr_db: f64,
}

impl Walk {
    pub(super) fn name(&self) -> String {
        format!("{}-{}", self.kind.name(), self.seed)
    }

    /// The scene of the walk, trained or read.
    ///
    /// # Errors
    /// The walk or the training fails, or an I/O error.
    pub(super) fn reconstruction(&self) -> Result<Reconstruction> {
        let folder = folder()?;
        let file = |end: &str| folder.join(format!("{}.{end}", self.name()));
        // Written last.
        if !file("txt").exists() {
            let walk = Recording::new(self)?;
            let (scene, psnr_db) = walk.train()?;
            write(&file("ply"), &files::ply::write(&scene.splats, false))?;
            write(&file("sky"), &sky_bytes(&scene.background))?;
            write(&file("txt"), text(psnr_db, &walk.path()?).as_bytes())?;
        }
        let splats = files::ply::read(&read(&file("ply"))?, 10 * MAX_SPLATS)?.splats;
        let background = Background::Sky(sky_of(&read(&file("sky"))?)?);
        let (psnr_db, path) = parsed(&String::from_utf8(read(&file("txt"))?)?)?;
        Ok(Reconstruction {
            scene: Scene { splats, background },
            path,
            psnr_db,
        })
    }
}

/// PSNR and poses, a line each: `w x y z` of the rotation, then the position, m.
fn text(psnr_db: f64, path: &[RigidTransform]) -> String {
    let line = |values: &[f64]| {
        let words: Vec<String> = values.iter().map(f64::to_string).collect();
        words.join(" ") + "\n"
    };
    let poses = path.iter();
    let poses =
        poses.map(|pose| line(&[&pose.rotation_wxyz()[..], &pose.translation_m()].concat()));
    line(&[psnr_db]) + &poses.collect::<String>()
}

fn parsed(text: &str) -> Result<(f64, Vec<RigidTransform>)> {
    let mut lines = text.lines();
    let psnr_db = lines.next().context("no PSNR")?.parse()?;
    let pose = |line: &str| -> Result<RigidTransform> {
        let words = line.split_whitespace().map(str::parse);
        let values: Vec<f64> = words.collect::<Result<_, _>>()?;
        let [w, x, y, z, a, b, c] = values[..] else {
            bail!("found {} numbers of a pose, expected 7", values.len());
        };
        Ok(RigidTransform::from_wxyz([w, x, y, z], [a, b, c])?)
    };
    Ok((psnr_db, lines.map(pose).collect::<Result<_>>()?))
}

/// The simulation of a walk and its keyframes.
struct Recording {
    simulation: Arc<Simulation>,
    keyframes: Vec<(u64, i64)>,
}

impl Recording {
    fn new(walk: &Walk) -> Result<Self> {
        let rig = Rig::parse(EXAMPLE_RIG).context("reading the example rig")?;
        let settings = Settings {
            kind: walk.kind,
            lighting: Lighting::Day,
            seed: walk.seed,
            seconds: SECONDS,
            rate_hz: RATE_HZ,
            width: SIZE[0],
            height: SIZE[1],
            quality: Quality::ACCURATE,
        };
        let simulation = Arc::new(Simulation::new(&settings, &rig)?);
        let mut keyframes: Vec<(u64, i64)> = Vec::new();
        let mut last: Option<RigidTransform> = None;
        for frame in 0..settings.frame_count() {
            let time_ns = settings.frame_ns(frame);
            let now = rig_pose(&simulation, time_ns)?;
            let is_near = last.is_some_and(|last| {
                let motion = last.inverse() * now;
                motion.distance_m() < SPACING_M && motion.angle_rad().to_degrees() < SPACING_DEG
            });
            if !is_near {
                last = Some(now);
                keyframes.push((frame, time_ns));
            }
        }
        Ok(Self {
            simulation,
            keyframes,
        })
    }

    /// Poses of a camera that looks ahead from the rig.
    fn path(&self) -> Result<Vec<RigidTransform>> {
        let ahead = RigidTransform::body_from_optical();
        let poses = self.keyframes.iter();
        poses
            .map(|(_, time_ns)| Ok(rig_pose(&self.simulation, *time_ns)? * ahead))
            .collect()
    }

    fn train(&self) -> Result<(Scene, f64)> {
        let cameras: Vec<usize> = (0..self.simulation.cameras().len()).collect();
        let views: Vec<Vec<TrainingView>> = cameras
            .par_iter()
            .map(|camera| self.views(*camera))
            .collect::<Result<_>>()?;
        let views = views.concat();
        let mut start = StartConfig::default();
        start.max_points = START_POINTS;
        let points = points_from_views(&views, &start);
        println!("  {} views, {} points", views.len(), points.len());
        let scene = Scene {
            splats: splats_from_points(&points)?,
            background: Background::Sky(Sky::uniform(SKY_SIZE, SKY_COLOR)?),
        };
        let mut config = TrainConfig::default();
        config.steps = STEPS;
        config.degree = 0;
        config.growth.interval = 100;
        // At half size from the beginning to the end.
        (config.quarter_until, config.full_from) = (0.1, 2.0);
        config.growth.max_splats = MAX_SPLATS;
        let judged: Vec<TrainingView> = views
            .iter()
            .step_by(8)
            .map(|view| view.reduced(2))
            .collect::<Result<_, _>>()?;
        let mut trainer = Trainer::new(scene, views, config, RenderConfig::default(), 1)?;
        for step in 0..STEPS {
            trainer.step()?;
            if step % 500 == 0 {
                println!("  step {step}: {} Gaussians", trainer.scene().splats.len());
            }
        }
        let psnr_db = trainer.evaluate(&judged).mean_psnr_db();
        println!("  {psnr_db:.2} dB on training views");
        Ok((trainer.scene().clone(), psnr_db))
    }

    /// Left images of a camera with true depths.
    fn views(&self, camera: usize) -> Result<Vec<TrainingView>> {
        let of = &self.simulation.cameras()[camera];
        let count = self.simulation.cameras().len();
        let mut frames = self.simulation.frames(camera);
        let mut truth = self.simulation.ground_truth(camera);
        let mut views = Vec::new();
        let mut first_light = None;
        for (number, (frame, time_ns)) in self.keyframes.iter().enumerate() {
            let shot = frames.expose(*frame, *time_ns);
            let seen = truth.render(0, *time_ns);
            let pose = |time_ns: i64| -> Result<RigidTransform> {
                Ok(rig_pose(&self.simulation, time_ns)? * of.rig_from_eye[0])
            };
            let mut eye = Camera::new(of.models[0], pose(*time_ns)?.inverse())?;
            if let rig_sim::camera::Shutter::Rolling { line_s } = of.shutter {
                let motion = pose(time_ns - STEP_NS / 2)?.inverse() * pose(time_ns + STEP_NS / 2)?;
                let per_s = |v: f64| v / (STEP_NS as f64 * 1e-9);
                eye = eye.with_shutter(Shutter::rows(
                    line_s,
                    SIZE[1],
                    motion.translation_m().map(per_s),
                    motion.rotation_vector().map(per_s),
                ))?;
            }
            let light = shot.exposure.seconds * shot.exposure.gain;
            let gain = (light / *first_light.get_or_insert(light)).powf(1.0 / 2.2);
            let id = (number * count + camera) as u32;
            let mut view = TrainingView::new(eye, shot.rgb(0).concat(), id);
            view.instant = number as u32;
            view.exposure = Exposure::from_log_gain([libm::log(gain) as f32; 3]);
            view.mask = seen.class.iter().map(|c| *c != Class::Person).collect();
            view.depth_m = seen
                .depth
                .iter()
                .zip(&view.mask)
                .map(|(z, usable)| match *usable && *z < MAX_DEPTH_M {
                    true => *z,
                    false => f32::NAN,
                })
                .collect();
            let sigma = |z: &f32| z * z * DISPARITY_SIGMA_PX / FOCAL_BASELINE_PX_M;
            view.depth_sigma_m = view.depth_m.iter().map(sigma).collect();
            views.push(view);
        }
        Ok(views)
    }
}

fn rig_pose(simulation: &Simulation, time_ns: i64) -> Result<RigidTransform> {
    let rig = simulation.walker().rig(seconds(time_ns));
    transform(&rig.position, &rig.rotation)
}

fn sky_bytes(background: &Background) -> Vec<u8> {
    match background {
        Background::Constant(color) => color.iter().flat_map(|v| v.to_le_bytes()).collect(),
        Background::Sky(sky) => {
            let values = sky.texels().as_flattened().iter();
            values.flat_map(|v| v.to_le_bytes()).collect()
        }
    }
}

fn sky_of(bytes: &[u8]) -> Result<Sky> {
    let (words, _) = bytes.as_chunks::<4>();
    let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    let (texels, _) = values.as_chunks::<3>();
    Ok(Sky::from_texels(SKY_SIZE, texels.to_vec())?)
}

fn folder() -> Result<PathBuf> {
    let program = meter::on_disk(None)?;
    let target = program.parent().unwrap_or(Path::new("."));
    let folder = target.join("bench-render");
    fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    Ok(folder)
}

fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("reading {}", path.display()))
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    fs::write(path, bytes).with_context(|| format!("writing {}", path.display()))
}
