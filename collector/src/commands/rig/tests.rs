use std::fs;
use std::path::Path;

use console_output::{Clock, Show};

use super::*;

const EXAMPLE: &str = include_str!("../../../../cad-transforms/rigs/example.toml");
const STEP: &[u8] = include_bytes!("../../../../cad-transforms/tests/data/plate_ap214.step");

const MAP: &str = "format = 1\nname = \"plate\"\nrevision = \"C\"\n\
    [[camera]]\nname = \"left_shoulder\"\npart = \"left_mount\"\nmodel = \"zed_x_mini\"\n\
    [[camera]]\nname = \"right_shoulder\"\npart = \"right_mount\"\nmodel = \"zed_x_mini\"\n\
    [[camera]]\nname = \"feet\"\npart = \"feet_mount\"\nmodel = \"zed_mini\"\nserial = 7\n";

/// Runs a command; returns its output and outcome.
fn run_command(verb: &RigVerb) -> Result<(String, Outcome)> {
    let mut out = Vec::new();
    let mut console = Console {
        out: &mut out,
        show: Show::Nothing,
        clock: Clock::STILL,
    };
    let outcome = run(verb, &mut console)?;
    Ok((String::from_utf8(out)?, outcome))
}

fn check(file: &Path, calibration: &[&str]) -> (String, Outcome) {
    let calibration = calibration.iter().map(|c| (*c).to_owned()).collect();
    run_command(&RigVerb::Check {
        file: file.to_owned(),
        calibration,
        json: false,
    })
    .unwrap()
}

fn convert(src: &Path, map: Option<&Path>, out: &Path) -> Result<(String, Outcome)> {
    run_command(&RigVerb::Convert {
        src: src.to_owned(),
        map: map.map(Path::to_owned),
        out: Some(out.to_owned()),
        list: false,
        force: false,
    })
}

#[test]
fn from_a_step_file_to_a_checked_rig() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("plate.step"), STEP).unwrap();
    fs::write(at("map.toml"), MAP).unwrap();
    let list = RigVerb::Convert {
        src: at("plate.step"),
        map: None,
        out: None,
        list: true,
        force: false,
    };
    let (text, _) = run_command(&list).unwrap();
    assert!(
        text.contains("plate/left_mount/zed_x_mini") && text.contains("145.000"),
        "{text}"
    );

    let (text, outcome) =
        convert(&at("plate.step"), Some(&at("map.toml")), &at("rig.toml")).unwrap();
    assert!(text.starts_with("wrote 6 frames to"), "{text}");
    assert_eq!(outcome, Outcome::Fine);
    let rig = Rig::read(&at("rig.toml")).unwrap();
    let hash = blake3::hash(STEP).to_hex().to_string();
    assert_eq!(rig.provenance().cad.as_ref().unwrap().blake3, hash);

    let (text, outcome) = check(&at("rig.toml"), &[]);
    assert_eq!(outcome, Outcome::Fine, "{text}");
    assert!(
        text.contains("good: 0 errors, 0 warnings, 3 notes"),
        "{text}"
    );

    // Nothing is overwritten, not by the same command either.
    let before = fs::read(at("rig.toml")).unwrap();
    let error = convert(&at("plate.step"), Some(&at("map.toml")), &at("rig.toml")).unwrap_err();
    assert!(
        format!("{error:#}").contains("there is one already"),
        "{error:#}"
    );
    assert_eq!(fs::read(at("rig.toml")).unwrap(), before);

    // Round trip through every other format.
    for name in ["rig.urdf", "rig.gltf", "rig.csv", "table.toml"] {
        convert(&at("rig.toml"), None, &at(name)).unwrap();
        let back = at(&format!("{name}.toml"));
        convert(&at(name), None, &back).unwrap();
        let diff = RigVerb::Diff {
            a: at("rig.toml"),
            b: back,
        };
        let (text, outcome) = run_command(&diff).unwrap();
        // Data that only a rig file holds is lost, and reported.
        assert!(text.contains("\nno frame changed, "), "{name}: {text}");
        assert!(
            text.contains("\nserial of feet: \"7\" in a only\n"),
            "{name}: {text}"
        );
        assert_eq!(outcome, Outcome::Loss);
    }
}

