use super::*;

mod kinds_of_sources;

const CAMERA: &str = "[[camera]]\nname = \"feet\"\n[camera.source]\nkind = \"synthetic\"\n";

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse(text, Path::new("/etc/paws"))
}

fn problems(text: &str) -> Vec<String> {
    match parse(text) {
        Err(ConfigError::Invalid {
            problems,
            path: None,
        }) => problems.0.iter().map(Problem::to_string).collect(),
        other => panic!("expected problems, found {other:?}"),
    }
}

/// The text must have exactly one problem, which begins like `expected`.
fn check(text: &str, expected: &str) {
    let found = problems(text);
    assert!(
        found.len() == 1 && found[0].starts_with(expected),
        "found {found:#?}, expected {expected:?}"
    );
}

#[test]
fn example_is_complete_and_states_the_defaults() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/pawsd.toml");
    let example = Config::read(&path).unwrap();
    let names: Vec<&str> = example
        .cameras
        .iter()
        .map(|camera| camera.name.as_str())
        .collect();
    assert_eq!(names, ["left_shoulder", "right_shoulder", "feet"]);
    // Settings that are commented out or have their default value are the defaults.
    let defaults = parse(CAMERA).unwrap();
    assert_eq!(example.session.chunk_ns, defaults.session.chunk_ns);
    assert_eq!(example.session.pre_roll_ns, defaults.session.pre_roll_ns);
    assert_eq!(example.session.name, defaults.session.name);
    assert_eq!(example.disk, defaults.disk);
    assert_eq!(example.encoder, defaults.encoder);
    assert_eq!(example.control, defaults.control);
    assert_eq!(example.rig, defaults.rig);

    // Every commented-out setting is valid: no example without a meaning.
    let text = std::fs::read_to_string(&path).unwrap();
    let is_setting = |line: &str| line.starts_with("#") && !line.starts_with("# ");
    assert!(text.lines().any(is_setting));
    let uncommented: String = text
        .lines()
        .map(|line| if is_setting(line) { &line[1..] } else { line })
        .flat_map(|line| [line, "\n"])
        .collect();
    let all = Config::parse(&uncommented, Path::new("/etc/paws"))
        .unwrap_or_else(|error| panic!("{error}"));
    assert!(
        all.cameras
            .iter()
            .any(|camera| matches!(camera.source, SourceConfig::Replay(_)))
    );
}

#[test]
fn absent_keys_have_their_defaults() {
    let config = parse(CAMERA).unwrap();
    let expected = Config {
        session: Session {
            out: None,
            name: String::new(),
            chunk_ns: 500_000_000,
            pre_roll_ns: 0,
        },
        disk: Disk {
            reserve_bytes: 1_000_000_000,
        },
        encoder: Encoder {
            element: None,
            quality_db: 42.0,
            threads: 1,
        },
        control: Control {
            socket: "/run/paws/pawsd.sock".into(),
        },
        operator: Operator::default(),
        page: None,
        rig: None,
        cameras: vec![Camera {
            name: "feet".into(),
            trigger: None,
            calibration: None,
            latency_ns: 0,
            latency_sigma_ns: 1_000_000,
            imu_latency_ns: 0,
            imu_latency_sigma_ns: 1_000_000,
            source: SourceConfig::Synthetic(SyntheticConfig {
                width: 1344,
                height: 376,
                rate_hz: 30.0,
                imu_rate_hz: 400.0,
                seed: 0,
            }),
        }],
    };
    assert_eq!(config, expected);
}

