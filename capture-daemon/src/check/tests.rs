use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;

use super::*;

const SYNTHETIC: &str =
    "[[camera]]\nname = \"feet\"\nsource = { kind = \"synthetic\", width = 128, height = 64 }\n";

/// The findings about a configuration in a folder of its own.
fn findings(folder: &Path, text: &str) -> Vec<Finding> {
    check(&Config::parse(text, folder).unwrap())
}

/// Among the findings of `about`, the worst must be `level`, and one of that level must contain
/// `expected`.
fn expect(findings: &[Finding], about: &str, level: Level, expected: &str) {
    let of: Vec<&Finding> = findings
        .iter()
        .filter(|finding| finding.about == about)
        .collect();
    assert_eq!(
        of.iter().map(|f| f.level).max(),
        Some(level),
        "{about}: {findings:#?}"
    );
    let says = |f: &&&Finding| f.level == level && f.message.contains(expected);
    assert!(
        of.iter().any(|f| says(&f)),
        "{about} does not say {expected:?}: {findings:#?}"
    );
}

fn write_pair(folder: &Path, width: u32, height: u32) -> PathBuf {
    fs::create_dir_all(folder).unwrap();
    for name in ["left.png", "right.png"] {
        let file = fs::File::create(folder.join(name)).unwrap();
        let mut encoder = png::Encoder::new(file, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        let mut writer = encoder.write_header().unwrap();
        writer
            .write_image_data(&vec![128; (width * height) as usize])
            .unwrap();
    }
    folder.to_owned()
}

#[test]
fn valid_configuration_has_no_errors() {
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "session.out = \"sessions\"\ncontrol.socket = \"pawsd.sock\"\ndisk.reserve_gb = 0\n{SYNTHETIC}"
    );
    let found = findings(folder.path(), &text);
    assert!(found.iter().all(|f| f.level < Level::Error), "{found:#?}");
    expect(&found, "session", Level::Ok, "which will be created");
    expect(&found, "disk", Level::Ok, "a recording ends at 0.0 GB");
    expect(&found, "control", Level::Ok, "pawsd.sock");
    expect(&found, "rig", Level::Warning, "no rig file");
    expect(
        &found,
        "camera feet",
        Level::Warning,
        "a synthetic camera has no lenses",
    );
    let is_described = |f: &Finding| {
        f.level == Level::Ok && f.message.contains("128x64 at 30.0 Hz, IMU at 400.0 Hz")
    };
    assert!(found.iter().any(is_described), "{found:#?}");
    let encoder = found.iter().find(|f| f.about == "encoder").unwrap();
    assert!(
        encoder
            .message
            .contains(", for 0.2 million pixels per second"),
        "{encoder}"
    );
    assert!(
        fs::read_dir(folder.path()).unwrap().next().is_none(),
        "something was left behind"
    );
}

#[cfg(feature = "simulator")]
#[test]
fn shipped_simulated_rig_has_no_errors() {
    // From a clone, for any user: it needs no folders of an installed daemon.
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/rigs/simulated.toml");
    let found = check(&Config::read(&path).unwrap());
    // Whether another program uses the page's port, and whether the disk has room, depends on this
    // machine.
    let ours = |f: &&Finding| !["page", "disk"].contains(&f.about.as_str());
    let wrong: Vec<&Finding> = found
        .iter()
        .filter(ours)
        .filter(|f| f.level == Level::Error)
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    expect(&found, "session", Level::Ok, "deploy/rigs/sessions");
}

#[test]
fn token_readable_by_others_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let token = folder.path().join("token");
    fs::write(&token, "0123456789abcdef").unwrap();
    let text = format!("[page]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"token\"\n{SYNTHETIC}");
    let config = Config::parse(&text, folder.path()).unwrap();
    let check_page = || {
        let mut report = Report::default();
        page::check(&config, false, &mut report);
        report.findings
    };
    let mode = |mode| fs::set_permissions(&token, fs::Permissions::from_mode(mode)).unwrap();
    mode(0o644);
    expect(
        &check_page(),
        "page",
        Level::Error,
        "mode 0644, expected 0600",
    );
    expect(&check_page(), "page", Level::Error, "chmod 600 ");
    mode(0o600);
    expect(&check_page(), "page", Level::Ok, "its token is in");
    fs::remove_file(&token).unwrap();
    expect(&check_page(), "page", Level::Error, "reading the token");
}

