use std::sync::Arc;

use super::*;
use crate::agent::AgentState;
use crate::episode::Task;
use crate::testing;
use crate::world::{World, WorldConfig};

/// An import of two sectors whose areas meet, in a new folder.
fn imported(second_m: f64) -> (tempfile::TempDir, SceneData) {
    let folder = tempfile::tempdir().unwrap();
    let from = folder.path().join("beogym");
    testing::beogym::write(&from, second_m).unwrap();
    let to = folder.path().join("yard");
    let scene = SceneData::import_beogym(&from, &to, &BeogymConfig::default(), 7).unwrap();
    (folder, scene)
}

#[test]
fn a_written_import_opens_as_it_was_read() {
    let (folder, expected) = imported(6.0);
    let found = SceneData::open(&folder.path().join("yard")).unwrap();
    assert_eq!(found.name, expected.name);
    assert_eq!(found.sectors.len(), 2);
    for (found, expected) in found.sectors.iter().zip(&expected.sectors) {
        assert_eq!(found.name, expected.name);
        assert_eq!(found.area, expected.area);
        assert_eq!(found.references, expected.references);
        let [a, b] = [found, expected].map(|s| s.gaussians.as_ref().unwrap().load().unwrap());
        assert_eq!(a.splats, b.splats);
        assert_eq!(a.background, b.background);
        let [a, b] = [found, expected].map(|s| &s.edges[0]);
        assert_eq!(found.edges.len(), 1);
        assert_eq!((a.to, a.to_from_here), (b.to, b.to_from_here));
        assert_eq!((a.overlap, a.residual_m), (b.overlap, b.residual_m));
        assert!(a.is_imported);
        let [a, b] = [found, expected].map(|s| &s.levels.as_ref().unwrap()[0]);
        for x in [0.3, 2.1, 4.5, 7.0, 11.9] {
            for y in [-7.9, -4.5, -3.0, -0.2] {
                let [in_a, in_b] = [a, b].map(|level| level.grid.cell([x, y]).unwrap());
                assert_eq!(a.elevation[in_a].to_bits(), b.elevation[in_b].to_bits());
                assert_eq!(a.occupancy[in_a], b.occupancy[in_b]);
                assert_eq!(
                    a.normal[in_a].map(f32::to_bits),
                    b.normal[in_b].map(f32::to_bits)
                );
            }
        }
    }
    // Only what recordings have is missing.
    assert!(
        found
            .missing()
            .iter()
            .all(|m| m.output != "maps" && m.output != "splats")
    );
}

#[test]
fn parts_of_maps_end_beyond_an_area() {
    let (_folder, scene) = imported(6.0);
    let sector = &scene.sectors[0];
    let level = &sector.levels.as_ref().unwrap()[0];
    let area = crate::scene::Area::new([0.5, -3.0], [1.0, -2.0]);
    let part = crop::cropped(level, &area, 1.0).unwrap();
    let (corner, size) = (part.grid.corner_m(), part.grid.size_m());
    for (k, [least, greatest]) in [[0.0, 2.0], [-4.0, -1.0]].into_iter().enumerate() {
        assert!((corner[k] - least).abs() < 0.1 + 1e-9, "{corner:?}");
        assert!(
            (corner[k] + size[k] - greatest).abs() < 0.1 + 1e-9,
            "{size:?}"
        );
    }
    let far = crate::scene::Area::new([50.0, 50.0], [60.0, 60.0]);
    assert!(crop::cropped(level, &far, 8.0).is_none());
}

