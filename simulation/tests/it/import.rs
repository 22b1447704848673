//! `paws-sim import`, and the verbs that open what it writes.

use std::fs;

use scene_bundle::film;

use crate::bundle::{paws_sim, printed};

#[test]
fn a_folder_of_beogym_becomes_a_scene_that_the_verbs_open() {
    let folder = tempfile::tempdir().expect("a folder");
    let [from, to] = ["beogym", "yard"].map(|name| folder.path().join(name));
    simulation::testing::beogym::write(&from, 6.0).expect("a folder of Beogym");
    let [from_text, to_text] = [&from, &to].map(|path| path.to_str().expect("a path"));
    let import = ["import", from_text, "--out", to_text];
    let text = printed(&paws_sim(&import));
    assert!(
        text.starts_with("2 sectors, 2 edges, 4 Gaussians: "),
        "{text}"
    );
    assert!(text.contains("only where it has the scale"), "{text}");
    // Every bundle is whole.
    for name in ["000.scene", "001.scene"] {
        let bundle = scene_bundle::Scene::open(&to.join(name)).expect("a bundle");
        let report = scene_bundle::verify::verify(&bundle, |_| {}).expect("verified");
        assert!(report.is_whole() && report.unnamed.is_empty(), "{report:?}");
    }
    let text = printed(&paws_sim(&["info", to_text]));
    assert!(text.contains("leads to sec2"), "{text}");
    // An agent walks in it.
    printed(&paws_sim(&["film", to_text, "--seconds", "4"]));
    let film = film::read(&to).expect("a film").expect("a film");
    assert_eq!(film.film.frames.len(), 21);

    // Nothing is overwritten, whatever is there.
    let before = fs::read(to.join("scene-graph.json")).expect("the scene file");
    let again = paws_sim(&import);
    assert_eq!(again.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(errors.contains("there already"), "{errors}");
    assert_eq!(
        fs::read(to.join("scene-graph.json")).expect("the scene file"),
        before
    );

    // What the folder lacks is named, and the exit code says so.
    fs::remove_file(from.join("surfaceMap.pcd")).expect("remove the map");
    let other = folder.path().join("other");
    let other = other.to_str().expect("a path");
    let without = paws_sim(&["import", from_text, "--out", other]);
    assert_eq!(without.status.code(), Some(3));
    let text = String::from_utf8_lossy(&without.stdout).into_owned();
    assert!(text.contains("missing: surfaceMap.pcd"), "{text}");
    let film = paws_sim(&["film", other]);
    assert_eq!(film.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&film.stderr).into_owned();
    assert!(errors.contains("sector sec1 has no maps"), "{errors}");
}
