use super::*;

#[test]
fn nodes_that_are_no_cameras() {
    let error = Camera::open(Path::new("/dev/null")).unwrap_err();
    assert!(matches!(error, CameraError::NotACamera { .. }), "{error:?}");
    assert_eq!(
        error.to_string(),
        "this is no camera that can be used: it does not speak V4L2: /dev/null"
    );

    let folder = tempfile::tempdir().unwrap();
    let error = Camera::open(&folder.path().join("video7")).unwrap_err();
    assert!(error.is_gone(), "{error:?}");

    let file = folder.path().join("video0");
    std::fs::write(&file, "").unwrap();
    let error = Camera::open(&file).unwrap_err();
    assert!(matches!(error, CameraError::NotACamera { .. }), "{error:?}");
}

#[test]
fn refusals_of_the_system() {
    let path = Path::new("/dev/video0");
    let of = |errno| CameraError::of("setting the format", errno, path);
    assert!(of(Errno::NODEV).is_gone());
    assert!(matches!(of(Errno::BUSY), CameraError::Busy { .. }));
    let io = of(Errno::IO);
    assert_eq!(io.to_string(), "setting the format: /dev/video0");
    assert!(std::error::Error::source(&io).is_some());
}

#[test]
fn capabilities_are_those_of_the_node() {
    let mut raw = sys::Capability {
        version: 0x0006_010c,
        capabilities: sys::CAP_DEVICE_CAPS | sys::CAP_CAPTURE | sys::CAP_STREAMING,
        device_caps: sys::CAP_STREAMING,
        ..sys::Capability::default()
    };
    raw.driver[..8].copy_from_slice(b"uvcvideo");
    raw.card = [b'Z'; 32];
    let capability = Capability::of(&raw);
    assert_eq!(capability.driver, "uvcvideo");
    assert_eq!(capability.card, "Z".repeat(32));
    assert_eq!(capability.version, (6, 1, 12));
    assert!(!capability.captures && capability.streams);

    raw.capabilities &= !sys::CAP_DEVICE_CAPS;
    assert!(Capability::of(&raw).captures);
}
