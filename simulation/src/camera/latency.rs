//! When a camera captures and when its frames are delivered.
//!
//! Every environment has its own clock in ns, 0 at its reset. Frame `k` is captured at
//! `phase + k · interval` and delivered its latency later; at a control step the newest frame
//! counts that was captured and delivered by then. A queue holds poses, never images: frames that
//! are superseded cost nothing, and the state of a queue is plain data.

use cad_transforms::RigidTransform;
use estimator_config::config;
use serde::{Deserialize, Serialize};

use super::frames::{FrameRequest, NoiseKey};
use crate::error::{SimulationError, check_range};
use crate::randomness::{RandomStream, Stream};
use crate::scene::SceneData;

config! {
    /// When a camera captures, and when its frames are delivered. Each environment draws its own
    /// values, once per episode.
    pub struct TimingConfig {
        /// Range of the time between two frames, s. 0 to 0 captures at the end of every control
        /// step.
        pub interval_s: [f64; 2] = [0.0, 0.0],
        /// Range of the time of the first frame after a reset, in intervals.
        pub phase: [f64; 2] = [0.0, 0.0],
        /// Range of the time from capture to delivery, s.
        pub latency_s: [f64; 2] = [0.0, 0.0],
        /// Time after which the latency is drawn again, s; 0 for each frame.
        pub redraw_s: f64 = 0.0,
    }
}

/// Frames that may be in transit where frames have an interval, at most. It bounds the memory of
/// a queue.
const MAX_IN_TRANSIT: f64 = 16.0;

impl TimingConfig {
    /// A fixed rate, 1/s, and a fixed latency, s.
    pub fn regular(rate_hz: f64, latency_s: f64) -> Self {
        Self {
            interval_s: [1.0 / rate_hz; 2],
            latency_s: [latency_s; 2],
            ..Self::default()
        }
    }

    /// The ranges of GaussGym: intervals of 0.05 to 0.15 s, latencies of 0.12 to 0.3 s, drawn again
    /// every 3 s. Source: `config_vision.yaml` of escontra/gauss_gym (f356bc7). There all
    /// environments share one interval; here each has its own, and a phase.
    pub fn gauss_gym() -> Self {
        Self {
            interval_s: [0.05, 0.15],
            phase: [0.0, 1.0],
            latency_s: [0.12, 0.3],
            redraw_s: 3.0,
        }
    }

    pub(super) fn check(&self) -> Result<(), SimulationError> {
        let ranges = [
            ("interval_s", self.interval_s, [0.0, 100.0]),
            ("phase", self.phase, [0.0, 1.0]),
            ("latency_s", self.latency_s, [0.0, 100.0]),
            ("redraw_s", [self.redraw_s; 2], [0.0, 1e6]),
        ];
        for (name, [low, high], [least, most]) in ranges {
            if !(least <= low && low <= high && high <= most) {
                return Err(SimulationError::Setting {
                    name: format!("camera.timing.{name}"),
                    found: format!("{low} to {high}"),
                    expected: format!("an ascending range within {least} to {most}"),
                });
            }
        }
        let [shortest, longest] = self.interval_s;
        if longest == 0.0 {
            return Ok(());
        }
        let name = "camera.timing.interval_s";
        check_range(
            name,
            shortest,
            [1e-4, 100.0],
            "0 to 0, or at least 0.0001 s",
        )?;
        let in_transit = self.latency_s[1] / shortest;
        let expected = "at most 16 frames in transit: a shorter latency or a longer interval";
        check_range(
            "camera.timing.latency_s / interval_s",
            in_transit,
            [0.0, MAX_IN_TRANSIT],
            expected,
        )
    }
}

/// Times of the frames of one camera in one episode, ns after the reset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSchedule {
    /// Time of the first frame, ns.
    pub phase_ns: i64,
    /// Time between frames, ns; 0 for a frame per control step.
    pub interval_ns: i64,
    /// Range of the latency, ns.
    pub latency_ns: [i64; 2],
    /// Time after which the latency is drawn again, ns; 0 for each frame.
    pub redraw_ns: i64,
    /// Seed of the environment.
    pub seed: u64,
    /// Its episode.
    pub episode: u64,
}