/// The bag behind its head may be valid or not: a check does not read it.
#[test]
fn bag_whose_head_is_insufficient_is_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = session_archive::mcap::MAGIC.to_vec();
    // A record of an unknown kind, longer than the head.
    bytes.push(0xf0);
    bytes.extend((1_u64 << 30).to_le_bytes());
    let bag = folder.path().join("walk.mcap");
    fs::write(&bag, &bytes).unwrap();
    let file = fs::OpenOptions::new().write(true).open(&bag).unwrap();
    file.set_len(bytes.len() as u64 + (1 << 30)).unwrap();
    let text = "control.socket = \"s\"\n[[camera]]\nname = \"feet\"\nsource = { kind = \"bag\", path = \"walk.mcap\" }\n";
    let found = findings(folder.path(), text);
    expect(
        &found,
        "camera feet",
        Level::Warning,
        "the first 1 MiB of each file of a bag, which is all that a check reads",
    );
}

#[test]
fn all_findings_are_reported_in_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("file"), "").unwrap();
    fs::write(here.join("rig.toml"), "format = 1\n").unwrap();
    fs::create_dir(here.join("empty")).unwrap();
    write_pair(&here.join("desk"), 64, 32);
    fs::create_dir(here.join("filed")).unwrap();
    fs::write(here.join("filed/K.txt"), "50 0 32 0 50 16 0 0 1\n0.1\n").unwrap();
    fs::write(here.join("K.txt"), "500 0 320 0 500 240 0 0 1\n0.1\n").unwrap();
    let text = "\
        session.out = \"file/sessions\"\ncontrol.socket = \"no/such/pawsd.sock\"\ndisk.reserve_gb = 99999\n\
        rig.file = \"rig.toml\"\nencoder.element = \"nvv4l2h265enc\"\n\
        [[camera]]\nname = \"gone\"\ntrigger = \"chest\"\nsource = { kind = \"replay\", path = \"gone\" }\n\
        [[camera]]\nname = \"none\"\nsource = { kind = \"replay\", path = \"empty\" }\n\
        [[camera]]\nname = \"rateless\"\nsource = { kind = \"replay\", path = \"desk\" }\n\
        [[camera]]\nname = \"plain\"\nsource = { kind = \"replay\", path = \"desk\", rate_hz = 10 }\n\
        [[camera]]\nname = \"filed\"\ncalibration = \"filed\"\nsource = { kind = \"replay\", path = \"desk\", rate_hz = 10 }\n\
        [[camera]]\nname = \"misfit\"\ncalibration = \"K.txt\"\n\
        source = { kind = \"replay\", path = \"desk\", rate_hz = 10, repeat = true }\n\
        [[camera]]\nname = \"uncalibrated\"\ncalibration = \"absent.conf\"\nsource = { kind = \"synthetic\", width = 128, height = 32 }\n";
    let found = findings(here, text);
    expect(&found, "session", Level::Error, "not a directory");
    expect(&found, "disk", Level::Error, "expected at least 99999.3 GB");
    expect(&found, "control", Level::Error, "could not make its socket");
    expect(&found, "rig", Level::Error, "name is missing");
    expect(&found, "trigger", Level::Warning, "gone alone");
    expect(&found, "camera gone", Level::Error, "no folder");
    expect(
        &found,
        "camera none",
        Level::Error,
        "recognising a data set",
    );
    expect(&found, "camera rateless", Level::Error, "rate");
    expect(&found, "camera misfit", Level::Error, "principal point");
    let note = |f: &&Finding| f.about == "camera misfit" && f.message.contains("no calibration");
    assert_eq!(
        found.iter().find(note),
        None,
        "it has a calibration of its own"
    );
    expect(
        &found,
        "camera plain",
        Level::Warning,
        "the data set contains no calibration",
    );
    expect(
        &found,
        "camera plain",
        Level::Warning,
        "its intrinsics are not known: record a board (BOARDS), then `paws calib cameras BOARDS --target board.toml \
         --out calibration`, then calibration = \"calibration/plain.yaml\" in its [[camera]]",
    );
    expect(
        &found,
        "camera filed",
        Level::Ok,
        "calibrated, baseline 100.0 mm",
    );
    expect(&found, "camera uncalibrated", Level::Error, "absent.conf");
    expect(
        &found,
        "encoder",
        Level::Error,
        "nvv4l2h265enc, which [encoder] names",
    );
}

