//! Faults of the reference page: what is wrong although all hashes are right, and disks that fail
//! during an episode.

use gaussians::files::ply;

use super::*;
use crate::agent::AgentState;
use crate::camera::{CameraBatch, CameraConfig, Frames};
use crate::episode::Task;
use crate::scene::{GaussianStore, ResidencyConfig};
use crate::world::{World, WorldConfig};

/// A bundle of one sector whose file of Gaussians has these bytes, with the hashes of them.
fn with_gaussians(folder: &Path, count: usize, bytes: &[u8]) -> PathBuf {
    let path = folder.join("wrong.scene");
    let bundle = Bundle::create_or_open(&path, provenance()).unwrap();
    let record_of_splats = SplatScene {
        degree: 0,
        compensated: false,
        background: SplatBackground::Constant([0.5; 3]),
        sectors: vec![SplatSector {
            min_m: [-1.0; 3],
            max_m: [1.0; 3],
            count,
            file: "000.ply".to_owned(),
            blake3: blake3::hash(bytes).to_hex().to_string(),
            views: Vec::new(),
            neighbors: Vec::new(),
        }],
        views: Vec::new(),
        training: SplatTraining::default(),
        coverage: None,
    };
    let draft = bundle.begin(outputs::SPLATS).unwrap();
    draft.write("000.ply", bytes).unwrap();
    let text = serde_json::to_vec(&record_of_splats).unwrap();
    draft.write("splats.json", &text).unwrap();
    draft.commit(record()).unwrap();
    bundle.finish(2).unwrap();
    path
}

/// Three Gaussians of degree 0, in which a property of the second one has another value.
fn changed(changes: &[(&str, f32)]) -> Vec<u8> {
    let mut splats = Splats::empty(0).unwrap();
    for _ in 0..3 {
        let ball = gaussians::Splat::sphere(0.1, [0.5; 3]);
        splats.push(&ball).unwrap();
    }
    let mut bytes = ply::write(&splats, false);
    let end = b"end_header\n";
    let body = bytes
        .windows(end.len())
        .position(|part| part == end)
        .unwrap()
        + end.len();
    let header = String::from_utf8(bytes[..body].to_vec()).unwrap();
    let properties = header
        .lines()
        .filter_map(|line| line.strip_prefix("property float "));
    let properties: Vec<&str> = properties.collect();
    for (name, value) in changes {
        let index = properties.iter().position(|own| own == name).unwrap();
        let at = body + 4 * (properties.len() + index);
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    bytes
}

#[test]
fn gaussians_that_mean_nothing_are_errors_at_opening_with_their_index() {
    let zero = ["rot_0", "rot_1", "rot_2", "rot_3"].map(|name| (name, 0.0));
    let none = ply::write(&Splats::empty(0).unwrap(), false);
    for (count, bytes, expected) in [
        (3, changed(&[("x", f32::NAN)]), "Gaussian 1"),
        (3, changed(&[("scale_1", f32::INFINITY)]), "Gaussian 1"),
        // An opacity is stored as its logit: every finite number is one between 0 and 1.
        (3, changed(&[("opacity", f32::NEG_INFINITY)]), "Gaussian 1"),
        (3, changed(&zero), "Gaussian 1"),
        (0, none, "0 Gaussians"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = with_gaussians(folder.path(), count, &bytes);
        let error = SceneData::open(&path).unwrap_err();
        assert!(matches!(error, SimulationError::Scene { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains(expected), "{text}");
        assert!(text.contains("000.ply"), "{text}");
    }
    let folder = tempfile::tempdir().unwrap();
    let far = changed(&[("opacity", 80.0)]);
    SceneData::open(&with_gaussians(folder.path(), 3, &far)).unwrap();
}

/// The second sector's file is removed while an agent walks through the first one.
#[test]
fn a_disk_error_in_an_episode_leaves_the_environment_usable() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_bundle(folder.path());
    let scene = Arc::new(SceneData::open(&path).unwrap());
    let store = GaussianStore::new(scene.clone(), ResidencyConfig::default());
    let camera = CameraConfig::pinhole([24, 16], 1.2).unwrap();
    let cameras = CameraBatch::new(Arc::new(store), camera).unwrap();
    let mut config = WorldConfig::default();
    config.task.task = Task::Velocity;
    config.end.max_deviation_m = 100.0;
    config.end.max_deviation_rad = 4.0;
    let mut world = World::new(scene, config).unwrap();
    world.reset(None, None).unwrap();
    let start = AgentState {
        position_m: [3.0, 1.5, 0.0],
        yaw_rad: 0.0,
        velocity: [0.0; 3],
        level: 0,
        ..world.states()[0]
    };
    world.place(0, 0, &start).unwrap();
    let image = |world: &World| {
        let mut frames = Frames::default();
        cameras.render(&[world.frame_request(0)], &mut frames)?;
        Ok::<_, SimulationError>(frames.rgb.clone())
    };
    // More than 8 m from the border: only the first sector is loaded.
    image(&world).unwrap();
    let removed = file(&path, outputs::SPLATS, "001.ply");
    let bytes = fs::read(&removed).unwrap();
    fs::remove_file(&removed).unwrap();
    walk_while(&mut world, |world| world.states()[0].position_m[0] < 11.0);
    let before = image(&world).unwrap();
    let snapshot = world.save(0, &[]).unwrap();
    walk_while(&mut world, |world| world.world_from_camera(0).0 == 0);
    let error = image(&world).unwrap_err();
    assert!(matches!(error, SimulationError::Scene { .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("sector bridge/001"), "{text}");
    assert!(text.contains("001.ply"), "{text}");
    // Without images the episode goes on, and the snapshot from before restores.
    world.step(&[1.0, 0.0]).unwrap();
    assert!(!world.has_ended(0));
    world.restore(0, &snapshot).unwrap();
    assert!(image(&world).unwrap() == before);
    // With the file as it was, the walk shows what it shows without a fault.
    fs::write(&removed, &bytes).unwrap();
    walk_while(&mut world, |world| world.world_from_camera(0).0 == 0);
    let found = image(&world).unwrap();
    let fresh = GaussianStore::new(Arc::clone(world.scene()), ResidencyConfig::default());
    let fresh = CameraBatch::new(Arc::new(fresh), cameras.config().clone()).unwrap();
    let mut frames = Frames::default();
    fresh
        .render(&[world.frame_request(0)], &mut frames)
        .unwrap();
    assert!(found == frames.rgb);
}

/// Walks ahead while a condition holds, which it does for a few hundred steps at most.
fn walk_while(world: &mut World, holds: impl Fn(&World) -> bool) {
    for _ in 0..500 {
        if !holds(world) {
            return;
        }
        world.step(&[1.0, 0.0]).unwrap();
    }
    panic!("at {:?} after 500 steps", world.states()[0]);
}
