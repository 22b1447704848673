//! The page in a browser: layout, status, buttons, and detection of a lost connection.
//! `RIG_LINK_SCREENSHOTS=FOLDER` stores screenshots.

use std::time::Duration;

use browser::Browser;
use rig_link::fake::Scene;
use rig_link::rig::Action;
use rig_link::server::{Limits, Settings, serve};
use serde_json::json;

use crate::support::{Options, Setup, TOKEN, start};

/// Opens the page with a scene, and waits for its images.
fn open(browser: &mut Browser, scene: Scene) -> Setup {
    let setup = start(Options {
        scene,
        ..Options::default()
    });
    browser.open(&setup.server.url());
    browser.until("document.readyState === 'complete' && document.querySelectorAll('#streams tbody tr').length === 6");
    let images = if matches!(scene, Scene::Fault | Scene::Idle) {
        2
    } else {
        3
    };
    browser.until(&format!(
        "document.querySelectorAll('.preview img').length === {images} && \
         [...document.querySelectorAll('.preview img')].every(i => i.complete && i.naturalWidth > 0)"
    ));
    browser.until("document.querySelectorAll('#sessions .when').length === 2");
    setup
}

/// Elements that do not fit, as text.
const MISFITS: &str = "(() => {
    const wrong = [];
    const root = document.documentElement;
    if (root.scrollWidth > innerWidth) wrong.push(`the page is ${root.scrollWidth} wide`);
    for (const e of document.querySelectorAll('body *')) {
        const r = e.getBoundingClientRect();
        if (r.width === 0 || r.height === 0 || e.closest('svg') && e.tagName !== 'svg') continue;
        const name = `${e.tagName} ${e.id} ${e.className} ${e.textContent.slice(0, 30)}`;
        if (r.left < -0.5 || r.right > innerWidth + 0.5) wrong.push(`${name} reaches from ${r.left} to ${r.right}`);
        if (['BUTTON', 'INPUT', 'A', 'SELECT'].includes(e.tagName) && (r.width < 48 || r.height < 48)) {
            wrong.push(`${name} is ${r.width} x ${r.height}`);
        }
        if (['H1', 'SPAN', 'P', 'TD', 'TH', 'SMALL'].includes(e.tagName) && e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 1 && getComputedStyle(e).textOverflow !== 'ellipsis'
            && getComputedStyle(e).display !== 'inline') wrong.push(`${name} is cut off`);
    }
    return wrong;
})()";

/// The minimum contrast of any text with its background (WCAG 2.2).
const CONTRAST: &str = "(() => {
    const numbers = (c) => (c.match(/[\\d.]+/g) ?? []).map(Number);
    const light = ([r, g, b]) => [r, g, b]
        .map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
        .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
    let least = [99, ''];
    for (const e of document.querySelectorAll('body *')) {
        const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
        if (!own || !e.checkVisibility() || e.closest('button:disabled') && !e.closest('#actions')) continue;
        let behind = e, back = [];
        while (behind) {
            back = numbers(getComputedStyle(behind).backgroundColor);
            if (back.length && back[3] !== 0) break;
            behind = behind.parentElement;
        }
        const [a, b] = [light(numbers(getComputedStyle(e).color)), light(behind ? back : [255, 255, 255])];
        const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        if (contrast < least[0]) least = [contrast, `${e.tagName} ${e.id} ${e.className} ${e.textContent}`];
    }
    return least;
})()";

#[test]
fn page_fits_a_small_phone_and_is_readable() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    for scene in Scene::ALL {
        let _setup = open(&mut browser, scene);
        for width in [320, 360, 412, 800, 1400] {
            browser.resize(width, 780);
            assert_eq!(browser.value(MISFITS), json!([]), "{scene:?} at {width}");
        }
        for dark in [false, true] {
            browser.dark(dark);
            let minimum = browser.value(CONTRAST);
            let limit = 7.0;
            assert!(
                minimum[0].as_f64().unwrap() >= limit,
                "{scene:?}, dark {dark}: {minimum}"
            );
        }
        let panel = browser.value(
            "(() => { const s = getComputedStyle(document.getElementById('panel')); return [s.color, s.backgroundColor]; })()",
        );
        assert!(panel[0] != panel[1]);
        browser.dark(false);
    }
}

