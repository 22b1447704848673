//! The wheel as a user installs it: `pip install FILE` in a fresh environment, which takes what the
//! wheel depends on from a package index, and then the lines of Python in README.md.
//!
//! They run on a scene bundle of a synthetic room, and on the demo's scene where it is there. The
//! environment is kept: while the manifest of the package is the same, only the wheel is installed
//! again, so that nothing is downloaded.

use std::path::Path;

use anyhow::{Context, Result, ensure};

use crate::process::{self, command, root, target_folder};

/// What the lines of README.md open.
const DEMO: &str = "target/demo/walk.scene";
/// Folder in the target folder.
const FOLDER: &str = "python-fresh";
/// What names the packages that the wheel depends on.
const MANIFEST: &str = "simulation/python/pyproject.toml";
/// A package without dependencies: whether there is a package index.
const PROBE: &str = "typing_extensions";

/// Installs a wheel and runs the lines. The text says how and on what, or why not.
pub(super) fn check(wheel: &Path) -> Result<String> {
    let folder = target_folder()?.join(FOLDER);
    let python = folder.join("environment/bin/python");
    let Some(how) = install(&folder, &python, wheel)? else {
        return Ok("not installed afresh: no package index".to_owned());
    };
    let room = folder.join("room.scene");
    remove(&room)?;
    let mut write = command(&python)?;
    let code = "import sys, paws_sim; paws_sim.write_synthetic('room', sys.argv[1])";
    process::run(write.args(["-I", "-c", code]).arg(&room))?;
    let lines = lines(&std::fs::read_to_string(root()?.join("README.md"))?)?;
    let mut scenes = vec![room];
    let demo = target_folder()?.join("demo/walk.scene");
    let has_demo = demo.exists();
    scenes.extend(has_demo.then_some(demo));
    for scene in &scenes {
        run_lines(&python, &lines, scene)?;
    }
    let on = match has_demo {
        true => "a synthetic scene and that of the demo",
        false => "a synthetic scene",
    };
    Ok(format!("{how}, README's lines on {on}"))
}

/// Installs a wheel with what it depends on, or alone where that is there. The text says which;
/// `None` without a package index.
fn install(folder: &Path, python: &Path, wheel: &Path) -> Result<Option<&'static str>> {
    let manifest = root()?.join(MANIFEST);
    let wanted =
        std::fs::read(&manifest).with_context(|| format!("reading {}", manifest.display()))?;
    let stamp = folder.join("installed-pyproject.toml");
    let is_kept = std::fs::read(&stamp).is_ok_and(|installed| installed == wanted);
    if is_kept && process::succeeds(command(python)?.args(["-I", "-c", "import gymnasium, numpy"]))
    {
        let mut again = pip(python)?;
        again.args(["install", "--no-index", "--no-deps", "--force-reinstall"]);
        process::run(again.arg(wheel)).context("installing the wheel again")?;
        return Ok(Some("installed again"));
    }
    remove(folder)?;
    let mut make = command("python3")?;
    make.args(["-m", "venv"]).arg(folder.join("environment"));
    process::run(&mut make).context("making a fresh Python environment")?;
    if let Err(error) = process::run(pip(python)?.arg("install").arg(wheel)) {
        let mut probe = pip(python)?;
        probe.args(["download", "--no-deps", "--dest"]);
        if process::succeeds(probe.arg(folder).arg(PROBE)) {
            return Err(error).context("installing the wheel with what it depends on");
        }
        return Ok(None);
    }
    std::fs::write(&stamp, wanted).with_context(|| format!("writing {}", stamp.display()))?;
    Ok(Some("installed afresh"))
}

/// Removes a folder, which may not exist.
fn remove(folder: &Path) -> Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("removing {}", folder.display()))
        }
        _ => Ok(()),
    }
}

fn pip(python: &Path) -> Result<std::process::Command> {
    let mut pip = command(python)?;
    pip.args(["-m", "pip", "--quiet", "--disable-pip-version-check"]);
    pip.args(["--no-input", "--retries", "2"]);
    Ok(pip)
}

fn run_lines(python: &Path, lines: &str, scene: &Path) -> Result<()> {
    let mut code = lines.replace(DEMO, &scene.to_string_lossy());
    // A state, a reward, two flags and the numbers of the step.
    code.push_str(
        "\nassert env.action_space.shape and len(env.step(env.action_space.sample())) == 5\n",
    );
    let mut run = command(python)?;
    process::run(run.args(["-I", "-c", &code]))
        .with_context(|| format!("the lines of README.md on {}", scene.display()))
}

/// The lines of Python in README.md that step an environment.
fn lines(readme: &str) -> Result<String> {
    let blocks = readme.split("```python\n").skip(1);
    let mut blocks = blocks.filter_map(|rest| rest.split("```").next());
    let found = blocks.find(|block| block.contains("paws_sim.make"));
    let lines = found.context("README.md has no lines of Python with paws_sim.make")?;
    ensure!(
        lines.contains(DEMO),
        "the lines of Python in README.md do not open {DEMO}"
    );
    Ok(lines.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lines_of_the_readme_are_found() {
        let readme = std::fs::read_to_string(root().unwrap().join("README.md")).unwrap();
        let lines = lines(&readme).unwrap();
        assert!(lines.contains("env.step"), "{lines}");
        assert!(super::lines("```python\nimport numpy\n```").is_err());
    }
}
