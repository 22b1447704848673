//! Batches of images for Python.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use numpy::{
    PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Map, Value};
use simulation::{
    CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, NoiseKey, ResidencyConfig,
    SimulationError,
};

use crate::error::{BudgetError, SettingError, StateError, exception};
use crate::pool::{self, Owner};
use crate::scene::PyScene;
use crate::settings;

/// Frames between two looks whether a signal ended the wait: milliseconds for small images.
const CHUNK: usize = 32;
/// Lenses that are kept ready.
const MAX_CAMERAS: usize = 32;

/// Cameras anywhere in a scene.
#[pyclass(name = "Cameras", module = "paws_sim._core", frozen)]
pub(crate) struct PyCameras {
    state: Mutex<Option<State>>,
    owner: Owner,
}

struct State {
    store: Arc<GaussianStore>,
    cameras: BTreeMap<String, Arc<CameraBatch>>,
}

#[pymethods]
impl PyCameras {
    /// Cameras in a scene, with memory for the Gaussians of its sectors, bytes. Loads nothing and
    /// starts no threads.
    #[new]
    fn new(scene: &PyScene, budget_bytes: u64) -> Self {
        let mut config = ResidencyConfig::default();
        config.budget_bytes = budget_bytes;
        let store = Arc::new(GaussianStore::new(scene.data.clone(), config));
        Self {
            state: Mutex::new(Some(State {
                store,
                cameras: BTreeMap::new(),
            })),
            owner: Owner::default(),
        }
    }

    /// Renders images at poses `world_from_camera` (optical frames) in sectors. `lens` is width,
    /// height, fx, fy, cx, cy; `options` are JSON with `distortion`, `exposure`, `noise`,
    /// `shutter`, `quality`, `depth`, `far_m` and `max_bytes`. `keys` are seed, episode and frame
    /// number of each image's noise. `conditions`, shape (N, 7), are velocity, m/s, and angular
    /// rate, rad/s, of the camera in its own axes, and gain of linear light; without them cameras
    /// are at rest.
    ///
    /// Returns `rgb` (N, height, width, 3), `depth` (N, height, width), m, and `has_depth`.
    #[pyo3(signature = (poses, sectors, lens, options, keys, conditions=None))]
    #[expect(
        clippy::too_many_arguments,
        reason = "a batch is its columns in Python"
    )]
    fn render<'py>(
        &self,
        py: Python<'py>,
        poses: PyReadonlyArray3<'py, f64>,
        sectors: PyReadonlyArray1<'py, i64>,
        lens: (u32, u32, f64, f64, f64, f64),
        options: &str,
        keys: PyReadonlyArray2<'py, u64>,
        conditions: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        self.owner.check("the cameras")?;
        let camera = self.camera(lens, options)?;
        let mut requests = requests(&poses, &sectors, &keys)?;
        if let Some(conditions) = conditions {
            set_conditions(&mut requests, &conditions)?;
        }
        check_bytes(&camera, requests.len())?;
        let rendered = pool::run_long(py, move |is_cancelled| {
            let (mut frames, mut chunk) = (Frames::default(), Frames::default());
            let model = &camera.config().model;
            (frames.height, frames.width) = (model.height as usize, model.width as usize);
            for requests in requests.chunks(CHUNK) {
                if is_cancelled.load(Ordering::Relaxed) {
                    break;
                }
                camera.render(requests, &mut chunk)?;
                frames.count += chunk.count;
                frames.rgb.extend_from_slice(&chunk.rgb);
                frames.depth_m.extend_from_slice(&chunk.depth_m);
                frames.has_depth.extend_from_slice(&chunk.has_depth);
            }
            Ok(frames)
        })?;
        let frames: Frames = rendered.map_err(|error: SimulationError| exception(&error))?;
        let [n, height, width] = [frames.count, frames.height, frames.width];
        let images = PyDict::new(py);
        let rgb = PyArray1::from_vec(py, frames.rgb).reshape([n, height, width, 3])?;
        images.set_item("rgb", rgb)?;
        let depth = PyArray1::from_vec(py, frames.depth_m).reshape([n, height, width])?;
        images.set_item("depth", depth)?;
        let has_depth = PyArray1::from_vec(py, frames.has_depth).reshape([n, height, width])?;
        images.set_item("has_depth", has_depth)?;
        Ok(images)
    }

    /// Sectors whose Gaussians are in memory.
    fn resident(&self) -> PyResult<Vec<usize>> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(state.as_ref().ok_or_else(closed)?.store.resident())
    }

    /// Gives the memory back. Every later call but this one is an error.
    fn close(&self) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl PyCameras {
    fn camera(
        &self,
        lens: (u32, u32, f64, f64, f64, f64),
        options: &str,
    ) -> PyResult<Arc<CameraBatch>> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let state = state.as_mut().ok_or_else(closed)?;
        let key = format!("{lens:?} {options}");
        if let Some(camera) = state.cameras.get(&key) {
            return Ok(camera.clone());
        }
        let config = config(lens, options)?;
        let camera = CameraBatch::new(state.store.clone(), config);
        let camera = Arc::new(camera.map_err(|error| exception(&error))?);
        if state.cameras.len() >= MAX_CAMERAS {
            state.cameras.clear();
        }
        state.cameras.insert(key, camera.clone());
        Ok(camera)
    }
}

