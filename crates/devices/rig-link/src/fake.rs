//! A fake rig without hardware: its status is set explicitly, and it records requested actions. For
//! tests, and for viewing the page (`cargo run -p rig-link --example demo`).
//!
//! [`ManualClock`] drives the limits of a server.
//!
//! Its images change with its clock. Its sessions are real ones, written by [`write_session`].

mod clock;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use session_archive::manifest::{Camera, Imu, Stop};
use session_archive::record::Frame;
use session_archive::storage::DiskStorage;
use session_archive::time::{CivilTime, HostTime, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter};

pub use self::clock::ManualClock;
use crate::preview::{Eyes, Planes, jpeg};
use crate::rig::{Action, Battery, ClockStatus, PageStatus, Preview, Rig, State, StreamStatus};

/// State of the fake rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scene {
    /// Two of three cameras deliver.
    Idle,
    /// Everything is ready.
    Armed,
    /// Recording, all well.
    Recording,
    /// The last frames are being written.
    Stopping,
    /// Recording, with drops and a disk that fills up.
    Warning,
    /// A camera is disconnected and it cannot record.
    Fault,
}

impl Scene {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Idle,
        Self::Armed,
        Self::Recording,
        Self::Stopping,
        Self::Warning,
        Self::Fault,
    ];

    /// Name on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Armed => "armed",
            Self::Recording => "recording",
            Self::Stopping => "stopping",
            Self::Warning => "warning",
            Self::Fault => "fault",
        }
    }

    fn state(self) -> State {
        match self {
            Self::Idle => State::Idle,
            Self::Armed => State::Armed,
            Self::Recording | Self::Warning => State::Recording,
            Self::Stopping => State::Stopping,
            Self::Fault => State::Fault,
        }
    }
}

/// Width and height of an eye of the fake's cameras, pixels.
const EYE: (usize, usize) = (320, 188);
const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];

/// The fake rig.
pub struct FakeRig {
    root: PathBuf,
    clock: Box<dyn Fn() -> Duration + Send + Sync>,
    inner: Mutex<Inner>,
}

struct Inner {
    scene: Scene,
    /// Start time of the scene.
    since: Duration,
    /// Folder of the session that is "being recorded".
    session: Option<String>,
    actions: Vec<Action>,
    rejection: Option<String>,
}

