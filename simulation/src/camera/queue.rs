//! Frames of a camera in transit.
//!
//! A queue holds poses, never images: frames that are superseded cost nothing, and the state of a
//! queue is plain data.

use cad_transforms::RigidTransform;

use super::frames::{FrameRequest, NoiseKey};
use super::latency::CameraSchedule;
use crate::scene::SceneData;

/// Frames in transit at most: those of 16 intervals, ends included.
pub(crate) const MAX_QUEUE: usize = 17;

/// A camera pose in a sector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraView {
    /// Index of the sector.
    pub sector: usize,
    /// The optical frame in the frame of the sector.
    pub world_from_camera: RigidTransform,
}

impl CameraView {
    /// The same pose with a quaternion of unit length to the last bits, which it keeps when it is
    /// written and read.
    fn normalized(self) -> Self {
        let pose = self.world_from_camera;
        let unit = RigidTransform::from_wxyz(pose.rotation_wxyz(), pose.translation_m());
        Self {
            world_from_camera: unit.unwrap_or(pose),
            ..self
        }
    }
}

/// A frame that was captured, not yet rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
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
/// queue.advance(&scene, &at(0.3), 300_000_000);
/// // That of 0.1 s is there, that of 0.2 s is in transit.
/// assert_eq!(queue.current.time_ns, 100_000_000);
/// assert!((queue.current.world_from_camera.translation_m()[0] - 0.1).abs() < 1e-12);
/// assert_eq!(queue.age_s(), 0.2);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct FrameQueue {
    /// Times of all frames.
    pub schedule: CameraSchedule,
    /// Time of the environment, ns after the reset.
    pub now_ns: i64,
    /// Where the camera is at that time.
    pub camera: CameraView,
    /// Index of the next frame of the schedule.
    pub next: u64,
    /// The newest frame that was delivered; that of the reset before any other.
    pub current: Capture,
    /// Frames in transit that are newer, by their number; at most 17.
    pub in_transit: Vec<Capture>,
}

impl FrameQueue {
    /// The queue after a reset: the frame at that pose is shown, nothing is in transit.
    pub fn new(schedule: CameraSchedule, start: &CameraView) -> Self {
        let start = start.normalized();
        Self {
            schedule,
            now_ns: 0,
            camera: start,
            next: 0,
            current: Capture {
                number: 0,
                time_ns: 0,
                delivery_ns: 0,
                sector: start.sector,
                world_from_camera: start.world_from_camera,
                velocity_m_s: [0.0; 3],
                rate_rad_s: [0.0; 3],
            },
            in_transit: Vec::with_capacity(MAX_QUEUE),
        }
    }

    /// The queue after a number of control steps, before any of its frames is known: their numbers
    /// and times follow from those of the steps. `None` if more frames would be in transit than a
    /// queue has after the frame that is shown.
    pub(crate) fn after_steps(
        schedule: CameraSchedule,
        camera: &CameraView,
        [steps, current]: [u64; 2],
        step_ns: i64,
    ) -> Option<Self> {
        let at_step_ns =
            |step: u64| step_ns.saturating_mul(i64::try_from(step).unwrap_or(i64::MAX));
        let now_ns = at_step_ns(steps);
        let next = match schedule.interval_ns {
            0 => steps,
            // The first step captures a frame of the time of the reset, not the reset.
            _ if steps == 0 || now_ns < schedule.phase_ns => 0,
            interval_ns => ((now_ns - schedule.phase_ns) / interval_ns) as u64 + 1,
        };
        let in_transit = next.checked_sub(current)?;
        if in_transit > MAX_QUEUE as u64 {
            return None;
        }
        let mut queue = Self {
            now_ns,
            next,
            ..Self::new(schedule, camera)
        };
        let unknown = queue.current;
        let frame = |number: u64| {
            let time_ns = match (number, schedule.interval_ns) {
                (0, _) => 0,
                (_, 0) => at_step_ns(number),
                _ => schedule.capture_ns(number - 1),
            };
            let latency_ns = match number {
                0 => 0,
                _ => schedule.latency_ns(number - 1, time_ns),
            };
            Capture {
                number,
                time_ns,
                delivery_ns: time_ns.saturating_add(latency_ns),
                ..unknown
            }
        };
        let mut frames = (current..=next).map(frame);
        queue.current = frames.next()?;
        queue.in_transit.extend(frames);
        Some(queue)
    }