#[test]
fn each_state_has_its_own_word_sign_and_color() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let mut colors = std::collections::BTreeSet::new();
    for (scene, word, main, enabled) in [
        (Scene::Idle, "WAITING", "Start", false),
        (Scene::Armed, "READY", "Start", true),
        (Scene::Recording, "RECORDING", "Stop", true),
        (Scene::Stopping, "STOPPING", "Start", false),
        (Scene::Warning, "RECORDING", "Stop", true),
        (Scene::Fault, "FAULT", "Start", false),
    ] {
        let _setup = open(&mut browser, scene);
        let body = browser.value("document.body.dataset.state");
        assert_eq!(body, json!(scene.word()));
        assert_eq!(
            browser.value("document.getElementById('word').innerText"),
            json!(word)
        );
        assert_eq!(
            browser.value("document.getElementById('main').innerText.trim()"),
            json!(main)
        );
        assert_eq!(
            browser.value("!document.getElementById('main').disabled"),
            json!(enabled)
        );
        let signs = browser.value(
            "[...document.querySelectorAll('.sign > *')].filter(e => getComputedStyle(e).display !== 'none').length",
        );
        assert_eq!(signs, json!(1));
        let color =
            browser.value("getComputedStyle(document.getElementById('panel')).backgroundColor");
        assert!(
            colors.insert(color.to_string()),
            "{scene:?} looks like another"
        );
        let text = browser.value("document.body.innerText").to_string();
        if scene == Scene::Warning {
            for part in [
                "disk: 21 minutes left",
                "143 frames dropped",
                "86 °C",
                "0:20",
                "h:mm",
                "18 %",
                "45:1",
                "27.4 of 30",
            ] {
                assert!(text.contains(part), "{part} is not in {text}");
            }
            // Of the camera that lost frames also the fraction; it falls while the recording
            // continues.
            let missing = browser.value(
                "[...document.querySelectorAll('#streams tbody tr')].map(r => r.lastElementChild.textContent)",
            );
            let of_right = missing[1].as_str().unwrap();
            assert!(
                of_right.starts_with("143 0.") && of_right.ends_with(" %"),
                "{missing}"
            );
            assert_eq!(missing[0], "0");
        }
        if scene == Scene::Fault {
            for part in ["camera is disconnected", "silent", "No image", "no sync"] {
                assert!(text.contains(part), "{part} is not in {text}");
            }
        }
    }
}

#[test]
fn buttons_trigger_their_actions() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let setup = open(&mut browser, Scene::Armed);
    browser.value("document.getElementById('name').value = ' stairs '");
    browser.tap("#main");
    browser.until("document.body.dataset.state === 'recording'");
    browser.tap("#mark");
    browser.until("!document.getElementById('toast').hidden && document.getElementById('toast').innerText.startsWith('Marked at')");
    // Discarding needs a confirmation, and the focused button keeps the recording.
    browser.until("!document.getElementById('discard').disabled");
    browser.tap("#discard");
    browser.until("document.getElementById('sure').open");
    assert_eq!(browser.value(MISFITS), json!([]));
    assert_eq!(browser.value("document.activeElement.id"), json!("keep"));
    browser.tap("#keep");
    browser.until("!document.getElementById('sure').open");
    browser.tap("#main");
    browser.until("document.body.dataset.state === 'armed'");
    let mark = Action::Mark {
        text: String::new(),
    };
    let start = Action::Start {
        name: "stairs".to_owned(),
    };
    assert_eq!(setup.rig.actions(), [start, mark, Action::Stop]);
    browser.until("document.getElementById('discard').innerText.includes('last') && !document.getElementById('discard').disabled");
    browser.tap("#discard");
    browser.until("document.getElementById('sure').open");
    browser.tap("#really");
    browser.until("document.getElementById('toast').innerText === 'Discarded.'");
    assert_eq!(setup.rig.actions().last(), Some(&Action::Discard));
    // Rejections by the rig are shown.
    setup.rig.refuse(Some("the disk is full"));
    browser.tap("#main");
    browser.until("document.getElementById('toast').innerText === 'Not done: the disk is full'");
    // A tap enlarges an image, another one restores it.
    browser.tap(".preview:nth-child(3)");
    browser.until("document.querySelector('.preview:nth-child(3)').offsetWidth > 300");
    browser.tap(".preview:nth-child(3)");
    browser.until("document.querySelector('.preview:nth-child(3)').offsetWidth < 120");
}

#[test]
fn page_reports_a_lost_rig_and_its_return() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let Setup { server, rig, .. } = open(&mut browser, Scene::Recording);
    let bind = server.address();
    drop(server);
    browser.until("document.body.dataset.state === 'lost'");
    assert_eq!(
        browser.value("document.getElementById('word').innerText"),
        json!("NO SIGNAL")
    );
    let detail = browser
        .value("document.getElementById('detail').innerText")
        .to_string();
    assert!(detail.contains("ago: recording 12:"), "{detail}");
    assert_eq!(
        browser.value("document.getElementById('main').disabled"),
        json!(true)
    );
    assert_eq!(
        browser.value("getComputedStyle(document.querySelector('main')).filter"),
        json!("grayscale(1)")
    );
    assert_eq!(browser.value(MISFITS), json!([]));
    image(&mut browser, "lost");
    let settings = Settings {
        bind,
        ..Settings::default()
    };
    let _server = serve(settings, rig).unwrap();
    browser.until("document.body.dataset.state === 'recording'");
    assert_eq!(
        browser.value("document.getElementById('main').disabled"),
        json!(false)
    );
}

