//! Against the kernel's own test cameras: `vivid` with three HDMI inputs at 1280x720p30 (which
//! scale to any size), errors allowed (`vivid.no_error_inj=0`), as /dev/video0, 1 and 2. Faults are
//! produced by vivid's own controls, found by name. `cargo xtask vm-test drivers` runs them in such
//! a machine.

#![expect(
    clippy::disallowed_methods,
    reason = "real drivers keep real time; the tests measure it"
)]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use v4l2::device::ControlKind;
use v4l2::hotplug::{Change, Watch};
use v4l2::node::{self, NodeSelector};
use v4l2::stream::{Clock, Sequence, Step, TimestampSource};
use v4l2::{Camera, CameraError, FrameInfo, Interval, Mode, Next, Sizes, Stream, StreamError};

const PATIENCE: Duration = Duration::from_secs(2);

/// Whether the machine is the one that these tests are for. Elsewhere a camera may be somebody's
/// own.
fn is_vivid_here() -> bool {
    let is_here = std::env::var_os("PAWS_VIVID").is_some();
    if !is_here {
        println!("skipped: needs the kernel's test cameras; `cargo xtask vm-test drivers` runs it");
    }
    is_here
}

fn path(number: u32) -> PathBuf {
    format!("/dev/video{number}").into()
}

fn mode(width: u32, height: u32, rate_hz: u32) -> Mode {
    Mode {
        fourcc: "YUYV".parse().unwrap(),
        width,
        height,
        interval: Interval::of_rate(rate_hz),
    }
}

/// Sets a control by its name; buttons take any value.
fn set(camera: &Camera, name: &str, value: i64) {
    let controls = camera.controls().unwrap();
    let control = controls.iter().find(|c| c.name == name);
    let control = control.unwrap_or_else(|| panic!("vivid has no control {name:?}"));
    camera.set_control(control.id, value).unwrap();
}

/// The cameras are threads of the kernel: on a busy machine they come late and leave frames out,
/// which the number has to tell. It never repeats or goes back.
fn goes_on(step: Step) {
    assert!(
        matches!(step, Step::First | Step::Next | Step::Missed(_)),
        "{step:?}"
    );
}

/// Stamps at the start of exposure, as USB cameras have.
fn open(number: u32) -> Camera {
    let camera = Camera::open(&path(number)).unwrap();
    set(&camera, "Timestamp Source", 1);
    camera
}

fn frame(stream: &mut Stream) -> FrameInfo {
    match stream.next(PATIENCE).unwrap() {
        Next::Frame(buffer) => {
            assert_eq!(buffer.bytes().len(), buffer.info().bytes_used);
            *buffer.info()
        }
        Next::Nothing => panic!("no frame within {PATIENCE:?}"),
    }
}

#[test]
fn listed_and_found() {
    if !is_vivid_here() {
        return;
    }
    let nodes = node::list(Path::new("/sys"), Path::new("/dev")).unwrap();
    assert_eq!(nodes.len(), 3);
    for (i, node) in nodes.iter().enumerate() {
        assert_eq!(node.path, path(i as u32));
        assert_eq!(node.driver.as_deref(), Some("vivid"));
        assert!(matches!(node.captures, Ok(true)), "{:?}", node.captures);
        assert_eq!(node.usb, None);
    }
    let found = node::find(&nodes, &NodeSelector::Path(path(1))).unwrap();
    assert_eq!(found.card, "vivid-001-vid-cap");
}

#[test]
fn modes_of_an_input_that_scales() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    assert_eq!(camera.capability().driver, "vivid");
    let modes = camera.modes().unwrap();
    assert!(modes.len() > 20, "{} formats", modes.len());
    let yuyv = modes.iter().find(|m| m.fourcc.0 == *b"YUYV").unwrap();
    assert!(!yuyv.compressed && !yuyv.description.is_empty());
    assert!(matches!(yuyv.sizes[0].sizes, Sizes::Stepwise { .. }));
    assert_eq!(yuyv.sizes[0].intervals[0].to_string(), "30 fps");
    for (width, height) in [(2560, 720), (1344, 376)] {
        assert!(yuyv.offers(&mode(width, height, 30)));
        let format = camera.set_mode(&mode(width, height, 30)).unwrap();
        assert_eq!(format.image_bytes(), Some((width * height * 2) as usize));
        assert!(format.interval.unwrap().is_about(Interval::of_rate(30)));
    }
}

