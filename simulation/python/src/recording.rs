//! What was recorded of a walk, for Python: lenses and mounts, contacts, the wearer.

use std::sync::{Arc, OnceLock};

use cad_transforms::rig::Foot;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulation::{CameraConfig, Playback, SceneData, Sector};

use crate::error::{SettingError, exception};
use crate::matrices::{matrices, rows};
use crate::pool;

/// What was recorded of the walk, in the frame of a sector.
#[pyclass(name = "Recording", module = "paws_sim._core", frozen)]
pub(crate) struct PyRecording {
    scene: Arc<SceneData>,
    /// Index of the sector, which the scene has.
    sector: usize,
    /// The wearer, if there is a trajectory; made at the first use.
    wearer: OnceLock<Option<Playback>>,
}

impl PyRecording {
    pub(crate) fn new(scene: Arc<SceneData>, sector: usize) -> Self {
        Self {
            wearer: OnceLock::new(),
            scene,
            sector,
        }
    }

    fn sector(&self) -> &Sector {
        &self.scene.sectors[self.sector]
    }

    fn playback(&self) -> Option<&Playback> {
        let wearer = || Playback::of(&self.sector().recording);
        self.wearer.get_or_init(wearer).as_ref()
    }
}

#[pymethods]
impl PyRecording {
    /// Lens of a camera by its name, for images of a size; a missing edge keeps the shape: `size`,
    /// `intrinsics`, `distortion` as JSON, and the readout line time `line_s`, s.
    #[pyo3(signature = (name, width=None, height=None))]
    fn lens<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        width: Option<u32>,
        height: Option<u32>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let config = CameraConfig::recorded(self.sector(), name, [width, height]);
        let config = config.map_err(|error| exception(&error))?;
        let model = &config.model;
        let distortion = serde_json::to_string(&model.distortion)
            .map_err(|error| SettingError::new_err(format!("camera.recorded: {error}")))?;
        let of = PyDict::new(py);
        of.set_item("size", (model.width, model.height))?;
        of.set_item("intrinsics", (model.fx, model.fy, model.cx, model.cy))?;
        of.set_item("distortion", distortion)?;
        of.set_item("line_s", config.shutter.line_s)?;
        Ok(of)
    }

    /// Mount `body_from_camera` of a camera on an agent, where the wearer had it: rows of a
    /// homogeneous matrix.
    fn mount(&self, py: Python<'_>, name: String) -> PyResult<[[f64; 4]; 4]> {
        let (scene, sector) = (self.scene.clone(), self.sector);
        let mount = pool::run_apart(py, move |_| {
            CameraConfig::recorded_mount(&scene.sectors[sector], &name)
        })?;
        Ok(rows(&mount.map_err(|error| exception(&error))?))
    }

    /// Contacts of the wearer's feet by time: `foot` (0 left, 1 right), `time_ns` (N, 4) of heel
    /// strike, foot flat, heel off and toe off, and `world_from_foot` (N, 4, 4).
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let contacts = &self.sector().recording.contacts;
        let of = PyDict::new(py);
        let feet = contacts.iter().map(|contact| match contact.foot {
            Foot::Left => 0_i8,
            Foot::Right => 1,
        });
        of.set_item("foot", PyArray1::from_iter(py, feet))?;
        let times = contacts
            .iter()
            .flat_map(|contact| contact.events.map(|event| event.time_ns));
        let times = PyArray1::from_vec(py, times.collect()).reshape([contacts.len(), 4])?;
        of.set_item("time_ns", times)?;
        let poses = contacts.iter().map(|contact| &contact.world_from_foot);
        of.set_item("world_from_foot", matrices(py, poses)?)?;
        Ok(of)
    }

    /// Times of the first and the last pose of the wearer, ns; `None` without any.
    #[getter]
    fn range_ns(&self) -> Option<(i64, i64)> {
        let [first, last] = self.playback()?.range_ns()?;
        Some((first, last))
    }

    /// The wearer at a time, ns: `world_from_rig` (4, 4) as rows, `velocity` along the
    /// world's axes, m/s, and `contacts`, the numbers of those of the left and the right foot that
    /// last. `None` where there is no pose.
    fn wearer<'py>(&self, py: Python<'py>, time_ns: i64) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(state) = self.playback().and_then(|of| of.at(time_ns)) else {
            return Ok(None);
        };
        let of = PyDict::new(py);
        of.set_item("world_from_rig", rows(&state.world_from_rig))?;
        of.set_item("velocity", state.velocity_in_world)?;
        let [left, right] = state.contacts;
        of.set_item("contacts", (left, right))?;
        Ok(Some(of))
    }
}
