//! The whole daemon on real drivers: three V4L2 cameras, an IMU behind hidraw, a GPIO button and a
//! key.
//!
//! In virtual time, where nothing depends on the machine: `devices`, `golden` and `soak`. In real
//! time on ext4: `real-time`, and `devices` under QEMU, which has no virtual time. There a host
//! that is busy with other things loses frames and IMU samples in front of the daemon, and the case
//! asks only that each is accounted for.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Value, json};

use super::config::{self, CAMERAS, IMU};
use crate::account::{Account, validate};
use crate::case::{Bench, Case, Report};
use crate::guest::Guest;
use crate::image::{self, FileSystem};

/// The short test of everything.
pub(super) const DEVICES: Case = Case {
    name: "devices",
    shows: "pawsd records 3 V4L2 cameras and a HID IMU, started and stopped by a GPIO button and by a key",
    quick: true,
    on_qemu: true,
    run: |bench| {
        let take_s = if bench.quick { 4 } else { 20 };
        let virtual_time = !bench.machine.is_slow();
        Rig::new(bench, take_s, virtual_time).show(bench)
    },
};

/// The same on a disk.
pub(super) const REAL_TIME: Case = Case {
    name: "real-time",
    shows: "the same in real time, on ext4; on a busy host samples are missing, and accounted for",
    quick: false,
    on_qemu: false,
    run: |bench| Rig::new(bench, 20, false).show(bench),
};

/// Two runs, one archive.
pub(super) const GOLDEN: Case = Case {
    name: "golden",
    shows: "in virtual time two runs of the daemon leave the same archives, byte for byte",
    quick: true,
    on_qemu: false,
    run: golden,
};

/// A long recording.
pub(super) const SOAK: Case = Case {
    name: "soak",
    shows: "300 s of virtual time, 3 cameras at 30 fps and an IMU at 800 Hz: nothing is lost",
    quick: false,
    on_qemu: false,
    run: soak,
};

/// Two cameras as one.
pub(super) const PAIR: Case = Case {
    name: "pair",
    shows: "pawsd records two V4L2 cameras as the eyes of one, paired by the kernel's stamps; each left frame is there or accounted for",
    quick: true,
    on_qemu: false,
    run: pair,
};

/// What is recorded, and how.
struct Rig {
    take_s: u32,
    /// A take by the key, after the one by the GPIO button.
    with_key: bool,
    /// Whether there is a GPIO chip.
    gpio: bool,
    /// In virtual time and into memory, or in real time and on ext4.
    virtual_time: bool,
}

/// A disk would move the clock of virtual time. Civil time and random numbers are the same in every
/// run, for they make a session's name and identifier.
const SCRIPT: &str = r#"
mkdir -p /run/archive
if [ -n "$DISK0" ]; then
  mount $DISK0 /run/archive || exit 9
else
  mount -t tmpfs -o size=${MEMORY}M tmpfs /run/archive || exit 9
  date -s 2026-01-02T03:04:05Z >/dev/null
  mount --bind /dev/zero /dev/urandom
fi
module uinput; module evdev
cameras 30 || exit 8
imu --rate 800 --frames 30
[ -z "$GPIO" ] || gpio_chip || exit 7
daemon || exit 6
if [ -n "$GPIO" ]; then
  press; until_state recording || exit 5
  sleep $TAKE_S
  press; until_state armed || exit 4
fi
if [ -n "$KEY" ]; then
  vm-button press@2 press@$((2 + TAKE_S)) end@$((6 + TAKE_S)) >button.txt & button=$!
  until_state recording || exit 3
  sleep $TAKE_S
  until_state armed || exit 2
  wait $button