#[test]
fn what_is_not_given_is_refused() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    let refused = |mode: &Mode| match camera.set_mode(mode).unwrap_err() {
        CameraError::Refused { asked, given, .. } => (asked, given),
        other => panic!("{other:?}"),
    };
    assert_eq!(
        refused(&mode(640, 360, 60)),
        (
            "640x360 YUYV at 60 fps".into(),
            "640x360 YUYV at 30 fps".into()
        )
    );
    let (_, given) = refused(&mode(100_000, 360, 30));
    assert!(!given.contains("100000"), "{given}");
    let odd = Mode {
        fourcc: "ABCD".parse().unwrap(),
        ..mode(640, 360, 30)
    };
    let (asked, given) = refused(&odd);
    assert!(asked.contains("ABCD") && !given.contains("ABCD"), "{given}");
}

#[test]
fn three_cameras_at_once() {
    if !is_vivid_here() {
        return;
    }
    for (width, height) in [(2560, 720), (1344, 376)] {
        std::thread::scope(|scope| {
            for number in 0..3 {
                scope.spawn(move || steady(number, width, height));
            }
        });
    }
}

fn steady(number: u32, width: u32, height: u32) {
    const FRAMES: i64 = 60;
    let camera = open(number);
    camera.set_mode(&mode(width, height, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    assert_eq!(stream.buffers(), 4);
    let mut sequence = Sequence::default();
    let first = frame(&mut stream);
    assert_eq!(sequence.follow(first.sequence), Step::First);
    let (mut last, mut missed, mut steps) = (first, 0, Vec::new());
    for _ in 1..FRAMES {
        let info = frame(&mut stream);
        match sequence.follow(info.sequence) {
            Step::Next => steps.push(info.time_ns - last.time_ns),
            Step::Missed(count) => missed += i64::from(count),
            step => panic!("{step:?}"),
        }
        assert_eq!(info.clock, Clock::Monotonic);
        assert_eq!(info.stamped, TimestampSource::StartOfExposure);
        assert!(!info.corrupt && !info.short && info.time_ns > last.time_ns);
        assert_eq!(info.bytes_used, (width * height * 2) as usize);
        last = info;
    }
    steps.sort_unstable();
    let mean = (last.time_ns - first.time_ns) / (FRAMES - 1 + missed);
    println!(
        "video{number} {width}x{height}: mean {mean} ns, steps {} to {} ns, missed {missed}",
        steps[0],
        steps[steps.len() - 1]
    );
    assert!((32_000_000..35_000_000).contains(&mean), "{mean} ns");
    let median = steps[steps.len() / 2];
    assert!((30_000_000..37_000_000).contains(&median), "{median} ns");
}

#[test]
fn dropped_buffers_show_as_gaps() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    set(&camera, "Percentage of Dropped Buffers", 20);
    let mut stream = Stream::start(&camera, 4).unwrap();
    let (mut sequence, mut missed) = (Sequence::default(), 0);
    for _ in 0..150 {
        let info = frame(&mut stream);
        match sequence.follow(info.sequence) {
            Step::First | Step::Next => {}
            Step::Missed(count) => missed += count,
            step => panic!("{step:?}"),
        }
        assert!(!info.corrupt);
    }
    set(&camera, "Percentage of Dropped Buffers", 0);
    // 20 % of all, so a quarter of those that came: 37 with a sigma of 7.
    println!("missed {missed} beside 150");
    assert!((15..65).contains(&missed), "{missed}");
}

#[test]
fn damaged_buffers_are_delivered_and_say_so() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    let mut corrupt = 0;
    let mut sequence = Sequence::default();
    for i in 0..30 {
        if i % 10 == 5 {
            set(&camera, "Inject V4L2_BUF_FLAG_ERROR", 1);
        }
        let info = frame(&mut stream);
        goes_on(sequence.follow(info.sequence));
        corrupt += u32::from(info.corrupt);
    }
    assert_eq!(corrupt, 3);
}