#[test]
fn truncated_input_leaves_no_output() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("plate.step"), &STEP[..STEP.len() / 2]).unwrap();
    fs::write(at("map.toml"), MAP).unwrap();
    let error = convert(&at("plate.step"), Some(&at("map.toml")), &at("rig.toml")).unwrap_err();
    let text = format!("{error:#}");
    assert!(
        text.contains("cut off") && text.contains("plate.step"),
        "{text}"
    );
    assert!(!at("rig.toml").exists());
    let error = convert(&at("plate.step"), None, &at("rig.txt.zip")).unwrap_err();
    assert!(format!("{error:#}").contains("plate.step"), "{error:#}");
}

#[test]
fn diff_reports_all_changes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.toml"), EXAMPLE).unwrap();
    let diff = |b: &str| {
        fs::write(at("b.toml"), b).unwrap();
        let verb = RigVerb::Diff {
            a: at("a.toml"),
            b: at("b.toml"),
        };
        run_command(&verb).unwrap()
    };
    let (text, outcome) = diff(EXAMPLE);
    assert!(text.ends_with("\nnothing changed\n"), "{text}");
    assert_eq!(outcome, Outcome::Fine);
    let model = "model = \"ZED Mini\"\n";
    let (text, outcome) = diff(&EXAMPLE.replace(model, &format!("{model}serial = 7\n")));
    let expected = "\nserial of feet: \"7\" in b only\nno frame changed, 1 other change\n";
    assert!(text.ends_with(expected), "{text}");
    assert_eq!(outcome, Outcome::Loss);
}

#[test]
fn diff_reports_millimetres_and_degrees() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.toml"), EXAMPLE).unwrap();
    let moved = EXAMPLE.replacen(
        "translation_m = [0.063, 0, 0]",
        "translation_m = [0.0625, 0, 0]",
        1,
    );
    fs::write(at("b.toml"), moved).unwrap();
    let diff = RigVerb::Diff {
        a: at("a.toml"),
        b: at("b.toml"),
    };
    let (text, outcome) = run_command(&diff).unwrap();
    assert_eq!(outcome, Outcome::Loss);
    let line = text
        .lines()
        .find(|line| line.starts_with("feet/right"))
        .unwrap();
    assert!(
        line.contains("0.500") && line.contains("[-0.500, +0.000, +0.000]"),
        "{line}"
    );
    assert!(text.ends_with("1 frame changed\n"), "{text}");
}

#[test]
fn factory_files_are_compared_with_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // A rectified pair with a baseline of 6 cm, and a view of 65 degrees across.
    fs::write(at("K.txt"), "1000 0 640 0 1000 360 0 0 1\n0.06\n").unwrap();
    fs::write(at("rig.toml"), EXAMPLE).unwrap();
    let argument = format!("feet={}@1280x720", at("K.txt").display());
    let (text, outcome) = check(&at("rig.toml"), &[&argument]);
    assert_eq!(outcome, Outcome::Failed);
    let expected = "error: the baseline of feet is 63.000 mm, K.txt at 1280x720 has 60.000 mm: off by +3.000 mm";
    assert!(text.contains(expected), "{text}");

    let bad = |argument: &str| {
        let verb = RigVerb::Check {
            file: at("rig.toml"),
            calibration: vec![argument.to_owned()],
            json: false,
        };
        let error = run_command(&verb).unwrap_err();
        (
            error
                .downcast_ref::<console_output::BadArguments>()
                .is_some(),
            format!("{error:#}"),
        )
    };
    assert!(bad("feet").0);
    // No size, so a part of the path.
    let (arguments, text) = bad("feet=a@1280");
    assert!(!arguments && text.contains("a@1280"), "{text}");
    let (_, text) = bad("feet=no/such.conf");
    assert!(
        text.contains("the calibration of feet") && text.contains("no/such.conf"),
        "{text}"
    );
}

/// A factory file with these sections; the focal length is that of the section's name.
fn conf(sections: &[(&str, &str)]) -> String {
    let mut text = "[STEREO]\nBaseline=63\nTY=0\nTZ=0\nRX_HD=0\nCV_HD=0\nRZ_HD=0\n".to_owned();
    for tag in ["FHD", "FHD1200"] {
        text += &format!("RX_{tag}=0\nCV_{tag}=0\nRZ_{tag}=0\n");
    }
    for (tag, fx) in sections {
        for eye in ["LEFT", "RIGHT"] {
            text += &format!(
                "[{eye}_CAM_{tag}]\nfx={fx}\nfy=700\ncx=640\ncy=360\nk1=0.1\nk2=0\np1=0\np2=0\nk3=0\n"
            );
        }
    }
    text
}

