//! Recordings that lack what the stages of feet and ground use: each stage reports what is missing,
//! and the pipeline continues.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use cad_transforms::Rig;
use reconstruction::pipeline::report_of;
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render_session};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{EyeDifference, Imaging, Settings, Simulation};
use scene_bundle::outputs::depth::{DepthImage, DepthWriter};
use scene_bundle::outputs::terrain::MeshDetail;
use scene_bundle::verify::verify;
use scene_bundle::{Bundle, Record, Scene, outputs};
use serde_json::Value;
use session_archive::handoff::Verdict;

use crate::frame_set_reader::RIG;
use crate::full_disk::copy;
use crate::session::{index, seal_session};
use crate::walk::made;

/// A walk on a plaza, rendered into a new folder.
fn record(seconds: f64, rig_text: &str, imaging: Imaging) -> (tempfile::TempDir, PathBuf) {
    let settings = Settings {
        kind: Kind::Plaza,
        lighting: Lighting::Day,
        seed: 3,
        seconds,
        rate_hz: 15.0,
        width: 480,
        height: 268,
        quality: Quality::FAST,
    };
    let rig = Rig::parse(rig_text).expect("a rig file");
    let simulation = Simulation::new(&settings, &rig).and_then(|own| own.with_imaging(imaging));
    let job = Job {
        rig: &rig,
        rig_text,
        faults: &Faults::default(),
        truth: false,
        session: true,
        threads: 2,
    };
    let folder = tempfile::tempdir().expect("folder");
    let session = folder.path().join("session");
    let simulation = Arc::new(simulation.expect("a walk"));
    render_session(&simulation, &job, &session, &|| {}).expect("a session");
    index(&session);
    seal_session(&session, Verdict::Pass);
    (folder, session)
}

fn run(session: &Path, scene: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.arg("run").arg(session).arg("--out").arg(scene);
    let output = command
        .args(["--preset", "fast", "--to", "maps"])
        .args(more)
        .output();
    output.expect("run")
}

/// All outputs are there and whole, and the page of the bundle is written.
fn complete(scene: &Path) -> Scene {
    let scene = Scene::open(scene).expect("a bundle");
    for output in [
        "tag-detections",
        "terrain",
        "feet",
        "contacts",
        "maps",
        "collision",
    ] {
        assert!(scene.has(output), "{output}");
    }
    assert!(verify(&scene, |_| {}).expect("a bundle").is_whole());
    reconstruction::report::report(&scene, None, None).expect("a page");
    scene
}

fn notes(scene: &Scene, output: &str) -> Vec<String> {
    report_of(scene, output).expect("a report").notes
}

fn losses(scene: &Scene, output: &str) -> Vec<String> {
    report_of(scene, output).expect("a report").losses
}

fn contacts(scene: &Scene) -> usize {
    let reader = scene.output("contacts").expect("contacts");
    outputs::contacts::read(&reader).expect("contacts").len()
}

fn has(sentences: &[String], part: &str) -> bool {
    sentences.iter().any(|sentence| sentence.contains(part))
}

