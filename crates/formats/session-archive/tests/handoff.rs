//! The hand-off: what its seal is of, what stands beside it, what is refused, and what version 1
//! was.

use session_archive::handoff::{
    Acceptance, Beyond, Check, HandOff, HandOffError, SealedFile, Statement, Verdict, later_verdict,
};
use session_archive::layout;
use session_archive::storage::FaultStorage;
use session_archive::time::CivilTime;

const ID: &str = "0192aa00-0000-7000-8000-000000000001";

/// A disk with a file of each kind. A hand-off looks at bytes alone, so they can be any.
fn disk() -> FaultStorage {
    let disk = FaultStorage::new();
    for (path, content) in [
        (layout::MANIFEST, "manifest"),
        ("rig/rig.toml", "rig"),
        ("segments/000000.mcap", "segment"),
        (layout::INDEX, "index"),
        (layout::VALIDATION, "{\"verdict\": \"FAIL\", \"more\": 1}"),
    ] {
        disk.set_content(path, content.as_bytes().to_vec());
    }
    disk
}

fn recorded() -> Vec<String> {
    ["session.json", "rig/rig.toml", "segments/000000.mcap"]
        .map(str::to_owned)
        .to_vec()
}

fn files(disk: &FaultStorage, paths: &[String]) -> Vec<SealedFile> {
    let of = |path: &String| SealedFile::of(disk, path, |_| {}).expect("a file");
    paths.iter().map(of).collect()
}

fn beyond(metric: &str, of: &str, verdict: Verdict) -> Beyond {
    Beyond {
        metric: metric.to_owned(),
        of: of.to_owned(),
        verdict,
        // No short decimal: what is read back must be what was written.
        value: Some(0.1 + 0.2),
        warn: Some(0.001),
        fail: None,
        unit: "ratio".to_owned(),
        text: format!("{of}: {metric} is beyond"),
    }
}

fn accepted(level: Verdict) -> Acceptance {
    Acceptance {
        level,
        accepted: CivilTime(9),
        verdict: Verdict::Fail,
        metrics: vec![
            beyond("camera.dropped", "feet", Verdict::Fail),
            beyond("imu.dropped", "feet/imu", Verdict::Warn),
        ],
        limits: Vec::new(),
    }
}

fn said(verdict: Verdict, acceptance: Option<Acceptance>) -> Statement {
    Statement {
        software: "tests".to_owned(),
        sealed: CivilTime(7),
        verdict,
        limits: vec!["camera.rate=1,2".to_owned()],
        acceptance,
    }
}

fn handoff(disk: &FaultStorage, verdict: Verdict, acceptance: Option<Acceptance>) -> HandOff {
    let index = [layout::INDEX.to_owned()];
    let (recorded, index) = (files(disk, &recorded()), files(disk, &index));
    HandOff::new(ID, recorded, index, said(verdict, acceptance))
}

fn open(disk: &FaultStorage) -> Result<HandOff, HandOffError> {
    HandOff::open(disk, Check::Content, |_| {})
}

