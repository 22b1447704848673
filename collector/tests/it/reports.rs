//! The HTML report: self-contained, honest, bounded.

use collector::limits::Limits;
use collector::page;
use collector::validate::{Options, validate};

use crate::support::{Session, capture};

fn html(session: &Session) -> String {
    let folder = tempfile::tempdir().unwrap();
    session.write(folder.path());
    let options = Options::default();
    let validated = capture(|console| validate(folder.path(), &options, console)).0;
    page::html(&validated.unwrap(), &Limits::default())
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
        at("What was recorded when"),
        at("encoder overload"),
        at("the &quot;stairs&quot;, up"),
        at("Time from frame to frame"),
        at("Frame period by the camera"),
        at("Distance of each frame from the time of its frame set"),
        at("Size of the compressed pictures"),
        at("Time from IMU sample to sample"),
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
fn nothing_is_fetched_from_elsewhere() {
    let page = html(&Session::good(1.0));
    for foreign in ["src=", "href=", "url(", "<script", "@import"] {
        assert!(!page.contains(foreign), "{foreign} is in the page");
    }
}

#[test]
fn strange_names_are_escaped_and_missing_streams_drawn() {
    let mut session = Session::good(1.0);
    session.spec.name = "<script>alert(1)</script>".to_owned();
    session.pictures.retain(|p| p.camera == 0);
    session.imu.clear();
    session.health.clear();
    session.clocks.clear();
    let page = html(&session);
    assert!(!page.contains("<script>"));
    assert!(page.contains("not one frame was recorded"));
}

#[test]
fn the_page_does_not_grow_with_the_session() {
    let (short, long) = (html(&Session::good(20.0)), html(&Session::good(100.0)));
    assert!(
        long.len() < 2 * short.len(),
        "{} {}",
        short.len(),
        long.len()
    );
}
