//! The wheel as a user installs it: `pip install FILE` in a fresh environment, which takes what the
//! wheel depends on from a package index, and then the lines of Python in README.md.
//!
//! They run on a scene bundle of a synthetic room, and on the demo's scene where it is there.

use std::path::Path;

use anyhow::{Context, Result, ensure};

use crate::process::{self, command, root, target_folder};

/// What the lines of README.md open.
const DEMO: &str = "target/demo/walk.scene";
/// How an environment of its own is named in messages.
const FOLDER: &str = "python-fresh";
/// A package without dependencies: whether there is a package index.
const PROBE: &str = "typing_extensions";

/// Installs a wheel into a fresh environment and runs the lines. The text says on what, or why not;
/// the environment is removed again.
pub(super) fn check(wheel: &Path) -> Result<String> {
    let folder = target_folder()?.join(FOLDER);
    let checked = check_in(&folder, wheel);
    // Kept after an error, to look at.
    if checked.is_ok() && folder.exists() {
        std::fs::remove_dir_all(&folder)
            .with_context(|| format!("removing {}", folder.display()))?;
    }
    checked
}

fn check_in(folder: &Path, wheel: &Path) -> Result<String> {
    let environment = folder.join("environment");
    let mut make = command("python3")?;
    make.args(["-m", "venv", "--clear"]).arg(&environment);
    process::run(&mut make).context("making a fresh Python environment")?;
    let python = environment.join("bin/python");
    if let Err(error) = process::run(pip(&python)?.arg("install").arg(wheel)) {
        let mut probe = pip(&python)?;
        probe.args(["download", "--no-deps", "--dest"]);
        if process::succeeds(probe.arg(folder).arg(PROBE)) {
            return Err(error).context("installing the wheel with what it depends on");
        }
        return Ok("not installed afresh: no package index".to_owned());
    }
    let room = folder.join("room.scene");
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
    Ok(format!("installed afresh, README's lines on {on}"))
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
