// The phone's page. It requests the rig's status once a second and previews twice a second, only while the page
// is visible. It shows the last response; when responses stop, it reports that within seconds and grays out
// outdated values. Texts from the rig are only ever set as text.
"use strict";

const STATUS_INTERVAL_MS = 1000;
const PREVIEW_INTERVAL_MS = 500;
const SESSIONS_INTERVAL_MS = 20000;
const REQUEST_TIMEOUT_MS = 4000;
// The response to a stop comes after the last frames are written, within 30 s.
const ACT_LIMIT = 45000;
// Without a response for this time, ms, the shown values are outdated.
const LOST_AFTER_MS = 3500;

const $ = (id) => document.getElementById(id);
const NONE = "–";

let status = null;
let receivedAt = 0;
let refused = false;
let busy = "";
let sequences = [];
let sessionsAt = 0;
let lastState = "";
let toastTimer = 0;
let lastSpoken = "";

// ---- requests ---------------------------------------------------------------------------------------

class Refused extends Error {}

async function ask(path, { limit = REQUEST_TIMEOUT_MS, ...options } = {}) {
  const response = await fetch(path, {
    cache: "no-store",
    credentials: "same-origin",
    signal: AbortSignal.timeout(limit),
    ...options,
  });
  if (response.ok) return response;
  const body = await response.json().catch(() => ({}));
  const error = new Refused(body.error?.message ?? `the rig responds with status ${response.status}`);
  error.status = response.status;
  throw error;
}

function post(path, body) {
  return ask(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
    limit: ACT_LIMIT,
  });
}

async function askStatus() {
  try {
    status = await (await ask("/api/status")).json();
    receivedAt = performance.now();
    if (refused) closeLogin();
    show();
  } catch (error) {
    if (error.status === 401) openLogin();
    else show();
  }
}

async function askPreviews() {
  if (!status || isLost()) return;
  await Promise.all(status.cameras.map(async (_, i) => {
    try {
      const have = sequences[i] === undefined ? "" : `?have=${sequences[i]}`;
      const response = await ask(`/api/preview/${i}${have}`);
      if (response.status === 204) return markOutdated(i);
      sequences[i] = Number(response.headers.get("X-Sequence"));
      showImage(i, await response.blob());
    } catch (error) {
      if (error.status === 404) showImage(i, null);
    }
  }));
}

async function askSessions() {
  try {
    const list = await (await ask("/api/sessions")).json();
    sessionsAt = performance.now();
    showSessions(list.sessions);
  } catch { /* The status panel shows the lost connection. */ }
}

// Runs forever, never concurrently, and not while the page is hidden.
async function every(pause, work) {
  for (;;) {
    const started = performance.now();
    if (!document.hidden && !$("login").open) await work();
    const left = Math.max(50, pause - (performance.now() - started));
    await new Promise((done) => setTimeout(done, left));
  }
}

// ---- display --------------------------------------------------------------------------------------

const age = () => (performance.now() - receivedAt) / 1000;
const isLost = () => status !== null && age() * 1000 > LOST_AFTER_MS;

const WORDS = {
  idle: ["Waiting", "Not all streams deliver yet."],
  armed: ["Ready", "Start records immediately."],
  recording: ["Recording", ""],
  stopping: ["Stopping", "The last frames are being written."],
  fault: ["Fault", "Recording is not possible."],
};

function show() {
  if (status === null) {
    if (performance.now() > LOST_AFTER_MS && !refused) panel("lost", "lost", "No signal", "", "The rig does not respond. Is it on, and the phone in its network?");
    return;
  }
  const { state, alarms, session, seconds } = status;
  const [word, what] = WORDS[state] ?? [state, ""];
  const recording = state === "recording" || state === "stopping";
  const does = state === "recording" ? "stop" : "start";
  document.body.dataset.does = does;
  const time = recording ? clockTime(seconds) : "";
  if (isLost()) {
    const since = `Last response ${span(age())} ago: ${word.toLowerCase()}${time ? ` ${time}` : ""}.`;
    panel("lost", "lost", "No signal", "", since);
  } else {
    const warned = alarms.length > 0 && state !== "fault" && state !== "idle";
    let detail = what;
    if (alarms.length) detail = alarms[0];
    else if (state === "recording") detail = "All streams deliver.";
    panel(warned ? "warning" : state, warned ? "warning" : state, word, time, detail);
  }
  text($("session"), recording && session ? session : "");
  buttons(state, does);
  showAlarms(alarms);
  showPreviews();
  showTiles();
  showStreams();
  text($("encoders"), status.encoders.length ? `Encoders: ${status.encoders.join(", ")}` : "");
  if (state !== lastState) {
    lastState = state;
    sessionsAt = 0;
  }
}

