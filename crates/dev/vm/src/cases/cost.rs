//! `cost`: how often the daemon's threads wake up and what processor time they take, armed and
//! while it records.
//!
//! The kernel counts: each thread's switches and processor time are read from `/proc` at both ends
//! of a window, in real time. A *wake-up* is a voluntary switch of the thread, so one for each time
//! that it went to sleep; an involuntary switch is not counted. Wake-ups hardly depend on how busy
//! the host is. Processor time does: in User-Mode Linux it contains what the host did meanwhile,
//! and a system call costs many times what it costs elsewhere ([`Cost::call_us`]).

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};

use crate::case::{Bench, Case, Report};
use crate::guest::Guest;
use crate::image::{self, FileSystem};

/// The case.
pub(super) const CASE: Case = Case {
    name: "cost",
    shows: "the daemon's threads wake up for their samples and hardly otherwise",
    quick: false,
    on_qemu: false,
    run,
};

/// Wake-ups of all threads together while it waits for a camera, per second. Rounds of hub and
/// recorder, the state for the lights: some 25.
const MOST_WAITING: f64 = 40.0;
/// Wake-ups of the hub for an IMU's 800 samples and a camera's 30 frames, per second.
const MOST_HUB: f64 = 120.0;

/// Ticks in which `/proc` counts processor time, per second (USER_HZ, the same on every Linux that
/// this runs on).
const TICKS_PER_S: f64 = 100.0;

/// Viewers of the phone's page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Page {
    /// It is not served.
    Off,
    /// Nobody.
    Unseen,
    /// One phone: the state and three frames each half second.
    Seen,
}

/// A rig whose daemon is measured.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// In words.
    pub name: &'static str,
    /// How many; with none, the daemon waits for one that is not there.
    pub cameras: usize,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// The first camera has an IMU of 800 Hz.
    pub imu: bool,
    /// Two buttons and a light.
    pub operator: bool,
    /// The phone's page.
    pub page: Page,
}

/// The rigs of the benchmark.
pub const SETUPS: [Setup; 10] = [
    Setup::new("waits for a camera", 0),
    Setup::new("1 camera", 1),
    Setup {
        size: (1344, 376),
        ..Setup::new("1 camera, 1344x376", 1)
    },
    Setup::new("2 cameras", 2),
    Setup::new("3 cameras", 3),
    Setup::new("1 camera, IMU", 1).with_imu(),
    Setup::new("3 cameras, IMU", 3).with_imu(),
    Setup {
        operator: true,
        ..Setup::new("and buttons, light", 3).with_imu()
    },
    Setup {
        operator: true,
        page: Page::Unseen,
        ..Setup::new("and page, unseen", 3).with_imu()
    },
    Setup {
        operator: true,
        page: Page::Seen,
        ..Setup::new("and a phone looks", 3).with_imu()
    },
];

impl Setup {
    const fn new(name: &'static str, cameras: usize) -> Self {
        Self {
            name,
            cameras,
            size: (320, 96),
            imu: false,
            operator: false,
            page: Page::Off,
        }
    }

    const fn with_imu(mut self) -> Self {
        self.imu = true;
        self
    }

    fn config(&self) -> String {
        let mut text = "[session]\nout = \"/run/archive\"\npre_roll_s = 0\n\
             [disk]\nreserve_gb = 0\n\
             [encoder]\nelement = \"x264enc\"\n\
             [control]\nsocket = \"/run/paws/pawsd.sock\"\n"
            .to_owned();
        if self.operator {
            text += "[operator]\nbuttons = [\"gpio:/dev/gpiochip0:3\", \"evdev:name=vm-button,key=KEY_RECORD\"]\n\
                 lights = [\"gpio:/dev/gpiochip0:5\"]\n";
        }
        if self.page != Page::Off {
            text += "[page]\nlisten = \"127.0.0.1:8077\"\n";
        }
        let (width, height) = self.size;
        for i in 0..self.cameras.max(1) {
            // Threads are named after them, in 15 letters.
            let device = if self.cameras == 0 { 9 } else { i };
            text += &format!(
                "[[camera]]\nname = \"c{i}\"\n[camera.source]\nkind = \"v4l2\"\ndevice = \"/dev/video{device}\"\n\
                 width = {width}\nheight = {height}\nrate_hz = 30\n"
            );
            if i == 0 && self.imu {
                text += "imu = \"zed\"\nimu_rate_hz = 800\n";
            }
        }
        text
    }

