//! A browser without a window, for tests of pages: controlled over a pipe (Chrome DevTools
//! Protocol, messages that end with a zero byte).
//!
//! Contract: where there is no browser, [`Browser::start`] prints a line beginning with `skipped:`
//! and gives none. Everything that goes wrong afterwards panics, as tests do.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use serde_json::{Value, json};

/// How long anything may take on a machine that is busy.
const LIMIT: Duration = Duration::from_secs(300);

/// How long it may take to close.
const CLOSE_LIMIT: Duration = Duration::from_secs(5);

/// How often an element is tapped that moves between the look at its place and the tap.
const TAPS: usize = 20;

/// Draws in software what a page draws with WebGL.
const SOFTWARE: [&str; 3] = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
];

/// A page in a browser.
pub struct Browser {
    child: Child,
    to: ChildStdin,
    from: Receiver<Value>,
    session: String,
    next: u64,
    /// What the page did besides answering.
    pub events: Vec<Value>,
    _profile: tempfile::TempDir,
}

/// A browser on this machine.
fn program() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let mut places = std::env::split_paths(&path).flat_map(|p| names.map(|n| p.join(n)));
    places.find(|p| p.is_file())
}

impl Browser {
    /// A browser with an empty page of this size in CSS pixels, two device pixels each. None, and
    /// the reason printed, if there is no browser.
    pub fn start(width: u32, height: u32) -> Option<Self> {
        Self::start_with(&["--disable-gpu"], width, height)
    }

    /// The same, with WebGL in software as far as this browser has it.
    pub fn start_with_webgl(width: u32, height: u32) -> Option<Self> {
        Self::start_with(&SOFTWARE, width, height)
    }