function panel(state, sign, word, time, detail) {
  const body = document.body.dataset;
  if (body.state !== state) body.state = state;
  if (body.sign !== sign) body.sign = sign;
  text($("word"), word);
  text($("time"), time);
  text($("detail"), detail);
  // Announced once, not every second.
  const spoken = state === "lost" ? word : `${word}. ${detail}`;
  if (spoken !== lastSpoken) text($("spoken"), (lastSpoken = spoken));
  document.title = time ? `${word} ${time}` : word;
  const colour = getComputedStyle(document.body).getPropertyValue("--panel").trim();
  document.querySelector("meta[name=theme-color]").content = colour;
}

function buttons(state, does) {
  const main = $("main");
  const can = does === "stop" || state === "armed";
  const words = { start: "Starting…", stop: "Stopping…" };
  text(main.firstElementChild, words[busy] ?? (does === "stop" ? "Stop" : "Start"));
  main.setAttribute("aria-label", does === "stop" ? "Stop recording" : "Start recording");
  main.disabled = !can || busy !== "" || isLost();
  $("mark").disabled = state !== "recording" || busy !== "" || isLost();
  const last = state === "armed" && status.session;
  $("discard").disabled = !(state === "recording" || last) || busy !== "" || isLost();
  text($("discard"), last ? "Discard the last recording…" : "Discard the recording…");
  text($("next-title"), status.session && state === "recording" ? "This recording" : "Recording");
}

function showAlarms(alarms) {
  const section = $("alarms");
  // The first one is shown above.
  const rest = isLost() ? alarms : alarms.slice(1);
  section.hidden = rest.length === 0;
  list(section.firstElementChild, rest, (alarm) => element("li", {}, alarm));
}

function showPreviews() {
  const place = $("previews");
  if (place.childElementCount !== status.cameras.length) {
    sequences = [];
    place.replaceChildren(...status.cameras.map((camera, i) => {
      const label = element("span", { className: "label" }, plain(camera));
      const button = element("button", { type: "button", className: "preview" }, element("span", { className: "none" }, "No image"), label);
      button.setAttribute("aria-pressed", "false");
      button.setAttribute("aria-label", `${plain(camera)}: show large`);
      button.addEventListener("click", () => enlarge(i));
      return button;
    }));
  }
}

function enlarge(chosen) {
  [...$("previews").children].forEach((button, i) => {
    const large = i === chosen && button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(large));
  });
}

function showImage(i, blob) {
  const button = $("previews").children[i];
  if (!button) return;
  const shown = button.firstElementChild;
  button.classList.remove("old");
  button.dataset.since = performance.now();
  if (blob === null) {
    sequences[i] = undefined;
    if (shown.tagName === "IMG") {
      URL.revokeObjectURL(shown.src);
      shown.replaceWith(element("span", { className: "none" }, "No image"));
    }
    return;
  }
  const url = URL.createObjectURL(blob);
  if (shown.tagName === "IMG") {
    const before = shown.src;
    shown.src = url;
    URL.revokeObjectURL(before);
  } else {
    const img = element("img", { src: url, alt: "" });
    shown.replaceWith(img);
  }
}

// No newer image; after 3 s it is marked as outdated.
function markOutdated(i) {
  const button = $("previews").children[i];
  if (button && performance.now() - Number(button.dataset.since) > 3000) button.classList.add("old");
}

