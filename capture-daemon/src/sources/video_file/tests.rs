use std::path::PathBuf;

use video::file::FileFrame;
use video::{PixelFormat, RawImage};

use super::images::{Image, Times};
use super::*;

fn account(within_ns: i64) -> Account {
    Account::new(within_ns, 40, HostTime(1_000), 50, (2, 2))
}

fn image(number: u64, time_ns: i64) -> Image {
    image_of(number, time_ns, 2)
}

fn image_of(number: u64, time_ns: i64, height: u32) -> Image {
    let data = vec![number as u8; 3 * height as usize];
    let image = RawImage::new(2, height, PixelFormat::I420, data);
    Image {
        number,
        time_ns,
        image: image.expect("an image"),
    }
}

/// Output: number, arrival, and the time difference of the eyes or the reason.
fn outputs(account: &Account) -> Vec<String> {
    let outputs = |sample: &Sample| match sample {
        Sample::Frame(f) => format!("{} {} {:?}", f.number, f.host_time.0, f.eyes_apart_ns),
        Sample::Dropped(l) => format!("{} {} {}", l.number, l.host_time.0, l.detail),
        Sample::Notice(n) => n.text.clone(),
        other => panic!("{other:?}"),
    };
    account.out.iter().map(outputs).collect()
}

#[test]
fn unusable_image_is_dropped_at_its_number() {
    let mut account = account(40);
    account.bad.push_back((0, "no time"));
    account.single(image(1, 50));
    account.bad.push_back((2, "damaged"));
    account.single(image(3, 250));
    account.bad.push_back((4, "no time"));
    account.finish(false);
    assert_eq!(
        outputs(&account),
        [
            "0 1000 no time",
            "1 1000 None",
            "2 1200 damaged",
            "3 1200 None",
            "4 1200 no time"
        ]
    );
}

/// The encoder could not take it, and the recording would end with it.
#[test]
fn image_of_another_size_is_dropped_alone() {
    let mut account = account(40);
    account.single(image(0, 50));
    account.single(image_of(1, 150, 4));
    account.single(image(2, 250));
    account.finish(false);
    assert_eq!(
        outputs(&account),
        [
            "0 1000 None",
            "1 1100 it is 2x4, expected 2x2 like the first one",
            "2 1200 None"
        ]
    );
}

#[test]
fn two_files_are_paired_by_time() {
    let mut account = account(40);
    account.size = (4, 2);
    for n in 0..3 {
        let time = 50 + 100 * n as i64;
        account.push(Eye::Left, image(n, time));
        // The second right image is too late for its left one.
        let later = if n == 1 { 45 } else { -10 };
        account.push(Eye::Right, image(n, time + later));
    }
    account.finish(true);
    let found = outputs(&account);
    assert_eq!(found[0], "0 1000 Some(-10)");
    assert!(
        found[1].starts_with("1 1100 no right image was taken within"),
        "{found:?}"
    );
    assert_eq!(found[2], "2 1200 Some(-10)");
    assert!(found[3].contains("at most 0.000 ms apart"), "{found:?}");
    assert!(
        found[4].starts_with("of the right images 1 have no left one"),
        "{found:?}"
    );
}

#[test]
fn files_without_pairs_report_their_time_spans_and_a_remedy() {
    const MS: i64 = 1_000_000;
    let account = |within_ns: i64, later_ns: i64| {
        let max_ns = 40 * MS;
        let mut account = Account::new(within_ns, max_ns, HostTime(0), 0, (2, 2));
        for n in 0..5 {
            account.push(Eye::Left, image(n, n as i64 * 100 * MS));
            account.push(Eye::Right, image(n, n as i64 * 100 * MS + later_ns));
        }
        account.finish(true);
        account.never_paired()
    };
    assert_eq!(account(40 * MS, 30 * MS), None);
    let text = account(40 * MS, 45 * MS).expect("no pair");
    for part in [
        "no image of the right file was taken within 40.0 ms of one of the left file; the nearest two are 45.0 ms apart",
        "(left images: 5 at 10.00 Hz from 0.000 s to 0.400 s; right images: 5 at 10.00 Hz from 0.045 s to 0.445 s)",
        "say by right_later_ms how much later the right file began",
    ] {
        assert!(text.contains(part), "{text}");
    }
    // No larger limit is possible.
    assert!(!text.contains("pair_within_ms"), "{text}");
    let text = account(2 * MS, 30 * MS).expect("no pair");
    let more = "allow more with pair_within_ms (up to 40.0 at this rate)";
    assert!(text.contains(more), "{text}");
}