impl FakeRig {
    /// A fake rig with the sessions in `root` and this clock.
    pub fn new(
        root: impl Into<PathBuf>,
        scene: Scene,
        clock: impl Fn() -> Duration + Send + Sync + 'static,
    ) -> Self {
        let inner = Inner {
            scene,
            since: clock(),
            session: None,
            actions: Vec::new(),
            rejection: None,
        };
        Self {
            root: root.into(),
            clock: Box::new(clock),
            inner: Mutex::new(inner),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the scene.
    pub fn show(&self, scene: Scene) {
        let now = (self.clock)();
        let mut inner = self.lock();
        (inner.scene, inner.since) = (scene, now);
    }

    /// Sets the folder of the session that is being recorded, or none.
    pub fn record(&self, session: Option<&str>) {
        self.lock().session = session.map(str::to_owned);
    }

    /// Rejects all actions with this text, or no longer.
    pub fn refuse(&self, why: Option<&str>) {
        self.lock().rejection = why.map(str::to_owned);
    }

    /// The requested actions so far.
    pub fn actions(&self) -> Vec<Action> {
        self.lock().actions.clone()
    }
}

impl Rig for FakeRig {
    fn status(&self) -> PageStatus {
        let inner = self.lock();
        let elapsed = (self.clock)().saturating_sub(inner.since).as_secs_f64();
        status(inner.scene, inner.session.clone(), elapsed)
    }

    fn act(&self, action: Action) -> Result<(), String> {
        let mut inner = self.lock();
        inner.actions.push(action.clone());
        if let Some(why) = &inner.rejection {
            return Err(why.clone());
        }
        let recording = matches!(inner.scene, Scene::Recording | Scene::Warning);
        inner.scene = match action {
            Action::Start { .. } if inner.scene == Scene::Armed => Scene::Recording,
            Action::Start { .. } if recording => return Err("it records already".to_owned()),
            Action::Start { .. } => return Err("not every stream has delivered yet".to_owned()),
            Action::Mark { .. } | Action::Stop if !recording => {
                return Err("nothing is being recorded".to_owned());
            }
            Action::Mark { .. } => inner.scene,
            Action::Stop => Scene::Armed,
            Action::Discard if recording => Scene::Armed,
            Action::Discard => inner.scene,
        };
        inner.since = (self.clock)();
        Ok(())
    }

    fn preview(&self, camera: usize) -> Option<Preview> {
        let scene = self.lock().scene;
        let missing = match scene {
            Scene::Fault => Some(1),
            Scene::Idle => Some(2),
            _ => None,
        };
        if camera >= CAMERAS.len() || missing == Some(camera) {
            return None;
        }
        let tick = ((self.clock)().as_millis() / 200) as usize;
        let data = image(camera, tick);
        let planes = Planes {
            width: EYE.0 as u32,
            height: EYE.1 as u32,
            data: &data,
        };
        Some(Preview {
            jpeg: jpeg(planes, Eyes::Both, EYE.0 as u32).ok()?.into(),
            sequence: tick as u64,
        })
    }

    fn sessions_root(&self) -> PathBuf {
        self.root.clone()
    }

    fn is_recording(&self, session: &str) -> bool {
        self.lock().session.as_deref() == Some(session)
    }
}

/// Status in a scene, `elapsed` seconds after its start.
fn status(scene: Scene, session: Option<String>, elapsed: f64) -> PageStatus {
    let recording = matches!(scene, Scene::Recording | Scene::Warning | Scene::Stopping);
    let seconds = match scene {
        Scene::Warning => 2712.0 + elapsed,
        _ if recording => 754.0 + elapsed,
        Scene::Armed => 1804.0,
        _ => 0.0,
    };
    let stream = |name: &str, rate: f64, nominal: f64, missing: u64| StreamStatus {
        name: name.to_owned(),
        rate_hz: rate,
        nominal_hz: Some(nominal),
        received: ((seconds + 60.0) * nominal) as u64,
        stored: (seconds * nominal) as u64,
        missing,
        silent: rate == 0.0,
        frozen: false,
    };
    let warns = scene == Scene::Warning;
    let feet = if scene == Scene::Idle { 0.0 } else { 29.97 };
    let (right, feet_drops) = match scene {
        Scene::Warning => (27.4, 0),
        Scene::Fault => (0.0, 0),
        _ => (30.0, 0),
    };
    let mut status = PageStatus::new(scene.state());
    status.session =
        session.or_else(|| (seconds > 0.0).then(|| "2026-05-04T09-31-07Z_1a2b3c4d".to_owned()));
    status.seconds = seconds;
    status.cameras = CAMERAS.map(str::to_owned).to_vec();
    status.streams = vec![
        stream("left_shoulder", 30.0, 30.0, 0),
        stream("right_shoulder", right, 30.0, if warns { 143 } else { 0 }),
        stream("feet", feet, 30.0, feet_drops),
        stream("left_shoulder/imu", 200.0, 200.0, 0),
        stream(
            "right_shoulder/imu",
            if right == 0.0 { 0.0 } else { 200.1 },
            200.0,
            0,
        ),
        stream("feet/imu", 799.6, 800.0, 0),
    ];
    status.free_bytes = Some(if warns {
        9_400_000_000
    } else {
        412_000_000_000
    });
    status.seconds_left = Some(if warns {
        1260.0 - elapsed
    } else {
        55_320.0 - elapsed
    });
    status.temperature_c = Some(if warns { 86.5 } else { 61.2 });
    status.battery = Some(Battery {
        percent: if warns { 18.0 } else { 76.0 },
        charging: false,
        minutes_left: Some(if warns { 24.0 } else { 131.0 }),
    });
    status.clock = Some(ClockStatus {
        synchronised: scene != Scene::Fault,
        offset_ns: (scene != Scene::Fault).then_some(-38_400),
        source: if scene == Scene::Fault { "" } else { "chrony" }.to_owned(),
    });
    status.alarms = match scene {
        Scene::Idle => vec!["feet: no image yet".to_owned()],
        Scene::Warning => vec![
            "disk: 21 minutes left".to_owned(),
            "right_shoulder: the encoder is too slow, 143 frames dropped".to_owned(),
            "86 °C: fewer previews".to_owned(),
        ],
        Scene::Fault => vec![
            "right_shoulder: camera is disconnected (unplugged?)".to_owned(),
            "clock: not synchronized".to_owned(),
        ],
        _ => Vec::new(),
    };
    status.encoders = CAMERAS.map(|c| format!("{c}: nvv4l2h265enc")).to_vec();
    status
}

/// A moving street, I420.
fn image(camera: usize, tick: usize) -> Vec<u8> {
    let (width, height) = EYE;
    let horizon = [height * 2 / 5, height * 2 / 5, height / 6][camera.min(2)];
    let shift = tick * 7 + camera * 91;
    let mut luma = Vec::with_capacity(width * height * 3 / 2);
    let is_house = |x: usize, y: usize| {
        let column = (x + shift) / 46;
        let top = horizon.saturating_sub(12 + column * 37 % 40);
        y < horizon && y >= top && (x + shift) % 46 < 38
    };
    for y in 0..height {
        for x in 0..width {
            let value = if is_house(x, y) {
                let window = (x + shift) % 46 % 12 > 4 && y % 14 > 6;
                if window { 70 } else { 145 }
            } else if y < horizon {
                225 - y / 4
            } else {
                // Joints of the pavement approach.
                let depth = y - horizon + 6;
                let row = (6000 / depth + tick * 9) / 40 % 2;
                let column =
                    ((x as isize - width as isize / 2) * 90 / depth as isize + 4000) / 60 % 2;
                let tile = if row as isize == column { 8 } else { 0 };
                92 + (y - horizon) / 3 + tile
            };
            luma.push(value.min(255) as u8);
        }
    }
    let chroma = |sky: u8, house: u8, ground: u8| {
        let places = (0..height / 2).flat_map(|y| (0..width / 2).map(move |x| (x, y)));
        places.map(
            move |(x, y)| match (is_house(2 * x, 2 * y), 2 * y < horizon) {
                (true, _) => house,
                (false, true) => sky,
                (false, false) => ground,
            },
        )
    };
    luma.extend(chroma(148, 112, 124).collect::<Vec<_>>());
    luma.extend(chroma(112, 146, 130).collect::<Vec<_>>());
    luma
}

/// Writes a session of one camera and one IMU into `root/NAME`, valid except for the images, which
/// are arbitrary bytes. Its content is a function of `seed`; a second is about 60 kB.
///
/// # Panics
/// An I/O error occurs. For tests only.
pub fn write_session(root: &Path, name: &str, seed: u64, seconds: u32) {
    let folder = root.join(name);
    std::fs::create_dir_all(&folder).expect("make the session's folder");
    let start = HostTime(5_000_000_000_000);
    let spec = SessionSpec {
        session_id: format!("0192aa00-0000-7000-8000-{seed:012x}"),
        name: name.to_owned(),
        software: "fake".to_owned(),
        started: start,
        started_civil: CivilTime(1_790_000_000_000_000_000 + seed as i64 * 3_600_000_000_000),
        chunk_ns: 500_000_000,
        cameras: vec![Camera {
            name: "feet".to_owned(),
            width: 64,
            height: 24,
            codec: "h264".to_owned(),
            colour: "grey".to_owned(),
            rate_hz: 30.0,
            tick: TickLength::NANOSECOND,
            trigger: None,
            source: "synthetic".to_owned(),
            encoder: "none".to_owned(),
        }],
        imus: vec![Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 200.0,
            tick: TickLength::ZED_MINI,
            source: "synthetic".to_owned(),
            noise: None,
        }],
        rig: vec![(
            "rig.toml".to_owned(),
            format!("revision = {seed}\n").into_bytes(),
        )],
    };
    let storage = Arc::new(DiskStorage::new(&folder));
    let mut writer = SessionWriter::create(storage, spec).expect("create the session");
    let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    for number in 0..u64::from(seconds) * 30 {
        let t = number as i64 * 33_333_333;
        let unit: Vec<u8> = std::iter::repeat_with(|| {
            // Xorshift (Marsaglia 2003).
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random as u8
        })
        .take(2000)
        .collect();
        let frame = Frame {
            number,
            device_ticks: t,
            host_time: start.0 + t + 3_000_000,
            time: start.0 + t,
            sigma_ns: 20_000,
            clock_map: 1,
            ..Frame::default()
        };
        let key = number % 15 == 0;
        writer
            .append_frame("feet", frame, &unit, key)
            .expect("write a frame");
    }
    let stop = Stop {
        at: start,
        reason: "control".to_owned(),
    };
    writer.close(stop).expect("close the session");
}
