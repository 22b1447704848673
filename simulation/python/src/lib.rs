//! `paws_sim._core`: scenes, recordings, worlds and cameras of the package `simulation` for Python.
//!
//! The Python package builds Gymnasium environments of them and holds all its words; this library
//! hands arrays over. Python's global lock is released while worlds step and images are rendered.
//! No thread is started before the first reset or image, and threads do not outlive a fork:
//! see `pool.rs`.

mod cameras;
mod error;
mod matrices;
mod pool;
mod recording;
mod scene;
mod settings;
mod world;

use std::path::PathBuf;

use pyo3::prelude::*;
use pyo3::types::PyDict;

#[pymodule]
mod _core {
    use super::*;

    #[pymodule_export]
    use super::cameras::PyCameras;
    #[pymodule_export]
    use super::recording::PyRecording;
    #[pymodule_export]
    use super::scene::PyScene;
    #[pymodule_export]
    use super::world::PyWorld;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        error::add_to(module)?;
        module.add("REWARD_TERMS", simulation::REWARD_TERMS)?;
        module.add("DT_S", simulation::WorldConfig::default().dt_s)?;
        let reasons = PyDict::new(module.py());
        for reason in simulation::EndReason::ALL {
            reasons.set_item(reason.name().to_uppercase(), reason as i8)?;
        }
        module.add("END_REASONS", reasons)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }

    /// Refuses a camera that no image could be rendered with: its lens (width, height, fx, fy, cx,
    /// cy) and its options as those of `Cameras.render`.
    #[pyfunction]
    fn check_camera(lens: (u32, u32, f64, f64, f64, f64), options: &str) -> PyResult<()> {
        cameras::check(lens, options)
    }

    /// A pose, a homogeneous matrix, as JSON in a world's configuration.
    #[pyfunction]
    fn pose(matrix: [[f64; 4]; 4]) -> PyResult<String> {
        settings::pose(&matrix)
    }

    /// Writes a synthetic scene of one sector as a scene bundle, which must not exist.
    #[pyfunction]
    fn write_synthetic(py: Python<'_>, name: String, path: PathBuf) -> PyResult<()> {
        scene::write_synthetic(py, name, path)
    }

    /// The whole timing of a camera as JSON: of its settings, or of a preset by its name, as JSON.
    #[pyfunction]
    fn timing(settings: &str) -> PyResult<String> {
        world::timing(settings)
    }

    /// Writes a folder of Beogym as a new folder of scene bundles. The time is for their
    /// provenance, ns of UTC since 1970.
    #[pyfunction]
    fn import_beogym(py: Python<'_>, folder: PathBuf, out: PathBuf, now_ns: i64) -> PyResult<()> {
        scene::import_beogym(py, folder, out, now_ns)
    }

    /// Sets the number of threads for steps and images; 0 is one per core. Results do not depend
    /// on it.
    #[pyfunction]
    fn set_threads(threads: usize) {
        pool::set_threads(threads);
    }
}
