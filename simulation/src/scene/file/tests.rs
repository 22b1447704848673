use std::fs;

use super::*;
use crate::scene::Place;

/// A bundle of maps alone, an open square of 8 x 8 m.
fn write_bundle(path: &Path) {
    use scene_bundle::outputs::grid::Grid;
    use scene_bundle::outputs::maps::{self, FREE, KNOWN, MapLevel};
    use scene_bundle::{Bundle, Provenance, Record, RigRevision};
    let provenance = Provenance {
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
    };
    let bundle = Bundle::create_or_open(path, provenance).unwrap();
    let grid = Grid {
        cell_m: 0.5,
        origin_m: [0.25, 0.25],
        columns: 16,
        rows: 16,
    };
    let mut level = MapLevel::unknown(grid);
    level.elevation.fill(0.0);
    level.flags.fill(KNOWN);
    level.occupancy.fill(FREE);
    let draft = bundle.begin(scene_bundle::outputs::MAPS).unwrap();
    maps::write(&draft, &[level]).unwrap();
    let record = Record {
        stage: "test".to_owned(),
        stage_version: 1,
        settings: serde_json::json!({}),
        inputs: Default::default(),
    };
    draft.commit(record).unwrap();
    bundle.finish(2).unwrap();
}

/// The yard begins where the hall ends, rotated by a quarter, 2 % larger.
const EDGE: &str = r#"{"from": "hall", "to": "yard", "to_from_here": {"scale": 1.02,
    "rotation_wxyz": [0.7071067811865476, 0, 0, 0.7071067811865476],
    "translation_m": [8.0, -6.0, 0.0]},
    "overlap_min_m": [6.0, 0.0], "overlap_max_m": [8.0, 8.0], "residual_m": 0.004}"#;

fn open(folder: &Path, edges: &str) -> Result<SceneData, SimulationError> {
    let text = format!(
        r#"{{"format": "paws-scene-graph", "version": 1, "name": "campus",
            "recordings": [{{"name": "hall", "bundle": "a.scene"}},
                           {{"name": "yard", "bundle": "b.scene"}}],
            "edges": [{edges}]}}"#
    );
    let path = folder.join("campus.json");
    fs::write(&path, text).unwrap();
    SceneData::open(&path)
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_bundle(&folder.path().join("a.scene"));
    write_bundle(&folder.path().join("b.scene"));
    folder
}

#[test]
fn recordings_are_sectors_with_edges_both_ways() {
    let folder = folder();
    let scene = open(folder.path(), EDGE).unwrap();
    let names: Vec<&str> = scene
        .sectors
        .iter()
        .map(|sector| sector.name.as_str())
        .collect();
    assert_eq!(names, ["hall", "yard"]);
    assert_eq!(scene.missing().len(), 14);
    let [there, back] = [0, 1].map(|k| &scene.sectors[k].edges[0]);
    assert!(there.is_imported && there.residual_m == Some(0.004));
    let at = back
        .to_from_here
        .apply(there.to_from_here.apply([7.0, 3.0, 0.5]));
    assert!(
        at.iter()
            .zip([7.0, 3.0, 0.5])
            .all(|(a, b)| (a - b).abs() < 1e-12),
        "{at:?}"
    );
    assert!((back.to_from_here.scale() - 1.0 / 1.02).abs() < 1e-12);
    // Another transform is another scene.
    let other = open(folder.path(), &EDGE.replace("1.02", "1.01")).unwrap();
    assert_ne!(scene.hash(), other.hash());
}

#[test]
fn there_and_back_is_the_same_pose() {
    let folder = folder();
    let scene = open(folder.path(), EDGE).unwrap();
    // x = 7.5 of the hall is y = 1.65 of the yard: deeper there.
    let position = [7.5, 4.0, 0.0];
    let start = Place {
        sector: 0,
        sector_from_body: cad_transforms::RigidTransform::from_rotation_vector(
            [0.1, 0.0, 0.7],
            position,
        )
        .unwrap(),
    };
    let there = scene.cross(&start);
    assert_eq!(there.sector, 1);
    let back = scene.sectors[1].edges[0]
        .to_from_here
        .carry(&there.sector_from_body);
    let difference = back.inverse() * start.sector_from_body;
    assert!(difference.distance_m() < 1e-12 && difference.angle_rad() < 1e-7);
}

#[test]
fn damaged_files_and_edges_are_errors() {
    let folder = folder();
    for (edges, expected) in [
        (
            EDGE.replace("\"yard\"", "\"garden\""),
            "an edge with the sector \"garden\"",
        ),
        (EDGE.replace("1.02", "-1"), "a scale of -1"),
        (
            EDGE.replace("0.7071067811865476]", "0.9]"),
            "a quaternion of length",
        ),
        (EDGE.replace("residual_m", "residual"), "unknown field"),
        (
            EDGE.replace("1.02", "10.2"),
            "found a scale of 10.2, expected 1 within 0.02",
        ),
        (EDGE.replace("0.004", "-1.0"), "found a residual of -1 m"),
        (EDGE.replace("0.004", "3.0"), "found a residual of 3 m"),
        (
            EDGE.replace("[6.0, 0.0]", "[9.0, 0.0]"),
            "edge from hall to yard",
        ),
        (
            EDGE.replace("[8.0, 8.0]", "[8.0, -1.0]"),
            "an overlap from [6.0, 0.0] to [8.0, -1.0]",
        ),
    ] {
        let error = open(folder.path(), &edges).unwrap_err();
        assert!(matches!(error, SimulationError::Scene { .. }), "{error}");
        assert!(error.to_string().contains(expected), "{error}");
    }
    // Both ways are listed, and the cycle does not close by 3 cm.
    let back = r#"{"from": "yard", "to": "hall", "to_from_here": {"scale": 0.9803921568627451,
        "rotation_wxyz": [0.7071067811865476, 0, 0, -0.7071067811865476],
        "translation_m": [5.882352941176471, 7.873137254901961, 0.0]},
        "overlap_min_m": [0.0, 0.0], "overlap_max_m": [8.0, 2.0], "residual_m": 0.004}"#;
    let error = open(folder.path(), &format!("{EDGE}, {back}"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("edge from yard to hall: found a cycle that does not close by 0.03"),
        "{error}"
    );
    let exact = back.replace("7.873137254901961", "7.8431372549019605");
    open(folder.path(), &format!("{EDGE}, {exact}")).unwrap();
    fs::remove_dir_all(folder.path().join("b.scene")).unwrap();
    let error = open(folder.path(), EDGE).unwrap_err();
    assert!(matches!(error, SimulationError::Bundle { .. }), "{error}");
}

#[test]
fn sectors_are_named_after_their_recording() {
    assert_eq!(renamed("walk", "walk", "hall"), "hall");
    assert_eq!(renamed("walk/001", "walk", "hall"), "hall/001");
    assert_eq!(renamed("sec1", "sec", "yard"), "yard/sec1");
}
