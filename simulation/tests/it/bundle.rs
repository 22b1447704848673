//! A bundle of the synthetic room.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use simulation::testing::SyntheticScene;

/// Writes a room with one sector of Gaussians, maps, the walk and its rig.
pub(crate) fn write(folder: &Path) -> PathBuf {
    let path = folder.join("room.scene");
    let room = SyntheticScene::room().expect("a room");
    room.write_bundle(&path).expect("a bundle");
    path
}

/// Runs `paws-sim`.
pub(crate) fn paws_sim(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_paws-sim");
    let output = Command::new(program).args(arguments).output();
    output.expect("start paws-sim")
}

/// Standard output of a run that succeeds.
pub(crate) fn printed(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}