#[test]
fn every_key_can_be_set() {
    let text = r#"
        [session]
        out = "sessions"
        name = "kitchen, morning ☀"
        chunk_ms = 250
        pre_roll_s = 2.5
        [disk]
        reserve_gb = 4
        [encoder]
        element = "x264enc"
        quality_db = 45
        threads = 2
        [control]
        socket = "/tmp/p.sock"
        [rig]
        file = "../rig.toml"
        [[camera]]
        name = "left_shoulder"
        trigger = "chest"
        calibration = "SN1.conf"
        latency_ms = 12.3456789
        latency_sigma_ms = 0.5
        imu_latency_ms = 1
        imu_latency_sigma_ms = 0.25
        source = { kind = "replay", path = "/data/kitti", rate_hz = 9.97, repeat = true, imu = false }
        [[camera]]
        name = "feet"
        [camera.source]
        kind = "synthetic"
        width = 1_280
        height = 0x168
        rate_hz = 15
        imu_rate_hz = 0.0
        seed = 9223372036854775807
    "#;
    let config = parse(text).unwrap();
    assert_eq!(
        config.session.out.as_deref(),
        Some(Path::new("/etc/paws/sessions"))
    );
    assert_eq!(config.session.name, "kitchen, morning ☀");
    assert_eq!(
        (config.session.chunk_ns, config.session.pre_roll_ns),
        (250_000_000, 2_500_000_000)
    );
    assert_eq!(config.disk.reserve_bytes, 4_000_000_000);
    assert_eq!(
        config.encoder,
        Encoder {
            element: Some("x264enc".into()),
            quality_db: 45.0,
            threads: 2
        }
    );
    assert_eq!(config.control.socket, Path::new("/tmp/p.sock"));
    assert_eq!(
        config.rig.as_deref(),
        Some(Path::new("/etc/paws/../rig.toml"))
    );
    let [left, feet] = config.cameras.as_slice() else {
        panic!("{:?}", config.cameras)
    };
    assert_eq!(left.trigger.as_deref(), Some("chest"));
    assert_eq!(
        left.calibration.as_deref(),
        Some(Path::new("/etc/paws/SN1.conf"))
    );
    assert_eq!(
        (left.latency_ns, left.latency_sigma_ns),
        (12_345_679, 500_000)
    );
    assert_eq!(
        (left.imu_latency_ns, left.imu_latency_sigma_ns),
        (1_000_000, 250_000)
    );
    let replay = ReplayConfig {
        path: "/data/kitti".into(),
        rate_hz: Some(9.97),
        repeat: true,
        imu: false,
    };
    assert_eq!(left.source, SourceConfig::Replay(replay));
    let synthetic = SyntheticConfig {
        width: 1280,
        height: 360,
        rate_hz: 15.0,
        imu_rate_hz: 0.0,
        seed: i64::MAX as u64,
    };
    assert_eq!(feet.source, SourceConfig::Synthetic(synthetic));
}

#[test]
fn synthetic_cameras_without_a_seed_differ() {
    let config = parse(&format!("{CAMERA}{}", CAMERA.replace("feet", "hand"))).unwrap();
    assert_ne!(config.cameras[0].source, config.cameras[1].source);
}