#[test]
fn a_stream_that_failed_begins_again() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    for _ in 0..5 {
        frame(&mut stream);
    }
    set(&camera, "Inject Fatal Streaming Error", 1);
    // Immediately, and repeatedly until it is handled.
    for _ in 0..3 {
        let begun = Instant::now();
        let error = stream.next(PATIENCE).unwrap_err();
        assert!(
            matches!(error, StreamError::Interrupted { .. }),
            "{error:?}"
        );
        assert!(begun.elapsed() < Duration::from_millis(500));
    }
    stream.restart().unwrap();
    assert!(frame(&mut stream).sequence < 5);
    for _ in 0..10 {
        assert!(!frame(&mut stream).corrupt);
    }
}

#[test]
fn a_buffer_that_is_not_taken_back_is_reported() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    let Next::Frame(buffer) = stream.next(PATIENCE).unwrap() else {
        panic!("no frame");
    };
    set(&camera, "Inject VIDIOC_QBUF Error", 1);
    drop(buffer);
    let error = stream.next(PATIENCE).unwrap_err();
    assert!(
        matches!(error, StreamError::Interrupted { .. }),
        "{error:?}"
    );
    stream.restart().unwrap();
    frame(&mut stream);
}

#[test]
fn streams_that_cannot_begin_leave_nothing_behind() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    for fault in [
        "Inject VIDIOC_REQBUFS Error",
        "Inject VIDIOC_QBUF Error",
        "Inject VIDIOC_STREAMON Error",
    ] {
        set(&camera, fault, 1);
        let error = Stream::start(&camera, 4).unwrap_err();
        assert!(
            matches!(error, CameraError::Io { .. }),
            "{fault}: {error:?}"
        );
        // No buffers are left, otherwise this would be busy.
        camera.set_mode(&mode(640, 360, 30)).unwrap();
        frame(&mut Stream::start(&camera, 4).unwrap());
    }
}