#[test]
fn without_a_camera_that_sees_shoes_there_is_nothing_to_do_for_feet() {
    let parts = RIG.split("\n\n");
    let kept = parts.filter(|part| !part.contains("feet/") && !part.contains("\"feet\""));
    let rig = kept.collect::<Vec<_>>().join("\n\n");
    let (folder, session) = record(1.0, &rig, Imaging::USUAL);
    let scene = folder.path().join("scene");
    let output = run(&session, &scene, &[]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let scene = complete(&scene);
    let notes = notes(&scene, "tag-detections");
    assert!(
        has(&notes, "no camera of the rig can see the wearer's shoes"),
        "{notes:?}"
    );
    assert_eq!(contacts(&scene), 0);
}

#[test]
fn less_than_two_steps_are_no_loss() {
    let (folder, session) = record(0.8, RIG, Imaging::USUAL);
    let scene = folder.path().join("scene");
    let output = run(&session, &scene, &[]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let scene = complete(&scene);
    let detections = scene.output("tag-detections").expect("detections");
    let detections = outputs::tag_detections::read(&detections).expect("detections");
    assert!(!detections.is_empty());
    assert!(contacts(&scene) <= 2, "{}", contacts(&scene));
    let poses = outputs::feet::read(&scene.output("feet").expect("feet")).expect("poses");
    // Two for each pose of the rig.
    assert!(!poses.is_empty() && poses.len().is_multiple_of(2));
}

#[test]
fn an_eye_that_shows_no_tag_is_a_loss_and_the_pipeline_continues() {
    let imaging = Imaging {
        right_eye: EyeDifference {
            blur_px: 10.0,
            gain: -0.5,
            ..EyeDifference::default()
        },
        ..Imaging::USUAL
    };
    let (folder, session) = record(1.5, RIG, imaging);
    let scene = folder.path().join("scene");
    let output = run(&session, &scene, &[]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{errors}");
    let scene = complete(&scene);
    let losses = losses(&scene, "tag-detections");
    assert!(has(&losses, "an eye is covered"), "{losses:?}");
}

/// Replaces all depth maps by empty ones, with the record of the stage.
fn remove_depth(scene: &Path) {
    let old = Scene::open(scene).expect("a bundle");
    let reader = old.output("depth").expect("depth");
    let depth = outputs::depth::read_index(&reader).expect("an index");
    let images: Vec<DepthImage> = depth
        .images
        .iter()
        .map(|key| {
            let mut image = outputs::depth::read(&reader, &depth, key).expect("a depth map");
            image.depth.fill(0);
            image.sigma.fill(0);
            image
        })
        .collect();
    let made = reader.output();
    let record = Record {
        stage: made.stage.clone(),
        stage_version: made.stage_version,
        settings: made.settings.clone(),
        inputs: made.inputs.clone(),
    };
    let provenance = old.manifest().provenance.clone();
    let bundle = Bundle::create_or_open(scene, provenance).expect("a bundle");
    let draft = bundle.begin("depth").expect("a draft");
    let writer = DepthWriter::new(&draft, depth.views.clone()).expect("views");
    for (key, image) in depth.images.iter().zip(&images) {
        writer.write(*key, image).expect("a depth map");
    }
    writer.finish().expect("an index");
    draft.commit(record).expect("an output");
}

#[test]
fn ground_without_depth_is_a_hole_and_feet_need_none() {
    let (session, made) = made();
    let known = contacts(&Scene::open(made).expect("a bundle"));
    assert!(known > 0);
    let folder = tempfile::tempdir().expect("folder");
    let scene = folder.path().join("scene");
    copy(made, &scene);
    remove_depth(&scene);
    let output = run(session, &scene, &["--from", "cloud"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let scene = complete(&scene);
    assert_eq!(contacts(&scene), known);
    let reader = scene.output("terrain").expect("terrain");
    let terrain = outputs::terrain::read(&reader).expect("terrain");
    let mesh = outputs::terrain::read_mesh(&reader, MeshDetail::Dense, &terrain);
    assert!(mesh.expect("a mesh").triangles.is_empty());
    let notes = notes(&scene, "terrain");
    assert!(has(&notes, "no depth map shows a surface"), "{notes:?}");
}

#[test]
fn a_bundle_of_before_feet_and_ground_is_continued() {
    let (session, made) = made();
    let folder = tempfile::tempdir().expect("folder");
    let scene = folder.path().join("scene");
    copy(made, &scene);
    let hashes = |scene: &Path| -> Vec<(String, String)> {
        let scene = Scene::open(scene).expect("a bundle");
        let outputs = scene.manifest().outputs.iter();
        outputs
            .map(|(name, own)| (name.clone(), own.hash.clone()))
            .collect()
    };
    let expected = hashes(&scene);
    // As version 1 of the format, whose provenance had no judgement.
    let path = scene.join("scene.json");
    let mut manifest: Value =
        serde_json::from_slice(&fs::read(&path).expect("a file")).expect("JSON");
    manifest["version"] = 1.into();
    manifest["provenance"]
        .as_object_mut()
        .expect("an object")
        .remove("judgement");
    let named = manifest["outputs"].as_object_mut().expect("an object");
    for name in [
        "tag-detections",
        "terrain",
        "feet",
        "contacts",
        "maps",
        "collision",
    ] {
        let output = named.remove(name).expect("an output");
        let hash = output["hash"].as_str().expect("a hash");
        fs::remove_dir_all(scene.join(format!("{name}.{}", &hash[..16]))).expect("a folder");
    }
    fs::write(&path, manifest.to_string()).expect("a file");

    let old = Scene::open(&scene).expect("a bundle");
    let report = reconstruction::report::report(&old, None, None).expect("a page");
    assert!(report.html.len() > 1000);
    for (from, missing) in [
        (
            "terrain",
            "output tag-detections is missing, expected it of stage tags",
        ),
        (
            "maps",
            "output terrain is missing, expected it of stage terrain",
        ),
    ] {
        let output = run(session, &scene, &["--from", from]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{errors}");
        assert!(errors.contains(missing), "{errors}");
    }
    let output = run(session, &scene, &[]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("4 stages run, 5 up to date"), "{text}");
    assert_eq!(hashes(&scene), expected);
}