#[test]
fn values_out_of_range_are_rejected() {
    let with = |table: &str, line: &str| format!("[{table}]\n{line}\n{CAMERA}");
    check(
        &with("session", "chunk_ms = 99"),
        "line 2: chunk_ms in [session] is 99, expected an integer from 100 to 1000",
    );
    check(
        &with("session", "chunk_ms = 1001"),
        "line 2: chunk_ms in [session] is 1001",
    );
    check(
        &with("session", "chunk_ms = 500.0"),
        "line 2: chunk_ms in [session] is 500.0, expected an integer",
    );
    check(
        &with("session", "chunk_ms = 99999999999999999999"),
        "line 2: chunk_ms in [session] is 99999999999999999999",
    );
    check(
        &with("session", "pre_roll_s = 60.1"),
        "line 2: pre_roll_s in [session] is 60.1, expected a number from 0 to 60",
    );
    check(
        &with("session", "pre_roll_s = -1"),
        "line 2: pre_roll_s in [session] is -1",
    );
    check(
        &with("session", "pre_roll_s = nan"),
        "line 2: pre_roll_s in [session] is nan",
    );
    check(
        &with("session", "pre_roll_s = \"1 s\""),
        "line 2: pre_roll_s in [session] is \"1 s\"",
    );
    check(
        &with("session", "name = \"a\\nb\""),
        "line 2: name in [session] is \"a\\nb\", expected one line without control",
    );
    check(
        &with("session", "out = \"\""),
        "line 2: out in [session] is \"\", expected a path",
    );
    check(
        &with("session", "out = \"~/paws\""),
        "line 2: out in [session] is \"~/paws\", expected a path",
    );
    check(
        &with("session", "out = [\"/data\"]"),
        "line 2: out in [session] is a list, expected a path",
    );
    check(
        &with("disk", "reserve_gb = -0.5"),
        "line 2: reserve_gb in [disk] is -0.5",
    );
    check(
        &with("disk", "reserve_gb = inf"),
        "line 2: reserve_gb in [disk] is inf",
    );
    check(
        &with("encoder", "element = \"x263enc\""),
        "line 2: element in [encoder] is \"x263enc\", expected \"auto\" or",
    );
    check(
        &with("encoder", "quality_db = 29.9"),
        "line 2: quality_db in [encoder] is 29.9",
    );
    check(
        &with("encoder", "quality_db = 56"),
        "line 2: quality_db in [encoder] is 56",
    );
    check(
        &with("encoder", "threads = 0"),
        "line 2: threads in [encoder] is 0",
    );
    check(
        &with("encoder", "threads = 17"),
        "line 2: threads in [encoder] is 17",
    );
    let long = format!("socket = \"/{}\"", "s".repeat(107));
    check(
        &with("control", &long),
        "line 2: socket in [control] is a path of 108 bytes, expected at most 107",
    );
    check(
        &with("rig", "file = 2024-01-01"),
        "line 2: file in [rig] is a date",
    );
    check(
        &format!("session = 3\n{CAMERA}"),
        "line 1: session in the configuration is 3, expected a table",
    );
    check(
        &format!("{CAMERA}[session]\nname = \"{}\"", "x".repeat(201)),
        "line 6: name in [session] is",
    );
    let longest = format!("{CAMERA}[session]\nname = \"{}\"", "x".repeat(200));
    assert!(parse(&longest).is_ok());
}

#[test]
fn control_characters_are_rejected_in_names_paths_and_sources() {
    for escape in ["\\u001b[2J", "\\u009b2J", "\\u202e", "\\u2028", "\\u007f"] {
        let bad = |text: &str, expected: &str| check(&text.replace('@', escape), expected);
        let source = |lines: &str| format!("[[camera]]\nname = \"feet\"\n[camera.source]\n{lines}");
        bad(
            &format!("{CAMERA}[session]\nname = \"a@\""),
            "line 6: name in [session]",
        );
        bad(
            &format!("{CAMERA}[session]\nout = \"a@\""),
            "line 6: out in [session]",
        );
        bad(
            &format!("{CAMERA}[control]\nsocket = \"a@\""),
            "line 6: socket in [control]",
        );
        bad(
            &source("kind = \"replay\"\npath = \"a@\""),
            "line 5: path in [camera.source]",
        );
        bad(
            &source("kind = \"gstreamer\"\nchain = \"videotestsrc@\""),
            "line 5: chain in [camera.source]",
        );
        bad(
            &source("kind = \"v4l2\"\nusb = \"2b03:f682\"\nusb_serial = \"1@\""),
            "line 6: usb_serial in [camera.source]",
        );
        for (key, others) in [
            ("path", "kind = \"bag\""),
            ("topic", "kind = \"bag\"\npath = \"walk\""),
            ("imu_topic", "kind = \"bag\"\npath = \"walk\""),
            ("path", "kind = \"video\""),
            ("right_path", "kind = \"video\"\npath = \"left.mp4\""),
            ("right_device", "kind = \"v4l2\"\ndevice = \"/dev/video0\""),
        ] {
            let line = 4 + others.lines().count();
            bad(
                &source(&format!("{others}\n{key} = \"a@\"")),
                &format!("line {line}: {key} in [camera.source]"),
            );
        }
        // The error does not contain the raw characters.
        let text = CAMERA.replace("feet", &format!("f{escape}"));
        let found = problems(&text);
        assert!(
            found.iter().all(|p| session_archive::text::is_plain(p)),
            "{found:?}"
        );
    }
    // A chain may be written over several lines.
    let chain = "kind = \"gstreamer\"\nchain = \"\"\"\n  videotestsrc !\n\tvideoconvert\n\"\"\"";
    assert!(
        parse(&format!(
            "[[camera]]\nname = \"feet\"\n[camera.source]\n{chain}"
        ))
        .is_ok()
    );
}

