//! Worlds for Python: steps with autoreset, and results as arrays.

mod arrays;
mod autoreset;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use cad_transforms::RigidTransform;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use simulation::{AgentState, FrameRequest, TimingConfig, World, WorldConfig};

use self::autoreset::{Autoreset, Batch};
use crate::cameras;
use crate::error::{ActionError, SettingError, StateError, exception};
use crate::matrices::matrices;
use crate::pool::{self, Owner};
use crate::scene::PyScene;
use crate::settings;

/// Duration of a step from which a signal ends the wait for the next one. Below it the thread that
/// this needs would be the slower way.
const LONG_STEP: Duration = Duration::from_millis(20);

/// Least and greatest values.
type Bounds<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>);
/// Poses as matrices, and their sectors.
type Poses<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray1<i64>>);
/// The same with seed, episode and number of each frame, and what `Cameras.render` has as its
/// conditions.
type PyFrames<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<u64>>,
    Bound<'py, PyArray2<f64>>,
);

/// Environments with an agent each on one scene.
#[pyclass(name = "World", module = "paws_sim._core", frozen)]
pub(crate) struct PyWorld {
    batch: Arc<Mutex<Option<Batch>>>,
    /// Two arrays that steps alternate between where observations are not copied; the first one has
    /// the last observations.
    buffers: Mutex<Option<[Py<PyArray2<f32>>; 2]>>,
    owner: Owner,
    environments: usize,
    action_size: usize,
    config: String,
    /// Whether the last step was long; before the first it is not known and counts as long.
    is_long: AtomicBool,
}

#[pymethods]
impl PyWorld {
    /// A world on a scene, with its configuration as JSON. Settings that are left out have their
    /// default. Starts no threads.
    #[new]
    fn new(py: Python<'_>, scene: &PyScene, config: &str, copy: bool) -> PyResult<Self> {
        let parsed: WorldConfig = serde_json::from_str(config)
            .map_err(|error| SettingError::new_err(format!("configuration: {error}")))?;
        let whole = serde_json::to_string(&parsed)
            .map_err(|error| SettingError::new_err(format!("configuration: {error}")))?;
        let (environments, action_size) = (parsed.environments, parsed.drive.action_size());
        let data = scene.data.clone();
        let world = py.detach(|| World::new(data, parsed));
        let world = world.map_err(|error| exception(&error))?;
        let shape = [environments, world.observation_bounds().0.len()];
        let buffer = || PyArray2::<f32>::zeros(py, shape, false).unbind();
        let buffers = (!copy).then(|| [buffer(), buffer()]);
        Ok(Self {
            batch: Arc::new(Mutex::new(Some(Batch::new(world)))),
            buffers: Mutex::new(buffers),
            owner: Owner::default(),
            environments,
            action_size,
            config: whole,
            is_long: AtomicBool::new(true),
        })
    }

    /// Number of environments.
    #[getter]
    fn environments(&self) -> usize {
        self.environments
    }

    /// Components of an action.
    #[getter]
    fn action_size(&self) -> usize {
        self.action_size
    }

    /// The whole configuration as JSON.
    #[getter]
    fn config(&self) -> &str {
        &self.config
    }

    /// Named parts of an observation vector: name, first element, number of elements.
    fn observation_fields(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, usize, usize)>> {
        self.read(py, |batch| {
            let fields = batch.world.observation_fields().iter();
            let field = |field: &simulation::ObservationField| {
                (field.name, field.elements.start, field.elements.len())
            };
            fields.map(field).collect()
        })
    }