impl CameraSchedule {
    /// Draws the times of an episode.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for ranges that are not ascending, and for latencies of more
    /// than 16 intervals.
    pub fn new(config: &TimingConfig, seed: u64, episode: u64) -> Result<Self, SimulationError> {
        config.check()?;
        let stream = RandomStream::new(seed, episode, Stream::Camera);
        let interval_s = stream.range(0, config.interval_s);
        let phase = stream.range(1, config.phase);
        Ok(Self {
            phase_ns: nanoseconds(phase * interval_s),
            interval_ns: nanoseconds(interval_s),
            latency_ns: config.latency_s.map(nanoseconds),
            redraw_ns: nanoseconds(config.redraw_s),
            seed,
            episode,
        })
    }

    /// Time at which frame `index` is captured, ns.
    pub fn capture_ns(&self, index: u64) -> i64 {
        self.interval_ns
            .saturating_mul(index as i64)
            .saturating_add(self.phase_ns)
    }

    /// Time from capture to delivery of frame `index`, captured at a time, ns.
    pub fn latency_ns(&self, index: u64, capture_ns: i64) -> i64 {
        let [least, most] = self.latency_ns;
        let draw = match self.redraw_ns {
            0 => index,
            redraw_ns => (capture_ns / redraw_ns) as u64,
        };
        // 0 is left to the latency that holds for a whole episode.
        let uniform = RandomStream::new(self.seed, self.episode, Stream::Latency).uniform(draw + 1);
        least + ((most - least) as f64 * uniform).round() as i64
    }
}

fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

/// A camera pose in a sector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraView {
    /// Index of the sector.
    pub sector: usize,
    /// The optical frame in the frame of the sector.
    pub world_from_camera: RigidTransform,
}

/// A frame that was captured, not yet rendered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Capture {
    /// 0 for the frame of the reset, `k + 1` for frame `k` of the schedule.
    pub number: u64,
    /// When it was captured, ns after the reset.
    pub time_ns: i64,
    /// When it is delivered, ns after the reset.
    pub delivery_ns: i64,
    /// Index of the sector.
    pub sector: usize,
    /// The optical frame in the frame of the sector.
    pub world_from_camera: RigidTransform,
    /// Velocity of the camera in its own axes, m/s.
    pub velocity_m_s: [f64; 3],
    /// Angular rate in its own axes, rad/s.
    pub rate_rad_s: [f64; 3],
}

/// Frames of one camera in one environment: the one that is shown, and those in transit.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use simulation::testing::SyntheticScene;
/// use simulation::{CameraSchedule, CameraView, FrameQueue, TimingConfig};
///
/// let scene = SyntheticScene::room()?.scene;
/// let at = |x: f64| CameraView {
///     sector: 0,
///     world_from_camera: RigidTransform::from_translation_m([x, 0.0, 1.0]).unwrap(),
/// };
/// // 10 Hz, delivered 150 ms later; 1 m/s.
/// let schedule = CameraSchedule::new(&TimingConfig::regular(10.0, 0.15), 0, 0)?;
/// let mut queue = FrameQueue::new(schedule, &at(0.0));
/// queue.advance(&scene, &at(0.0), &at(0.3), 300_000_000);
/// // That of 0.1 s is there, that of 0.2 s is in transit.
/// assert_eq!(queue.shown.time_ns, 100_000_000);
/// assert!((queue.shown.world_from_camera.translation_m()[0] - 0.1).abs() < 1e-12);
/// assert_eq!(queue.age_s(), 0.2);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameQueue {
    /// Times of all frames.
    pub schedule: CameraSchedule,
    /// Time of the environment, ns after the reset.
    pub now_ns: i64,
    /// Index of the next frame of the schedule.
    pub next: u64,
    /// The newest frame that was delivered; that of the reset before any other.
    pub shown: Capture,
    /// Frames in transit that are newer, by their number.
    pub in_transit: Vec<Capture>,
}

impl FrameQueue {
    /// The queue after a reset: the frame at that pose is shown, nothing is in transit.
    pub fn new(schedule: CameraSchedule, start: &CameraView) -> Self {
        Self {
            schedule,
            now_ns: 0,
            next: 0,
            shown: Capture {
                number: 0,
                time_ns: 0,
                delivery_ns: 0,
                sector: start.sector,
                world_from_camera: start.world_from_camera,
                velocity_m_s: [0.0; 3],
                rate_rad_s: [0.0; 3],
            },
            in_transit: Vec::new(),
        }
    }

