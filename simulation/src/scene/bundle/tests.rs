use std::fs;
use std::path::PathBuf;

use cad_transforms::RigidTransform;
use gaussians::{Plane, Splats};
use scene_bundle::outputs::splats::{SplatBackground, SplatContent, SplatNeighbor, SplatTraining};
use scene_bundle::{Bundle, Provenance, Record, RigRevision};

use super::*;
use crate::scene::Place;
use crate::testing::SyntheticScene;
use crate::testing::bundle::whole_sole;

mod faults;

/// Writes the bridge as a bundle with two sectors of Gaussians that part at x = 12 m.
fn write_bundle(folder: &Path) -> PathBuf {
    let path = folder.join("bridge.scene");
    let synthetic = SyntheticScene::bridge().unwrap();
    let sector = &synthetic.scene.sectors[0];
    let bundle = Bundle::create_or_open(&path, provenance()).unwrap();
    let draft = bundle.begin(outputs::MAPS).unwrap();
    maps::write(&draft, sector.levels.as_ref().unwrap()).unwrap();
    draft.commit(record()).unwrap();
    let scene = sector.gaussians.as_ref().unwrap().load().unwrap();
    let (parts, sectors): (Vec<Splats>, Vec<SplatSector>) =
        (0..2).map(|side| half(&scene.splats, side)).unzip();
    let record_of_splats = SplatScene {
        degree: 0,
        compensated: false,
        background: SplatBackground::Constant([0.5; 3]),
        sectors,
        views: Vec::new(),
        training: SplatTraining::default(),
        coverage: None,
    };
    let content = SplatContent {
        sectors: &parts,
        ..SplatContent::default()
    };
    let draft = bundle.begin(outputs::SPLATS).unwrap();
    outputs::splats::write(&draft, &record_of_splats, &content).unwrap();
    draft.commit(record()).unwrap();
    let draft = bundle.begin(outputs::TRAJECTORY).unwrap();
    let trajectory = sector.recording.trajectory.as_ref().unwrap();
    outputs::trajectory::write(&draft, trajectory).unwrap();
    draft.commit(record()).unwrap();
    let draft = bundle.begin(outputs::CONTACTS).unwrap();
    let contacts = &sector.recording.contacts;
    let patches: Vec<_> = contacts.iter().map(whole_sole).collect();
    outputs::contacts::write(&draft, contacts, &patches, &[]).unwrap();
    draft.commit(record()).unwrap();
    bundle.finish(2).unwrap();
    path
}

fn half(splats: &Splats, side: usize) -> (Splats, SplatSector) {
    let x = &splats.planes()[Plane::POSITION];
    let is_here = |index: &u32| usize::from(x[*index as usize] > 12.0) == side;
    let indices: Vec<u32> = (0..splats.len() as u32).filter(is_here).collect();
    let sector = SplatSector {
        min_m: [12.0 * side as f64, -1.0, -1.0],
        max_m: [12.0 * (side + 1) as f64, 9.0, 9.0],
        count: 0,
        file: String::new(),
        blake3: String::new(),
        views: Vec::new(),
        neighbors: vec![SplatNeighbor {
            sector: 1 - side,
            neighbor_from_sector: RigidTransform::identity(),
        }],
    };
    (splats.select(&indices), sector)
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

fn record() -> Record {
    Record {
        stage: "test".to_owned(),
        stage_version: 1,
        settings: serde_json::json!({}),
        inputs: Default::default(),
    }
}

/// The first file of an output with this ending.
fn file(bundle: &Path, output: &str, ending: &str) -> PathBuf {
    let folders = fs::read_dir(bundle)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let is_output = |path: &PathBuf| {
        path.file_name()
            .unwrap()
            .to_string_lossy()
            .starts_with(&format!("{output}."))
    };
    let folder = folders.into_iter().find(is_output).unwrap();
    let mut files: Vec<PathBuf> = Vec::new();
    let mut open = vec![folder];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path)
            } else {
                files.push(path)
            }
        }
    }
    files.sort();
    files
        .into_iter()
        .find(|path| path.to_string_lossy().ends_with(ending))
        .unwrap()
}