    /// Least and greatest value of each element of an observation vector.
    fn observation_bounds<'py>(&self, py: Python<'py>) -> PyResult<Bounds<'py>> {
        self.read(py, |batch| {
            let (low, high) = batch.world.observation_bounds();
            (
                PyArray1::from_slice(py, low),
                PyArray1::from_slice(py, high),
            )
        })
    }

    /// Begins episodes in the environments of the mask, or in all. With a seed, one or `None` per
    /// environment, episodes are counted from 0.
    #[pyo3(signature = (mask=None, seeds=None))]
    fn reset(
        &self,
        py: Python<'_>,
        mask: Option<PyReadonlyArray1<'_, bool>>,
        seeds: Option<Vec<Option<u64>>>,
    ) -> PyResult<()> {
        self.owner.check("the world")?;
        let mask = mask.map(|mask| mask.as_array().to_vec());
        self.work(py, true, move |batch, is_cancelled| {
            // Predictions of the PSNR take long; a signal ends them.
            batch
                .world
                .prepare(&|_, _| match is_cancelled.load(Ordering::Relaxed) {
                    false => ControlFlow::Continue(()),
                    true => ControlFlow::Break(()),
                })?;
            batch.reset(mask.as_deref(), seeds.as_deref())
        })
    }

    /// Advances all environments, with an autoreset of 0 (the step after the end), 1 (in the same
    /// step) or 2 (none). Returns observations, rewards, terminated, truncated, numbers of the
    /// step, the mask of those that had ended before it and ignored their action, and with 1 where
    /// episodes ended: their mask, final observations and numbers.
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, f64>,
        autoreset: u8,
    ) -> PyResult<Bound<'py, PyTuple>> {
        self.owner.check("the world")?;
        let autoreset = Autoreset::from_code(autoreset)?;
        let expected = [self.environments, self.action_size];
        if actions.shape() != expected {
            return Err(ActionError::new_err(format!(
                "actions: found shape {:?}, expected {expected:?}",
                actions.shape()
            )));
        }
        let actions: Vec<f64> = actions.as_array().iter().copied().collect();
        let is_long = self.is_long.load(Ordering::Relaxed);
        let took = self.work(py, is_long, move |batch, _| {
            #[expect(
                clippy::disallowed_methods,
                reason = "how long it takes decides how it is waited for, and no result"
            )]
            let begin = Instant::now();
            batch.step(&actions, autoreset)?;
            Ok(begin.elapsed())
        })?;
        self.is_long.store(took > LONG_STEP, Ordering::Relaxed);
        let batch = self.lock(py)?;
        let batch = open(&batch)?;
        self.alternate();
        let step = &batch.step;
        let ended = match &batch.ended {
            None => py.None().into_bound(py),
            Some(ended) => {
                let mask = PyArray1::from_slice(py, &ended.mask);
                let observations = PyArray1::from_slice(py, &ended.observations)
                    .reshape([self.environments, batch.observation_len()])?;
                let numbers = arrays::numbers(py, &ended.result)?;
                (mask, observations, numbers).into_pyobject(py)?.into_any()
            }
        };
        (
            self.observations_of(py, batch)?,
            PyArray1::from_slice(py, &step.rewards),
            PyArray1::from_slice(py, &step.terminated),
            PyArray1::from_slice(py, &step.truncated),
            arrays::numbers(py, batch.world.result())?,
            PyArray1::from_slice(py, batch.had_ended()),
            ended,
        )
            .into_pyobject(py)
    }

    /// Observation vectors, shape (environments, elements).
    fn observations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let batch = self.lock(py)?;
        self.observations_of(py, open(&batch)?)
    }

    /// Numbers of the last step or reset by name, one per environment.
    fn numbers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let batch = self.lock(py)?;
        arrays::numbers(py, open(&batch)?.world.result())
    }

    /// Terms of the reward of the last step, before an autoreset, shape (environments, terms).
    fn reward_terms<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.read(py, |batch| {
            let terms = batch.step.reward_terms.as_flattened();
            let columns = simulation::REWARD_TERMS.len();
            PyArray1::from_slice(py, terms).reshape([self.environments, columns])
        })?
    }

    /// Environments that have ended and wait for a reset, or had none yet.
    fn has_ended<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        self.read(py, |batch| {
            let ended = (0..self.environments).map(|index| batch.world.has_ended(index));
            PyArray1::from_iter(py, ended)
        })
    }

    /// Agents by name of the quantity.
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let batch = self.lock(py)?;
        arrays::states(py, &open(&batch)?.world)
    }

    /// Poses `world_from_camera` of all environments in their sectors, shape (environments, 4, 4),
    /// and the sectors.
    fn camera_poses<'py>(&self, py: Python<'py>) -> PyResult<Poses<'py>> {
        let poses: Vec<_> = self.read(py, |batch| {
            (0..self.environments)
                .map(|index| batch.world.world_from_camera(index))
                .collect()
        })?;
        poses_and_sectors(py, &poses)
    }

    /// The frames that all environments see, which may be late: poses `world_from_camera`, their
    /// sectors, seed, episode and number of each frame, shape (environments, 3), and their
    /// conditions as `Cameras.render` takes them, shape (environments, 7).
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<PyFrames<'py>> {
        let frames: Vec<_> = self.read(py, |batch| {
            (0..self.environments)
                .map(|index| batch.world.frame_request(index))
                .collect()
        })?;
        frames_as_arrays(py, &frames)
    }

    /// The same of the environments that ended in the last step and were reset in it, at the end.
    fn final_frames<'py>(&self, py: Python<'py>) -> PyResult<PyFrames<'py>> {
        self.read(py, |batch| {
            let ended = batch.ended.as_ref();
            frames_as_arrays(py, ended.map_or(&[], |ended| &ended.frames))
        })?
    }

    /// Seed and episode of each environment: what noise of images is drawn with.
    fn random_keys<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u64>>> {
        self.read(py, |batch| {
            let keys = (0..self.environments).map(|index| batch.world.random_key(index));
            let keys = keys.flat_map(|(seed, episode)| [seed, episode]).collect();
            PyArray1::from_vec(py, keys).reshape([self.environments, 2])
        })?
    }

    /// Puts an agent somewhere, as physics outside of this world does: position, m, and yaw,
    /// pitch, roll, rad, in the frame of a sector, which is the agent's without one.
    #[pyo3(signature = (environment, position_m, angles_rad, velocity, sector=None, level=0))]
    #[expect(clippy::too_many_arguments, reason = "a state is its parts in Python")]
    fn place(
        &self,
        py: Python<'_>,
        environment: usize,
        position_m: [f64; 3],
        angles_rad: [f64; 3],
        velocity: [f64; 3],
        sector: Option<usize>,
        level: usize,
    ) -> PyResult<()> {
        self.owner.check("the world")?;
        let [yaw_rad, pitch_rad, roll_rad] = angles_rad;
        let state = AgentState {
            position_m,
            yaw_rad,
            pitch_rad,
            roll_rad,
            velocity,
            level,
            is_on_ground: true,
        };
        let is_there = environment < self.environments;
        self.work(py, false, move |batch, _| {
            let own = || is_there.then(|| batch.world.world_from_camera(environment).0);
            let sector = sector.or_else(own).unwrap_or_default();
            batch.world.place(environment, sector, &state)
        })
    }

    /// Puts an agent where the recorded wearer was at a time of the recording, ns; `False` where it
    /// has no pose above known ground, and nothing changed.
    fn play(&self, py: Python<'_>, environment: usize, time_ns: i64) -> PyResult<bool> {
        self.owner.check("the world")?;
        self.work(py, false, move |batch, _| {
            batch.world.play(environment, time_ns)
        })
    }

    /// A snapshot of an environment, at most 4 KB.
    fn save<'py>(
        &self,
        py: Python<'py>,
        environment: usize,
        attachment: &[u8],
    ) -> PyResult<Bound<'py, PyBytes>> {
        let saved = self.read(py, |batch| batch.world.save(environment, attachment))?;
        Ok(PyBytes::new(py, &saved.map_err(|error| exception(&error))?))
    }

    /// Restores an environment from a snapshot, and returns the attachment.
    fn restore<'py>(
        &self,
        py: Python<'py>,
        environment: usize,
        snapshot: Vec<u8>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        self.owner.check("the world")?;
        let attachment = self.work(py, true, move |batch, _| {
            let attachment = batch.world.restore(environment, &snapshot)?.to_vec();
            batch.mark_restored(environment);
            Ok(attachment)
        })?;
        Ok(PyBytes::new(py, &attachment))
    }

    /// Gives the memory back. Every later call but this one is an error.
    fn close(&self, py: Python<'_>) {
        py.detach(|| *locked(&self.batch) = None);
        *self.buffers.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl PyWorld {
    /// Waits for work that goes on, without Python's lock.
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Option<Batch>>> {
        loop {
            match self.batch.try_lock() {
                Ok(batch) => return Ok(batch),
                Err(TryLockError::Poisoned(batch)) => return Ok(batch.into_inner()),
                Err(TryLockError::WouldBlock) => {}
            }
            // Only work that a signal left in the background, or another thread, has it.
            let batch = self.batch.clone();
            pool::run_apart(py, move |_| drop(locked(&batch)))?;
        }
    }

    fn read<T>(&self, py: Python<'_>, read: impl FnOnce(&Batch) -> T) -> PyResult<T> {
        let batch = self.lock(py)?;
        Ok(read(open(&batch)?))
    }

    fn work<T: Send + 'static>(
        &self,
        py: Python<'_>,
        is_long: bool,
        work: impl FnOnce(&mut Batch, &AtomicBool) -> Result<T, simulation::SimulationError>
        + Send
        + 'static,
    ) -> PyResult<T> {
        drop(self.lock(py)?);
        let batch = self.batch.clone();
        let work = move |is_cancelled: &AtomicBool| {
            let mut batch = locked(&batch);
            batch.as_mut().map(|batch| work(batch, is_cancelled))
        };
        let result = match is_long {
            true => pool::run_long(py, work)?,
            false => pool::run(py, move || work(&AtomicBool::new(false)))?,
        };
        result
            .ok_or_else(closed)?
            .map_err(|error| exception(&error))
    }

    /// Lets the other array have the next observations, where they are not copied: those of the
    /// step before do not change.
    fn alternate(&self) {
        let mut buffers = self.buffers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(buffers) = &mut *buffers {
            buffers.reverse();
        }
    }

    fn observations_of<'py>(
        &self,
        py: Python<'py>,
        batch: &Batch,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let values = batch.world.observations();
        let buffers = self.buffers.lock().unwrap_or_else(PoisonError::into_inner);
        let Some([last, _]) = &*buffers else {
            return PyArray1::from_slice(py, values)
                .reshape([self.environments, batch.observation_len()]);
        };
        let array = last.bind(py).clone();
        let mut into = array.try_readwrite().map_err(|error| {
            StateError::new_err(format!("the array of observations is in use: {error}"))
        })?;
        into.as_slice_mut()?.copy_from_slice(values);
        drop(into);
        Ok(array)
    }
}