function showTiles() {
  const { seconds_left: left, free_bytes: free, battery, temperature_c: heat, clock } = status;
  tile("disk", left === null ? NONE : hours(left), "", free === null ? "" : `${bytes(free)} free`, left !== null && left < 1800);
  const percent = battery === null ? null : Math.round(battery.percent);
  const charge = battery === null ? "not readable" : battery.charging ? "charging" : battery.minutes_left === null ? "" : `${hours(battery.minutes_left * 60)} left`;
  tile("battery", percent === null ? NONE : String(percent), percent === null ? "" : "%", charge, percent !== null && !battery.charging && percent < 25);
  tile("heat", heat === null ? NONE : heat.toFixed(0), heat === null ? "" : "°C", heat === null ? "not readable" : heat >= 85 ? "too hot" : "", heat !== null && heat >= 85);
  if (clock === null) return tile("clock", NONE, "", "unknown", false);
  const offset = clock.offset_ns === null ? "" : nanoseconds(clock.offset_ns);
  tile("clock", clock.synchronised ? "in sync" : "no sync", "", clock.synchronised ? [clock.source, offset].filter(Boolean).join(", ") : "recording is not affected", !clock.synchronised);
}

function tile(id, value, suffix, note, bad) {
  const place = $(id);
  const shown = place.querySelector(".value");
  if (shown.dataset.value !== `${value} ${suffix}`) {
    shown.dataset.value = `${value} ${suffix}`;
    shown.replaceChildren(value, ...(suffix ? [" ", element("small", {}, suffix)] : []));
  }
  text(place.querySelector(".note"), note || "\u00a0");
  place.classList.toggle("bad", bad);
}

function showStreams() {
  list($("streams").tBodies[0], status.streams, (stream) => {
    const wrong = stream.silent ? "silent" : stream.frozen ? "frozen" : "";
    const slow = stream.nominal_hz !== null && stream.rate_hz < 0.95 * stream.nominal_hz;
    const rate = element("td", {}, rateText(stream.rate_hz), element("small", {}, stream.nominal_hz === null ? "" : ` of ${+stream.nominal_hz.toFixed(1)}`));
    const all = stream.stored + stream.missing;
    const share = stream.missing === 0 ? "" : ` ${percentText(stream.missing, all)}`;
    const missing = element("td", {}, String(stream.missing), element("small", {}, share));
    const name = element("th", { scope: "row" }, plain(stream.name), wrong ? ` – ${wrong}` : "");
    const row = element("tr", {}, name, rate, missing);
    row.classList.toggle("bad", wrong !== "" || slow || stream.missing > 0);
    return row;
  });
}

const STATES = {
  recording: "being recorded",
  closed: "",
  recovered: "recovered after a cut",
  interrupted: "cut off",
  damaged: "damaged",
};

function showSessions(sessions) {
  const place = $("sessions");
  if (sessions.length === 0) {
    place.replaceChildren(element("li", { className: "empty" }, "None yet."));
    return;
  }
  // Newest first.
  const rows = [...sessions].sort((a, b) => (b.started_ns ?? 0) - (a.started_ns ?? 0));
  place.replaceChildren(...rows.map((s) => {
    const when = s.started_ns === null ? s.name : new Date(s.started_ns / 1e6).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
    const what = [s.title, STATES[s.state] ?? s.state, s.receipt ? `also on ${s.receipt.host}` : s.state === "recording" ? "" : "only here"];
    return element("li", {},
      element("span", { className: "when" }, when),
      element("span", { className: "size" }, bytes(s.bytes)),
      element("span", { className: "where" }, what.filter(Boolean).join(" · ")));
  }));
}

// ---- actions ----------------------------------------------------------------------------------------

async function act(action, done) {
  busy = action.do;
  show();
  try {
    status = await (await post("/api/act", action)).json();
    receivedAt = performance.now();
    navigator.vibrate?.(60);
    if (done) toast(done);
  } catch (error) {
    navigator.vibrate?.([80, 60, 80]);
    if (error.status === 401) openLogin();
    else toast(error instanceof Refused ? `Not done: ${error.message}` : "Not done: the rig does not respond.", true);
  }
  busy = "";
  show();
  askSessions();
}

function toast(what, error = false) {
  const place = $("toast");
  text(place, what);
  place.classList.toggle("error", error);
  place.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => { place.hidden = true; }, error ? 8000 : 2500);
}

$("main").addEventListener("click", () => {
  if (status?.state === "recording") {
    act({ do: "stop" }, "Stopped. The recording is on the rig.");
  } else {
    act({ do: "start", name: $("name").value.trim() });
  }
});

$("mark").addEventListener("click", () => {
  const at = clockTime(status.seconds);
  act({ do: "mark", text: "" }, `Marked at ${at}.`);
});