#[test]
fn one_camera_goes_and_returns_while_another_goes_on() {
    if !is_vivid_here() {
        return;
    }
    let (camera, other) = (open(1), open(0));
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    other.set_mode(&mode(640, 360, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    let mut stays = Stream::start(&other, 4).unwrap();
    let mut sequence = Sequence::default();
    for _ in 0..10 {
        frame(&mut stream);
        sequence.follow(frame(&mut stays).sequence);
    }
    set(&camera, "Disconnect", 1);
    let error = (0..10).find_map(|_| stream.next(PATIENCE).err()).unwrap();
    assert!(matches!(error, StreamError::Gone { .. }), "{error:?}");
    assert!(matches!(
        stream.next(PATIENCE).unwrap_err(),
        StreamError::Gone { .. }
    ));
    assert!(camera.format().unwrap_err().is_gone());
    assert!(camera.controls().unwrap_err().is_gone());
    assert!(
        camera
            .write_and_check(&[(0x0098_0900, 1)])
            .unwrap_err()
            .is_gone()
    );
    assert!(stream.restart().unwrap_err().is_gone());
    assert!(Camera::open(&path(1)).unwrap_err().is_gone());
    for _ in 0..10 {
        goes_on(sequence.follow(frame(&mut stays).sequence));
    }
    // vivid's cameras return when no one has them open any more.
    drop(stream);
    drop(camera);
    let camera = open(1);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    frame(&mut Stream::start(&camera, 4).unwrap());
    goes_on(sequence.follow(frame(&mut stays).sequence));
}

#[test]
fn a_node_that_goes_and_comes_is_noticed() {
    if !is_vivid_here() {
        return;
    }
    let driver = Path::new("/sys/bus/platform/drivers/vivid");
    let mut watch = Watch::new(["/dev"]).unwrap();
    let camera = open(2);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    frame(&mut stream);
    // The driver releases all its cameras simultaneously; a stream of one that is disconnected says
    // so.
    std::fs::write(driver.join("unbind"), "vivid.0").unwrap();
    let error = (0..10).find_map(|_| stream.next(PATIENCE).err()).unwrap();
    assert!(matches!(error, StreamError::Gone { .. }), "{error:?}");
    let gone = watch.wait_for(PATIENCE, |c| *c == Change::Removed(path(2)));
    assert!(gone.unwrap().is_some());
    assert!(Camera::open(&path(2)).unwrap_err().is_gone());
    drop((stream, camera));

    std::fs::write(driver.join("bind"), "vivid.0").unwrap();
    let back = watch.wait_for(PATIENCE, |c| *c == Change::Appeared(path(2)));
    assert!(back.unwrap().is_some());
    // The driver begins with its default signal, which has another rate.
    for number in 0..3 {
        let set = std::process::Command::new("v4l2-ctl")
            .args(["--set-dv-bt-timings", "index=5", "-d"])
            .arg(path(number))
            .output();
        assert!(set.unwrap().status.success());
    }
    open(2).set_mode(&mode(640, 360, 30)).unwrap();
}

#[test]
fn a_second_stream_after_the_first() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    for (width, height) in [(640, 360), (1344, 376), (2560, 720), (640, 360)] {
        camera.set_mode(&mode(width, height, 30)).unwrap();
        let mut stream = Stream::start(&camera, 4).unwrap();
        frame(&mut stream);
        // While it runs it is in use: for another mode, for this handle and for another one.
        let other = Camera::open(&path(0)).unwrap();
        for error in [
            camera.set_mode(&mode(320, 240, 30)).unwrap_err(),
            Stream::start(&camera, 4).unwrap_err(),
            Stream::start(&other, 4).unwrap_err(),
        ] {
            assert!(matches!(error, CameraError::Busy { .. }), "{error:?}");
        }
        frame(&mut stream);
    }
}

#[test]
fn a_frame_that_is_held_costs_only_its_buffer() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    let mut stream = Stream::start(&camera, 4).unwrap();
    // A held buffer borrows the stream, so the time is that of the frames of another camera.
    let other = open(1);
    other.set_mode(&mode(640, 360, 30)).unwrap();
    let mut other = Stream::start(&other, 4).unwrap();
    let mut sequence = Sequence::default();
    // More often than there are buffers.
    for _ in 0..12 {
        let Next::Frame(buffer) = stream.next(PATIENCE).unwrap() else {
            panic!("no frame");
        };
        let (number, sum) = (buffer.info().sequence, checksum(buffer.bytes()));
        pass(&mut other, 2);
        assert_eq!(checksum(buffer.bytes()), sum);
        goes_on(sequence.follow(number));
    }
    // Held for longer than the others last: frames are missed, and then they come again.
    let Next::Frame(buffer) = stream.next(PATIENCE).unwrap() else {
        panic!("no frame");
    };
    let held = buffer.info().sequence;
    pass(&mut other, 20);
    drop(buffer);
    let numbers: Vec<_> = (0..8).map(|_| frame(&mut stream).sequence).collect();
    assert!(
        numbers.is_sorted() && numbers[7] > held + 10,
        "{held} {numbers:?}"
    );
}

/// Waits until a camera has produced this number of frames, including those that the driver left
/// out.
fn pass(stream: &mut Stream, frames: u32) {
    let begin = frame(stream).sequence;
    while frame(stream).sequence < begin + frames {}
}

fn checksum(bytes: &[u8]) -> u64 {
    let step = |sum: u64, b: &u8| sum.wrapping_mul(31).wrapping_add(u64::from(*b));
    bytes.iter().fold(0, step)
}

#[test]
fn waiting_ends_in_time() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    set(&camera, "Percentage of Dropped Buffers", 100);
    let mut stream = Stream::start(&camera, 4).unwrap();
    let timed = |stream: &mut Stream, limit: Duration| {
        let begun = Instant::now();
        let next = stream.next(limit).unwrap();
        assert!(matches!(next, Next::Nothing), "{next:?}");
        begun.elapsed()
    };
    assert!(timed(&mut stream, Duration::ZERO) < Duration::from_millis(100));
    let limit = Duration::from_millis(300);
    let waited = timed(&mut stream, limit);
    assert!(
        waited >= limit && waited < limit + Duration::from_millis(500),
        "{waited:?}"
    );

    set(&camera, "Percentage of Dropped Buffers", 0);
    frame(&mut stream);
}

