//! All recorded data are read back: counts, times to the ns, images, IMU samples bit by bit, in
//! order and by number.

use reconstruction::input::Input;
use session_archive::time::HostTime;
use session_input::{Color, FrameSet, Image, ImuSample, ReadError, View};
use video::raw_image::{i420_to_rgb, psnr};

use session_archive::handoff::Verdict;
use session_archive::layout;
use session_archive::manifest::{Manifest, SegmentEntry, SegmentState};

use crate::session::{RecordedSession, START, Source, hand_over, index, lens, seal_only};

fn open() -> (tempfile::TempDir, RecordedSession, Input) {
    let folder = tempfile::tempdir().expect("folder");
    let recorded = hand_over(folder.path());
    let input = Input::open(folder.path()).expect("open");
    (folder, recorded, input)
}

/// PSNR over all bytes, dB.
fn decibel(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let grey = |bytes: &[u8]| {
        let width = bytes.len() as u32;
        video::RawImage::new(width, 1, video::PixelFormat::Grey8, bytes.to_vec()).expect("image")
    };
    psnr(&grey(a), &grey(b))
}

/// Left and right half of the source's pixels, by a reference implementation.
fn halves(source: &Source, color: Color) -> [Vec<u8>; 2] {
    let image = &source.image;
    let pixels = match color {
        Color::Grey => image.luma().expect("luma").to_vec(),
        Color::Rgb => i420_to_rgb(image).expect("rgb"),
    };
    let (width, channels) = (image.width as usize, color.channels());
    [0, width / 2].map(|from| {
        let mut half = Vec::new();
        for y in 0..image.height as usize {
            let row = (y * width + from) * channels;
            half.extend_from_slice(&pixels[row..row + width / 2 * channels]);
        }
        half
    })
}

fn check_view(view: &View, source: &Source, color: Color) {
    assert_eq!(
        (view.number, view.time, view.sigma_ns, view.time_unreliable),
        (
            source.number,
            source.time,
            source.sigma_ns,
            source.time_unreliable
        )
    );
    for (found, expected) in [&view.left, &view.right]
        .into_iter()
        .zip(halves(source, color))
    {
        let Image { width, height, .. } = *found;
        assert_eq!(
            (2 * width, height),
            (source.image.width, source.image.height)
        );
        assert_eq!(found.color, color);
        let quality = decibel(&found.data, &expected);
        assert!(
            quality >= 40.0,
            "{} {}: {quality:.1} dB",
            view.camera,
            view.number
        );
    }
    // This would fail if the halves, or the images of two frames, were exchanged.
    let other = decibel(&view.right.data, &halves(source, color)[0]);
    assert!(other < 30.0, "the sides differ: {other:.1} dB");
}

#[test]
fn sets_in_order_hold_what_was_recorded() {
    let (_folder, recorded, input) = open();
    let sets: Vec<FrameSet> = input
        .session()
        .sets()
        .expect("sets")
        .map(|s| s.expect("set"))
        .collect();
    assert_eq!(sets.len(), recorded.sets.len());
    assert_eq!(sets.len(), 45);
    let (mut pairs, mut alone) = (0, 0);
    for (found, expected) in sets.iter().zip(&recorded.sets) {
        assert_eq!(
            (found.number, found.time.ns()),
            (expected.number, expected.time)
        );
        for ((camera, color), view) in [("left_shoulder", Color::Grey), ("feet", Color::Rgb)]
            .into_iter()
            .zip(&found.views)
        {
            let member = expected.members.iter().find(|m| m.camera == camera);
            assert_eq!(
                view.as_ref().map(|v| v.number),
                member.map(|m| m.number),
                "{camera}"
            );
            if let Some(view) = view {
                assert_eq!(*view.camera, *camera);
                let mut sources = recorded.camera(camera).iter();
                let source = sources.find(|s| s.number == view.number).expect("source");
                check_view(view, source, color);
            }
        }
        match found.views.iter().flatten().count() {
            2 => pairs += 1,
            _ => alone += 1,
        }
    }
    assert!(pairs > 15 && alone > 15, "{pairs} pairs, {alone} alone");
}