    fn script(&self, window_s: u32) -> String {
        let flag = |is: bool| if is { "1" } else { "" };
        format!(
            "WINDOW_S={window_s} CAMERAS={} IMU={} OPERATOR={} PHONE={}\n{SCRIPT}",
            self.cameras,
            flag(self.imu),
            flag(self.operator),
            flag(self.page == Page::Seen),
        )
    }
}

/// The test battery of the kernel says that it is nearly empty, which would end the recording.
const SCRIPT: &str = r#"
snapshot() {
  { cat /proc/uptime; grep -H . /proc/$daemon/task/*/{comm,stat,status}; } >snapshot.txt 2>/dev/null
  mv snapshot.txt "$1"
}
window() { snapshot "$1-begin.txt"; sleep $WINDOW_S; snapshot "$1-end.txt"; }
phone() {
  local page=http://127.0.0.1:8077/api
  while sleep .5; do curl -s $page/status $page/preview/{0,1,2} >/dev/null; done
}
battery=/sys/module/test_power/parameters
[ ! -d $battery ] || { echo on >$battery/ac_online; echo charging >$battery/battery_status; echo 100 >$battery/battery_capacity; }
mkdir -p /run/archive && mount $DISK0 /run/archive || exit 9
cameras 30 || exit 8
[ -z "$IMU" ] || imu --rate 800 --frames 30 || exit 7
[ -z "$OPERATOR" ] || { gpio_chip && { vm-button end@600 >/dev/null & }; } || exit 7
# What a system call costs here: two for each byte.
{ time -p dd if=/dev/zero of=/dev/null bs=1 count=20000 status=none; } 2>calls.txt
pawsd run --config pawsd.toml 2>daemon.txt & daemon=$!
[ $CAMERAS = 0 ] && until_state idle || until_state armed || exit 6
[ -z "$PHONE" ] || phone & phone=$!
sleep 3
window armed
if [ $CAMERAS != 0 ]; then
  pawsd start >/dev/null || exit 5
  sleep 3
  window recording
  state recording || exit 4
  # On a busy host frames are dropped, which it tells by its exit.
  pawsd stop >/dev/null 2>stop.txt; until_state armed || exit 3
fi
kill $phone; kill $daemon; wait $daemon
umount /run/archive
"#;

/// What a thread, or all of one name, did per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rate {
    /// How many threads.
    pub threads: usize,
    /// Times that they woke up.
    pub wakes: f64,
    /// Times that another took the processor from them.
    pub preempted: f64,
    /// Share of a processor, %.
    pub cpu_percent: f64,
}

impl Rate {
    fn add(&mut self, other: &Self) {
        self.threads += other.threads;
        self.wakes += other.wakes;
        self.preempted += other.preempted;
        self.cpu_percent += other.cpu_percent;
    }

    fn figures(&self) -> Value {
        let round = |value: f64| (value * 100.0).round() / 100.0;
        json!({
            "threads": self.threads,
            "wakes_per_s": round(self.wakes),
            "preempted_per_s": round(self.preempted),
            "cpu_percent": round(self.cpu_percent),
        })
    }
}

/// What the daemon's threads did in a window, by what they are for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Window(pub BTreeMap<&'static str, Rate>);

impl Window {
    /// All threads together.
    pub fn total(&self) -> Rate {
        let mut total = Rate::default();
        self.0.values().for_each(|rate| total.add(rate));
        total
    }

    /// The threads of one kind; zero if there are none.
    pub fn of(&self, kind: &str) -> Rate {
        self.0.get(kind).copied().unwrap_or_default()
    }

    fn figures(&self) -> Value {
        let mut threads: BTreeMap<&str, Value> = BTreeMap::new();
        threads.extend(self.0.iter().map(|(kind, rate)| (*kind, rate.figures())));
        json!({ "all": self.total().figures(), "threads": threads })
    }
}

/// What one rig costs.
#[derive(Clone, Debug)]
pub struct Cost {
    /// The rig.
    pub setup: Setup,
    /// What a small system call costs in the guest, us.
    pub call_us: f64,
    /// Nothing is being recorded.
    pub armed: Window,
    /// None where there is nothing to record.
    pub recording: Option<Window>,
}

impl Cost {
    /// How many of the samples that the rig should have made the daemon woke up for, in the worse
    /// window: 1 for all. Much less, and the host was too busy for the guest.
    pub fn served(&self) -> f64 {
        let windows = [Some(&self.armed), self.recording.as_ref()];
        let shares = windows.into_iter().flatten().flat_map(|window| {
            let frames = 30.0 * self.setup.cameras as f64;
            let samples = if self.setup.imu { 800.0 } else { 0.0 };
            let share = |kind: &str, of: f64| (of > 0.0).then(|| window.of(kind).wakes / of);
            [share("source", frames), share("imu", samples)]
        });
        shares.flatten().fold(1.0, f64::min)
    }

    /// Everything, for programs.
    pub fn figures(&self) -> Value {
        let setup = &self.setup;
        json!({
            "name": setup.name,
            "cameras": setup.cameras,
            "size": [setup.size.0, setup.size.1],
            "imu": setup.imu,
            "operator": setup.operator,
            "page": format!("{:?}", setup.page).to_lowercase(),
            "served": (self.served() * 1000.0).round() / 1000.0,
            "system_call_us": (self.call_us * 100.0).round() / 100.0,
            "armed": self.armed.figures(),
            "recording": self.recording.as_ref().map(Window::figures),
        })
    }
}

/// Measures one rig in a guest of its own, `window_s` long in each state.
///
/// # Errors
/// The guest or its daemon fails, or the recording ends by itself.
pub fn measure(bench: &Bench, setup: Setup, window_s: u32) -> Result<Cost> {
    let job = bench.folder("job")?;
    let disk = bench.folder.join("disk.img");
    image::formatted(&disk, 512 << 20, FileSystem::Ext4)?;
    fs::write(job.join("pawsd.toml"), setup.config())?;
    let limit = Duration::from_secs(u64::from(2 * window_s) + 1800);
    Guest::new(&job, setup.script(window_s))
        .disk(&disk)
        .run(&bench.machine, limit)?
        .success()
        .with_context(|| setup.name)?;
    let read = |name: &str| {
        let path = job.join(name);
        fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))
    };
    let window = |state: &str| -> Result<Window> {
        let begin = Snapshot::parse(&read(&format!("{state}-begin.txt"))?)?;
        let end = Snapshot::parse(&read(&format!("{state}-end.txt"))?)?;
        Ok(end.since(&begin))
    };
    let recording = Path::new(&job).join("recording-end.txt").exists();
    Ok(Cost {
        setup,
        call_us: call_us(&read("calls.txt")?)?,
        armed: window("armed")?,
        recording: recording.then(|| window("recording")).transpose()?,
    })
}

fn run(bench: &Bench) -> Result<Report> {
    let window_s = if bench.quick { 5 } else { 15 };
    let waiting = measure(bench, SETUPS[0], window_s)?;
    let with_imu = Setup::new("1 camera, IMU", 1).with_imu();
    let with_imu = measure(bench, with_imu, window_s)?;
    let wakes = waiting.armed.total().wakes;
    ensure!(
        wakes < MOST_WAITING,
        "{wakes:.0} wake-ups in a second while it waits for a camera, expected fewer than {MOST_WAITING}: {:?}",
        waiting.armed
    );
    let recording = with_imu.recording.as_ref().context("nothing recorded")?;
    for window in [&with_imu.armed, recording] {
        let hub = window.of("hub").wakes;
        ensure!(
            hub < MOST_HUB,
            "the hub wakes up {hub:.0} times in a second, expected fewer than {MOST_HUB}: {window:?}"
        );
    }
    Ok(Report {
        line: format!(
            "wake-ups per second: {wakes:.0} waiting for a camera; with a camera and an IMU {:.0} armed, {:.0} recording",
            with_imu.armed.total().wakes,
            recording.total().wakes
        ),
        figures: json!([waiting.figures(), with_imu.figures()]),
    })
}

/// Calls that `dd` makes in the script.
const CALLS: f64 = 40_000.0;

/// What one call took, from what bash's `time -p` said of all.
fn call_us(text: &str) -> Result<f64> {
    let real = text.lines().find_map(|line| line.strip_prefix("real "));
    let seconds: Option<f64> = real.and_then(|word| word.trim().parse().ok());
    let seconds = seconds.with_context(|| format!("reading how long dd took: {text:?}"))?;
    Ok(seconds * 1e6 / CALLS)
}

/// What a thread is for, by its name.
fn kind(name: &str) -> &'static str {
    match name {
        "imu" => "imu",
        "hub" => "hub",
        "recorder" => "recorder",
        "panel" => "light",
        "button" => "button",
        "pawsd" => "main",
        "signals" | "printer" => "rest",
        _ if name.starts_with("source-") => "source",
        _ if name.starts_with("control") => "control",
        _ if name.starts_with("rig-link") => "page",
        // GStreamer names a thread after the pad whose data it pushes.
        _ if name.contains(':') => "encoder",
        _ => "rest",
    }
}

/// The kernel's counters of one thread.
#[derive(Clone, Debug, Default, PartialEq)]
struct Counters {
    name: String,
    wakes: u64,
    preempted: u64,
    ticks: u64,
}

/// All threads at one time.
#[derive(Debug)]
struct Snapshot {
    uptime_s: f64,
    threads: BTreeMap<u32, Counters>,
}

impl Snapshot {
    /// Reads what the script's `snapshot` wrote: the line of `/proc/uptime`, then lines of files
    /// with their paths in front.
    fn parse(text: &str) -> Result<Self> {
        let (first, rest) = text.split_once('\n').context("an empty snapshot")?;
        let uptime = first.split(' ').next().and_then(|word| word.parse().ok());
        let uptime_s = uptime.with_context(|| format!("a snapshot that begins with {first:?}"))?;
        let mut threads: BTreeMap<u32, Counters> = BTreeMap::new();
        for line in rest.lines() {
            take(line, &mut threads)
                .with_context(|| format!("a snapshot with the line {line:?}"))?;
        }
        // One that ended while it was looked at has left a part.
        threads.retain(|_, thread| !thread.name.is_empty());
        ensure!(!threads.is_empty(), "a snapshot without a thread");
        Ok(Self { uptime_s, threads })
    }

    /// What happened since; threads that ended meanwhile are left out, new ones count from their
    /// beginning.
    fn since(&self, before: &Self) -> Window {
        let seconds = self.uptime_s - before.uptime_s;
        let mut kinds: BTreeMap<&'static str, Rate> = BTreeMap::new();
        let new = Counters::default();
        for (id, now) in &self.threads {
            let then = before.threads.get(id).unwrap_or(&new);
            let per_s = |now: u64, then: u64| now.saturating_sub(then) as f64 / seconds;
            kinds.entry(kind(&now.name)).or_default().add(&Rate {
                threads: 1,
                wakes: per_s(now.wakes, then.wakes),
                preempted: per_s(now.preempted, then.preempted),
                cpu_percent: per_s(now.ticks, then.ticks) / TICKS_PER_S * 100.0,
            });
        }
        Window(kinds)
    }
}

/// Takes a line of `/proc/PID/task/TID/FILE`.
fn take(line: &str, threads: &mut BTreeMap<u32, Counters>) -> Option<()> {
    let (path, text) = line.split_once(':')?;
    let mut parts = path.split('/').skip(4);
    let thread = threads.entry(parts.next()?.parse().ok()?).or_default();
    match parts.next()? {
        "comm" => thread.name = text.to_owned(),
        "stat" => {
            // proc(5): utime and stime are fields 14 and 15, and field 2, in brackets, may hold
            // anything.
            let (_, rest) = text.rsplit_once(')')?;
            let mut fields = rest.split_whitespace().skip(11);
            thread.ticks =
                fields.next()?.parse::<u64>().ok()? + fields.next()?.parse::<u64>().ok()?;
        }
        _ => {
            if let Some(count) = text.strip_prefix("voluntary_ctxt_switches:") {
                thread.wakes = count.trim().parse().ok()?;
            } else if let Some(count) = text.strip_prefix("nonvoluntary_ctxt_switches:") {
                thread.preempted = count.trim().parse().ok()?;
            }
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thread(id: u32, name: &str, ticks: (u32, u32), switches: (u32, u32)) -> String {
        let path = format!("/proc/70/task/{id}");
        format!(
            "{path}/comm:{name}\n\
             {path}/stat:{id} ({name}) S 1 70 70 0 -1 4194368 1213 0 1 0 {} {} 0 0 20 0 16 0 300\n\
             {path}/status:Name:\t{name}\n\
             {path}/status:voluntary_ctxt_switches:\t{}\n\
             {path}/status:nonvoluntary_ctxt_switches:\t{}\n",
            ticks.0, ticks.1, switches.0, switches.1
        )
    }

    #[test]
    fn counters_become_rates_by_kind() {
        let begin = "100.00 80.00\n".to_owned()
            + &thread(70, "pawsd", (5, 5), (1000, 1))
            + &thread(71, "source-c0", (1, 1), (10, 0))
            + &thread(72, "source-c1", (1, 1), (10, 0))
            + &thread(75, "gone", (9, 9), (900, 9));
        let end = "110.00 85.00\n".to_owned()
            + &thread(70, "pawsd", (10, 20), (1050, 3))
            + &thread(71, "source-c0", (6, 6), (310, 0))
            + &thread(72, "source-c1", (1, 1), (320, 0))
            + &thread(80, "a) b:src", (1, 0), (20, 0));
        let end = Snapshot::parse(&end).expect("end");
        let window = end.since(&Snapshot::parse(&begin).expect("begin"));
        let main = Rate {
            threads: 1,
            wakes: 5.0,
            preempted: 0.2,
            cpu_percent: 2.0,
        };
        assert_eq!(window.of("main"), main);
        let sources = window.of("source");
        assert_eq!((sources.threads, sources.wakes), (2, 61.0));
        assert_eq!(window.of("encoder").wakes, 2.0, "a new one");
        assert_eq!(window.total().wakes, 68.0);
        assert_eq!(window.total().threads, 4);
    }

    #[test]
    fn a_rig_is_served_as_badly_as_its_worst_stream() {
        let rate = |wakes| Rate {
            wakes,
            ..Rate::default()
        };
        let window = |imu| Window([("source", rate(57.0)), ("imu", rate(imu))].into());
        let mut cost = Cost {
            setup: Setup::new("", 2).with_imu(),
            call_us: 1.0,
            armed: window(810.0),
            recording: None,
        };
        assert_eq!(cost.served(), 0.95);
        cost.recording = Some(window(400.0));
        assert_eq!(cost.served(), 0.5);
        cost.setup = Setup::new("", 0);
        assert_eq!(cost.served(), 1.0, "nothing to serve");
    }

    #[test]
    fn what_is_no_snapshot_is_refused() {
        let said = |text: &str| format!("{:#}", Snapshot::parse(text).expect_err("no snapshot"));
        assert_eq!(said(""), "an empty snapshot");
        assert_eq!(
            said("up\n"),
            "a snapshot that begins with \"up\"",
            "no number"
        );
        assert_eq!(said("1.0 2.0\n"), "a snapshot without a thread");
        let torn = "1.0 2.0\n/proc/1/task/1/stat:1 (x) S 1 2";
        assert_eq!(
            said(torn),
            "a snapshot with the line \"/proc/1/task/1/stat:1 (x) S 1 2\""
        );
    }

    #[test]
    fn what_dd_took_is_a_cost_of_a_call() {
        assert_eq!(
            call_us("real 0.50\nuser 0.1\nsys 0.1\n").expect("a time"),
            12.5
        );
        assert!(call_us("dd: not found").is_err());
    }
}