/// Refuses a lens and options that no image could be rendered with.
///
/// # Errors
/// [`SettingError`] with the name of the setting.
pub(crate) fn check(lens: (u32, u32, f64, f64, f64, f64), options: &str) -> PyResult<()> {
    let config = config(lens, options)?;
    config.check().map_err(|error| exception(&error))
}

fn config(
    (width, height, fx, fy, cx, cy): (u32, u32, f64, f64, f64, f64),
    options: &str,
) -> PyResult<CameraConfig> {
    let model = CameraModel::new((width, height), [fx, fy, cx, cy], Distortion::None);
    let mut config = CameraConfig::new(model).map_err(|error| exception(&error))?;
    let options: Map<String, Value> = settings::json("camera", options)?;
    for (name, value) in options {
        let place = format!("camera.{name}");
        match name.as_str() {
            "quality" => config.quality = settings::value(&place, value)?,
            "depth" => config.depth = settings::value(&place, value)?,
            "distortion" => config.model.distortion = settings::value(&place, value)?,
            "exposure" => config.exposure = settings::fields(&place, value)?,
            "noise" => config.noise = settings::fields(&place, value)?,
            "variation" => config.variation = settings::fields(&place, value)?,
            "shutter" => config.shutter = settings::fields(&place, value)?,
            "far_m" => config.far_m = settings::value(&place, value)?,
            "max_bytes" => config.max_bytes = settings::value(&place, value)?,
            _ => {
                return Err(SettingError::new_err(format!(
                    "{place}: found an unknown setting, expected width, height, fov, K, \
                     recorded, distortion, mount, timing, budget_bytes, exposure, noise, \
                     shutter, variation, quality, depth, far_m or max_bytes"
                )));
            }
        }
    }
    Ok(config)
}

/// Bytes of a pixel: color, depth, and whether there is a depth.
const BYTES_PER_PIXEL: u64 = 3 + 4 + 1;

/// The images of all chunks together keep to the memory that is allowed.
fn check_bytes(camera: &CameraBatch, count: usize) -> PyResult<()> {
    let config = camera.config();
    let (width, height) = (config.model.width, config.model.height);
    let pixels = u64::from(width) * u64::from(height);
    let needed = (pixels * BYTES_PER_PIXEL).saturating_mul(count as u64);
    match needed <= config.max_bytes {
        true => Ok(()),
        false => Err(BudgetError::new_err(format!(
            "{needed} bytes are needed for {count} images of {width}x{height}, {} are allowed",
            config.max_bytes
        ))),
    }
}

fn requests(
    poses: &PyReadonlyArray3<'_, f64>,
    sectors: &PyReadonlyArray1<'_, i64>,
    keys: &PyReadonlyArray2<'_, u64>,
) -> PyResult<Vec<FrameRequest>> {
    let (count, rows, columns) = (poses.shape()[0], poses.shape()[1], poses.shape()[2]);
    if (rows, columns) != (4, 4) || sectors.len() != count || keys.shape() != [count, 3] {
        return Err(SettingError::new_err(format!(
            "poses: found shapes {:?}, {:?} and {:?}, expected (N, 4, 4), N sectors and (N, 3) keys",
            poses.shape(),
            sectors.shape(),
            keys.shape()
        )));
    }
    let (poses, sectors, keys) = (poses.as_array(), sectors.as_array(), keys.as_array());
    let request = |index: usize| {
        let rows = std::array::from_fn(|k| poses[[index, k / 4, k % 4]]);
        let pose = RigidTransform::from_rows_4x4(rows)
            .map_err(|error| SettingError::new_err(format!("pose {index}: {error}")))?;
        let sector = usize::try_from(sectors[index])
            .map_err(|_| SettingError::new_err(format!("sector of pose {index}: negative")))?;
        let mut request = FrameRequest::new(sector, pose);
        request.noise = NoiseKey {
            seed: keys[[index, 0]],
            episode: keys[[index, 1]],
            frame: keys[[index, 2]],
            camera: 0,
        };
        Ok(request)
    };
    (0..count).map(request).collect()
}

/// Motion and gain of each frame.
fn set_conditions(
    requests: &mut [FrameRequest],
    conditions: &PyReadonlyArray2<'_, f64>,
) -> PyResult<()> {
    if conditions.shape() != [requests.len(), CONDITIONS] {
        return Err(SettingError::new_err(format!(
            "conditions: found shape {:?}, expected ({}, {CONDITIONS})",
            conditions.shape(),
            requests.len()
        )));
    }
    for (request, row) in requests.iter_mut().zip(conditions.as_array().rows()) {
        request.velocity_m_s = [row[0], row[1], row[2]];
        request.rate_rad_s = [row[3], row[4], row[5]];
        request.gain = row[6];
    }
    Ok(())
}

/// Numbers of a frame besides its pose and the key of its noise. No world sets deviations of the
/// lens.
pub(crate) const CONDITIONS: usize = 7;

/// Those numbers, as [`PyCameras::render`] takes them.
pub(crate) fn conditions(request: &FrameRequest) -> [f64; CONDITIONS] {
    let [vx, vy, vz] = request.velocity_m_s;
    let [rx, ry, rz] = request.rate_rad_s;
    [vx, vy, vz, rx, ry, rz, request.gain]
}

fn closed() -> PyErr {
    StateError::new_err("the cameras are closed")
}
