//! The HTML report: self-contained, bounded, and with camera images.

use std::process::Command;

use browser::Browser;
use collector::commands::validate::{Options, validate};
use collector::report_page;
use session_health::Limits;

use crate::support::{Session, capture};

fn html(session: &Session) -> String {
    let folder = tempfile::tempdir().unwrap();
    session.write(folder.path());
    let options = Options::default();
    let validated = capture(|console| validate(folder.path(), &options, console)).0;
    report_page::html(&validated.unwrap(), &Limits::default())
}

#[test]
fn the_verdict_and_its_reasons_come_first() {
    let mut session = Session::good(4.0);
    session.drop_frames(2, 120, 122, true);
    let page = html(&session);
    let at = |text: &str| {
        page.find(text)
            .unwrap_or_else(|| panic!("{text:?} is not there"))
    };
    let order = [
        at("badge fail"),
        at("Not fit for use"),
        at("feet: frames missing: 5 %, limit 1 % (3 of 60 frames)"),
        at("Recorded spans and gaps"),
        at("encoder overload"),
        at("the &quot;stairs&quot;, up"),
        at("Frame interval"),
        at("Frame period by the camera"),
        at("Time offset of each frame from its frame set"),
        at("Bit rate of the compressed images"),
        at("IMU sample interval"),
        at("Device clocks against the host"),
        at("Uncertainty of the clock maps"),
        at("Waiting in the recorder"),
        at("Longest write and sync"),
        at("Free on the recorder"),
        at("Hottest sensor"),
        at("Aria Gen 2 health check"),
    ];
    assert!(order.is_sorted(), "{order:?}");
}

#[test]
fn report_loads_no_external_resources() {
    let page = html(&Session::good(1.0));
    for foreign in ["src=", "href=", "url(", "<script", "@import"] {
        assert!(!page.contains(foreign), "{foreign} is in the page");
    }
    assert_eq!(charts::inspect(&page), Ok(()));
}

#[test]
fn frames_of_every_camera_are_shown() {
    let session = Session::decodable(4.0);
    let page = html(&session);
    assert_eq!(charts::inspect(&page), Ok(()));
    let images = page.matches("src=\"data:image/jpeg;base64,/9j/").count();
    let cameras = session.spec.cameras.len();
    // Three or four each: the least sharp may be one of the others.
    assert!((3 * cameras..=4 * cameras).contains(&images), "{images}");
    let start = page.find("Camera images").expect("a section");
    for camera in &session.spec.cameras {
        let at = page[start..].find(&format!("<h3>{}</h3>", camera.name));
        let at = start + at.unwrap_or_else(|| panic!("{} is not there", camera.name));
        let part = page[at + 4..].split("<h").next().expect("a part");
        for role in ["start", "middle", "end", "least sharp"] {
            assert!(part.contains(role), "{}: no {role}", camera.name);
        }
        assert!(part.contains("frames examined."), "{}", camera.name);
    }
    assert!(page.len() < 25_000_000, "{}", page.len());
    assert!(page == html(&session), "the same session, another page");
}