/// Lines as FORMAT.md has them.
fn seal_by_hand(disk: &FaultStorage, paths: &[&str]) -> String {
    let mut text = format!("paws-handoff 2\n{ID}\n");
    for path in paths {
        let content = disk.content(path).expect("a file");
        let hash = blake3::hash(&content).to_hex();
        text.push_str(&format!("{hash} {} {path}\n", content.len()));
    }
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

#[test]
fn the_seal_is_of_what_was_recorded_and_nothing_else() {
    let disk = disk();
    let first = handoff(&disk, Verdict::Warn, None);
    let sorted = ["rig/rig.toml", "segments/000000.mcap", "session.json"];
    assert_eq!(first.seal, seal_by_hand(&disk, &sorted));

    // Another verdict, another acceptance, another index, another order of files.
    disk.set_content(layout::INDEX, b"another index".to_vec());
    let mut again = handoff(&disk, Verdict::Fail, Some(accepted(Verdict::Fail)));
    assert_eq!(again.seal, first.seal);
    again.files.reverse();
    let reversed = HandOff::new(ID, again.files, Vec::new(), said(Verdict::Pass, None));
    assert_eq!(reversed.seal, first.seal);

    disk.set_content("segments/000000.mcap", b"Segment".to_vec());
    assert_ne!(handoff(&disk, Verdict::Warn, None).seal, first.seal);
}

#[test]
fn what_is_written_reads_back_and_is_noticed_when_edited() {
    let disk = disk();
    let mut written = handoff(&disk, Verdict::Fail, Some(accepted(Verdict::Fail)));
    written.earlier_seals = vec!["ab".repeat(32)];
    written.write(&disk).expect("write");
    assert_eq!(open(&disk).expect("open"), written);
    assert!(written.is_known_as(&written.seal) && written.is_known_as(&"ab".repeat(32)));
    assert!(!written.is_known_as(&"cd".repeat(32)));

    let text = String::from_utf8(disk.content(layout::HANDOFF).expect("text")).expect("UTF-8");
    for (from, to) in [
        ("\"level\": \"FAIL\"", "\"level\": \"WARN\""),
        ("\"verdict\": \"FAIL\"", "\"verdict\": \"PASS\""),
        ("is beyond", "is fine"),
        ("\"bytes\": 7", "\"bytes\": 8"),
        ("\"blake3\": \"", "\"blake3\": \"0"),
        ("}\n", "} "),
    ] {
        assert!(text.contains(from), "{from}");
        disk.set_content(layout::HANDOFF, text.replacen(from, to, 1).into_bytes());
        let refused = open(&disk);
        assert!(
            matches!(refused, Err(HandOffError::Invalid(_))),
            "{from}: {refused:?}"
        );
    }
    let newer = text.replacen("\"version\": 2", "\"version\": 3", 1);
    disk.set_content(layout::HANDOFF, newer.into_bytes());
    let error = open(&disk).expect_err("of another version").to_string();
    assert!(error.contains("paws-handoff version 3"), "{error}");
}

#[test]
fn a_failure_is_opened_only_where_it_was_accepted() {
    let disk = disk();
    for acceptance in [None, Some(accepted(Verdict::Warn))] {
        handoff(&disk, Verdict::Fail, acceptance)
            .write(&disk)
            .expect("write");
        let refused = open(&disk);
        assert!(matches!(refused, Err(HandOffError::Failed)), "{refused:?}");
    }
    let given = Some(accepted(Verdict::Fail));
    handoff(&disk, Verdict::Fail, given)
        .write(&disk)
        .expect("write");
    let opened = open(&disk).expect("accepted");
    let notes = opened.notes().join("\n");
    for part in [
        "FAIL",
        "--accept FAIL",
        "camera.dropped is beyond",
        "camera.rate=1,2",
    ] {
        assert!(notes.contains(part), "{part:?} is not in {notes}");
    }
}

#[test]
fn a_later_validation_changes_no_hand_off() {
    let disk = disk();
    handoff(&disk, Verdict::Pass, None)
        .write(&disk)
        .expect("write");
    for text in ["{\"verdict\": \"WARN\"}", "not JSON", ""] {
        disk.set_content(layout::VALIDATION, text.as_bytes().to_vec());
        assert_eq!(open(&disk).expect("open").verdict, Verdict::Pass);
    }
    assert_eq!(later_verdict(&disk), None);
    disk.set_content(layout::VALIDATION, b"{\"verdict\": \"WARN\"}".to_vec());
    assert_eq!(later_verdict(&disk), Some(Verdict::Warn));
}

#[test]
fn an_acceptance_covers_what_it_named() {
    let acceptance = accepted(Verdict::Fail);
    let covers = |verdict, beyond: &[(&str, &str, Verdict)]| {
        acceptance.covers(verdict, beyond.iter().copied())
    };
    use Verdict::{Fail, Warn};
    assert!(covers(Fail, &[("camera.dropped", "feet", Fail)]));
    assert!(covers(
        Fail,
        &[
            ("camera.dropped", "feet", Warn),
            ("imu.dropped", "feet/imu", Warn)
        ]
    ));
    assert!(
        !covers(Fail, &[("imu.dropped", "feet/imu", Fail)]),
        "it was a warning"
    );
    assert!(!covers(Fail, &[("camera.dropped", "left_shoulder", Fail)]));
    assert!(!accepted(Warn).covers(Fail, []));
}

#[test]
fn paths_lead_nowhere_else() {
    let disk = disk();
    for path in ["../secret", "/etc/passwd", "rig/../../secret", ""] {
        let mut file = files(&disk, &recorded()).remove(0);
        file.path = path.to_owned();
        let handoff = HandOff::new(ID, vec![file], Vec::new(), said(Verdict::Pass, None));
        handoff.write(&disk).expect("write");
        let refused = open(&disk);
        assert!(
            matches!(refused, Err(HandOffError::Invalid(_))),
            "{path}: {refused:?}"
        );
    }
}

/// A hand-off as version 1 wrote it: the seal is over the whole, compact and without a seal.
fn version1(disk: &FaultStorage, verdict: &str) -> String {
    let mut paths = recorded();
    paths.extend([layout::INDEX, layout::VALIDATION].map(str::to_owned));
    let file = |file: SealedFile| {
        let SealedFile {
            path,
            bytes,
            blake3,
        } = file;
        format!("{{\"path\":\"{path}\",\"bytes\":{bytes},\"blake3\":\"{blake3}\"}}")
    };
    let files: Vec<String> = files(disk, &paths).into_iter().map(file).collect();
    let document = |seal: &str| {
        format!(
            "{{\"format\":\"paws-handoff\",\"version\":1,\"session_id\":\"{ID}\",\"software\":\"paws 0.1.0\",\
             \"sealed\":7,\"verdict\":\"{verdict}\",\"files\":[{}],\"seal\":\"{seal}\"}}",
            files.join(",")
        )
    };
    let seal = blake3::hash(document("").as_bytes()).to_hex().to_string();
    disk.set_content(layout::HANDOFF, document(&seal).into_bytes());
    seal
}

#[test]
fn version_1_is_still_opened_with_a_note() {
    let disk = disk();
    let seal = version1(&disk, "WARN");
    // What broke it before: the validation that it was made with is replaced.
    disk.set_content(layout::VALIDATION, b"{\"verdict\": \"PASS\"}".to_vec());
    let opened = open(&disk).expect("open");
    assert_eq!((opened.seal.as_str(), opened.version), (seal.as_str(), 1));
    assert_eq!(opened.verdict, Verdict::Warn);
    assert_eq!(opened.files, files(&disk, &recorded()));
    assert!(opened.names(layout::INDEX));
    let notes = opened.notes();
    assert!(
        notes.len() == 1 && notes[0].contains("version 1"),
        "{notes:?}"
    );

    disk.set_content("rig/rig.toml", b"RIG".to_vec());
    assert!(matches!(open(&disk), Err(HandOffError::Changed { .. })));
    disk.set_content("rig/rig.toml", b"rig".to_vec());
    let text = String::from_utf8(disk.content(layout::HANDOFF).expect("text")).expect("UTF-8");
    disk.set_content(layout::HANDOFF, text.replace("WARN", "PASS").into_bytes());
    assert!(matches!(open(&disk), Err(HandOffError::Invalid(_))));
    version1(&disk, "FAIL");
    assert!(matches!(open(&disk), Err(HandOffError::Failed)));
}
