//! Scenes for Python.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulation::testing::SyntheticScene;
use simulation::{BeogymConfig, SceneData, Sector, SimulationError};

use crate::error::{SettingError, exception};
use crate::matrices::matrices;
use crate::pool;
use crate::recording::PyRecording;

/// Writes a folder of Beogym as a new folder of scene bundles.
pub(crate) fn import_beogym(
    py: Python<'_>,
    folder: PathBuf,
    out: PathBuf,
    now_ns: i64,
) -> PyResult<()> {
    let config = BeogymConfig::default();
    let import = move |_: &_| SceneData::import_beogym(&folder, &out, &config, now_ns).map(drop);
    pool::run_apart(py, import)?.map_err(|error| exception(&error))
}

/// A scene: what was reconstructed, shared by worlds and cameras.
#[pyclass(name = "Scene", module = "paws_sim._core", frozen)]
pub(crate) struct PyScene {
    pub(crate) data: Arc<SceneData>,
    /// What `paws_sim.open_scene` opens it by.
    source: String,
}

impl PyScene {
    fn new(data: Arc<SceneData>, source: String) -> Self {
        Self { data, source }
    }

    /// # Errors
    /// [`SettingError`] for an index beyond the last.
    pub(crate) fn sector(&self, sector: usize) -> PyResult<&Sector> {
        self.data.sectors.get(sector).ok_or_else(|| {
            SettingError::new_err(format!(
                "sector: found {sector}, expected below {}",
                self.data.sectors.len()
            ))
        })
    }
}

#[pymethods]
impl PyScene {
    /// Opens a scene bundle; the hash of every file is checked.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let path = path.canonicalize().unwrap_or(path);
        let source = path.display().to_string();
        let opened = pool::run_apart(py, move |_| SceneData::open(&path))?;
        let data = opened.map_err(|error| exception(&error))?;
        Ok(Self::new(Arc::new(data), source))
    }

    /// A synthetic scene with exact truth: `tilted-plane`, `stairs`, `kerb`, `wall`, `room`,
    /// `bridge` or `corridor-loop`.
    #[staticmethod]
    fn synthetic(py: Python<'_>, name: String) -> PyResult<Self> {
        let make = synthetic(&name)?;
        let synthetic = pool::run_apart(py, move |_| make())?.map_err(|error| exception(&error))?;
        Ok(Self::new(synthetic.scene, format!("synthetic:{name}")))
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.data.name
    }

    /// Hash of everything in it. Snapshots belong to a scene by it.
    #[getter]
    fn hash(&self) -> String {
        self.data
            .hash()
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect()
    }

    /// Names of its sectors.
    #[getter]
    fn sectors(&self) -> Vec<String> {
        self.data
            .sectors
            .iter()
            .map(|sector| sector.name.clone())
            .collect()
    }

    /// Outputs that it does not have: place, name of the output, features that this costs.
    #[getter]
    fn missing(&self) -> Vec<(String, String, String)> {
        let missing = self.data.missing().iter();
        missing
            .map(|m| (m.place.clone(), m.output.clone(), m.features.clone()))
            .collect()
    }

    /// Number of Gaussians of each sector.
    #[getter]
    fn gaussians(&self) -> Vec<usize> {
        let sectors = self.data.sectors.iter();
        sectors
            .map(|sector| sector.gaussians.as_ref().map_or(0, |of| of.count()))
            .collect()
    }

    /// Recorded camera poses `world_from_camera` in the frame of a sector, shape (N, 4, 4).
    fn reference_poses<'py>(
        &self,
        py: Python<'py>,
        sector: usize,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        matrices(py, self.sector(sector)?.references.iter())
    }

    /// Cameras that recorded a sector: name, image size, intrinsics fx, fy, cx, cy.
    fn cameras<'py>(&self, py: Python<'py>, sector: usize) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let cameras = self.sector(sector)?.recording.cameras.iter();
        cameras
            .map(|camera| {
                let model = &camera.model;
                let of = PyDict::new(py);
                of.set_item("name", &camera.name)?;
                of.set_item("size", (model.width, model.height))?;
                of.set_item("intrinsics", (model.fx, model.fy, model.cx, model.cy))?;
                Ok(of)
            })
            .collect()
    }

    /// What was recorded of the walk, in the frame of a sector.
    fn recording(&self, sector: usize) -> PyResult<PyRecording> {
        self.sector(sector)?;
        Ok(PyRecording::new(self.data.clone(), sector))
    }

    /// What `paws_sim.open_scene` opens it by: an absolute path, or `synthetic:` and a name.
    #[getter]
    fn source(&self) -> &str {
        &self.source
    }

    /// A pickle opens the scene again.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let open = py.import("paws_sim")?.getattr("open_scene")?;
        Ok((open, (self.source.clone(),)))
    }

    /// Scenes do not change, so that copies share them.
    fn __deepcopy__<'py>(slf: Bound<'py, Self>, _memo: &Bound<'py, PyAny>) -> Bound<'py, Self> {
        slf
    }

    fn __repr__(&self) -> String {
        let sectors = self.data.sectors.len();
        format!("Scene({:?}, {sectors} sectors)", self.data.name)
    }
}

type Make = fn() -> Result<SyntheticScene, SimulationError>;

/// Makes the synthetic scene of a name.
fn synthetic(name: &str) -> PyResult<Make> {
    Ok(match name {
        "tilted-plane" => || SyntheticScene::tilted_plane([0.1, 0.05]),
        "stairs" => SyntheticScene::stairs,
        "kerb" => || SyntheticScene::kerb(0.12),
        "wall" => SyntheticScene::wall,
        "room" => SyntheticScene::room,
        "bridge" => SyntheticScene::bridge,
        "corridor-loop" => SyntheticScene::corridor_loop,
        _ => {
            return Err(SettingError::new_err(format!(
                "synthetic scene: found {name:?}, expected tilted-plane, stairs, kerb, wall, \
                 room, bridge or corridor-loop"
            )));
        }
    })
}

/// Writes a synthetic scene as a bundle.
///
/// # Errors
/// [`SettingError`] for another name, `SceneError` for a scene of several sectors and a folder
/// that cannot be written.
pub(crate) fn write_synthetic(py: Python<'_>, name: String, path: PathBuf) -> PyResult<()> {
    let make = synthetic(&name)?;
    let written = pool::run_apart(py, move |_| make()?.write_bundle(&path))?;
    written.map_err(|error| exception(&error))
}