#[test]
fn cameras_are_checked() {
    let with = |lines: &str| format!("[[camera]]\nname = \"feet\"\n{lines}");
    let synthetic = "source = { kind = \"synthetic\" }";
    check(
        "",
        "line 1: camera is missing in the configuration, expected a table [[camera]] for each camera",
    );
    check(
        "camera = []",
        "line 1: camera in the configuration is an empty list, expected tables",
    );
    check(
        "camera = [3]",
        "line 1: camera in the configuration is a list, expected tables",
    );
    check(
        "[camera]\nname = \"feet\"",
        "line 1: camera in the configuration is a table, expected tables",
    );
    check(
        &format!("[[camera]]\n{synthetic}"),
        "line 1: name is missing in [[camera]]",
    );
    for bad in ["Feet", "0cam", "rig", "world", "a/b", "", &"a".repeat(49)] {
        let text = format!("[[camera]]\nname = {bad:?}\n{synthetic}");
        check(
            &text,
            &format!("line 2: name in [[camera]] is {bad:?}, expected a name of a-z"),
        );
    }
    check(
        &format!("{0}\n{0}", with(synthetic)),
        "line 5: name in [[camera]] is \"feet\" like that of camera 1, expected a name of its own",
    );
    check(
        &with(&format!("trigger = \"\"\n{synthetic}")),
        "line 3: trigger in [[camera]] is \"\"",
    );
    check(
        &with(&format!("latency_ms = -1\n{synthetic}")),
        "line 3: latency_ms in [[camera]] is -1",
    );
    check(
        &with(&format!("imu_latency_sigma_ms = 1e4\n{synthetic}")),
        "line 3: imu_latency_sigma_ms in [[camera]] is 1e4",
    );
}

#[test]
fn sources_are_checked() {
    let with = |lines: &str| format!("[[camera]]\nname = \"feet\"\n[camera.source]\n{lines}");
    check(
        "[[camera]]\nname = \"feet\"",
        "line 1: source is missing in [[camera]], expected a table [camera.source]",
    );
    check(
        "[[camera]]\nname = \"feet\"\nsource = \"replay\"",
        "line 3: source in [[camera]] is \"replay\", expected a table",
    );
    check(
        &with("path = \"/data\""),
        "line 3: kind is missing in [camera.source], expected \"zed\"",
    );
    check(
        &with("kind = \"v4l3\"\ndevice = \"/dev/video0\""),
        "line 4: kind in [camera.source] is \"v4l3\", expected \"zed\"",
    );
    check(
        &with("kind = \"reply\""),
        "line 4: kind in [camera.source] is \"reply\", expected \"zed\"",
    );
    assert!(problems(&with("kind = \"reply\""))[0].ends_with("did you mean replay?"));
    check(
        &with("kind = \"replay\""),
        "line 3: path is missing in [camera.source], expected the folder of a data set",
    );
    let replay = |line: &str| with(&format!("kind = \"replay\"\npath = \"/data\"\n{line}"));
    check(
        &replay("rate_hz = 0"),
        "line 6: rate_hz in [camera.source] is 0",
    );
    check(
        &replay("repeat = 1"),
        "line 6: repeat in [camera.source] is 1, expected true or false",
    );
    check(
        &replay("imu = \"no\""),
        "line 6: imu in [camera.source] is \"no\", expected true or false",
    );
    check(
        &replay("seed = 1"),
        "line 6: unknown key seed in [camera.source]; known are kind, path, rate_hz, repeat, imu",
    );
    let synthetic = |line: &str| with(&format!("kind = \"synthetic\"\n{line}"));
    check(
        &synthetic("width = 642"),
        "line 5: width in [camera.source] is 642, expected a multiple of 4",
    );
    check(
        &synthetic("width = 64"),
        "line 5: width in [camera.source] is 64, expected an integer from 128",
    );
    check(
        &synthetic("height = 241"),
        "line 5: height in [camera.source] is 241, expected a multiple of 2",
    );
    check(
        &synthetic("rate_hz = 2000"),
        "line 5: rate_hz in [camera.source] is 2000",
    );
    check(
        &synthetic("imu_rate_hz = -1"),
        "line 5: imu_rate_hz in [camera.source] is -1",
    );
    check(
        &synthetic("seed = -1"),
        "line 5: seed in [camera.source] is -1",
    );
    check(
        &synthetic("path = \"/data\""),
        "line 5: unknown key path in [camera.source]; known are kind, width,",
    );
}