#[test]
fn imu_samples_are_bit_equal_and_come_once() {
    let (_folder, recorded, input) = open();
    let mut expected = Vec::new();
    for batch in &recorded.imu {
        for k in 0..batch.times.len() {
            let vector = |counts: &[i32], scale: f64, si: &[f64]| {
                [0, 1, 2].map(|axis| match si.get(3 * k + axis) {
                    Some(value) => *value,
                    None => f64::from(counts[3 * k + axis]) * scale,
                })
            };
            expected.push(ImuSample {
                number: batch.first_number + k as u64,
                ticks: batch.device_ticks[k],
                time_ns: batch.times[k],
                temperature_c: None,
                time_unreliable: batch.time_unreliable,
                gyro_rad_s: vector(&batch.gyro_counts, batch.gyro_scale, &batch.gyro),
                accel_m_s2: vector(&batch.accel_counts, batch.accel_scale, &batch.accel),
            });
        }
    }
    assert_eq!(expected.len(), 500);
    assert_eq!(input.session().imu("feet/imu", ..).expect("imu"), expected);
    let batches = input.session().imu_batches("feet/imu").expect("batches");
    let batches: Vec<_> = batches.flat_map(|b| b.expect("batch")).collect();
    assert_eq!(batches, expected);

    // Between the sets, each sample once, and samples after the last set separately.
    let mut found = Vec::new();
    let mut before = HostTime::MIN;
    for set in input.session().sets().expect("sets") {
        let set = set.expect("set");
        assert_eq!(set.imu.len(), 1);
        assert!(
            set.imu[0]
                .iter()
                .all(|s| s.time_ns > before.ns() && s.time_ns <= set.time.ns())
        );
        before = set.time;
        found.extend_from_slice(&set.imu[0]);
    }
    let behind = input
        .session()
        .imu("feet/imu", HostTime(before.ns() + 1)..)
        .expect("imu");
    assert!(!behind.is_empty());
    found.extend(behind);
    assert_eq!(found, expected);
}

#[test]
fn all_frames_of_a_camera_are_returned_also_those_in_no_set() {
    let (_folder, recorded, input) = open();
    for (camera, color) in [("left_shoulder", Color::Grey), ("feet", Color::Rgb)] {
        let sources = recorded.camera(camera);
        let frames = input.session().frames(camera).expect("frames");
        assert_eq!(frames.len(), sources.len());
        for (view, source) in frames.zip(sources) {
            check_view(&view.expect("view"), source, color);
        }
    }
    let odd = input
        .session()
        .frames_where("feet", |position| position % 7 == 5)
        .expect("frames");
    let numbers: Vec<u64> = odd.map(|v| v.expect("view").number).collect();
    let expected = recorded.feet.iter().skip(5).step_by(7).map(|s| s.number);
    assert_eq!(numbers, expected.collect::<Vec<_>>());
}

#[test]
fn random_access_gives_the_same_as_the_sequence() {
    let (_folder, recorded, input) = open();
    let sets: Vec<FrameSet> = input
        .session()
        .sets()
        .expect("sets")
        .map(|s| s.expect("set"))
        .collect();
    // Back and forth, across GOPs and within them.
    for step in 0..sets.len() {
        let place = step * 17 % sets.len();
        let expected = &sets[place];
        assert_eq!(
            input.session().set(expected.number).expect("set").as_ref(),
            Some(expected)
        );
        let near = HostTime(expected.time.ns() + 3_000_000);
        assert_eq!(
            input.session().set_at(near).expect("set").as_ref(),
            Some(expected)
        );
    }
    assert_eq!(input.session().set(45).expect("no set"), None);
    let last = input
        .session()
        .set_at(HostTime::MAX)
        .expect("set")
        .map(|s| s.number);
    assert_eq!(last, Some(44));

    let feet: Vec<View> = input
        .session()
        .frames("feet")
        .expect("frames")
        .map(|v| v.expect("view"))
        .collect();
    for view in feet.iter().rev() {
        assert_eq!(
            input
                .session()
                .frame("feet", view.number)
                .expect("frame")
                .as_ref(),
            Some(view)
        );
    }
    assert!(recorded.feet.iter().all(|s| s.number != 113));
    assert_eq!(
        input.session().frame("feet", 113).expect("a lost frame"),
        None
    );
    assert!(
        matches!(input.session().frame("head", 100), Err(ReadError::NoSuch(name)) if name == "head")
    );
    assert!(matches!(
        input.session().imu("feet", ..),
        Err(ReadError::NoSuch(_))
    ));
}