#[test]
fn sizes_are_not_guessed() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, text: &str, size: &str| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, text).unwrap();
        calibrations::read(&[format!("feet={}{size}", path.display())])
    };
    let source =
        |name: &str, text: &str, size: &str| read(name, text, size).unwrap()["feet"].source.clone();
    let refused = |name: &str, text: &str| {
        let error = read(name, text, "").unwrap_err();
        let arguments = error
            .downcast_ref::<console_output::BadArguments>()
            .is_some();
        (arguments, format!("{error:#}"))
    };
    let both = conf(&[("HD", "700"), ("FHD", "1400")]);
    assert_eq!(source("SN1.conf", &both, ""), "SN1.conf at 1280x720");
    assert_eq!(
        source("SN1.conf", &both, "@1920x1080"),
        "SN1.conf at 1920x1080"
    );
    let gmsl = conf(&[("FHD1200", "700")]);
    assert_eq!(source("SN2.conf", &gmsl, ""), "SN2.conf at 1920x1200");
    // A path may hold an @.
    assert_eq!(source("a@b/SN1.conf", &both, ""), "SN1.conf at 1280x720");

    // The error is that of the section that is there.
    let (_, text) = refused("SN2.conf", &conf(&[("FHD1200", "nan")]));
    assert!(
        text.contains("nan") && !text.contains("no section for HD"),
        "{text}"
    );
    let (_, text) = refused("SN1.conf", &conf(&[("HD", "nan"), ("FHD", "1400")]));
    assert!(text.contains("nan"), "{text}");

    let pair = "1000 0 640 0 1000 360 0 0 1\n0.06\n";
    let (arguments, text) = refused("K.txt", pair);
    assert!(
        arguments && text.contains("give it as feet=") && text.contains("K.txt@WIDTHxHEIGHT"),
        "{text}"
    );
    // A file that states its size needs none.
    let middlebury = "cam0=[1000 0 400; 0 1000 300; 0 0 1]\ncam1=[1000 0 400; 0 1000 300; 0 0 1]\n\
                      doffs=0\nbaseline=60\nwidth=800\nheight=600\nndisp=64\n";
    assert_eq!(source("m.txt", middlebury, ""), "m.txt at 800x600");
}

#[test]
fn serial_is_that_of_the_file_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("SN9")).unwrap();
    fs::write(at("SN9/SN00123.conf"), conf(&[("HD", "700")])).unwrap();
    let argument = format!("feet={}", at("SN9").display());
    let serial = |serial: &str| {
        let model = "model = \"ZED Mini\"";
        let text = EXAMPLE.replace(model, &format!("{model}\nserial = {serial}"));
        fs::write(at("rig.toml"), text).unwrap();
        check(&at("rig.toml"), &[&argument]).0
    };
    let text = serial("123");
    assert!(!text.contains("serial"), "{text}");
    let text = serial("124");
    let expected =
        "the serial of feet is 124, SN00123.conf at 1280x720 is for 00123: another camera's file?";
    assert!(text.contains(expected), "{text}");
    fs::rename(at("SN9/SN00123.conf"), at("SN9/factory.conf")).unwrap();
    let text = serial("123");
    assert!(
        text.contains("note: serial of feet not checked: factory.conf at"),
        "{text}"
    );
}

#[test]
fn drawings_are_not_overwritten_and_reproducible() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("rig.toml"), EXAMPLE).unwrap();
    let show = |force: bool| {
        run_command(&RigVerb::Show {
            file: at("rig.toml"),
            out: Some(at("out")),
            calibration: Vec::new(),
            force,
        })
    };
    let (text, _) = show(false).unwrap();
    assert!(
        text.contains("rig        example chest plate, revision nominal-1"),
        "{text}"
    );
    let feet = text
        .lines()
        .find(|line| line.trim_start().starts_with("feet/left"))
        .unwrap();
    assert!(
        feet.contains("80.000") && feet.contains("31.500") && feet.contains("-80.0"),
        "{feet}"
    );
    let svg = fs::read_to_string(at("out/rig.svg")).unwrap();
    for expected in [
        "front: facing the wearer",
        "ground",
        "left_shoulder: left lens at 7.5, 161.6, 100.0 mm",
    ] {
        assert!(svg.contains(expected), "no {expected:?}");
    }
    let png = fs::read(at("out/rig.png")).unwrap();
    assert!(png.starts_with(b"\x89PNG"));
    assert!(show(false).is_err());
    show(true).unwrap();
    assert_eq!(
        fs::read(at("out/rig.png")).unwrap(),
        png,
        "the same rig, the same bytes"
    );
}