#[test]
fn unknown_key_names_the_nearest_known_one() {
    let with = |table: &str, line: &str| format!("[{table}]\n{line}\n{CAMERA}");
    check(
        &with("session", "quality_db = 42"),
        "line 2: unknown key quality_db in [session]; known are out, name, chunk_ms, pre_roll_s",
    );
    check(
        &with("session", "chunk = 500"),
        "line 2: unknown key chunk in [session]; did you mean chunk_ms?",
    );
    check(
        &with("session", "chunk_sm = 500"),
        "line 2: unknown key chunk_sm in [session]; did you mean chunk_ms?",
    );
    check(
        &with("session", "Out = \"/data\""),
        "line 2: unknown key Out in [session]; did you mean out?",
    );
    check(
        &with("encoder", "quality = 42"),
        "line 2: unknown key quality in [encoder]; did you mean quality_db?",
    );
    check(
        &with("disc", "reserve_gb = 1"),
        "line 1: unknown key disc in the configuration; did you mean disk?",
    );
    check(
        &format!("{CAMERA}[rig]\nfiel = \"rig.toml\""),
        "line 6: unknown key fiel in [rig]; did you mean file?",
    );
    check(
        &format!("colour = 1\n{CAMERA}"),
        "line 1: unknown key colour in the configuration; known are session, disk, encoder, control, operator, page, rig, camera",
    );
    check(
        "[[camera]]\nname = \"feet\"\ntriger = \"chest\"\nsource = { kind = \"synthetic\" }",
        "line 3: unknown key triger in [[camera]]; did you mean trigger?",
    );
}

#[test]
fn all_problems_are_reported_in_file_order() {
    let text = "\
        [[camera]]\n\
        name = \"Feet\"\n\
        [camera.source]\n\
        kind = \"replay\"\n\
        rate = 10\n\
        [[camera]]\n\
        nam = \"hand\"\n\
        [session]\n\
        chunk_ms = 5\n\
        [encoder]\n\
        element = 3\n\
        thread = 1\n";
    let error = parse(text).unwrap_err().to_string();
    let expected = [
        "checking the configuration: 9 problems",
        "  line 2: name in [[camera]] is \"Feet\"",
        "  line 3: path is missing in [camera.source]",
        "  line 5: unknown key rate in [camera.source]; did you mean",
        "  line 6: name is missing in [[camera]]",
        "  line 6: source is missing in [[camera]]",
        "  line 7: unknown key nam in [[camera]]; did you mean name?",
        "  line 9: chunk_ms in [session] is 5",
        "  line 11: element in [encoder] is 3",
        "  line 12: unknown key thread in [encoder]; did you mean threads?",
    ];
    let lines: Vec<&str> = error.lines().collect();
    assert_eq!(lines.len(), expected.len(), "{error}");
    for (line, expected) in lines.iter().zip(expected) {
        assert!(
            line.starts_with(expected),
            "found {line:?}, expected {expected:?}"
        );
    }
}