#[test]
fn part_of_a_session_is_the_same_as_that_part_of_the_whole() {
    let (_folder, _recorded, input) = open();
    let sets: Vec<FrameSet> = input
        .session()
        .sets()
        .expect("sets")
        .map(|s| s.expect("set"))
        .collect();
    let (from, to) = (sets[13].time, sets[31].time);
    let part: Vec<FrameSet> = input
        .session()
        .sets_in(from..to)
        .expect("sets")
        .map(|s| s.expect("set"))
        .collect();
    assert!(part == sets[13..31]);
    assert_eq!(input.session().sets_in(to..from).expect("sets").len(), 0);
    // An iterator may be dropped at any time.
    let mut given_up = input.session().sets().expect("sets");
    assert!(given_up.next().is_some());
    drop(given_up);
}

#[test]
fn kept_frames_are_the_same_and_are_not_decoded_again() {
    let (folder, recorded, input) = open();
    let session = input.session();
    let read = || -> Vec<Vec<Result<View, ReadError>>> {
        let cameras = ["left_shoulder", "feet"].into_iter();
        let frames = cameras.map(|camera| session.frames(camera).expect("frames"));
        frames.map(Iterator::collect).collect()
    };
    let decoded = read();
    session.keep_frames_in(tempfile::tempfile().expect("a file"), 1 << 30);
    for set in session.luma_frame_sets(..).expect("sets") {
        set.frames.iter().flatten().for_each(|f| session.keep(f));
    }
    // No access unit can be read any more.
    let segment = std::fs::File::options()
        .write(true)
        .open(folder.path().join(layout::segment(0)));
    segment.expect("open").set_len(0).expect("truncate");
    let mut lost = 0;
    for (decoded, kept) in decoded.iter().flatten().zip(read().iter().flatten()) {
        match kept {
            Ok(kept) => assert_eq!(decoded.as_ref().expect("decoded"), kept),
            Err(_) => lost += 1,
        }
    }
    let frames = recorded.feet.len() + recorded.camera("left_shoulder").len();
    let members = recorded.sets.iter().map(|s| s.members.len());
    assert_eq!(lost, frames - members.sum::<usize>());
    assert!(lost > 0 && lost < frames);
}

#[test]
fn the_newest_state_of_the_rig_is_returned() {
    let (folder, _recorded, input) = open();
    assert_eq!(input.root(), folder.path().canonicalize().expect("path"));
    for eye in ["left_shoulder/left", "left_shoulder/right"] {
        assert_eq!(input.calibration(eye), Some(&lens(eye)));
    }
    assert_eq!(input.calibration("feet/left"), None);
    assert_eq!(input.transforms().len(), 1);
    assert_eq!(input.transforms()[0].child_frame_id, "feet/left");
    let versions: Vec<u32> = input.clock_maps("feet").iter().map(|m| m.version).collect();
    assert_eq!(versions, [1, 2]);
    assert!(input.clock_maps("left_shoulder").is_empty());
    assert_eq!(input.manifest().started, START);
}

/// The state is in the first segment only: the next one is empty.
#[test]
fn state_is_found_where_the_last_segments_are_empty() {
    for there in [true, false] {
        let folder = tempfile::tempdir().expect("folder");
        hand_over(folder.path());
        let path = folder.path().join(layout::MANIFEST);
        let bytes = std::fs::read(&path).expect("manifest");
        let mut manifest = Manifest::from_bytes(&bytes).expect("manifest");
        let mut files = vec![
            layout::MANIFEST.to_owned(),
            layout::INDEX.to_owned(),
            layout::rig_file("rig.toml"),
            layout::segment(0),
        ];
        for number in [1, 2] {
            manifest.segments.push(SegmentEntry {
                number,
                state: SegmentState::GivenUp,
                bytes: 0,
                start: None,
                end: None,
                messages: 0,
            });
            if there {
                files.push(layout::segment(number));
                std::fs::write(folder.path().join(layout::segment(number)), b"").expect("write");
            }
        }
        std::fs::write(&path, manifest.to_bytes()).expect("write");
        index(folder.path());
        seal_only(folder.path(), Verdict::Pass, &files);
        let input = Input::open(folder.path()).expect("open");
        let eye = "left_shoulder/left";
        assert_eq!(input.calibration(eye), Some(&lens(eye)));
        assert_eq!(input.transforms().len(), 1);
        let versions = input.clock_maps("feet").iter().map(|m| m.version);
        assert_eq!(versions.collect::<Vec<_>>(), [1, 2]);
    }
}