/// The whole timing of a camera as JSON, of settings or the name of a preset.
///
/// # Errors
/// [`SettingError`] with the name of the setting.
pub(crate) fn timing(settings: &str) -> PyResult<String> {
    const PLACE: &str = "camera.timing";
    let timing: TimingConfig = match settings::json(PLACE, settings)? {
        serde_json::Value::String(name) => {
            TimingConfig::preset(&name).map_err(|error| exception(&error))?
        }
        whole => settings::fields(PLACE, whole)?,
    };
    serde_json::to_string(&timing)
        .map_err(|error| SettingError::new_err(format!("{PLACE}: {error}")))
}

fn poses_and_sectors<'py>(
    py: Python<'py>,
    poses: &[(usize, RigidTransform)],
) -> PyResult<Poses<'py>> {
    let sectors = poses.iter().map(|(sector, _)| *sector as i64).collect();
    let matrices = matrices(py, poses.iter().map(|(_, pose)| pose))?;
    Ok((matrices, PyArray1::from_vec(py, sectors)))
}

fn frames_as_arrays<'py>(py: Python<'py>, frames: &[FrameRequest]) -> PyResult<PyFrames<'py>> {
    let sectors = frames.iter().map(|frame| frame.sector as i64).collect();
    let poses = matrices(py, frames.iter().map(|frame| &frame.world_from_camera))?;
    let keys = frames.iter().flat_map(|frame| {
        let noise = &frame.noise;
        [noise.seed, noise.episode, noise.frame]
    });
    let keys = PyArray1::from_vec(py, keys.collect()).reshape([frames.len(), 3])?;
    let values = frames.iter().flat_map(cameras::conditions).collect();
    let values = PyArray1::from_vec(py, values).reshape([frames.len(), cameras::CONDITIONS])?;
    Ok((poses, PyArray1::from_vec(py, sectors), keys, values))
}

fn locked(batch: &Mutex<Option<Batch>>) -> MutexGuard<'_, Option<Batch>> {
    batch.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open(batch: &Option<Batch>) -> PyResult<&Batch> {
    batch.as_ref().ok_or_else(closed)
}

fn closed() -> PyErr {
    StateError::new_err("the world is closed")
}
