//! `paws-sim film` and `info`.

use std::fs;

use scene_bundle::film;
use simulation::testing::SyntheticScene;

use crate::bundle::{paws_sim, printed, write};

#[test]
fn an_agent_walks_to_goals_and_the_same_seed_gives_the_same_film() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write(folder.path());
    let path = scene.to_str().expect("a path");
    let page = folder.path().join("film.html");
    let page = page.to_str().expect("a path");
    let run = |seed: &str| {
        let arguments = [
            "film",
            path,
            "--seconds",
            "12",
            "--seed",
            seed,
            "--page",
            page,
        ];
        let line = printed(&paws_sim(&arguments));
        let film = film::read(&scene).expect("a film").expect("a film");
        (line, film)
    };
    let (line, first) = run("1");
    assert!(line.starts_with("An agent walked "), "{line}");
    // An image every 0.2 s, the first at the start.
    assert_eq!(first.film.frames.len(), 61);
    let way = |k: usize| first.film.frames[k].map_px;
    let far = |k: usize| (way(k)[0] - way(0)[0]).hypot(way(k)[1] - way(0)[1]);
    assert!((0..61).any(|k| far(k) > 30.0), "it moved");
    let (_, again) = run("1");
    assert!(again == first);
    let (_, other) = run("2");
    assert!(other != first);
    let text = fs::read_to_string(page).expect("the page");
    assert_eq!(charts::inspect(&text), Ok(()));
    // The bundle is as it was.
    let verified = scene_bundle::Scene::open(&scene).expect("the bundle");
    let report = scene_bundle::verify::verify(&verified, |_| {}).expect("verified");
    assert!(report.is_whole() && report.unnamed.is_empty(), "{report:?}");
}

/// On a bundle, of which a record says what its training saw.
#[test]
fn limits_of_the_predicted_psnr_need_a_record_of_the_training() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("plane.scene");
    let plane = SyntheticScene::tilted_plane([0.05, 0.0]).expect("a plane");
    plane.write_observed_bundle(&scene).expect("a bundle");
    let path = scene.to_str().expect("a path");
    let film = |limit: &str| {
        let seconds = ["--seconds", "6", "--min-support", limit];
        paws_sim(&[&["film", path][..], &seconds].concat())
    };
    printed(&film("1"));
    assert!(film::read(&scene).expect("a film").is_some());
    // No image is that good.
    let output = film("150");
    assert_eq!(output.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("support"), "{errors}");
    // Without the record there is nothing to predict from.
    let other = write(folder.path());
    let output = paws_sim(&[
        "film",
        other.to_str().expect("a path"),
        "--min-support",
        "1",
    ]);
    assert_eq!(output.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("training"), "{errors}");
}

#[test]
fn what_a_scene_lacks_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write(folder.path());
    let path = scene.to_str().expect("a path");
    let text = printed(&paws_sim(&["info", path]));
    assert!(text.contains("missing: output terrain"), "{text}");
    assert!(text.contains("Gaussians of degree 0"), "{text}");
    let json = printed(&paws_sim(&["info", path, "--json"]));
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert!(json["sectors"][0]["free_m2"].as_f64().expect("an area") > 10.0);
    assert_eq!(json["hash"].as_str().expect("a hash").len(), 64);
}

#[test]
fn a_scene_without_maps_or_with_damage_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = paws_sim(&["film", folder.path().to_str().expect("a path")]);
    assert_eq!(output.status.code(), Some(1));
    let scene = write(folder.path());
    let maps = fs::read_dir(&scene)
        .expect("the bundle")
        .map(|entry| entry.expect("an entry").path())
        .find(|path| path.display().to_string().contains("maps."))
        .expect("maps");
    let layer = maps.join("level-0/elevation.npy");
    let mut bytes = fs::read(&layer).expect("a layer");
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&layer, bytes).expect("damage");
    let output = paws_sim(&["film", scene.to_str().expect("a path")]);
    assert_eq!(output.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("elevation.npy"), "{errors}");
    assert!(film::read(&scene).expect("no film").is_none());
}