    fn start_with(flags: &[&str], width: u32, height: u32) -> Option<Self> {
        let Some(program) = program() else {
            println!("skipped: no chromium on PATH, so the page is not looked at");
            return None;
        };
        let profile = tempfile::tempdir().unwrap();
        // It wants its pipe at 3 and 4.
        let mut child = Command::new("sh")
            .arg("-c")
            .arg("exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1")
            .arg(program)
            .args(flags)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--no-first-run",
                "--hide-scrollbars",
                "--remote-debugging-pipe",
                "about:blank",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let to = child.stdin.take().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let (sender, from) = sync_channel(10_000);
        std::thread::spawn(move || {
            let mut message = Vec::new();
            while out.read_until(0, &mut message).is_ok_and(|n| n > 0) {
                message.pop();
                if let Ok(value) = serde_json::from_slice(&message)
                    && sender.send(value).is_err()
                {
                    return;
                }
                message.clear();
            }
        });
        let mut browser = Self {
            child,
            to,
            from,
            session: String::new(),
            next: 0,
            events: Vec::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let target = target["targetId"].clone();
        let attached = browser.call(
            "Target.attachToTarget",
            json!({"targetId": target, "flatten": true}),
        );
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        for domain in [
            "Page.enable",
            "Runtime.enable",
            "Log.enable",
            "Network.enable",
        ] {
            browser.call(domain, json!({}));
        }
        browser.resize(width, height);
        Some(browser)
    }

    /// Gives the page another size, as [`Browser::start`].
    pub fn resize(&mut self, width: u32, height: u32) {
        let metrics =
            json!({"width": width, "height": height, "deviceScaleFactor": 2, "mobile": true});
        self.call("Emulation.setDeviceMetricsOverride", metrics);
    }

    /// Whether the phone prefers dark.
    pub fn dark(&mut self, dark: bool) {
        let value = if dark { "dark" } else { "light" };
        let feature = json!({"name": "prefers-color-scheme", "value": value});
        self.call("Emulation.setEmulatedMedia", json!({"features": [feature]}));
    }

    /// Sends a command and waits for its result.
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        self.try_call(method, params)
            .unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Sends a command and waits for its result; the error is that of the browser.
    fn try_call(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.next += 1;
        let id = self.next;
        let mut message = json!({"id": id, "method": method, "params": params});
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        let mut text = serde_json::to_vec(&message).unwrap();
        text.push(0);
        self.to.write_all(&text).unwrap();
        loop {
            let answer = self.from.recv_timeout(LIMIT);
            let mut answer = answer.unwrap_or_else(|e| panic!("{method}: the browser: {e}"));
            if answer["id"] == json!(id) {
                return match answer.get("error") {
                    Some(error) => Err(error.clone()),
                    None => Ok(answer["result"].take()),
                };
            }
            self.events.push(answer);
        }
    }

    /// Waits for the page's next event, and appends it to [`Self::events`].
    pub fn wait_for_event(&mut self) {
        let event = self.from.recv_timeout(LIMIT);
        let event = event.unwrap_or_else(|e| panic!("waiting for an event: the browser: {e}"));
        self.events.push(event);
    }

    /// Goes to an address.
    pub fn open(&mut self, url: &str) {
        self.call("Page.navigate", json!({"url": url}));
    }

    /// Opens a page that lies in a file, and waits until all of it is there.
    pub fn open_file(&mut self, path: &Path) {
        let path = path.canonicalize().unwrap();
        self.open(&format!("file://{}", path.to_str().unwrap()));
        self.until("document.readyState === 'complete' && location.protocol === 'file:'");
    }

    /// What failed in the page's programs so far.
    pub fn exceptions(&mut self) -> Vec<String> {
        // Events before this answer are reported before it.
        self.value("1");
        let thrown = self.events.iter();
        let thrown = thrown.filter(|event| event["method"] == "Runtime.exceptionThrown");
        thrown.map(Value::to_string).collect()
    }

    /// How much wider than the window the page is, CSS pixels; 0 where it never scrolls sideways.
    pub fn overflow(&mut self, width: u32) -> u64 {
        // Of the requested size: a page that is too wide makes a phone's window wider.
        let wide = self.value("document.documentElement.scrollWidth").as_u64();
        wide.unwrap().saturating_sub(width.into())
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let params = json!({
            "expression": expression, "returnByValue": true, "awaitPromise": true,
            "userGesture": true,
        });
        let result = self.call("Runtime.evaluate", params);
        assert!(
            result.get("exceptionDetails").is_none(),
            "{expression}: {result}"
        );
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true. The page evaluates it before each frame that it draws.
    pub fn until(&mut self, expression: &str) {
        let promise = format!(
            "new Promise((resolve, reject) => {{
                const limit = performance.now() + {};
                const look = () => {{
                    try {{
                        if (({expression}) === true) resolve('');
                        else if (performance.now() > limit) resolve(`never: ${{document.body.innerText}}`);
                        else requestAnimationFrame(look);
                    }} catch (error) {{ reject(error); }}
                }};
                look();
            }})",
            LIMIT.as_millis() / 2
        );
        let params = json!({
            "expression": promise, "returnByValue": true, "awaitPromise": true,
        });
        loop {
            match self.try_call("Runtime.evaluate", params.clone()) {
                Ok(result) => {
                    assert!(
                        result.get("exceptionDetails").is_none(),
                        "{expression}: {result}"
                    );
                    let never = result["result"]["value"].as_str();
                    assert_eq!(never, Some(""), "{expression}");
                    return;
                }
                // The page gave way to the next one, which evaluates it from the start.
                Err(error) if is_navigation(&error) => {}
                Err(error) => panic!("{expression}: {error}"),
            }
        }
    }

    /// Touches the middle of the first element that fits, as a finger would.
    pub fn tap(&mut self, selector: &str) {
        // What moves or appears would be missed.
        self.value(
            "Promise.allSettled(document.getAnimations()
                .filter((animation) => animation.effect.getComputedTiming().iterations < Infinity)
                .map((animation) => animation.finished))
                .then(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))
                .then(() => 0)",
        );
        for _ in 0..TAPS {
            let place = self.value(&format!(
                "(() => {{ const e = document.querySelector({selector:?}); \
                 e.scrollIntoView({{block: 'center'}}); window.isTapped = false; \
                 e.addEventListener('click', () => {{ window.isTapped = true; }}, \
                 {{once: true, capture: true}}); \
                 const r = e.getBoundingClientRect(); \
                 return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
            ));
            for kind in ["mousePressed", "mouseReleased"] {
                let params = json!({
                    "type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1,
                });
                self.call("Input.dispatchMouseEvent", params);
            }
            // Another page has no such variable.
            if self.value("window.isTapped ?? true") == json!(true) {
                return;
            }
        }
        panic!("{TAPS} taps missed {selector}");
    }

    /// Screenshot of the viewport as a PNG file; of the whole page if `whole`.
    pub fn screenshot(&mut self, whole: bool) -> Vec<u8> {
        let params = json!({"format": "png", "captureBeyondViewport": whole});
        let image = self.call("Page.captureScreenshot", params);
        base64(image["data"].as_str().unwrap())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.session.clear();
        // A requested close ends its child processes too.
        let _ = self
            .to
            .write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        // Its output ends with it.
        let closed = loop {
            match self.from.recv_timeout(CLOSE_LIMIT) {
                Ok(_) => {}
                Err(end) => break end == RecvTimeoutError::Disconnected,
            }
        };
        if !closed {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

/// Whether a promise was dropped because its page was left.
fn is_navigation(error: &Value) -> bool {
    let message = error["message"].as_str().unwrap_or_default();
    message.contains("context was destroyed")
        || message.contains("navigated or closed")
        || message.contains("Promise was collected")
        || message.contains("Cannot find context")
}

fn base64(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u8> = text.bytes().filter(|c| *c != b'=').map(digit).collect();
    let mut bytes = Vec::new();
    for four in digits.chunks(4) {
        let bits = four.iter().fold(0_u32, |bits, d| bits << 6 | u32::from(*d));
        let bits = bits << (6 * (4 - four.len()));
        bytes.extend(&bits.to_be_bytes()[1..four.len()]);
    }
    bytes
}