#[test]
fn sequence_numbers_wrap() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    camera.set_mode(&mode(640, 360, 30)).unwrap();
    set(&camera, "Wrap Sequence Number", 1);
    let mut stream = Stream::start(&camera, 4).unwrap();
    let mut sequence = Sequence::default();
    let mut numbers = Vec::new();
    for _ in 0..160 {
        let number = frame(&mut stream).sequence;
        goes_on(sequence.follow(number));
        numbers.push(number);
    }
    set(&camera, "Wrap Sequence Number", 0);
    assert!(
        numbers[0] > u32::MAX - 200 && numbers[159] < 300,
        "{numbers:?}"
    );
}

#[test]
fn controls_are_written_and_read_back() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    let controls = camera.controls().unwrap();
    let by_name = |name: &str| controls.iter().find(|c| c.name == name).unwrap();
    let (brightness, contrast) = (by_name("Brightness"), by_name("Contrast"));
    assert_eq!(
        (brightness.minimum, brightness.maximum, brightness.step),
        (0, 255, 1)
    );
    assert_eq!(by_name("Integer 64 Bits").kind, ControlKind::Integer64);
    assert_eq!(by_name("Bitmask").kind, ControlKind::Bitmask);
    assert!(by_name("Test Pattern").menu.len() > 10);
    let numbers = &by_name("Integer Menu").menu;
    assert!(numbers.iter().any(|i| i.name == "42"), "{numbers:?}");

    let wide = by_name("Integer 64 Bits");
    let bits = by_name("Bitmask");
    let taken = [
        (brightness.id, 17),
        (contrast.id, 200),
        (wide.id, -5_000_000_000),
        (bits.id, 0x8000_2000),
        (by_name("Button").id, 1),
        (brightness.id, 99),
    ];
    assert_eq!(camera.write_and_check(&taken).unwrap(), []);
    assert_eq!(camera.control(brightness.id).unwrap(), 99);
    assert_eq!(camera.control(wide.id).unwrap(), -5_000_000_000);
    assert_eq!(camera.control(bits.id).unwrap(), 0x8000_2000);

    let read_only = controls
        .iter()
        .find(|c| c.read_only && c.is_readable())
        .unwrap();
    let not_taken = camera
        .write_and_check(&[
            (brightness.id, 300),
            (contrast.id, 1 << 40),
            (read_only.id, 1),
            (0x0098_09ff, 3),
        ])
        .unwrap();
    let found: Vec<_> = not_taken
        .iter()
        .map(|n| (n.id, n.found, n.why.as_deref()))
        .collect();
    println!("{not_taken:#?}");
    // Controls beyond their range are clamped by the kernel, or refused.
    assert_eq!(found[0].0, brightness.id);
    assert_eq!(found[0].1, Some(255));
    assert_eq!(found[1], (contrast.id, Some(200), Some("out of its range")));
    assert_eq!(found[2].0, read_only.id);
    assert_eq!(
        found[2].2,
        Some("read-only, or ruled by an automatic control")
    );
    assert_eq!(found[3], (0x0098_09ff, None, Some("no such control")));

    let defaults: Vec<_> = [brightness, contrast, wide, bits]
        .map(|c| (c.id, c.default))
        .into();
    assert_eq!(camera.write_and_check(&defaults).unwrap(), []);
}

#[test]
fn no_extension_units_here() {
    if !is_vivid_here() {
        return;
    }
    let camera = open(0);
    let error = camera.extension_get(4, 2).unwrap_err();
    assert!(matches!(error, CameraError::NotACamera { .. }), "{error:?}");
    let error = camera.extension_set(4, 2, &[0; 384]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "this is no camera that can be used: vivid has no control 0x02 of extension unit 0x04: /dev/video0"
    );
}
