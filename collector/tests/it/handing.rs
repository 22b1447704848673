//! Hand-off: with an accepted failure, repeated, and with validations in between.

use std::fs;
use std::path::PathBuf;

use collector::commands::handoff::{self, Options};
use collector::commands::{import, report, show, validate};
use collector::target::Target;
use collector::validation::Validation;
use console_output::Outcome;
use session_archive::handoff::{Check, HandOff, HandOffError, SealedFile, Verdict};
use session_archive::layout;
use session_archive::storage::DiskStorage;
use session_health::Limits;

use crate::support::{ID, Session, calib_program, capture};

/// A library with one session in it.
struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    fn with(session: &Session) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("source");
        session.write(&source);
        let desk = Self { folder };
        let root = desk.folder.path().join("library");
        let imported = capture(|console| import::run(&[source], &root, console)).0;
        assert_ne!(imported.unwrap(), Outcome::Failed);
        desk
    }

    /// Three frames of 121 are missing, which is a failure.
    fn failing() -> Self {
        let mut session = Session::good(4.0);
        session.drop_frames(0, 120, 122, true);
        Self::with(&session)
    }

    fn session(&self) -> PathBuf {
        self.folder.path().join("library/sessions").join(ID)
    }

    fn target(&self) -> Target {
        Target::find(ID, Some(&self.folder.path().join("library"))).unwrap()
    }

    fn hand_over(&self, accept: Option<Verdict>, limits: &[&str]) -> (Outcome, String) {
        let options = Options {
            accept,
            limits: set(limits),
            frames: None,
            calib_program: calib_program(self.folder.path()),
        };
        let (outcome, text) =
            capture(|console| handoff::run_with(&self.target(), &options, console));
        (outcome.unwrap(), text)
    }

    fn validate(&self, deep: bool, limits: &[&str]) -> (Outcome, String) {
        let options = validate::Options {
            deep,
            limits: set(limits),
            calib_program: calib_program(self.folder.path()),
            ..validate::Options::default()
        };
        let (outcome, text) = capture(|console| validate::run(&[self.target()], &options, console));
        (outcome.unwrap(), text)
    }

    fn open(&self) -> Result<HandOff, HandOffError> {
        let storage = DiskStorage::new(self.session());
        HandOff::open(&storage, Check::Content, |_| {})
    }

    fn bytes(&self) -> Vec<u8> {
        fs::read(self.session().join(layout::HANDOFF)).unwrap()
    }
}

fn set(texts: &[&str]) -> Limits {
    let mut limits = Limits::default();
    texts.iter().for_each(|text| limits.set(text).unwrap());
    limits
}

#[test]
fn failed_session_is_handed_over_on_request_and_marked() {
    let desk = Desk::failing();
    for accept in [None, Some(Verdict::Warn)] {
        let (outcome, text) = desk.hand_over(accept, &[]);
        assert_eq!(outcome, Outcome::Failed, "{text}");
        assert!(text.contains("--accept FAIL` hands it over"), "{text}");
        assert!(desk.open().is_err());
    }
    let (outcome, text) = desk.hand_over(Some(Verdict::Fail), &[]);
    assert_eq!(outcome, Outcome::Loss, "{text}");
    let path = desk.target().folder.join(layout::HANDOFF);
    assert_eq!(text.lines().last(), path.to_str(), "the path comes last");
    let opened = desk.open().unwrap();
    let acceptance = opened.acceptance.as_ref().unwrap();
    assert_eq!(
        (opened.verdict, acceptance.level),
        (Verdict::Fail, Verdict::Fail)
    );
    assert_eq!(acceptance.accepted.0, 1_800_000_000_000_000_000);
    let failed: Vec<_> = acceptance
        .metrics
        .iter()
        .map(|m| (m.metric.as_str(), m.of.as_str()))
        .collect();
    assert_eq!(failed[0], ("camera.dropped", "left_shoulder"));
    assert_eq!(acceptance.metrics[0].value, Some(3.0 / 121.0));
    assert_eq!(acceptance.metrics[0].fail, Some(0.01));

    // It is in the report and in `paws show`, and the acceptance is valid for the same recording.
    let default = validate::Options::default();
    let report = desk.folder.path().join("report.html");
    capture(|console| report::run(&desk.target(), &default, Some(&report), console))
        .0
        .unwrap();
    let page = fs::read_to_string(report).unwrap();
    let (_, shown) = capture(|console| show::run(&desk.target(), console));
    for text in [&page, &shown] {
        assert!(text.contains("as FAIL"), "{text}");
        assert!(text.contains("--accept FAIL"), "{text}");
    }
    let bytes = desk.bytes();
    assert_eq!(desk.hand_over(None, &[]).0, Outcome::Loss);
    assert_eq!(desk.hand_over(Some(Verdict::Fail), &[]).0, Outcome::Loss);
    assert_eq!(desk.bytes(), bytes);
}

