//! The stage `splats` of a simulated walk: its quality, what it loses and what it refuses.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;
use std::{io, thread};

use cad_transforms::RigidTransform;
use camera_models::Eye;
use reconstruction::pipeline::report_of;
use scene_bundle::outputs::depth::DepthWriter;
use scene_bundle::outputs::masks::{self, Mask};
use scene_bundle::outputs::splats::SplatScene;
use scene_bundle::outputs::{self, depth, keyframes, rig, splats};
use scene_bundle::{Bundle, Draft, OutputReader, Record, Scene, layout, verify};

use crate::full_disk::copy;
use crate::walk::{SPLAT_STEPS, made, walk};

fn run(scene: &Path, more: &[&str]) -> Output {
    command(scene, more).output().expect("run")
}

fn command(scene: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.arg("run").arg(made().0).arg("--out").arg(scene);
    command.args(["--preset", "fast", "--from", "splats"]);
    command.args(["--splat-steps", SPLAT_STEPS]);
    // The walk's bundle was written with one thread.
    command.env("RAYON_NUM_THREADS", "4");
    command.args(more);
    command
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn the_scene_renders_what_the_cameras_recorded() {
    let scene = Scene::open(&walk().scene).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    let record = splats::read(&reader).expect("a record");
    let held_out = record.held_out().expect("held-out images");
    let count = record
        .views
        .iter()
        .filter(|view| view.held_out.is_some())
        .count();
    println!(
        "{} Gaussians, {count} of {} images held out, {held_out:?}",
        record.count(),
        record.views.len()
    );
    assert!(record.views.len() >= 20 && count >= 6, "{count}");
    assert!(
        held_out.psnr_db > 17.0 && held_out.ssim > 0.42,
        "{held_out:?}"
    );
    assert!(record.training.depth_error.is_some_and(|error| error < 0.1));
    // A whole instant is held out: no other image of it was trained.
    let held: Vec<u64> = record
        .views
        .iter()
        .filter(|v| v.held_out.is_some())
        .map(|v| v.set)
        .collect();
    assert!(
        record
            .views
            .iter()
            .all(|v| v.held_out.is_some() == held.contains(&v.set))
    );
    assert!(
        record
            .views
            .iter()
            .any(|v| v.eye == Eye::Right && v.held_out.is_some())
    );
    let gaussians = splats::read_sector(&reader, &record, 0).expect("Gaussians");
    assert_eq!(gaussians.len(), record.count());
    assert!(
        !splats::read_sky(&reader, &record)
            .expect("a sky")
            .is_empty()
    );
    let coverage = splats::read_coverage(&reader, &record).expect("files");
    let coverage = coverage.expect("what the views saw");
    let observed = coverage.gaussians[0].iter().filter(|of| of.instants > 0);
    // Those that no view sees as much are transparent or hidden.
    assert!(observed.count() > gaussians.len() / 3);
    assert!(!coverage.space.is_empty());
    let compared = (0..record.views.len())
        .filter_map(|view| splats::read_comparison(&reader, view).expect("a file"))
        .inspect(|png| assert!(png.starts_with(b"\x89PNG")));
    assert_eq!(compared.count(), 3);
    let report = report_of(&scene, outputs::SPLATS).expect("a report");
    assert!(
        report.losses.is_empty() && report.notes.len() == 1,
        "{report:?}"
    );
}

/// A copy of the walk's bundle with an output replaced.
fn with(output: &str, write: &dyn Fn(&Draft, &Scene)) -> (tempfile::TempDir, PathBuf) {
    let (folder, path) = copied();
    let before = Scene::open(&path).expect("a bundle");
    let manifest = before.manifest();
    let bundle = Bundle::create_or_open(&path, manifest.provenance.clone()).expect("a bundle");
    let old = &manifest.outputs[output];
    let draft = bundle.begin(output).expect("a draft");
    write(&draft, &before);
    let record = Record {
        stage: old.stage.clone(),
        stage_version: old.stage_version,
        settings: old.settings.clone(),
        inputs: old.inputs.clone(),
    };
    draft.commit(record).expect("committed");
    bundle.finish(1).expect("finished");
    (folder, path)
}

/// The stage keeps a scene of before. Without one it ends with a loss, and an output without
/// Gaussians.
fn loses(path: &Path, expected: &str) {
    keeps_the_scene(path, expected);
    remove_splats(path);
    let output = run(path, &[]);
    let errors = errors(&output);
    assert_eq!(output.status.code(), Some(3), "{errors}");
    assert!(errors.contains(expected), "{errors}");
    let scene = Scene::open(path).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    assert_eq!(splats::read(&reader).expect("a record").count(), 0);
    let losses = report_of(&scene, outputs::SPLATS).expect("a report").losses;
    assert_eq!(losses.len(), 1, "{losses:?}");
}

/// The stage fails with an error that names what is wrong, and the scene of before is whole.
fn keeps_the_scene(path: &Path, expected: &str) {
    let output = run(path, &[]);
    let errors = errors(&output);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains(expected), "{errors}");
    assert!(errors.contains("is kept"), "{errors}");
    let scene = Scene::open(path).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    assert!(splats::read(&reader).expect("a record").count() > 0);
}

