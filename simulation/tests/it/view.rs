//! `paws-sim view` in a browser.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use browser::Browser;
use serde_json::json;

use crate::bundle::write;

/// Ends the program when the test does.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_page_shows_an_agent_and_drives_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = write(folder.path());
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-sim"));
    command.arg("view").arg(&scene).args(["--port", "0"]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
    let mut running = Running(child.expect("start paws-sim"));
    let output = running.0.stdout.take().expect("standard output");
    let mut url = String::new();
    BufReader::new(output)
        .read_line(&mut url)
        .expect("the address");
    browser.open(url.trim());
    let agent = "document.getElementById('agent')";
    let walked = "parseFloat(document.getElementById('note').textContent)";
    browser.until("document.getElementById('camera')?.naturalWidth === 384");
    // The agent walks to goals by itself.
    browser.until(&format!("{walked} > 0.5"));
    assert_eq!(
        browser.value(&format!("getComputedStyle({agent}).display")),
        json!("inline")
    );
    assert_eq!(
        browser.value("document.documentElement.scrollWidth <= innerWidth"),
        json!(true)
    );
    // A key takes over; without any the agent stands.
    browser.value("dispatchEvent(new KeyboardEvent('keydown', { key: 'a' })); 0");
    browser.until("document.getElementById('autopilot').getAttribute('aria-pressed') === 'false'");
    let heading = "Number(/rotate\\((.*)\\)/.exec(document.getElementById('agent').getAttribute('transform'))[1])";
    browser.value(&format!("window.before = {heading}; 0"));
    browser.until(&format!("Math.abs({heading} - before) > 5"));
    browser.value("dispatchEvent(new KeyboardEvent('keyup', { key: 'a' })); 0");
    browser.value("document.getElementById('reset').click(); 0");
    browser.until("document.getElementById('path').getAttribute('points').split(' ').length < 3");
    let start = "document.getElementById('start')";
    assert_eq!(
        browser.value(&format!("getComputedStyle({start}).display")),
        json!("inline")
    );
    // The recorded walk is played back.
    browser.value("document.getElementById('wearer').click(); 0");
    browser.until("document.getElementById('note').textContent.startsWith('the wearer at ')");
    browser.value("dispatchEvent(new KeyboardEvent('keydown', { key: 'w' })); 0");
    browser.until("document.getElementById('note').textContent.includes('m walked')");
    browser.value("dispatchEvent(new KeyboardEvent('keyup', { key: 'w' })); 0");
    // The film so far is a page of its own.
    let link = "document.querySelector('a[download]').href";
    let film = browser.value(link);
    browser.open(film.as_str().expect("an address"));
    browser.until("document.querySelector('.film-image')?.naturalWidth === 384");
    let text = browser.value("document.body.innerText").to_string();
    assert!(text.contains("An agent walked"), "{text}");
    assert_eq!(
        browser.value("document.documentElement.scrollWidth <= innerWidth"),
        json!(true)
    );
    let exceptions = browser.exceptions();
    assert!(exceptions.is_empty(), "{exceptions:?}");
}
