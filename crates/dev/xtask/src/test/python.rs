//! The Python environment of the interoperability tests: independent readers of our files.
//!
//! It lies in the target folder and is made again when the pinned list changes or one of the
//! packages no longer imports. Only ready-made wheels are taken: compiling a video library from
//! source is no part of a test run. An interpreter that PAWS_PYTHON names is used as it is.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::process::{self, command, root, target_folder};

const IMPORTS: &str = "import mcap, mcap_protobuf, av, numpy, cv2, pupil_apriltags, \
                       plyfile, laspy, lazrs, pycolmap, onnxruntime";

/// An interpreter that has the packages. The error says why there is none.
pub(crate) fn interpreter() -> Result<PathBuf> {
    if let Some(named) = std::env::var_os("PAWS_PYTHON") {
        if !imports(Path::new(&named))? {
            bail!("the interpreter that PAWS_PYTHON names cannot run `{IMPORTS}`: {named:?}");
        }
        return Ok(named.into());
    }
    let list = root()?.join("crates/dev/xtask/interop-requirements.txt");
    let wanted = std::fs::read(&list)
        .with_context(|| format!("reading the list of Python packages {}", list.display()))?;
    let folder = target_folder()?.join("python-readers");
    let python = folder.join("bin/python");
    let stamp = folder.join("installed-requirements.txt");
    if std::fs::read(&stamp).is_ok_and(|installed| installed == wanted) && imports(&python)? {
        return Ok(python);
    }

    process::run(
        command("python3")?
            .args(["-m", "venv", "--clear"])
            .arg(&folder),
    )
    .context("making a Python environment")?;
    let mut pip = command(&python)?;
    pip.args(["-m", "pip", "install", "--quiet"])
        .args(["--disable-pip-version-check", "--no-input"])
        .args(["--retries", "2", "--only-binary", ":all:"])
        .arg("--requirement")
        .arg(&list);
    process::run(&mut pip)
        .context("installing the Python packages (is a package index reachable from here?)")?;
    if !imports(&python)? {
        bail!(
            "the packages were installed, and yet `{IMPORTS}` fails in {}",
            folder.display()
        );
    }
    std::fs::write(&stamp, wanted).with_context(|| format!("writing {}", stamp.display()))?;
    Ok(python)
}

fn imports(python: &Path) -> Result<bool> {
    Ok(process::succeeds(command(python)?.args(["-c", IMPORTS])))
}