    /// Advances the time by a control step during which the camera moved between two poses.
    /// Captures are at poses between them: translation and rotation at constant rates. Where the
    /// agent changed its sector, the pose before is carried over the edge; without an edge between
    /// the two sectors (several were crossed) captures are at the pose after.
    pub fn advance(
        &mut self,
        scene: &SceneData,
        before: &CameraView,
        after: &CameraView,
        duration_ns: i64,
    ) {
        let begin_ns = self.now_ns;
        self.now_ns = begin_ns.saturating_add(duration_ns.max(0));
        let motion = Motion::new(scene, before, after, duration_ns);
        loop {
            let index = self.next;
            let capture_ns = match self.schedule.interval_ns {
                0 => self.now_ns,
                _ => self.schedule.capture_ns(index),
            };
            if capture_ns > self.now_ns {
                break;
            }
            let latency_ns = self.schedule.latency_ns(index, capture_ns);
            self.in_transit.push(motion.capture(
                Capture {
                    number: index + 1,
                    time_ns: capture_ns,
                    delivery_ns: capture_ns.saturating_add(latency_ns),
                    ..self.shown
                },
                begin_ns,
            ));
            self.next += 1;
            if self.schedule.interval_ns == 0 {
                break;
            }
        }
        let is_delivered = |frame: &Capture| frame.delivery_ns <= self.now_ns;
        if let Some(newest) = self.in_transit.iter().rposition(is_delivered) {
            self.shown = self.in_transit[newest];
            // Older ones are superseded.
            self.in_transit.drain(..=newest);
        }
    }

    /// Time since the frame that is shown was captured, s.
    pub fn age_s(&self) -> f64 {
        (self.now_ns - self.shown.time_ns) as f64 * 1e-9
    }

    /// The frame that is shown, for rendering. `camera` distinguishes the noise of several cameras
    /// of an environment.
    pub fn request(&self, camera: u8) -> FrameRequest {
        let shown = &self.shown;
        let mut request = FrameRequest::new(shown.sector, shown.world_from_camera);
        request.velocity_m_s = shown.velocity_m_s;
        request.rate_rad_s = shown.rate_rad_s;
        request.noise = NoiseKey {
            seed: self.schedule.seed,
            episode: self.schedule.episode,
            frame: shown.number,
            camera,
        };
        request
    }
}

/// Motion of a camera in a control step, in the sector at its end.
struct Motion {
    sector: usize,
    begin: RigidTransform,
    /// Translation in the sector, m.
    translation_m: [f64; 3],
    /// Rotation vector in the axes of the camera, rad.
    rotation_rad: [f64; 3],
    duration_ns: i64,
}

impl Motion {
    fn new(scene: &SceneData, before: &CameraView, after: &CameraView, duration_ns: i64) -> Self {
        let end = after.world_from_camera;
        let begin = match before.sector == after.sector {
            true => before.world_from_camera,
            false => {
                let edges = scene
                    .sectors
                    .get(before.sector)
                    .map_or(&[][..], |s| &s.edges);
                let edge = edges.iter().find(|edge| edge.to == after.sector);
                edge.map_or(end, |edge| {
                    edge.to_from_here.carry(&before.world_from_camera)
                })
            }
        };
        let [from, to] = [begin, end].map(|pose| pose.translation_m());
        Self {
            sector: after.sector,
            begin,
            translation_m: [0, 1, 2].map(|k| to[k] - from[k]),
            rotation_rad: (begin.inverse() * end).rotation_vector(),
            duration_ns,
        }
    }

    /// A frame at its time in the step.
    fn capture(&self, frame: Capture, begin_ns: i64) -> Capture {
        let duration_ns = self.duration_ns.max(1) as f64;
        let share = (frame.time_ns - begin_ns) as f64 / duration_ns;
        let rotation = self.rotation_rad.map(|v| v * share);
        let turned = RigidTransform::from_rotation_vector(rotation, [0.0; 3])
            .map_or(self.begin, |motion| self.begin * motion);
        let from = self.begin.translation_m();
        let position = [0, 1, 2].map(|k| from[k] + share * self.translation_m[k]);
        let pose = RigidTransform::from_wxyz(turned.rotation_wxyz(), position).unwrap_or(turned);
        let per_s = 1e9 / duration_ns;
        let velocity = self.translation_m.map(|v| v * per_s);
        Capture {
            sector: self.sector,
            world_from_camera: pose,
            velocity_m_s: pose.inverse().rotate(velocity),
            rate_rad_s: self.rotation_rad.map(|v| v * per_s),
            ..frame
        }
    }
}

#[cfg(test)]
mod tests;