fn remove_splats(path: &Path) {
    let scene = Scene::open(path).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    std::fs::remove_dir_all(path.join(reader.folder())).expect("removed");
}

#[test]
fn few_images_are_a_loss_and_none_are_nothing_to_do() {
    let of = |count: usize| {
        with(outputs::KEYFRAMES, &|draft, scene| {
            let reader = scene.output(outputs::KEYFRAMES).expect("an output");
            let mut all = keyframes::read(&reader).expect("keyframes");
            all.truncate(count);
            keyframes::write(draft, &all).expect("written");
        })
    };
    let (_folder, path) = of(3);
    loses(
        &path,
        "6 of 6 images can be used to train a scene of Gaussians, expected at least 20",
    );
    let (_folder, path) = of(0);
    remove_splats(&path);
    let output = run(&path, &[]);
    let errors = errors(&output);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    assert!(
        errors.contains("no keyframe: there is nothing to train from"),
        "{errors}"
    );
}

#[test]
fn images_that_are_masked_whole_are_a_loss() {
    let (_folder, path) = with(outputs::MASKS, &|draft, scene| {
        let reader = scene.output(outputs::RIG_REFINED).expect("an output");
        for camera in rig::read(&reader).expect("a rig").cameras {
            let (width, height) = (camera.left.width, camera.left.height);
            let pixels = vec![0; (width * height) as usize];
            let mask = Mask {
                width,
                height,
                pixels,
            };
            masks::write(draft, &camera.name, Eye::Left, &mask).expect("written");
        }
    });
    loses(
        &path,
        "images can be used to train a scene of Gaussians, expected at least 20",
    );
}

#[test]
fn no_depth_is_a_loss() {
    let (_folder, path) = with(outputs::DEPTH, &|draft, scene| {
        let reader = scene.output(outputs::DEPTH).expect("an output");
        let index = depth::read_index(&reader).expect("an index");
        DepthWriter::new(draft, index.views)
            .expect("views")
            .finish()
            .expect("written");
    });
    loses(&path, "no keyframe has depth");
}

#[test]
fn too_little_memory_is_an_error_and_the_old_output_stays() {
    let (_folder, path) = copied();
    let hash = || {
        let scene = Scene::open(&path).expect("a bundle");
        scene.manifest().outputs[outputs::SPLATS].hash.clone()
    };
    let before = hash();
    let output = run(&path, &["--force", "--max-memory-mb", "1"]);
    let errors = errors(&output);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("bytes of memory, found 1000000 available"),
        "{errors}"
    );
    assert_eq!(hash(), before);

    // A file of a training that was stopped, of another version: it is named and removed.
    let checkpoint = path.join("splats.checkpoint");
    std::fs::write(&checkpoint, "state").expect("a file");
    let output = run(&path, &["--force"]);
    let errors = self::errors(&output);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    assert!(
        errors.contains("the checkpoint of the training is discarded"),
        "{errors}"
    );
    assert!(!checkpoint.exists());
    // The same bytes, with another number of threads.
    assert_eq!(hash(), before);
}

/// A copy of the walk's bundle.
fn copied() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene");
    copy(made().1, &path);
    (folder, path)
}

fn record_of(path: &Path) -> (OutputReader, SplatScene) {
    let scene = Scene::open(path).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    let record = splats::read(&reader).expect("a record");
    (reader, record)
}

/// The walk has a few images more.
const SECTOR_VIEWS: [&str; 2] = ["--splat-sector-views", "20"];

