//! The walk: rounds of a plaza with the feet camera alone, and sessions of it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use cad_transforms::rig::Rig;
use nalgebra::{UnitQuaternion, Vector3};
use reconstruction::Input;
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render_session};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation, seconds};
use session_archive::handoff::{HandOff, Verdict};
use session_archive::index::Index;
use session_archive::layout;
use session_archive::reader::SessionReader;
use session_archive::storage::{DiskStorage, Storage, replace};
use session_archive::time::CivilTime;

const EXAMPLE_RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
const SEED: u64 = 331;
/// Length of a session of which only the rig is used, s.
const SHORT_S: f64 = 0.4;

/// A walk with its rig.
pub(super) struct Walk {
    pub(super) simulation: Arc<Simulation>,
    rig: Rig,
    rig_text: String,
    size: [u32; 2],
    rate_hz: f64,
}

impl Walk {
    /// Scene, light and seed.
    pub(super) const NAME: &'static str = "plaza-day-331";

    /// A walk of some minutes, with columns and rows of one eye, and its frame rate.
    pub(super) fn new(minutes: u32, size: [u32; 2], rate_hz: f64) -> Result<Self> {
        let rig_text = feet_camera_only(EXAMPLE_RIG);
        let rig = Rig::parse(&rig_text).context("reading the rig of the feet camera")?;
        let simulation = simulation(60.0 * f64::from(minutes), (size, rate_hz), &rig)?;
        Ok(Self {
            simulation: Arc::new(simulation),
            rig,
            rig_text,
            size,
            rate_hz,
        })
    }

    /// A handed-over session of the whole walk in a new folder.
    pub(super) fn session(&self, folder: &Path) -> Result<PathBuf> {
        self.record(&self.simulation, folder)
    }

    /// A handed-over session of the first frames only, with the same rig.
    pub(super) fn short_session(&self, folder: &Path) -> Result<PathBuf> {
        let simulation = simulation(SHORT_S, (self.size, self.rate_hz), &self.rig)?;
        self.record(&Arc::new(simulation), folder)
    }

    fn record(&self, simulation: &Arc<Simulation>, folder: &Path) -> Result<PathBuf> {
        let job = Job {
            rig: &self.rig,
            rig_text: &self.rig_text,
            faults: &Faults::default(),
            truth: false,
            session: true,
            threads: 1,
        };
        render_session(simulation, &job, folder, &|| {}).context("rendering the walk")?;
        hand_over(folder)?;
        Ok(folder.to_owned())
    }

    /// Times of all frames, ns.
    pub(super) fn frame_times(&self) -> impl Iterator<Item = i64> + use<'_> {
        let settings = self.simulation.settings();
        (0..settings.frame_count()).map(|number| settings.frame_ns(number))
    }

    /// True pose of the rig at a time.
    pub(super) fn world_from_rig(&self, time_ns: i64) -> Result<RigidTransform> {
        let state = self.simulation.walker().rig(seconds(time_ns));
        transform(&state.position, &state.rotation)
    }

    /// True velocity of the rig in the world, m/s.
    pub(super) fn velocity(&self, time_ns: i64) -> [f64; 3] {
        let state = self.simulation.walker().rig(seconds(time_ns));
        state.velocity.into()
    }
}

fn simulation(seconds: f64, (size, rate_hz): ([u32; 2], f64), rig: &Rig) -> Result<Simulation> {
    let settings = Settings {
        kind: Kind::Plaza,
        lighting: Lighting::Day,
        seed: SEED,
        seconds,
        rate_hz,
        width: size[0],
        height: size[1],
        quality: Quality::FAST,
    };
    Simulation::new(&settings, rig).context("preparing the walk")
}

/// A rig file without its shoulder cameras.
fn feet_camera_only(rig: &str) -> String {
    let parts = rig.split("\n\n");
    let kept = parts.filter(|part| !part.contains("_shoulder"));
    kept.collect::<Vec<_>>().join("\n\n")
}

/// A pose of the simulator.
pub(super) fn transform(
    position: &Vector3<f64>,
    rotation: &UnitQuaternion<f64>,
) -> Result<RigidTransform> {
    let q = rotation.quaternion();
    Ok(RigidTransform::from_wxyz(
        [q.w, q.i, q.j, q.k],
        (*position).into(),
    )?)
}

/// Indexes and seals a session, as `paws index` and `paws handoff` do.
fn hand_over(folder: &Path) -> Result<()> {
    let storage: Arc<dyn Storage> = Arc::new(DiskStorage::new(folder));
    let reader = SessionReader::open(storage.clone()).context("opening the session")?;
    let index = Index::build(&reader, |_| {}).context("indexing the session")?;
    let bytes = index.to_bytes().context("encoding the index")?;
    replace(&*storage, layout::INDEX, &bytes).context("writing the index")?;
    let manifest = reader.manifest();
    let rig = manifest.rig.iter().map(|file| layout::rig_file(&file.name));
    let files: Vec<String> = [layout::MANIFEST.to_owned(), layout::INDEX.to_owned()]
        .into_iter()
        .chain(rig)
        .chain(reader.segment_numbers().map(layout::segment))
        .collect();
    let id = &manifest.session_id;
    let verdict = Verdict::Pass;
    HandOff::seal(
        &*storage,
        id,
        verdict,
        "bench",
        CivilTime(0),
        &files,
        |_| {},
    )
    .context("sealing the session")?;
    Ok(())
}

/// The handed-over session.
pub(super) fn open(session: &Path) -> Result<Input> {
    Input::open(session).with_context(|| format!("opening {}", session.display()))
}