#[test]
fn cameras_missing_from_the_rig_file_are_an_error() {
    let rig = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cad-transforms/rigs/example.toml");
    let folder = tempfile::tempdir().unwrap();
    let with_rig =
        |cameras: &str| findings(folder.path(), &format!("rig.file = {rig:?}\n{cameras}"));
    expect(
        &with_rig(SYNTHETIC),
        "rig",
        Level::Ok,
        "left_shoulder, right_shoulder",
    );
    let hand = SYNTHETIC.replace("feet", "hand");
    expect(&with_rig(&hand), "rig", Level::Warning, "hand is not in it");
}

#[test]
fn running_daemon_is_detected() {
    let folder = tempfile::tempdir().unwrap();
    let _daemon = std::os::unix::net::UnixListener::bind(folder.path().join("s")).unwrap();
    let found = findings(
        folder.path(),
        &format!("control.socket = \"s\"\n{SYNTHETIC}"),
    );
    expect(
        &found,
        "control",
        Level::Warning,
        "a daemon answers already",
    );
}

#[test]
fn finding_is_one_line() {
    let finding = Finding {
        level: Level::Warning,
        about: "camera feet".into(),
        message: "no calibration".into(),
    };
    assert_eq!(finding.to_string(), "warning  camera feet: no calibration");
}

/// Otherwise the error would appear only at the start.
#[test]
fn page_that_cannot_be_served_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let page = |socket: &str, token: &str| {
        findings(
            here,
            &format!(
                "control.socket = \"{socket}\"\n[page]\nlisten = \"{address}\"\ntoken_file = \"{token}\"\n{SYNTHETIC}"
            ),
        )
    };
    let found = page("s", "absent");
    expect(&found, "page", Level::Error, "end what uses this one");
    expect(&found, "page", Level::Error, "absent");
    // A running daemon uses the address.
    let _daemon = std::os::unix::net::UnixListener::bind(here.join("running")).unwrap();
    fs::write(
        here.join("token"),
        format!("{}\n", "0123456789abcdef".repeat(4)),
    )
    .unwrap();
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    fs::set_permissions(here.join("token"), mode).unwrap();
    let found = page("running", "token");
    expect(&found, "page", Level::Ok, "as by the daemon that runs");
    expect(&found, "page", Level::Ok, "its token is in");
    drop(taken);
    let found = page("s", "token");
    expect(&found, "page", Level::Ok, "it will be at");
}

#[test]
fn socket_that_cannot_be_created_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("file"), "").unwrap();
    let socket = |path: &str| findings(here, &format!("control.socket = \"{path}\"\n{SYNTHETIC}"));
    expect(
        &socket("file"),
        "control",
        Level::Error,
        "a file that is not a socket exists at its path",
    );
}

/// A recording would lack it, however long a daemon would wait.
#[test]
fn absent_camera_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[[camera]]\nname = \"feet\"\n\
        source = { kind = \"v4l2\", device = \"/dev/video-that-is-not-there\", width = 128, height = 64, rate_hz = 15 }\n";
    let found = findings(folder.path(), text);
    expect(&found, "camera feet", Level::Error, "pawsd devices");
}