#[test]
fn acceptance_does_not_cover_later_findings() {
    let desk = Desk::failing();
    desk.hand_over(Some(Verdict::Fail), &[]);
    // A flipped bit: another recording, with one more failure.
    let segment = desk.session().join("segments/000000.mcap");
    let seal = desk.open().unwrap().seal;
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let (outcome, text) = desk.hand_over(None, &[]);
    assert_eq!(outcome, Outcome::Failed, "{text}");
    assert!(text.contains("is withdrawn"), "{text}");
    assert!(!desk.session().join(layout::HANDOFF).exists());
    let (outcome, text) = desk.hand_over(Some(Verdict::Fail), &[]);
    assert_eq!(outcome, Outcome::Loss, "{text}");
    assert_ne!(desk.open().unwrap().seal, seal, "the recording is another");
}

#[test]
fn repeated_hand_off_with_validations_in_between_changes_nothing() {
    let desk = Desk::with(&Session::decodable(1.0));
    assert_eq!(desk.hand_over(None, &[]).0, Outcome::Fine);
    let (first, bytes) = (desk.open().unwrap(), desk.bytes());
    assert_eq!(first.verdict, Verdict::Pass);
    let report = |deep| {
        let options = validate::Options {
            deep,
            calib_program: calib_program(desk.folder.path()),
            ..validate::Options::default()
        };
        capture(|console| report::run(&desk.target(), &options, None, console))
            .0
            .unwrap();
    };
    for step in 0..4 {
        match step {
            0 => drop(desk.validate(false, &[])),
            1 => report(false),
            2 => drop(desk.validate(true, &["camera.rate=0,0"])),
            _ => report(true),
        }
        assert_eq!(desk.bytes(), bytes, "step {step}");
        assert_eq!(desk.open().unwrap(), first, "step {step}");
        desk.hand_over(None, &[]);
        assert_eq!(desk.open().unwrap().seal, first.seal, "step {step}");
    }
}