#[test]
fn page_requests_the_token() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let setup = start(Options {
        token: true,
        limits: Limits {
            wrong_token_pause: Duration::from_secs(3600),
            ..Limits::default()
        },
        ..Options::default()
    });
    browser.open(&setup.server.url());
    browser.until(
        "document.readyState === 'complete' && document.getElementById('login')?.open === true",
    );
    assert_eq!(browser.value(MISFITS), json!([]));
    let enter = |browser: &mut Browser, token: &str| {
        // By a script: the status moves the dialog while it is open, and a tap could miss.
        browser.value(&format!(
            "document.getElementById('token').value = {token:?}; \
             document.getElementById('login-form').requestSubmit()"
        ));
    };
    enter(&mut browser, "wrong-wrong-wrong-wrong");
    browser.until("document.getElementById('login-error').innerText === 'the token is wrong'");
    image(&mut browser, "login");
    enter(&mut browser, TOKEN);
    browser
        .until("document.getElementById('login-error').innerText.startsWith('too many requests')");
    // A restarted rig has forgotten the failed attempts.
    let again = setup.again();
    let url = again.url();
    browser.open(&url);
    browser.until(&format!(
        "location.origin === {url:?} && document.readyState === 'complete' && \
         document.getElementById('login')?.open === true"
    ));
    enter(&mut browser, TOKEN);
    browser
        .until("document.body.dataset.state === 'armed' && !document.getElementById('login').open");
    // Scripts cannot see the cookie.
    assert_eq!(browser.value("document.cookie"), json!(""));
    browser.tap("#logout");
    browser.until("document.getElementById('login')?.open === true");
}

/// Hides the page. Timers that it starts from then on end without a pause; `rounds` counts them.
/// `hidden` is true as soon as each of its four loops waits for such a timer, so that none has
/// requests left from before.
const HIDE: &str = "
    var pause = setTimeout, waiting = 0, rounds = 0, hidden = false;
    Object.defineProperty(document, 'hidden', { get: () => true, configurable: true });
    setTimeout = (done) => {
        waiting += 1;
        hidden ||= waiting === 4;
        return pause(() => { waiting -= 1; rounds += 1; done(); }, 0);
    };
    0";

#[test]
fn page_is_self_contained_and_idle_when_hidden() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let setup = open(&mut browser, Scene::Warning);
    // Two rounds of previews.
    let is_preview = |event: &&serde_json::Value| {
        let url = event["params"]["request"]["url"].as_str();
        event["method"] == "Network.requestWillBeSent"
            && url.is_some_and(|url| url.contains("/api/preview/"))
    };
    while browser.events.iter().filter(is_preview).count() < 6 {
        // The page's other requests are events too.
        assert!(browser.events.len() < 5000, "no further images");
        browser.wait_for_event();
    }
    let own = format!("{}/", setup.server.url());
    let blobs = format!("blob:{}", setup.server.url());
    for event in &browser.events {
        let text = event.to_string();
        match event["method"].as_str() {
            Some("Network.requestWillBeSent") => {
                let url = event["params"]["request"]["url"].as_str().unwrap();
                assert!(
                    url.starts_with(&own) || url.starts_with(&blobs) || url == "about:blank",
                    "{url}"
                );
            }
            Some("Log.entryAdded" | "Runtime.exceptionThrown") => panic!("{text}"),
            Some("Runtime.consoleAPICalled") => panic!("{text}"),
            _ => {}
        }
    }

    browser.value(HIDE);
    browser.until("hidden");
    browser.value("rounds = 0");
    browser.events.clear();
    browser.until("rounds >= 200");
    let is_request = |e: &&serde_json::Value| e["method"] == "Network.requestWillBeSent";
    assert_eq!(browser.events.iter().filter(is_request).count(), 0);
    browser.value("delete document.hidden; setTimeout = pause; 0");
    browser.until("document.body.dataset.state === 'warning'");
}

#[test]
fn page_screenshots() {
    if std::env::var_os("RIG_LINK_SCREENSHOTS").is_none() {
        println!("skipped: RIG_LINK_SCREENSHOTS names no folder");
        return;
    }
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    for scene in Scene::ALL {
        let _setup = open(&mut browser, scene);
        image(&mut browser, scene.word());
        browser.dark(true);
        image(&mut browser, &format!("{}-dark", scene.word()));
        browser.dark(false);
        browser.resize(360, 1700);
        image(&mut browser, &format!("{}-whole", scene.word()));
        browser.resize(1400, 900);
        image(&mut browser, &format!("{}-desktop", scene.word()));
        browser.resize(360, 780);
    }
}

/// Stores a screenshot of the visible part.
fn image(browser: &mut Browser, name: &str) {
    if let Some(folder) = std::env::var_os("RIG_LINK_SCREENSHOTS") {
        // All transitions have ended, and what they ended with is drawn.
        browser.value(
            "Promise.allSettled(document.getAnimations()
                .filter((animation) => animation.effect.getComputedTiming().iterations < Infinity)
                .map((animation) => animation.finished))
                .then(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))
                .then(() => 0)",
        );
        let path = std::path::Path::new(&folder).join(format!("phone-{name}.png"));
        std::fs::write(path, browser.screenshot(false)).unwrap();
    }
}