#[test]
fn report_fits_a_phone_and_a_desktop() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::decodable(4.0);
    session.drop_frames(2, 120, 122, true);
    session.write(&folder.path().join("walk"));
    let output = Command::new(env!("CARGO_BIN_EXE_paws"))
        .args(["validate", "walk", "--html", "report.html"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    browser.open_file(&folder.path().join("report.html"));
    let text = browser.value("document.body.innerText").to_string();
    assert!(text.contains("Not fit for use"), "{text}");
    for width in [360, 1400] {
        browser.resize(width, 780);
        assert_eq!(browser.overflow(width), 0, "at {width}");
    }
    assert_eq!(browser.exceptions(), [""; 0]);
}

#[test]
fn camera_without_images_does_not_fail_the_report() {
    let mut session = Session::decodable(2.0);
    session.spec.cameras[0].codec = "av1".to_owned();
    session.stereo_frames.retain(|p| p.camera != 1);
    let page = html(&session);
    for why in [
        "No image can be shown: found the codec &quot;av1&quot;, expected h264 or h265.",
        "No image can be shown: no frame can be decoded.",
    ] {
        assert!(page.contains(why), "{why}");
    }
    assert!(page.contains("data:image/jpeg"), "the third camera");
    // Bytes that are not video.
    let page = html(&Session::good(2.0));
    assert!(page.contains("none of the examined frames could be decoded"));
}

#[test]
fn camera_loss_has_fraction_and_cause() {
    let mut session = Session::good(4.0);
    session.drop_frames(2, 120, 122, true);
    let page = html(&session);
    let row = page
        .lines()
        .find(|line| line.contains("Frames expected\">60<"));
    let row = row.expect("a row for the feet");
    for cell in [
        "data-head=\"Camera\">feet<",
        "data-head=\"Lost\">3<",
        "data-head=\"Share\">5 %<",
        "data-head=\"Because of\">encoder overload<",
    ] {
        assert!(row.contains(cell), "{cell}: {row}");
    }
}

#[test]
fn strange_names_are_escaped_and_missing_streams_drawn() {
    let mut session = Session::good(1.0);
    session.spec.name = "<script>alert(1)</script>".to_owned();
    session.stereo_frames.retain(|p| p.camera == 0);
    session.imu.clear();
    session.health.clear();
    session.clocks.clear();
    let page = html(&session);
    assert!(!page.contains("<script>"));
    assert!(page.contains("not one frame was recorded"));
}

#[test]
fn invalid_values_are_drawn_and_evaluated_without_a_panic() {
    let mut session = Session::good(2.0);
    for (i, batch) in session.imu.iter_mut().enumerate() {
        batch.times[3] = [i64::MIN, i64::MAX, 0][i % 3];
        batch.device_ticks[4] = [i64::MAX, i64::MIN][i % 2];
        batch.gyro_counts.truncate(40);
        batch.host_times[19] = crate::support::START + i as i64;
    }
    session.imu[19].first_number = u64::MAX - 3;
    for set in &mut session.sets {
        set.members[0].time = i64::MIN;
        for member in set.members.iter_mut().skip(1) {
            member.time = i64::MAX;
            member.camera = "nobody".to_owned();
        }
    }
    for (i, frame) in session.frames(0).enumerate() {
        frame.number = [u64::MAX, 0, u64::MAX - 1][i % 3];
        frame.sigma_ns = u64::MAX;
        frame.device_ticks = i64::MIN;
    }
    for frame in session.frames(2).take(1) {
        frame.time = i64::MAX;
    }
    session.gaps = (0..3)
        .map(|i| session_archive::record::Gap {
            stream: ["feet", "nobody", "feet/imu"][i].to_owned(),
            first: 0,
            last: u64::MAX,
            cause: 99,
            time_before: Some(i64::MIN),
            time_after: Some(i64::MAX),
            ..Default::default()
        })
        .collect();
    // A gap is written at its time, which the archive requires to be valid.
    session.gaps.iter_mut().for_each(|g| g.time_before = None);
    for (_, map) in &mut session.clocks {
        map.tick_den = 0;
        map.pieces[0].host_ref = i64::MIN;
        map.latency_sigma_ns = u64::MAX;
    }
    for (_, health) in &mut session.health {
        health.streams[0].rate_hz = f64::NAN;
        health.streams[1].queue_bytes = u64::MAX / 2;
        health.streams[2].queue_bytes = u64::MAX / 2 + 9;
        health.temperature_c = Some(f64::INFINITY);
    }
    session.spec.cameras[1].rate_hz = 1e-300;
    session.spec.cameras[2].width = 0;
    session.spec.imus[0].tick.den = 0;
    let page = html(&session);
    assert!(page.contains("badge fail"));
}

#[test]
fn report_size_does_not_grow_with_the_session() {
    let (short, long) = (html(&Session::good(20.0)), html(&Session::good(100.0)));
    assert!(
        long.len() < 2 * short.len(),
        "{} {}",
        short.len(),
        long.len()
    );
}
