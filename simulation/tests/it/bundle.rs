//! A bundle of the synthetic room.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use scene_bundle::outputs::splats::{
    self, SplatBackground, SplatContent, SplatScene, SplatSector, SplatTraining,
};
use scene_bundle::outputs::{self, maps, trajectory};
use scene_bundle::{Bundle, Provenance, Record, RigRevision};
use simulation::testing::SyntheticScene;

/// Writes a room with one sector of Gaussians, maps and the trajectory of its walk.
pub(crate) fn write(folder: &Path) -> PathBuf {
    let path = folder.join("room.scene");
    let room = SyntheticScene::room().expect("a room");
    let sector = &room.scene.sectors[0];
    let bundle = Bundle::create_or_open(&path, provenance()).expect("a bundle");
    let record = || Record {
        stage: "test".to_owned(),
        stage_version: 1,
        settings: serde_json::json!({}),
        inputs: Default::default(),
    };
    let draft = bundle.begin(outputs::MAPS).expect("a draft");
    maps::write(&draft, sector.levels.as_ref().expect("levels")).expect("maps");
    draft.commit(record()).expect("maps");

    let gaussians = sector.gaussians.as_ref().expect("Gaussians");
    let scene = gaussians.load().expect("Gaussians");
    let content = SplatContent {
        sectors: std::slice::from_ref(&scene.splats),
        ..SplatContent::default()
    };
    let splat_scene = SplatScene {
        degree: gaussians.degree(),
        compensated: gaussians.is_compensated(),
        background: SplatBackground::Constant([0.5, 0.7, 0.9]),
        sectors: vec![SplatSector {
            min_m: [-100.0; 3],
            max_m: [100.0; 3],
            count: 0,
            file: String::new(),
            blake3: String::new(),
            views: Vec::new(),
            neighbors: Vec::new(),
        }],
        views: Vec::new(),
        training: SplatTraining::default(),
        coverage: None,
    };
    let draft = bundle.begin(outputs::SPLATS).expect("a draft");
    splats::write(&draft, &splat_scene, &content).expect("Gaussians");
    draft.commit(record()).expect("Gaussians");

    let draft = bundle.begin(outputs::TRAJECTORY).expect("a draft");
    let walk = sector.recording.trajectory.as_ref().expect("a walk");
    trajectory::write(&draft, walk).expect("a trajectory");
    draft.commit(record()).expect("a trajectory");
    bundle.finish(2).expect("a bundle");
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

fn provenance() -> Provenance {
    Provenance {
        session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
        handoff_blake3: "ab".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "chest".to_owned(),
            revision: "B".to_owned(),
        },
        program: "test".to_owned(),
        program_version: "1.0".to_owned(),
        started_civil_ns: 1,
        ended_civil_ns: None,
    }
}
