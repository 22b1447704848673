//! The keys of each kind of source.

use super::*;

#[cfg(feature = "simulator")]
#[test]
fn simulated_walk_has_defaults_and_named_values() {
    let camera = |source: &str| {
        let text =
            format!("[[camera]]\nname = \"feet\"\n[camera.source]\nkind = \"sim\"\n{source}");
        parse(&text).map(|config| config.cameras[0].source.clone())
    };
    let Ok(SourceConfig::Simulated(walk)) = camera("") else {
        panic!("no simulated walk");
    };
    let of = &walk.walk;
    assert_eq!((of.kind.name(), of.lighting.name()), ("pavement", "day"));
    assert_eq!((of.width, of.height, of.rate_hz), (672, 376, 15.0));
    assert_eq!((of.seed, of.seconds, walk.faults), (1, 600.0, None));
    let Ok(SourceConfig::Simulated(walk)) =
        camera("scene = \"trail\"\nlight = \"low-sun\"\nwidth = 320\nfaults = \"f.toml\"")
    else {
        panic!("no simulated walk");
    };
    assert_eq!(
        (walk.walk.kind.name(), walk.walk.lighting.name()),
        ("trail", "low-sun")
    );
    assert_eq!(walk.walk.width, 160);
    assert!(walk.faults.unwrap().is_absolute());
    let message = camera("scene = \"moon\"\nwidth = 322")
        .unwrap_err()
        .to_string();
    for part in ["moon", "\"pavement\"", "322, expected a multiple of 4"] {
        assert!(message.contains(part), "{message}");
    }
}

fn source(keys: &str) -> String {
    format!("[[camera]]\nname = \"feet\"\n[camera.source]\n{keys}")
}

#[test]
fn device_cameras_are_parsed() {
    let of = |keys: &str| match parse(&source(keys)).unwrap().cameras.remove(0).source {
        SourceConfig::V4l2(config) => config,
        other => panic!("{other:?}"),
    };
    let text = "kind = \"v4l2\"\ndevice = \"/dev/video2\"\nwidth = 640\nheight = 240\nrate_hz = 29.97\n\
                format = \"NV12\"\nbuffers = 4\nimu = \"zed\"\nimu_serial = \"17\"\nimu_rate_hz = 800\n\
                controls = { gain = 3, exposure_auto = -1 }";
    let expected = V4l2Config {
        device: DeviceChoice::Path("/dev/video2".into()),
        right: None,
        width: 640,
        height: 240,
        rate_hz: 29.97,
        format: PixelLayout::Nv12,
        buffers: 4,
        controls: vec![("exposure_auto".into(), -1), ("gain".into(), 3)],
        imu: Some(ZedImuConfig {
            serial: Some("17".into()),
            rate_hz: 800.0,
        }),
    };
    let mut found = of(text);
    found.controls.sort();
    assert_eq!(found, expected);

    // A ZED Mini: its size and rates follow from the mode.
    let zed = of("kind = \"zed\"\nserial = 12345678\nmode = \"VGA\"\nrate_hz = 100");
    assert_eq!((zed.width, zed.height, zed.rate_hz), (1344, 376, 100.0));
    assert_eq!(zed.imu.unwrap().serial.as_deref(), Some("12345678"));
    assert_eq!(of("kind = \"zed\"\nmode = \"HD2K\"").rate_hz, 15.0);
    assert_eq!(of("kind = \"zed\"\nimu = false").imu, None);

    let usb = of("kind = \"v4l2\"\nusb = \"2b03:F682\"\nusb_serial = \"x\"");
    let expected = DeviceChoice::Usb {
        vendor: 0x2b03,
        product: 0xf682,
        serial: Some("x".into()),
    };
    assert_eq!(usb.device, expected);

    let check = |keys: &str, expected: &str| check(&source(keys), expected);
    check(
        "kind = \"v4l2\"",
        "line 3: device is missing in [camera.source]",
    );
    check(
        "kind = \"v4l2\"\nusb = \"2b03\"",
        "line 5: usb in [camera.source] is \"2b03\", expected vendor and product",
    );
    check(
        "kind = \"v4l2\"\nusb = \"2b03:f682\"\ndevice = \"/dev/video0\"",
        "line 5: usb in [camera.source] is given beside device",
    );
    check(
        "kind = \"v4l2\"\ndevice = \"/dev/video0\"\nusb_serial = \"x\"",
        "line 6: usb_serial in [camera.source] is given, expected usb, and not device, beside it",
    );
    check(
        "kind = \"gstreamer\"\nchain = \"a\"\nimu_serial = \"17\"",
        "line 6: imu_serial in [camera.source] is given, expected imu = \"zed\" beside it",
    );
    check(
        "kind = \"zed\"\nimu = false\nimu_rate_hz = 400",
        "line 6: imu_rate_hz in [camera.source] is given, expected imu = true beside it",
    );
    check(
        "kind = \"zed\"\nmode = \"HD2K\"\nrate_hz = 30",
        "line 6: rate_hz in [camera.source] is 30, expected one of 15 in this mode",
    );
    check(
        "kind = \"v4l2\"\ndevice = \"/dev/video0\"\ncontrols = { gain = \"high\" }",
        "line 6: gain in controls is \"high\", expected an integer",
    );
    check(
        "kind = \"gstreamer\"",
        "line 3: chain is missing in [camera.source]",
    );
}

