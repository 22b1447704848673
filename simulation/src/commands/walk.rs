//! An agent in a scene with its camera and a map, for films and the viewer.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use jpeg_encoder::{ColorType, Encoder};
use simulation::{
    AgentState, CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, Guide, MapImage,
    Playback, Recording, ResidencyConfig, SceneData, Similarity, Task, ViewJudge, World,
    WorldConfig,
};

use super::progress_bar;

/// Size of the images, px.
pub(super) const SIZE: [u32; 2] = [384, 216];
/// Size of the images by which their confidence is judged, px.
const JUDGED_SIZE: [u32; 2] = [96, 54];
/// Field of view from left to right, rad.
const FIELD_OF_VIEW_RAD: f64 = 1.6;
/// Quality of the JPEG files, 1 to 100.
const JPEG_QUALITY: u8 = 85;
/// Speed of the agent, m/s: that of a person who looks around.
const SPEED_M_S: f64 = 1.0;
/// Distances of goals, m.
const GOALS_M: [f64; 2] = [3.0, 12.0];
/// Distance at which a goal is reached, m.
const REACHED_M: f64 = 0.3;

/// An agent in a scene.
pub(super) struct Walk {
    world: World,
    /// One for each sector.
    guides: Vec<Guide>,
    camera: CameraBatch,
    frames: Frames,
    store: Arc<GaussianStore>,
    /// The judge of a sector, the last one that the agent was in.
    judge: Option<(usize, Option<ViewJudge>)>,
    pub(super) map: MapImage,
    /// Of the frame of each sector.
    map_from_sectors: Vec<Similarity>,
    /// Path length of the episodes before this one, m, and steps of theirs that were stopped.
    before_m: f64,
    before_collisions: u32,
    /// Episodes that ended.
    ends: u32,
    /// First and last time of the recorded wearer, ns, if there are any.
    recorded_ns: Option<[i64; 2]>,
    /// Time of the recording at which the agent is where the wearer was; `None` while it walks by
    /// itself.
    wearer_ns: Option<i64>,
}

impl Walk {
    /// Opens a scene and puts an agent at a start. Of what it sees a PSNR is predicted of at least
    /// `min_support_db`, dB, or else its episode ends; 0 is no limit.
    pub(super) fn open(path: &Path, seed: u64, min_support_db: f64) -> Result<Self> {
        let scene = Arc::new(SceneData::open(path)?);
        for missing in scene.missing() {
            log::warn!(
                "{}: no output {}: {}",
                missing.place,
                missing.output,
                missing.features
            );
        }
        let mut config = WorldConfig {
            seed,
            ..WorldConfig::default()
        };
        config.task.task = Task::Velocity;
        config.agent.max_speed_m_s = SPEED_M_S;
        config.end.time_limit_s = 1e6;
        config.end.unknown_ground_ends = false;
        config.end.left_map_ends = false;
        config.start.min_support_db = min_support_db;
        config.end.min_support_db = min_support_db;
        let mut guides = Vec::new();
        for sector in &scene.sectors {
            let Some(levels) = &sector.levels else {
                bail!("sector {} has no maps to walk on", sector.name);
            };
            guides.push(Guide::new(levels.to_vec(), &config.agent, seed, GOALS_M)?);
        }
        let mut map = MapImage::new(&scene).context("the maps of the scene are empty")?;
        let mut map_from_sectors = Vec::new();
        for (number, (root, map_from_sector)) in scene.roots_from_sectors().into_iter().enumerate()
        {
            if root != 0 {
                bail!(
                    "no edges connect sector {} with sector {}, and a walk has one map",
                    scene.sectors[number].name,
                    scene.sectors[0].name
                );
            }
            let recording = &scene.sectors[number].recording;
            let mut before = scene.sectors[..number].iter();
            if before.all(|sector| !Arc::ptr_eq(&sector.recording, recording)) {
                map.path(&path_on_map(recording, &map_from_sector));
            }
            map_from_sectors.push(map_from_sector);
        }
        // Times of several recordings have nothing to do with each other.
        let recording = &scene.sectors[0].recording;
        let mut sectors = scene.sectors.iter();
        let is_one = sectors.all(|sector| Arc::ptr_eq(&sector.recording, recording));
        let wearer = is_one.then(|| Playback::of(recording)).flatten();
        let recorded_ns = wearer.and_then(|wearer| wearer.range_ns());
        let store = Arc::new(GaussianStore::new(
            Arc::clone(&scene),
            ResidencyConfig::default(),
        ));
        let camera = CameraConfig::pinhole(SIZE, FIELD_OF_VIEW_RAD)?;
        let mut walk = Self {
            world: World::new(scene, config)?,
            guides,
            camera: CameraBatch::new(Arc::clone(&store), camera)?,
            store,
            judge: None,
            frames: Frames::default(),
            map,
            map_from_sectors,
            before_m: 0.0,
            before_collisions: 0,
            ends: 0,
            recorded_ns,
            wearer_ns: None,
        };
        let bar = progress_bar(0, "predicting the PSNR of images")?;
        walk.world.prepare(&|done, count| {
            bar.set_length(count as u64);
            bar.inc(1);
            if bar.is_hidden() && 10 * done / count > 10 * (done - 1) / count {
                log::info!("predicted the PSNR of {done} of {count} images");
            }
            ControlFlow::Continue(())
        })?;
        bar.finish_and_clear();
        walk.world.reset(None, None)?;
        Ok(walk)
    }