$("discard").addEventListener("click", () => {
  const length = status.seconds > 0 ? ` of ${span(status.seconds)}` : "";
  text($("sure-what"), `The recording${length} will be deleted. It cannot be restored.`);
  $("sure").showModal();
  $("keep").focus();
});
$("keep").addEventListener("click", () => $("sure").close());
$("really").addEventListener("click", () => {
  $("sure").close();
  act({ do: "discard" }, "Discarded.");
});

// ---- login -----------------------------------------------------------------------------------

function openLogin() {
  refused = true;
  $("logout").hidden = true;
  if (!$("login").open) $("login").showModal();
  panel("unknown", "idle", "Locked", "", "The rig requires its token.");
}

function closeLogin() {
  refused = false;
  $("logout").hidden = false;
  if ($("login").open) $("login").close();
}

$("login").addEventListener("cancel", (event) => event.preventDefault());
$("login-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  try {
    await post("/api/login", { token: $("token").value });
    $("token").value = "";
    text($("login-error"), "");
    closeLogin();
    await askStatus();
    askSessions();
  } catch (error) {
    text($("login-error"), error instanceof Refused ? error.message : "The rig does not respond.");
  }
});
$("logout").addEventListener("click", async () => {
  await post("/api/logout", {}).catch(() => {});
  location.reload();
});

// ---- numbers and elements --------------------------------------------------------------------------

const two = (n) => String(n).padStart(2, "0");

// Seconds as m:ss or h:mm:ss.
function clockTime(seconds) {
  const s = Math.max(0, Math.floor(seconds));
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return h > 0 ? `${h}:${two(m)}:${two(s % 60)}` : `${m}:${two(s % 60)}`;
}

// Seconds as h:mm.
function hours(seconds) {
  const m = Math.max(0, Math.floor(seconds / 60));
  return `${Math.floor(m / 60)}:${two(m % 60)}`;
}

// Seconds as text.
function span(seconds) {
  const s = Math.round(seconds);
  if (s < 90) return `${s} s`;
  if (s < 5400) return `${Math.round(s / 60)} min`;
  return `${Math.round(s / 3600)} h`;
}

function bytes(n) {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let i = 0;
  while (n >= 999.5 && i < units.length - 1) { n /= 1000; i += 1; }
  return `${n >= 100 || i === 0 ? n.toFixed(0) : n.toFixed(1)} ${units[i]}`;
}

function nanoseconds(n) {
  const size = Math.abs(n);
  const sign = n < 0 ? "−" : "+";
  if (size < 1e3) return `${sign}${size} ns`;
  if (size < 1e6) return `${sign}${(size / 1e3).toFixed(0)} µs`;
  if (size < 1e9) return `${sign}${(size / 1e6).toFixed(0)} ms`;
  return `${sign}${(size / 1e9).toFixed(0)} s`;
}

const rateText = (hz) => (hz === null ? NONE : hz >= 99.95 ? hz.toFixed(0) : hz.toFixed(1));
const percentText = (part, whole) => {
  const p = 100 * part / Math.max(1, whole);
  return p < 0.01 ? "<0.01 %" : `${p.toFixed(p < 1 ? 2 : 1)} %`;
};
const plain = (name) => name.replaceAll("_", " ").replace(/\/imu$/, " IMU");

function text(place, what) {
  if (place.textContent !== what) place.textContent = what;
}

function element(tag, properties, ...children) {
  const created = Object.assign(document.createElement(tag), properties);
  created.append(...children);
  return created;
}

// Replaces the children only if something changed, so that a screen reader is not disturbed.
function list(place, items, make) {
  const key = JSON.stringify(items);
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  place.replaceChildren(...items.map(make));
}

// ---- timers ----------------------------------------------------------------------------------------

every(STATUS_INTERVAL_MS, askStatus);
every(PREVIEW_INTERVAL_MS, askPreviews);
every(500, async () => { show(); });
every(1000, async () => {
  const due = sessionsAt === 0 || performance.now() - sessionsAt > SESSIONS_INTERVAL_MS;
  if (status && !isLost() && due) await askSessions();
});
document.addEventListener("visibilitychange", () => {
  if (!document.hidden && !$("login").open) askStatus();
});