#[test]
fn two_devices_form_a_stereo_pair() {
    let text = "kind = \"v4l2\"\ndevice = \"/dev/video0\"\nright_device = \"/dev/video2\"\nwidth = 1280\n\
                height = 480\nrate_hz = 30\nformat = \"MJPG\"\npair_within_ms = 5";
    let source_of = |text: &str| parse(&source(text)).unwrap().cameras.remove(0).source;
    let SourceConfig::V4l2(config) = source_of(text) else {
        panic!("no device");
    };
    assert_eq!(config.format, PixelLayout::Mjpeg);
    let right = config.right.clone().unwrap();
    assert_eq!(
        (right.device, right.within_ns),
        (DeviceChoice::Path("/dev/video2".into()), 5_000_000)
    );
    let eyes = config.eyes();
    assert_eq!(eyes.len(), 2);
    assert!(
        eyes.iter()
            .all(|eye| eye.width == 640 && eye.right.is_none())
    );
    assert_eq!(eyes[1].device, DeviceChoice::Path("/dev/video2".into()));
    let usb = "kind = \"v4l2\"\nusb = \"0c45:6366\"\nusb_serial = \"a\"\nright_usb = \"0c45:6366\"\n\
               right_usb_serial = \"b\"";
    let SourceConfig::V4l2(config) = source_of(usb) else {
        panic!("no device");
    };
    // Half a period less a tenth of one, at 30 Hz.
    assert_eq!(config.right.unwrap().within_ns, 13_333_333);

    let check = |keys: &str, expected: &str| {
        let keys = format!("kind = \"v4l2\"\ndevice = \"/dev/video0\"\n{keys}");
        check(&source(&keys), expected);
    };
    check(
        "right_device = \"/dev/video0\"",
        "line 6: right_device in [camera.source] is the device of the left eye, too",
    );
    check(
        "pair_within_ms = 5",
        "line 6: pair_within_ms in [camera.source] is given, expected right_device or right_usb beside it",
    );
    check(
        "right_device = \"/dev/video2\"\npair_within_ms = 20",
        "line 7: pair_within_ms in [camera.source] does not fit the rate: pair_within_ms is 20.0, expected at most 13.3",
    );
    check(
        "right_device = \"/dev/video2\"\nimu = \"zed\"",
        "line 7: imu in [camera.source] is \"zed\", but a pair of two devices has no IMU",
    );
    check(
        "right_usb_serial = \"x\"",
        "line 6: right_usb_serial in [camera.source] is given, expected right_usb beside it",
    );
}

#[test]
fn recorded_sources_are_parsed() {
    let of = |keys: &str| parse(&source(keys)).unwrap().cameras.remove(0).source;
    let bag = BagConfig {
        path: Path::new("/etc/paws").join("walk"),
        images: BagImages::Found,
        imu: true,
        imu_topic: None,
        pair_within_ns: None,
    };
    let found = of("kind = \"bag\"\npath = \"walk\"");
    assert_eq!(found, SourceConfig::Bag(bag.clone()));
    let found = of(
        "kind = \"bag\"\npath = \"walk\"\nleft_topic = \"/a\"\nright_topic = \"/b\"\n\
                    imu_topic = \"/c\"\npair_within_ms = 2.5",
    );
    let expected = BagConfig {
        images: BagImages::Pair {
            left: "/a".to_owned(),
            right: "/b".to_owned(),
        },
        imu_topic: Some("/c".to_owned()),
        pair_within_ns: Some(2_500_000),
        ..bag.clone()
    };
    assert_eq!(found, SourceConfig::Bag(expected));
    let found = of("kind = \"bag\"\npath = \"walk\"\ntopic = \"/a\"\nimu = false");
    let expected = BagConfig {
        images: BagImages::SideBySide("/a".to_owned()),
        imu: false,
        ..bag
    };
    assert_eq!(found, SourceConfig::Bag(expected));
    let found =
        of("kind = \"video\"\npath = \"l.mp4\"\nright_path = \"r.mp4\"\nright_later_ms = -12.5");
    let expected = VideoConfig {
        path: Path::new("/etc/paws").join("l.mp4"),
        right_path: Some(Path::new("/etc/paws").join("r.mp4")),
        right_later_ns: -12_500_000,
        pair_within_ns: None,
    };
    assert_eq!(found, SourceConfig::Video(expected));

    let check = |keys: &str, expected: &str| check(&source(keys), expected);
    check(
        "kind = \"bag\"",
        "line 3: path is missing in [camera.source]",
    );
    check(
        "kind = \"bag\"\npath = \"walk\"\nleft_topic = \"/a\"",
        "line 6: left_topic in [camera.source] is given, expected right_topic beside it",
    );
    check(
        "kind = \"bag\"\npath = \"walk\"\nimu = false\nimu_topic = \"/a\"",
        "line 7: imu_topic in [camera.source] is given beside imu = false",
    );
    check(
        "kind = \"video\"\npath = \"a.mp4\"\nright_later_ms = 3",
        "line 6: right_later_ms in [camera.source] is given, expected right_path beside it",
    );
}

#[cfg(not(feature = "simulator"))]
#[test]
fn simulated_camera_needs_a_program_with_the_simulator() {
    check(
        &source("kind = \"sim\"\nscene = \"pavement\""),
        "kind in [camera.source] is \"sim\", but this program was built without the simulator",
    );
}