    /// Begins at another start.
    pub(super) fn reset(&mut self) -> Result<()> {
        self.before_m += f64::from(self.world.result().path_length_m[0]);
        self.before_collisions += self.world.result().collisions[0];
        self.guides.iter_mut().for_each(Guide::forget);
        self.wearer_ns = None;
        Ok(self.world.reset(None, None)?)
    }

    /// Time of a step, s.
    pub(super) fn step_s(&self) -> f64 {
        self.world.config().dt_s
    }

    /// The action that leads to the next goal.
    pub(super) fn guide(&mut self) -> [f64; 2] {
        let sector = self.world.world_from_camera(0).0;
        self.guides[sector].action(&self.world.states()[0], REACHED_M)
    }

    /// Moves the agent by a step; where that ends the episode, another begins.
    pub(super) fn step(&mut self, action: [f64; 2]) -> Result<()> {
        self.wearer_ns = None;
        self.world.step(&action)?;
        if self.world.has_ended(0) {
            self.ends += 1;
            self.reset()?;
        }
        Ok(())
    }

    /// Whether there is a recorded wearer.
    pub(super) fn has_wearer(&self) -> bool {
        self.recorded_ns.is_some()
    }

    /// Puts the agent where the recorded wearer was a step later; at first, and after the last
    /// pose, where the walk begins. Spans without a pose above known ground are left out.
    /// Returns whether the walk begins here.
    pub(super) fn follow_wearer(&mut self) -> Result<bool> {
        let [first_ns, last_ns] = self.recorded_ns.context("the scene has no trajectory")?;
        let step_ns = (1e9 * self.step_s()) as i64;
        let (mut time_ns, mut is_begin) = match self.wearer_ns {
            Some(time_ns) => (time_ns + step_ns, false),
            None => (first_ns, true),
        };
        for _ in 0..=2 * ((last_ns - first_ns) / step_ns + 1) {
            if time_ns > last_ns {
                (time_ns, is_begin) = (first_ns, true);
            }
            if self.world.play(0, time_ns)? {
                self.wearer_ns = Some(time_ns);
                return Ok(is_begin);
            }
            time_ns += step_ns;
        }
        bail!("the recorded walk is nowhere above known ground");
    }

    /// What the agent sees, a JPEG file.
    pub(super) fn image(&mut self) -> Result<Vec<u8>> {
        let (sector, world_from_camera) = self.world.world_from_camera(0);
        let request = FrameRequest::new(sector, world_from_camera);
        self.camera.render(&[request], &mut self.frames)?;
        let mut file = Vec::new();
        let encoder = Encoder::new(&mut file, JPEG_QUALITY);
        let [width, height] = SIZE.map(|edge| edge as u16);
        let encoded = encoder.encode(&self.frames.rgb, width, height, ColorType::Rgb);
        encoded.context("encoding an image")?;
        Ok(file)
    }

    /// The agent.
    pub(super) fn state(&self) -> &AgentState {
        &self.world.states()[0]
    }

