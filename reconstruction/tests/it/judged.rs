//! A session that failed and was accepted, one that is handed over or validated again, and one of
//! version 1: messages of the program, content of the bundle and the page, and that no stage runs
//! again.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use reconstruction::Input;
use scene_bundle::Scene;
use session_archive::handoff::{Acceptance, Beyond, HandOff, SealedFile, Statement, Verdict};
use session_archive::layout;
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;

use crate::session::{hand_over, seal};
use crate::walk;

/// A copy of the walk's session and of its bundle, for changing.
struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    fn new() -> Self {
        let (session, scene) = walk::made();
        let desk = Self {
            folder: tempfile::tempdir().expect("folder"),
        };
        copy(session, &desk.session());
        copy(scene, &desk.scene());
        desk
    }

    fn session(&self) -> PathBuf {
        self.folder.path().join("session")
    }

    fn scene(&self) -> PathBuf {
        self.folder.path().join("walk.scene")
    }

    /// Hands the session over as it is.
    fn hand_over(&self, change: impl FnOnce(&mut HandOff)) {
        let storage = DiskStorage::new(self.session());
        let old = HandOff::read(&storage).expect("a hand-off");
        let said = Statement {
            software: "tests".to_owned(),
            sealed: CivilTime(8),
            verdict: Verdict::Pass,
            limits: Vec::new(),
            acceptance: None,
        };
        let mut handoff = HandOff::new(&old.session_id, old.files, old.derived, said);
        change(&mut handoff);
        handoff.write(&storage).expect("write");
    }

    /// Runs all stages; they must be up to date.
    fn run(&self) -> Output {
        let (session, scene) = (self.session(), self.scene());
        let output = program(&[
            "run".as_ref(),
            session.as_path(),
            "--out".as_ref(),
            scene.as_path(),
            "--preset".as_ref(),
            "fast".as_ref(),
            "--to".as_ref(),
            "maps".as_ref(),
        ]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            text.contains("0 stages run, 9 up to date"),
            "{text}{}",
            said(&output)
        );
        let scene = Scene::open(&scene).expect("a bundle");
        let checked = scene_bundle::verify::verify(&scene, |_| {}).expect("a bundle");
        assert!(checked.is_whole() && scene.manifest().outdated().is_empty());
        output
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("folder");
    for entry in fs::read_dir(from).expect("folder") {
        let entry = entry.expect("entry");
        let (path, to) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(path, to).expect("copy");
        }
    }
}