fi
kill $daemon; wait $daemon
kill -INT $imu; wait $imu
mkdir sessions && cp -r /run/archive/*-* sessions/
"#;

impl Rig {
    fn new(bench: &Bench, take_s: u32, virtual_time: bool) -> Self {
        Self {
            take_s,
            with_key: true,
            gpio: bench.machine.has_gpio(),
            virtual_time,
        }
    }

    /// Records in a guest; every session is whole.
    fn record(&self, bench: &Bench, name: &str) -> Result<Vec<Account>> {
        let job = bench.folder(name)?;
        fs::write(job.join("pawsd.toml"), config::devices(self.gpio))?;
        let memory_mb = 400 + 2 * self.take_s;
        let given = |whether| if whether { "1" } else { "" };
        let script = format!(
            "TAKE_S={} MEMORY={memory_mb} GPIO={} KEY={}\n{SCRIPT}",
            self.take_s,
            given(self.gpio),
            given(self.with_key)
        );
        let mut guest = Guest::new(&job, script).memory_mb(1024 + memory_mb);
        if self.virtual_time {
            guest = guest.virtual_time();
        } else {
            let disk = bench.folder.join("disk.img");
            image::formatted(&disk, 1 << 30, FileSystem::Ext4)?;
            guest = guest.disk(disk);
        }
        let limit = Duration::from_secs(1800 + 10 * u64::from(self.take_s));
        guest.run(&bench.machine, limit)?.success()?;
        let sessions = Account::read_all(&job.join("sessions"))?;
        let expected = usize::from(self.gpio) + usize::from(self.with_key);
        ensure!(
            sessions.len() == expected,
            "{} sessions, expected {expected}",
            sessions.len()
        );
        for session in &sessions {
            self.is_whole(session)?;
        }
        validate(
            &bench.machine.host_program("paws"),
            &sessions,
            self.limits(),
        )?;
        Ok(sessions)
    }

    /// vivid's frames come by ticks of 1 ms, 33 and 34 in turn. In real time the host decides how
    /// many are missing.
    fn limits(&self) -> &'static [&'static str] {
        if self.virtual_time {
            &["camera.period_deviation=1500000,2000000"]
        } else {
            &[
                "camera.period_deviation=never,never",
                "camera.dropped=never,never",
                "camera.longest_gap=never,never",
                "imu.dropped=never,never",
                "imu.longest_gap=never,never",
                "stream.clock_sigma=never,never",
            ]
        }
    }

    /// Everything is accounted for; in virtual time it is there.
    fn is_whole(&self, session: &Account) -> Result<()> {
        session.is_accounted_for()?;
        ensure!(session.closed, "not closed: {}", session.folder.display());
        ensure!(
            !self.virtual_time || session.ties.contains_key(IMU),
            "no frame sync was recorded: {}",
            session.folder.display()
        );
        for (name, stream) in &session.streams {
            ensure!(
                !self.virtual_time || stream.gaps == 0,
                "{name}: {stream:?}: {:?}",
                session.gaps
            );
        }
        let seconds = session.stream(IMU)?.span_ns / 1_000_000_000;
        // In real time the host decides when the stop comes.
        let most = match self.virtual_time {
            true => i64::from(self.take_s) + 2,
            false => i64::MAX,
        };
        ensure!(
            (i64::from(self.take_s) - 1..=most).contains(&seconds),
            "a session of {seconds} s, expected {}",
            self.take_s
        );
        Ok(())
    }

    fn show(&self, bench: &Bench) -> Result<Report> {
        let sessions = self.record(bench, "job")?;
        let mut lines = Vec::new();
        for (i, session) in sessions.iter().enumerate() {
            let by = if self.gpio && i == 0 { "GPIO" } else { "key" };
            lines.push(format!("{by}: {}", in_words(session)?));
        }
        if !self.gpio {
            lines.push("this kernel has no gpio-sim".to_owned());
        }
        Ok(report(lines.join("; "), &sessions))
    }
}

fn report(line: String, sessions: &[Account]) -> Report {
    let sessions: Vec<Value> = sessions.iter().map(Account::figures).collect();
    Report {
        line,
        figures: json!({ "sessions": sessions }),
    }
}

/// Frames, samples and the fit of the frame sync.
fn in_words(session: &Account) -> Result<String> {
    let count = |name: &str| -> Result<String> {
        let stream = session.stream(name)?;
        Ok(match stream.gaps {
            0 => stream.samples.to_string(),
            gaps => format!("{} ({gaps} missing)", stream.samples),
        })
    };
    let frames = CAMERAS.into_iter().map(count);
    let frames = frames.collect::<Result<Vec<_>>>()?.join("+");
    let samples = count(IMU)?;
    let sync = match session.ties.get(IMU) {
        Some(tie) => format!(
            "frame sync of {} pairs, residuals {} us (median) and {} us (p99)",
            tie.pairs,
            tie.residual_median_ns / 1000,
            tie.residual_p99_ns / 1000,
        ),
        None => "no frame sync".to_owned(),
    };
    Ok(format!("{frames} frames, {samples} IMU samples, {sync}"))
}

fn golden(bench: &Bench) -> Result<Report> {
    let rig = Rig {
        with_key: !bench.quick,
        ..Rig::new(bench, if bench.quick { 4 } else { 20 }, true)
    };
    let sessions = rig.record(bench, "first")?;
    rig.record(bench, "second")?;
    let [one, other] = ["first", "second"].map(|run| bench.folder.join(run).join("sessions"));
    let (one, other) = (files(&one)?, files(&other)?);
    ensure!(
        one.keys().eq(other.keys()),
        "the runs left other files: {:?} and {:?}",
        one.keys(),
        other.keys()
    );
    for (name, bytes) in &one {
        let same = bytes.iter().zip(&other[name]).take_while(|(a, b)| a == b);
        let same = same.count();
        ensure!(
            *bytes == other[name],
            "{name} is another one from byte {same} on; the runs are in {}",
            bench.folder.display()
        );
    }
    let bytes: usize = one.values().map(Vec::len).sum();
    let line = format!("{} files, {bytes} bytes, twice the same", one.len());
    Ok(report(line, &sessions))
}

/// All files below a folder, by their path.
fn files(folder: &Path) -> Result<BTreeMap<String, Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).with_context(|| format!("reading {}", next.display()))? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(folder)?.display().to_string();
            let bytes = fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
            found.insert(name, bytes);
        }
    }
    Ok(found)
}

/// `record` ends with 3 where anything is missing.
const PAIR_SCRIPT: &str = r#"
mkdir -p /run/archive && mount -t tmpfs -o size=400M tmpfs /run/archive || exit 9
cameras 30 || exit 8
pawsd record --config pawsd.toml --seconds $TAKE_S 2>daemon.txt; code=$?
[ $code -eq 0 ] || [ $code -eq 3 ] || exit 7
mkdir sessions && cp -r /run/archive/*-* sessions/
"#;

fn pair(bench: &Bench) -> Result<Report> {
    let job = bench.folder("job")?;
    fs::write(job.join("pawsd.toml"), config::pair())?;
    let take_s: u64 = if bench.quick { 3 } else { 6 };
    let script = format!("TAKE_S={take_s}\n{PAIR_SCRIPT}");
    let guest = Guest::new(&job, script).memory_mb(1424).virtual_time();
    let limit = Duration::from_secs(1800);
    guest.run(&bench.machine, limit)?.success()?;
    let sessions = Account::read_all(&job.join("sessions"))?;
    let [session] = &sessions[..] else {
        bail!("{} sessions, expected one", sessions.len());
    };
    session.is_accounted_for()?;
    let frames = session.stream(config::CAMERAS[0])?;
    // Cameras that start together stay together in virtual time.
    ensure!(
        frames.samples >= 16 * take_s,
        "{} frames are pairs, expected most of {}: {:?}",
        frames.samples,
        30 * take_s,
        session.gaps
    );
    let line = format!("{} pairs, {} missing", frames.samples, frames.gaps);
    Ok(report(line, &sessions))
}

fn soak(bench: &Bench) -> Result<Report> {
    let rig = Rig {
        with_key: false,
        ..Rig::new(bench, if bench.quick { 30 } else { 300 }, true)
    };
    let sessions = rig.record(bench, "job")?;
    let line = in_words(&sessions[0])?;
    Ok(report(line, &sessions))
}