    /// Advances the time by a control step, at whose end the camera is at a pose. Captures are at
    /// poses between that of the step before and this one: translation and rotation at constant
    /// rates. Where the agent changed its sector, the pose before is carried over the edge; without
    /// an edge between the two sectors (several were crossed) captures are at the pose after.
    pub fn advance(&mut self, scene: &SceneData, after: &CameraView, duration_ns: i64) {
        let after = after.normalized();
        let begin_ns = self.now_ns;
        self.now_ns = begin_ns.saturating_add(duration_ns.max(0));
        let motion = Motion::new(scene, &self.camera, &after, duration_ns);
        self.camera = after;
        // Before the new ones come in, so that the queue never has more than those in transit.
        self.deliver();
        while let Some(frame) = self.next_capture() {
            let capture = motion.capture(frame, begin_ns);
            self.next += 1;
            match capture.delivery_ns <= self.now_ns {
                true => {
                    self.current = capture;
                    // Older ones are superseded.
                    self.in_transit.clear();
                }
                false => self.in_transit.push(capture),
            }
            if self.schedule.interval_ns == 0 {
                break;
            }
        }
    }

    /// Number and times of the next frame, if it was captured by now; its pose is not known yet.
    fn next_capture(&self) -> Option<Capture> {
        let (index, time_ns) = (self.next, self.time_ns(self.next + 1));
        // Times that saturated have no end.
        (time_ns <= self.now_ns && time_ns < i64::MAX).then(|| Capture {
            number: index + 1,
            time_ns,
            delivery_ns: time_ns.saturating_add(self.schedule.latency_ns(index, time_ns)),
            ..self.current
        })
    }

    /// When a frame was captured; one frame per step is captured now.
    fn time_ns(&self, number: u64) -> i64 {
        match (number, self.schedule.interval_ns) {
            (0, _) => 0,
            (_, 0) => self.now_ns,
            (number, _) => self.schedule.capture_ns(number - 1),
        }
    }

    /// Shows the newest frame that was delivered by now.
    fn deliver(&mut self) {
        let is_delivered = |frame: &Capture| frame.delivery_ns <= self.now_ns;
        if let Some(newest) = self.in_transit.iter().rposition(is_delivered) {
            self.current = self.in_transit[newest];
            self.in_transit.drain(..=newest);
        }
    }

    /// Time since the frame that is shown was captured, s.
    pub fn age_s(&self) -> f64 {
        (self.now_ns - self.current.time_ns) as f64 * 1e-9
    }

    /// The frame that is shown, for rendering. `camera` distinguishes the noise of several cameras
    /// of an environment.
    pub fn request(&self, camera: u8) -> FrameRequest {
        let current = &self.current;
        let mut request = FrameRequest::new(current.sector, current.world_from_camera);
        request.velocity_m_s = current.velocity_m_s;
        request.rate_rad_s = current.rate_rad_s;
        request.noise = NoiseKey {
            seed: self.schedule.seed,
            episode: self.schedule.episode,
            frame: current.number,
            camera,
        };
        request
    }
}

/// Motion of a camera in a control step, in the sector at its end.
struct Motion {
    sector: usize,
    begin: RigidTransform,
    end: RigidTransform,
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
            end,
            translation_m: [0, 1, 2].map(|k| to[k] - from[k]),
            rotation_rad: (begin.inverse() * end).rotation_vector(),
            duration_ns,
        }
    }

    /// A frame at its time in the step.
    fn capture(&self, frame: Capture, begin_ns: i64) -> Capture {
        let duration_ns = self.duration_ns.max(1) as f64;
        let share = (frame.time_ns - begin_ns) as f64 / duration_ns;
        let pose = match share < 1.0 {
            true => self.pose(share),
            false => self.end,
        };
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

    /// The pose after a share of the step.
    fn pose(&self, share: f64) -> RigidTransform {
        let rotation = self.rotation_rad.map(|v| v * share);
        let rotated = RigidTransform::from_rotation_vector(rotation, [0.0; 3])
            .map_or(self.begin, |motion| self.begin * motion);
        let from = self.begin.translation_m();
        let position = [0, 1, 2].map(|k| from[k] + share * self.translation_m[k]);
        RigidTransform::from_wxyz(rotated.rotation_wxyz(), position).unwrap_or(rotated)
    }
}