    /// Its position on the map, px.
    pub(super) fn map_px(&self) -> [f64; 2] {
        self.px(self.state().position_m)
    }

    /// Its heading on the map, counterclockwise from the right, rad.
    pub(super) fn heading_rad(&self) -> f64 {
        let sector = self.world.world_from_camera(0).0;
        let yaw_rad = self.state().yaw_rad;
        let [x, y, _] =
            self.map_from_sectors[sector].rotate([libm::cos(yaw_rad), libm::sin(yaw_rad), 0.0]);
        libm::atan2(y, x)
    }

    /// A position in the sector of the agent on the map, px.
    fn px(&self, position_m: [f64; 3]) -> [f64; 2] {
        let sector = self.world.world_from_camera(0).0;
        let [x, y, _] = self.map_from_sectors[sector].apply(position_m);
        self.map.px([x, y])
    }

    /// Its goal on the map, px.
    pub(super) fn goal_px(&self) -> Option<[f64; 2]> {
        let sector = self.world.world_from_camera(0).0;
        Some(self.px(self.guides[sector].goal_m()?))
    }

    /// Goals that it reached.
    pub(super) fn goals_reached(&self) -> u32 {
        self.guides.iter().map(Guide::goals_reached).sum()
    }

    /// Path length of all episodes, m.
    pub(super) fn path_m(&self) -> f64 {
        self.before_m + f64::from(self.world.result().path_length_m[0])
    }

    /// Episodes that ended.
    pub(super) fn ends(&self) -> u32 {
        self.ends
    }

    /// Steps of all episodes that something stopped.
    pub(super) fn collisions(&self) -> u32 {
        self.before_collisions + self.world.result().collisions[0]
    }

    /// Predicted PSNR of what the agent sees, dB; `None` where it is not known what the training
    /// saw.
    fn predicted_psnr_db(&mut self) -> Result<Option<f32>> {
        let (sector, sector_from_camera) = self.world.world_from_camera(0);
        if self.judge.as_ref().is_none_or(|(of, _)| *of != sector) {
            let lens = simulation::pinhole(JUDGED_SIZE, FIELD_OF_VIEW_RAD)?;
            let gaussians = self.world.scene().sectors[sector].gaussians.as_ref();
            let judge = gaussians.map(|gaussians| {
                let scene = Arc::clone(&self.store.content(sector)?.exact);
                ViewJudge::new(gaussians, scene, lens)
            });
            self.judge = Some((sector, judge.transpose()?.flatten()));
        }
        let judge = self.judge.as_ref().and_then(|(_, judge)| judge.as_ref());
        Ok(judge
            .map(|judge| judge.psnr_db(&sector_from_camera))
            .transpose()?)
    }

    /// Where it is beside the recording, in a few words.
    ///
    /// # Errors
    /// Gaussians that cannot be read.
    pub(super) fn caption(&mut self) -> Result<String> {
        // What decides ends, where something is decided by it.
        let predicted_db = match self.world.support().is_empty() {
            false => Some(self.world.result().support_db[0]),
            true => self.predicted_psnr_db()?,
        };
        let result = self.world.result();
        let mut text = match (self.wearer_ns, self.recorded_ns) {
            (Some(now_ns), Some([first_ns, _])) => {
                format!("the wearer at {:.1} s", 1e-9 * (now_ns - first_ns) as f64)
            }
            _ => format!("{:.1} m walked", self.path_m()),
        };
        if result.deviation_m[0] >= 0.0 {
            text += &format!(
                ", {:.1} m and {:.0}° from the nearest recorded camera",
                result.deviation_m[0],
                result.deviation_rad[0].to_degrees()
            );
        }
        if let Some(psnr_db) = predicted_db {
            text += &format!("; PSNR {psnr_db:.0} dB predicted");
        }
        Ok(text)
    }
}

/// The recorded walk on a map, m.
fn path_on_map(recording: &Recording, map_from_sector: &Similarity) -> Vec<[f64; 2]> {
    let trajectory = recording.trajectory.iter();
    let poses = trajectory.flat_map(|trajectory| trajectory.usable());
    let positions = poses.map(|pose| map_from_sector.apply(pose.world_from_rig.translation_m()));
    positions.map(|[x, y, _]| [x, y]).collect()
}