#[test]
fn changed_verdict_is_reported_with_the_reason() {
    let mut session = Session::decodable(1.0);
    // The encoder's output was wrong, which only decoding finds.
    let bad = session.stereo_frames.iter_mut().rfind(|p| p.camera == 2);
    bad.unwrap().unit = vec![0, 0, 0, 1, 0x41, 0xFF, 0xFF, 0xFF];
    let desk = Desk::with(&session);
    let (_, text) = desk.validate(false, &[]);
    assert!(!text.contains("since the last validation"), "{text}");
    desk.hand_over(None, &[]);
    let (outcome, text) = desk.validate(true, &[]);
    assert_eq!(outcome, Outcome::Failed);
    for part in [
        "verdict PASS \u{2192} FAIL since the last validation: every image was decoded this time",
        "feet: images that cannot be decoded: 1",
        "handed over as PASS",
        "now FAIL: that hand-off is unchanged",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    assert_eq!(desk.open().unwrap().verdict, Verdict::Pass);
    let (_, text) = capture(|console| show::run(&desk.target(), console));
    assert!(
        text.contains("now FAIL: that hand-off is unchanged"),
        "{text}"
    );

    // A hand-off keeps the findings of the deep validation, even with other limits.
    let (outcome, text) = desk.hand_over(None, &["camera.rate=0.5,0.6"]);
    assert_eq!(outcome, Outcome::Failed, "{text}");
    let (outcome, _) = desk.hand_over(Some(Verdict::Fail), &[]);
    assert_eq!(outcome, Outcome::Loss);
    // A validation without decoding states why it finds less.
    let (_, text) = desk.validate(false, &[]);
    for part in [
        "verdict FAIL \u{2192} PASS since the last validation: images were not decoded this time",
        "not measured now, before FAIL: feet: images that cannot be decoded: 1",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

#[test]
fn limits_apply_to_a_hand_off_as_to_a_validation() {
    let desk = Desk::failing();
    let limits = ["camera.dropped=never", "camera.longest_gap=never,never"];
    let (outcome, _) = desk.validate(false, &limits);
    assert_eq!(outcome, Outcome::Fine);
    let (outcome, text) = desk.hand_over(None, &limits);
    assert_eq!(outcome, Outcome::Fine, "{text}");
    let opened = desk.open().unwrap();
    let expected = [
        "camera.dropped=never,never",
        "camera.longest_gap=never,never",
    ];
    assert_eq!(
        (opened.verdict, &opened.limits[..]),
        (Verdict::Pass, &expected.map(str::to_owned)[..])
    );
    assert_eq!(Validation::read(&desk.session()).unwrap().limits, expected);
    assert!(opened.acceptance.is_none(), "nothing had to be accepted");

    // Without them the default limits apply, and this is reported.
    let (outcome, text) = desk.hand_over(None, &[]);
    assert_eq!(outcome, Outcome::Failed, "{text}");
    assert!(
        text.contains("PASS \u{2192} FAIL since the last validation: limits are the defaults, before camera.dropped=never"),
        "{text}"
    );
    let stricter = ["camera.rate=0,0"];
    let (outcome, _) = desk.hand_over(Some(Verdict::Fail), &stricter);
    assert_eq!(outcome, Outcome::Loss);
    let acceptance = desk.open().unwrap().acceptance.unwrap();
    assert_eq!(acceptance.limits, ["camera.rate=0,0"]);
}

/// A hand-off as version 1 wrote it.
fn version1(desk: &Desk) -> String {
    let storage = DiskStorage::new(desk.session());
    let handoff = desk.open().unwrap();
    let mut files: Vec<SealedFile> = handoff.files.into_iter().chain(handoff.derived).collect();
    files.push(SealedFile::of(&storage, layout::VALIDATION, |_| {}).unwrap());
    let files: Vec<String> = files
        .iter()
        .map(|file| serde_json::to_string(file).unwrap())
        .collect();
    let document = |seal: &str| {
        format!(
            "{{\"format\":\"paws-handoff\",\"version\":1,\"session_id\":\"{ID}\",\"software\":\"paws 0.1.0\",\
             \"sealed\":7,\"verdict\":\"PASS\",\"files\":[{}],\"seal\":\"{seal}\"}}",
            files.join(",")
        )
    };
    let seal = blake3::hash(document("").as_bytes()).to_hex().to_string();
    fs::write(desk.session().join(layout::HANDOFF), document(&seal)).unwrap();
    seal
}

#[test]
fn version_1_hand_off_is_rewritten_and_keeps_its_seal() {
    let desk = Desk::with(&Session::good(1.0));
    desk.hand_over(None, &[]);
    let new = desk.open().unwrap();
    let old = version1(&desk);
    // The validation that it refers to is replaced.
    desk.validate(false, &["camera.rate=0.5,0.6"]);
    assert_eq!(desk.open().unwrap().seal, old);
    let (_, text) = capture(|console| show::run(&desk.target(), console));
    assert!(text.contains("of version 1"), "{text}");
    for _ in 0..2 {
        assert_eq!(desk.hand_over(None, &[]).0, Outcome::Fine);
        let opened = desk.open().unwrap();
        assert_eq!(opened.seal, new.seal);
        assert!(opened.is_known_as(&old));
    }
    // The seal of another recording is not kept.
    version1(&desk);
    let rig = desk.session().join("rig/rig.toml");
    fs::write(&rig, b"revision = 2\n").unwrap();
    assert_eq!(desk.hand_over(Some(Verdict::Fail), &[]).0, Outcome::Loss);
    assert!(desk.open().unwrap().earlier_seals.is_empty());
}