#[test]
fn unusable_right_file_pairs_with_nothing() {
    let mut account = account(40);
    account.push(Eye::Left, image(0, 50));
    account.bad_right += 1;
    account.finish(true);
    let text = account.never_paired().expect("no pair");
    assert!(text.contains("right images: none)"), "{text}");
}

#[test]
fn image_without_usable_time_keeps_its_number_and_reports_the_reason() {
    let frame = |time_ns, damaged| FileFrame {
        time_ns,
        damaged,
        image: image(0, 0).image,
    };
    let mut times = Times::new(7);
    let mut classify = |time_ns, damaged| match times.classify(frame(time_ns, damaged)) {
        Step::Image(image) => format!("{} {}", image.number, image.time_ns),
        Step::Bad(number, why) => format!("{number} {why}"),
        Step::End => "end".to_owned(),
    };
    assert_eq!(classify(Some(0), false), "0 7");
    let untimed = "the container gives no time for the image";
    assert_eq!(classify(None, false), format!("1 {untimed}"));
    let falling = "its time is not after that of the one before";
    assert_eq!(classify(Some(0), false), format!("2 {falling}"));
    assert_eq!(classify(Some(-100), false), format!("3 {falling}"));
    let damaged = "its decoder says that the image is damaged";
    assert_eq!(classify(Some(100), true), format!("4 {damaged}"));
    assert_eq!(classify(Some(100), false), "5 107");
}

#[test]
fn file_without_times_is_rejected() {
    let folder = tempfile::tempdir().expect("folder");
    // JPEG files one after another, as some cameras write them: no rate, and a time for the
    // first image only.
    let mut bytes = Vec::new();
    for grey in [40, 80, 120] {
        jpeg_encoder::Encoder::new(&mut bytes, 90)
            .encode(&[grey; 64 * 48], 64, 48, jpeg_encoder::ColorType::Luma)
            .expect("encoding");
    }
    let path = folder.path().join("walk.mjpeg");
    std::fs::write(&path, bytes).expect("a file");
    let config = VideoConfig {
        path: path.clone(),
        right_path: None,
        right_later_ns: 0,
        pair_within_ns: None,
    };
    let opened = VideoReplay::open("feet", &config, HostTime(0));
    let error = opened.err().expect("an error");
    assert!(matches!(error, VideoError::Times { .. }), "{error}");
    let text = error.to_string();
    assert!(
        text.contains("found neither a rate nor times that rise, expected a time for every image")
            && text.ends_with("walk.mjpeg"),
        "{text}"
    );

    let times = Times::new(3);
    assert_eq!(times.first_ns(Some(4), &path).expect("a time"), 7);
    let error = times.first_ns(None, &path).expect_err("no time");
    let text = error.to_string();
    assert!(
        text.contains("found a first image without a time"),
        "{text}"
    );
}

#[test]
fn digest_differs_for_other_files_or_settings() {
    let folder = tempfile::tempdir().expect("folder");
    let (left, right) = (folder.path().join("l.mp4"), folder.path().join("r.mp4"));
    std::fs::write(&left, b"left").expect("a file");
    std::fs::write(&right, b"right").expect("a file");
    let of = |right_path: Option<&PathBuf>, right_later_ns| {
        digest_of(&VideoConfig {
            path: left.clone(),
            right_path: right_path.cloned(),
            right_later_ns,
            pair_within_ns: None,
        })
    };
    let digests = || [of(None, 0), of(Some(&right), 0), of(Some(&right), 1)];
    let before = digests();
    assert_ne!(before[0], before[1]);
    assert_ne!(before[1], before[2]);
    std::fs::write(&right, b"RIGHT").expect("a file");
    let after = digests();
    assert_eq!(after[0], before[0]);
    assert_ne!(after[1], before[1]);
}

#[test]
fn non_video_file_is_rejected() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mp4");
    std::fs::write(&path, b"not a video").expect("a file");
    let open = |path: &Path| {
        let config = VideoConfig {
            path: path.to_owned(),
            right_path: None,
            right_later_ns: 0,
            pair_within_ns: None,
        };
        let opened = VideoReplay::open("feet", &config, HostTime(0));
        opened.err().expect("an error").to_string()
    };
    let error = open(&path);
    assert!(
        error.starts_with("reading a video file: ") && error.ends_with("walk.mp4"),
        "{error}"
    );
    let error = open(Path::new("/dev/null"));
    assert!(
        error.contains("found a character device, expected a regular file"),
        "{error}"
    );
    let error = open(&folder.path().join("none.mp4"));
    assert!(error.starts_with("opening a video file: "), "{error}");
}