#[test]
fn invalid_toml_is_reported_with_line_numbers() {
    let found = problems("[session]\nchunk_ms = \n[disk\nreserve_gb = 1\n");
    assert!(found.len() >= 2, "{found:#?}");
    assert!(found[0].starts_with("line 2: not TOML: "), "{found:#?}");
    assert!(found[1].starts_with("line 3: not TOML: "), "{found:#?}");
    check(
        &format!("{CAMERA}[disk]\n[disk]\n"),
        "line 6: not TOML: duplicate key",
    );
}

#[test]
fn error_names_the_file_and_paths_are_relative_to_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pawsd.toml");
    let absent = Config::read(&path).unwrap_err().to_string();
    assert_eq!(
        absent,
        format!("reading the configuration: {}", path.display())
    );
    std::fs::write(&path, "oops = 1").unwrap();
    let error = Config::read(&path).unwrap_err().to_string();
    assert!(
        error.ends_with(&format!("\nin {}", path.display())),
        "{error}"
    );
    std::fs::write(&path, format!("session.out = \"s\"\n{CAMERA}")).unwrap();
    assert_eq!(
        Config::read(&path).unwrap().session.out,
        Some(folder.path().join("s"))
    );
}

#[test]
fn damaged_text_never_panics() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/pawsd.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let settings: String = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .flat_map(|line| [line, "\n"])
        .collect();
    assert!(parse(&settings).is_ok());
    for (i, c) in settings.char_indices() {
        for replacement in ["", "\"", "[", "=", "\n", "9", "\u{1F43E}"] {
            // Most of these are invalid, some are not; each must have a result.
            let _ = parse(&format!(
                "{}{replacement}{}",
                &settings[..i],
                &settings[i + c.len_utf8()..]
            ));
        }
        let _ = parse(&settings[..i]);
    }
}

#[test]
fn operator_settings_are_parsed() {
    let text = format!(
        "{CAMERA}[operator]\nbuttons = [\"gpio:/dev/gpiochip1:3,active-low\", \"evdev:name=keypad\"]\n\
         lights = [\"gpio:red+green+blue\"]\nbeepers = [\"evdev:name=PC Speaker\"]\n\
         [page]\nlisten = \"0.0.0.0:8077\"\ntoken_file = \"token\"\n"
    );
    let config = parse(&text).unwrap();
    let expected = Operator {
        buttons: vec![
            "gpio:/dev/gpiochip1:3,active-low".parse().unwrap(),
            "evdev:name=keypad".parse().unwrap(),
        ],
        lights: vec!["gpio:red+green+blue".parse().unwrap()],
        beepers: vec!["evdev:name=PC Speaker".parse().unwrap()],
    };
    assert_eq!(config.operator, expected);
    let page = config.page.unwrap();
    assert_eq!(
        page.token_file.as_deref(),
        Some(Path::new("/etc/paws/token"))
    );
    assert_eq!(page.folder, Path::new("/var/lib/paws/page"));

    let check = |keys: &str, expected: &str| check(&format!("{CAMERA}{keys}"), expected);
    check(
        "[page]\nlisten = \"0.0.0.0:8077\"",
        "line 6: listen in [page] is 0.0.0.0:8077, which is reachable from other machines, expected token_file",
    );
    check("[page]\n", "line 5: listen is missing in [page]");
    check(
        "[operator]\nbuttons = [\n\"evdev:key=KEY_RECORD\",\n\"lever:3\"]\n",
        "line 8: buttons in [operator]: reading \"lever:3\"",
    );
    check(
        "[operator]\nlights = \"sysfs:status\"\n",
        "line 6: lights in [operator] is \"sysfs:status\", expected a list of texts",
    );
}

#[cfg(feature = "simulator")]
#[test]
fn shipped_rigs_can_be_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/rigs");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "toml") && !path.ends_with("simulated-rig.toml") {
            let config = Config::read(&path).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(config.cameras.len(), 3, "{}", path.display());
            names.push(path.file_name().unwrap().to_owned());
        }
    }
    names.sort();
    assert_eq!(names, ["bench.toml", "paws.toml", "simulated.toml"]);
}