#[test]
fn a_walk_in_sectors_has_each_gaussian_once_and_the_quality_of_one() {
    let (_folder, path) = copied();
    let output = run(&path, &SECTOR_VIEWS);
    let errors = errors(&output);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let (reader, record) = record_of(&path);
    let count = record.sectors.len();
    assert!(count >= 2, "{count}");
    let all: Vec<_> = (0..count)
        .map(|k| splats::read_sector(&reader, &record, k).expect("Gaussians"))
        .collect();
    for (k, splats) in all.iter().enumerate() {
        let sector = &record.sectors[k];
        assert!(splats.len() > 100, "{}", splats.len());
        // Strictly inside of no other box. That it is in its own one is checked when it is read.
        for other in record.sectors.iter().filter(|other| *other != sector) {
            let inside = (0..splats.len()).filter(|i| {
                let mean = splats.get(*i).position_m.map(f64::from);
                (0..2).all(|k| other.min_m[k] < mean[k] && mean[k] < other.max_m[k])
            });
            assert_eq!(inside.count(), 0);
        }
        assert!(!sector.neighbors.is_empty());
        for neighbor in &sector.neighbors {
            assert_eq!(neighbor.neighbor_from_sector, RigidTransform::identity());
            let back = &record.sectors[neighbor.sector].neighbors;
            assert!(back.iter().any(|of| of.sector == k), "{back:?}");
        }
        assert!(sector.views.is_sorted() && sector.views.len() >= 8);
        let is_trained = |view: &usize| record.views[*view].held_out.is_none();
        assert!(sector.views.iter().all(is_trained));
    }
    // Each view of the training is in a sector, some that look across the border in two.
    let of_sectors = record.sectors.iter().flat_map(|sector| &sector.views);
    let trained: BTreeSet<usize> = of_sectors.clone().copied().collect();
    let held_out = record.views.iter().filter(|view| view.held_out.is_some());
    assert_eq!(trained.len() + held_out.count(), record.views.len());
    assert!(of_sectors.count() > trained.len());
    let (_, one) = record_of(made().1);
    let same = |views: &[splats::SplatView]| -> Vec<_> {
        let names = views
            .iter()
            .map(|of| (of.camera.clone(), of.eye == Eye::Left, of.set));
        names
            .zip(views.iter().map(|of| of.held_out.is_some()))
            .collect()
    };
    assert_eq!(same(&record.views), same(&one.views));
    let [before, after] = [&one, &record].map(|of| of.held_out().expect("images").psnr_db);
    println!("{before:.2} dB in one sector, {after:.2} dB in {count}");
    assert!(
        after > before - 0.5,
        "{before} dB in one, {after} dB in {count}"
    );
    let coverage = splats::read_coverage(&reader, &record).expect("files");
    assert_eq!(coverage.expect("coverage").gaussians.len(), count);

    let report = verify::verify(&Scene::open(&path).expect("a bundle"), |_| {});
    let report = report.expect("a report");
    assert!(report.is_whole() && report.unnamed.is_empty(), "{report:?}");
    let scene = Scene::open(&path).expect("a bundle");
    let notes = report_of(&scene, outputs::SPLATS).expect("a report").notes;
    assert!(
        notes[0].contains(&format!("in {count} sectors")),
        "{notes:?}"
    );
}

#[test]
fn a_run_that_is_killed_in_a_later_sector_gives_the_same_bytes() {
    let hash = |path: &Path| record_of(path).0.output().hash.clone();
    let checkpoints = |path: &Path| -> Vec<String> {
        let entries = std::fs::read_dir(path).expect("a folder").map(|entry| {
            let name = entry.expect("an entry").file_name();
            name.to_string_lossy().into_owned()
        });
        entries
            .filter(|name| layout::is_splats_checkpoint(name))
            .collect()
    };
    let (_folder, path) = copied();
    let whole = command(&path, &SECTOR_VIEWS)
        .env("RAYON_NUM_THREADS", "2")
        .status();
    assert_eq!(whole.expect("run").code(), Some(0));

    let (_folder, killed) = copied();
    let mut child = command(&killed, &SECTOR_VIEWS)
        .env("RAYON_NUM_THREADS", "1")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("run");
    let mut stdout = child.stdout.take().expect("a pipe");
    let (sender, ended) = mpsc::sync_channel::<()>(1);
    let reader = thread::spawn(move || {
        let _ = io::copy(&mut stdout, &mut io::sink());
        drop(sender);
    });
    // The file of the first sector is written when its training is complete.
    while !killed.join("splats-000.checkpoint").exists() {
        let state = ended.recv_timeout(Duration::from_millis(5));
        let before = "ended before a sector was complete";
        assert_eq!(state, Err(RecvTimeoutError::Timeout), "{before}");
    }
    child.kill().expect("killed");
    let status = child.wait().expect("ended");
    reader.join().expect("read");
    assert_eq!(status.code(), None, "ended by itself: {status}");
    assert!(checkpoints(&killed).contains(&"splats-000.checkpoint".to_owned()));
    assert_ne!(hash(&killed), hash(&path));
    // A sector that is trained again is written again, which this makes a warning.
    let obstacle = killed.join("splats-000.checkpoint.tmp");
    std::fs::create_dir(&obstacle).expect("a folder");

    let output = command(&killed, &SECTOR_VIEWS)
        .env("RAYON_NUM_THREADS", "1")
        .output();
    let output = output.expect("run");
    let errors = errors(&output);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    assert!(!errors.contains("discarded"), "{errors}");
    assert!(!errors.contains("writing a checkpoint"), "{errors}");
    assert_eq!(hash(&killed), hash(&path));
    std::fs::remove_dir(&obstacle).expect("an empty folder");
    assert_eq!(checkpoints(&killed), [""; 0]);
}