#[test]
fn sectors_are_those_of_the_gaussians() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_bundle(folder.path());
    let scene = SceneData::open(&path).unwrap();
    assert_eq!((scene.name.as_str(), scene.sectors.len()), ("bridge", 2));
    let missing: Vec<&str> = scene.missing().iter().map(|m| m.output.as_str()).collect();
    assert_eq!(missing, ["rig", "feet", "terrain", "collision"]);
    assert!(
        scene
            .missing()
            .iter()
            .all(|missing| !missing.features.is_empty())
    );
    // Both sectors show everything within reach: here all of it, in the order of the files.
    let truth = SyntheticScene::bridge().unwrap();
    let all = truth.scene.sectors[0].gaussians.as_ref().unwrap();
    for sector in &scene.sectors {
        let gaussians = sector.gaussians.as_ref().unwrap();
        assert_eq!(gaussians.count(), all.count());
        assert_eq!(gaussians.load().unwrap().splats.len(), all.count());
        assert_eq!(
            sector.recording.contacts,
            truth.scene.sectors[0].recording.contacts
        );
    }
    // A pose crosses unchanged, a little beyond the border.
    let at = |x: f64| Place {
        sector: 0,
        sector_from_body: RigidTransform::from_translation_m([x, 4.0, 0.0]).unwrap(),
    };
    assert_eq!(scene.cross(&at(12.05)).sector, 0);
    let crossed = scene.cross(&at(12.1));
    assert_eq!(
        (crossed.sector, crossed.sector_from_body),
        (1, at(12.1).sector_from_body)
    );
    // The ground is one and the same, and nothing is faded.
    let [a, b] = [0, 1].map(|k| scene.sectors[k].levels.as_ref().unwrap());
    assert!(Arc::ptr_eq(a, b));
    assert!(scene.fade(0, [12.0, 4.0, 0.0]).is_none());
}

#[test]
fn a_short_reach_shows_less() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_bundle(folder.path());
    let config = BundleConfig { view_reach_m: 3.0 };
    let scene = SceneData::open_with(&path, &config).unwrap();
    for (number, sector) in scene.sectors.iter().enumerate() {
        let gaussians = sector.gaussians.as_ref().unwrap();
        let loaded = gaussians.load().unwrap();
        assert_eq!(loaded.splats.len(), gaussians.count());
        // Some beyond the border at 12 m, none beyond the reach.
        let near = |x: &&f32| [12.0..15.0, 9.0..12.0][number].contains(*x);
        let positions = &loaded.splats.planes()[Plane::POSITION];
        assert!(positions.iter().filter(near).count() > 0);
        let beyond = |x: &&f32| [**x > 15.0, **x < 9.0][number];
        assert_eq!(
            loaded.splats.planes()[Plane::POSITION]
                .iter()
                .filter(beyond)
                .count(),
            0
        );
    }
    assert_ne!(scene.hash(), SceneData::open(&path).unwrap().hash());
    assert_eq!(
        scene.hash(),
        SceneData::open_with(&path, &config).unwrap().hash()
    );
}

/// Faults of the reference page: each is an error at opening with output and file.
#[test]
fn damaged_files_are_errors_with_their_place() {
    type Damage = fn(&Path);
    let flip: Damage = |path| {
        let mut bytes = fs::read(path).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        fs::write(path, bytes).unwrap();
    };
    let truncate: Damage = |path| {
        let bytes = fs::read(path).unwrap();
        fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
    };
    let remove: Damage = |path| fs::remove_file(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = write_bundle(folder.path());
    for (damage, output, ending, expected) in [
        (flip, outputs::SPLATS, "001.ply", "content with the hash"),
        (truncate, outputs::SPLATS, "000.ply", "bytes"),
        (remove, outputs::SPLATS, "000.ply", "no file"),
        (
            flip,
            outputs::MAPS,
            "elevation.npy",
            "content with the hash",
        ),
        (truncate, outputs::CONTACTS, "contacts.npy", "bytes"),
        (remove, outputs::TRAJECTORY, "trajectory.npy", "no file"),
    ] {
        let file = file(&path, output, ending);
        let before = fs::read(&file).unwrap();
        damage(&file);
        let error = SceneData::open(&path).unwrap_err();
        fs::write(&file, before).unwrap();
        let SimulationError::Scene { place, found, .. } = error else {
            panic!("{error}");
        };
        assert!(place.contains(&format!("output {output}")), "{place}");
        assert!(place.contains(ending), "{place}");
        assert!(found.contains(expected), "{found}");
        SceneData::open(&path).unwrap();
    }
}

#[test]
fn what_is_no_bundle_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let error = SceneData::open(folder.path()).unwrap_err();
    assert!(matches!(error, SimulationError::Bundle { .. }), "{error}");
}