fn program(arguments: &[&Path]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.args(arguments).output().expect("run")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn accepted() -> Acceptance {
    Acceptance {
        level: Verdict::Fail,
        accepted: CivilTime(1_800_000_000_000_000_000),
        verdict: Verdict::Fail,
        metrics: vec![Beyond {
            metric: "camera.dropped".to_owned(),
            of: "feet".to_owned(),
            verdict: Verdict::Fail,
            value: Some(0.25),
            warn: Some(0.001),
            fail: Some(0.01),
            unit: "ratio".to_owned(),
            text: "feet: frames missing: 25 %, limit 1 % (15 of 60 frames)".to_owned(),
        }],
        limits: Vec::new(),
    }
}

#[test]
fn an_accepted_failure_is_reconstructed_and_marked() {
    let desk = Desk::new();
    desk.hand_over(|handoff| handoff.verdict = Verdict::Fail);
    let refused = program(&["info".as_ref(), desk.session().as_path()]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        said(&refused).contains("--accept FAIL"),
        "{}",
        said(&refused)
    );

    desk.hand_over(|handoff| {
        handoff.verdict = Verdict::Fail;
        handoff.acceptance = Some(accepted());
    });
    let output = desk.run();
    assert_eq!(output.status.code(), Some(3));
    let errors = said(&output);
    assert!(
        errors.contains("note: the verdict on the session is FAIL"),
        "{errors}"
    );
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let last = text.lines().last().expect("a line");
    assert!(
        last.contains("nothing lost, of a session accepted as FAIL"),
        "{last}"
    );

    let scene = Scene::open(&desk.scene()).expect("a bundle");
    let judged = scene
        .manifest()
        .provenance
        .judgement
        .as_ref()
        .expect("a judgement");
    assert_eq!(judged.verdict, "FAIL");
    let acceptance = judged.acceptance.as_ref().expect("an acceptance");
    assert_eq!(acceptance.accepted_civil_ns, 1_800_000_000_000_000_000);
    assert_eq!(acceptance.metrics[0].metric, "camera.dropped");
    assert_eq!(acceptance.metrics[0].value, Some(0.25));
    let page = reconstruction::report::report(&scene, None, None)
        .expect("a page")
        .html;
    for part in [
        "The verdict on the session is FAIL",
        "--accept FAIL",
        "25 %, limit 1 %",
    ] {
        assert!(page.contains(part), "{part:?} is not on the page");
    }

    // Validated again: the mark is removed, the outputs are kept.
    desk.hand_over(|_| {});
    let output = desk.run();
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let errors = said(&output);
    assert!(!errors.contains("the verdict on the session"), "{errors}");
    let scene = Scene::open(&desk.scene()).expect("a bundle");
    let judged = scene
        .manifest()
        .provenance
        .judgement
        .as_ref()
        .expect("a judgement");
    assert_eq!(
        (judged.verdict.as_str(), &judged.acceptance),
        ("PASS", &None)
    );
}

#[test]
fn a_later_validation_is_reported_and_breaks_nothing() {
    let desk = Desk::new();
    let path = desk.session().join(layout::VALIDATION);
    fs::write(&path, "{\"verdict\": \"FAIL\"}").expect("write");
    let output = desk.run();
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let errors = said(&output);
    assert!(
        errors.contains("handed over as PASS, and a later validation has the verdict FAIL"),
        "{errors}"
    );
}

#[test]
fn a_bundle_of_an_earlier_seal_of_the_same_recording_is_continued() {
    let desk = Desk::new();
    // The seal of version 1 is just a hash for the bundle.
    let made_of = Scene::open(&desk.scene()).expect("a bundle");
    let made_of = made_of.manifest().provenance.handoff_blake3.clone();
    fs::write(desk.session().join("rig/more.txt"), "more").expect("write");
    let more = SealedFile::of(&DiskStorage::new(desk.session()), "rig/more.txt", |_| {});
    let more = more.expect("a file");
    let renew = |earlier: Vec<String>| {
        desk.hand_over(|handoff| {
            let mut files = handoff.files.clone();
            if !handoff.names("rig/more.txt") {
                files.push(more.clone());
            }
            let said = Statement {
                software: "tests".to_owned(),
                sealed: CivilTime(9),
                verdict: Verdict::Pass,
                limits: Vec::new(),
                acceptance: None,
            };
            *handoff = HandOff::new(&handoff.session_id, files, handoff.derived.clone(), said);
            handoff.earlier_seals = earlier;
        });
    };
    renew(vec![made_of.clone()]);
    assert_ne!(
        Input::open(&desk.session()).expect("open").handoff().seal,
        made_of
    );
    let output = desk.run();
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let scene = Scene::open(&desk.scene()).expect("a bundle");
    assert_eq!(scene.manifest().provenance.handoff_blake3, made_of);

    // An unknown seal means another recording.
    renew(Vec::new());
    let (session, scene) = (desk.session(), desk.scene());
    let refused = program(&[
        "run".as_ref(),
        session.as_path(),
        "--out".as_ref(),
        scene.as_path(),
    ]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        said(&refused).contains("name another folder"),
        "{}",
        said(&refused)
    );
}

#[test]
fn a_rig_file_that_is_missing_is_only_accepted_with_the_failure() {
    let folder = tempfile::tempdir().expect("folder");
    hand_over(folder.path());
    fs::remove_file(folder.path().join("rig/rig.toml")).expect("remove");
    let files = [
        layout::MANIFEST.to_owned(),
        layout::INDEX.to_owned(),
        layout::segment(0),
    ];
    crate::session::seal_only(folder.path(), Verdict::Pass, &files);
    assert!(Input::open(folder.path()).is_err());
    let storage = DiskStorage::new(folder.path());
    let mut handoff = HandOff::read(&storage).expect("a hand-off");
    handoff.verdict = Verdict::Fail;
    handoff.acceptance = Some(accepted());
    handoff.write(&storage).expect("write");
    let input = Input::open(folder.path()).expect("accepted");
    assert!(input.is_failed() && input.notes().len() == 1);
    // A rig file from another source is still not read.
    fs::write(folder.path().join("rig/rig.toml"), "revision = 9").expect("write");
    assert!(Input::open(folder.path()).is_err());
    seal(folder.path(), Verdict::Pass);
    assert!(Input::open(folder.path()).is_ok());
}