/// An agent walks from the first sector into the second one, with a goal-less task.
#[test]
fn an_agent_walks_over_an_edge_of_a_written_import() {
    let (folder, _) = imported(6.0);
    let scene = SceneData::open(&folder.path().join("yard")).unwrap();
    let mut config = WorldConfig::default();
    config.task.task = Task::Velocity;
    config.end.max_deviation_m = 100.0;
    config.end.max_deviation_rad = 4.0;
    let mut world = World::new(Arc::new(scene), config).unwrap();
    let is_first = |world: &World| world.world_from_camera(0).0 == 0;
    for _ in 0..100 {
        world.reset(None, None).unwrap();
        if is_first(&world) {
            break;
        }
    }
    let start = AgentState {
        position_m: [2.8, -3.0, -1.5],
        yaw_rad: 0.0,
        velocity: [0.0; 3],
        ..world.states()[0]
    };
    world.place(0, 0, &start).unwrap();
    let mut changed_at_m = None;
    while world.states()[0].position_m[0] < 5.5 {
        let before = is_first(&world);
        world.step(&[1.0, 0.0]).unwrap();
        let [x, y, z] = world.states()[0].position_m;
        assert!(
            !world.has_ended(0) && world.result().blocked[0] == 0,
            "at {x}"
        );
        assert!((y + 3.0).abs() < 1e-9 && (z + 1.5).abs() < 1e-6, "{y} {z}");
        if before && !is_first(&world) {
            changed_at_m = Some(x);
        }
    }
    // Areas are -3 to 5 m and 3 to 11 m: the owner changes 8 cm beyond 4 m, within a step.
    let changed_at_m = changed_at_m.unwrap();
    assert!((4.08..4.25).contains(&changed_at_m), "{changed_at_m}");
    assert!(!is_first(&world));
}

#[test]
fn nothing_is_overwritten_and_nothing_is_left_of_a_failure() {
    let (folder, scene) = imported(6.0);
    let [from, to] = ["beogym", "yard"].map(|name| folder.path().join(name));
    let before = fs::read(to.join(IN_FOLDER)).unwrap();
    let config = BeogymConfig::default();
    let again = SceneData::import_beogym(&from, &to, &config, 8).unwrap_err();
    assert!(again.to_string().contains("there already"), "{again}");
    assert!(again.to_string().contains("yard"), "{again}");
    assert_eq!(fs::read(to.join(IN_FOLDER)).unwrap(), before);
    // What an import that was stopped left does not hinder the next one.
    let stopped = folder.path().join(".resumed.partial");
    fs::create_dir(&stopped).unwrap();
    fs::write(stopped.join("000.scene"), "half").unwrap();
    let resumed = folder.path().join("resumed");
    SceneData::import_beogym(&from, &resumed, &config, 8).unwrap();
    assert!(resumed.join(IN_FOLDER).exists() && !stopped.exists());
    // A folder of Beogym without a file: its name, and no new folder.
    let other = folder.path().join("other");
    let transform = from.join("sec2/transformation.txt");
    fs::remove_file(&transform).unwrap();
    let error = SceneData::import_beogym(&from, &other, &config, 8).unwrap_err();
    assert!(
        error.to_string().contains("sec2/transformation.txt"),
        "{error}"
    );
    assert!(!other.exists());
    // A sector that the format refuses.
    let mut wrong = scene;
    let mut references = wrong.sectors[1].references.to_vec();
    references.clear();
    wrong.sectors[1].references = Arc::new(references);
    let mut levels = wrong.sectors[1].levels.as_ref().unwrap().to_vec();
    levels[0].occupancy[0] = 7;
    wrong.sectors[1].levels = Some(Arc::new(levels));
    let error = write(&wrong, &config, &other, 8).unwrap_err();
    assert!(error.to_string().contains("sec2"), "{error}");
    assert!(!other.exists());
}

#[test]
fn an_area_of_a_recording_is_checked() {
    let (folder, _) = imported(6.0);
    let file = folder.path().join("yard").join(IN_FOLDER);
    let text = fs::read_to_string(&file).unwrap();
    let whole: serde_json::Value = serde_json::from_str(&text).unwrap();
    for wrong in [serde_json::json!([30.0, -6.0]), serde_json::Value::Null] {
        let mut changed = whole.clone();
        changed["recordings"][0]["area_min_m"] = wrong;
        fs::write(&file, changed.to_string()).unwrap();
        let error = SceneData::open(&file).unwrap_err();
        assert!(
            error.to_string().contains("recording sec1: an area from"),
            "{error}"
        );
    }
}
