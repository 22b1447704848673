//! Kills recorders at random instants and checks what they wrote.
//!
//! A recorder is a `pawsd record --json` process with two small synthetic cameras and their IMUs,
//! in real time. It is killed with SIGKILL at a random time after it began. Its progress messages
//! until then are promises; [`check`] compares the folder with them and with ground truth: every
//! image shows its number, every IMU sample is regenerated and compared, and every time follows
//! from its clock map.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, bail, ensure};
use capture_daemon::clock::{Clock as _, RealClock};
use capture_daemon::sources::synthetic::read_counter;
use capture_daemon::sources::{Sample, Source as _};
use capture_daemon::status::Progress;
use session_archive::recover::recover;
use session_archive::scan::DamageKind;
use session_archive::storage::DiskStorage;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::verify::{Report, verify};

use crate::contents::{self, Contents};
use crate::rig::Rig;

/// The recorded rig.
pub const RIG: Rig = Rig::small(2);
/// Maximum time until a recorder starts, and until data is on disk.
const START_TIMEOUT: Duration = Duration::from_secs(600);

/// Plan of kills.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Number of kills.
    pub kills: u32,
    /// Number of concurrent recorders.
    pub parallel: u32,
    /// Seed of the instants.
    pub seed: u64,
    /// Minimum and maximum time of the kill after the recorder reported its start, ms; in every
    /// fifth case after it reported data on disk.
    pub after_ms: (u64, u64),
    /// Path of the recorder program.
    pub pawsd: PathBuf,
    /// An empty working folder. Folders of failed kills are left in it.
    pub folder: PathBuf,
}

/// Result of one kill.
#[derive(Clone, Debug, PartialEq)]
pub struct KillResult {
    /// Index of the kill in the plan.
    pub number: u32,
    /// Time after the recorder reported its start, or data on disk, ms.
    pub after_ms: u64,
    /// Messages that the recorder had reported to be on disk.
    pub promised: u64,
    /// Messages found, at least the promised number.
    pub messages: u64,
    /// Frames found, every one decoded and its number read.
    pub frames: u64,
    /// IMU samples found, every one compared.
    pub imu_samples: u64,
    /// Missing samples according to gap records.
    pub missing: u64,
    /// Whether the file ended inside a record.
    pub cut_off: bool,
    /// Time from the newest sample that every stream has to the kill, ns; `None` if a stream has no
    /// samples.
    pub lost_ns: Option<i64>,
}

/// Runs the plan. `on_kill` is called after every kill, from several threads.
pub fn run(
    plan: &Plan,
    on_kill: &(impl Fn(&Result<KillResult>) + Sync),
) -> Vec<Result<KillResult>> {
    let next = AtomicU32::new(0);
    let work = || {
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= plan.kills {
                return done;
            }
            let killed =
                kill(plan, number).with_context(|| format!("kill {number} of seed {}", plan.seed));
            on_kill(&killed);
            done.push((number, killed));
        }
    };
    let mut all = Vec::new();
    thread::scope(|scope| {
        let workers: Vec<_> = (0..plan.parallel.max(1))
            .map(|_| scope.spawn(work))
            .collect();
        for worker in workers {
            match worker.join() {
                Ok(done) => all.extend(done),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
    });
    all.sort_by_key(|(number, _)| *number);
    all.into_iter().map(|(_, killed)| killed).collect()
}

/// One kill with its check.
fn kill(plan: &Plan, number: u32) -> Result<KillResult> {
    let (least, most) = plan.after_ms;
    let after_ms = least + random(plan.seed, number) % (most - least + 1);
    let folder = plan.folder.join(format!("kill-{number:04}"));
    let mut recorder = Recorder::start(&plan.pawsd, &folder)?;
    let session = recorder.wait_until_recording()?;
    if number % 5 == 4 {
        // On any machine, however slow, some kills have a promise to check.
        recorder.wait_for_durable()?;
    }
    recorder.runs_for(Duration::from_millis(after_ms))?;
    let (at, promise) = recorder.kill()?;
    let mut killed = check(&session, promise, at, false)?;
    (killed.number, killed.after_ms) = (number, after_ms);
    fs::remove_dir_all(&folder)?;
    Ok(killed)
}

/// A recording process. Dropping it kills it.
pub struct Recorder {
    child: Child,
    began: Receiver<PathBuf>,
    durable: Receiver<()>,
    /// Disconnected at the end of its output.
    ended: Receiver<()>,
    reader: Option<thread::JoinHandle<Result<Vec<Progress>>>>,
}

impl Recorder {
    /// Starts `pawsd record --json` on [`RIG`] in a folder, which is created. The folder receives
    /// the configuration, the sessions in `out/` and the recorder's messages.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(pawsd: &Path, folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder)?;
        let config = folder.join("pawsd.toml");
        fs::write(&config, RIG.toml())?;
        let mut child = Command::new(pawsd)
            .arg("record")
            .arg("--config")
            .arg(&config)
            .arg("--out")
            .arg(folder.join("out"))
            .args(["--seconds", "600", "--json"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(folder.join("messages.txt"))?)
            .spawn()
            .with_context(|| format!("starting {}", pawsd.display()))?;
        let stdout = child.stdout.take().context("no output to read")?;
        let (tell_began, began) = sync_channel(1);
        let (tell_durable, durable) = sync_channel(1);
        let (is_open, ended) = sync_channel(0);
        let reader = thread::spawn(move || {
            let output = listen(stdout, &tell_began, &tell_durable);
            drop(is_open);
            output
        });
        Ok(Self {
            child,
            began,
            durable,
            ended,
            reader: Some(reader),
        })
    }

    /// Waits until it records; returns the session's folder.
    ///
    /// # Errors
    /// It does not start.
    pub fn wait_until_recording(&self) -> Result<PathBuf> {
        self.began
            .recv_timeout(START_TIMEOUT)
            .context("waiting for the recorder to begin")
    }

    /// Waits until data is on disk.
    ///
    /// # Errors
    /// No data is written.
    pub fn wait_for_durable(&self) -> Result<()> {
        self.durable
            .recv_timeout(START_TIMEOUT)
            .context("waiting for the first chunk")
    }

    /// Watches it up to the instant of the kill. That instant is an input of the test, at random
    /// between and inside the writes of the recorder, so it belongs to no event; no result depends
    /// on how long this takes.
    fn runs_for(&self, time: Duration) -> Result<()> {
        match self.ended.recv_timeout(time) {
            Err(RecvTimeoutError::Timeout) => Ok(()),
            _ => bail!("the recorder ended before it was killed"),
        }
    }

    /// Process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for its end; returns its exit code and all progress messages.
    ///
    /// # Errors
    /// A message cannot be parsed.
    pub fn wait(mut self) -> Result<(Option<i32>, Vec<Progress>)> {
        let status = self.child.wait()?;
        Ok((status.code(), self.output()?))
    }

    /// Kills it; returns the time and the last report of data on disk.
    fn kill(&mut self) -> Result<(HostTime, Option<(HostTime, u64)>)> {
        ensure!(
            self.child.try_wait()?.is_none(),
            "the recorder ended before it was killed"
        );
        let at = RealClock.now();
        self.child.kill()?;
        self.child.wait()?;
        let mut promise = None;
        for progress in self.output()? {
            if let Progress::Durable { until, messages } = progress {
                promise = Some((until, messages));
            }
        }
        Ok((at, promise))
    }

    fn output(&mut self) -> Result<Vec<Progress>> {
        let reader = self.reader.take().context("its output was already taken")?;
        reader
            .join()
            .map_err(|_| anyhow!("reading the output of the recorder panicked"))?
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the recorder's lines to the end. The kill may truncate the last one.
fn listen(
    stdout: ChildStdout,
    began: &SyncSender<PathBuf>,
    durable: &SyncSender<()>,
) -> Result<Vec<Progress>> {
    let mut output = Vec::new();
    let mut lines = BufReader::new(stdout);
    loop {
        let mut line = Vec::new();
        lines.read_until(b'\n', &mut line)?;
        if line.last() != Some(&b'\n') {
            return Ok(output);
        }
        let progress = serde_json::from_slice(&line).with_context(|| {
            format!(
                "parsing a message of the recorder: found {:?}",
                String::from_utf8_lossy(&line)
            )
        })?;
        // The channel is full or closed: the message is not needed any more.
        match &progress {
            Progress::Started { session, .. } => drop(began.try_send(session.clone())),
            Progress::Durable { .. } => drop(durable.try_send(())),
            _ => {}
        }
        output.push(progress);
    }
}

/// Compares a session with the promise (a time and a number of messages) and with ground truth. In
/// virtual time no frame waits in front of an encoder, so every frame up to the promised time must
/// be present.
///
/// # Errors
/// A promise is broken, or data is wrong.
pub fn check(
    session: &Path,
    promise: Option<(HostTime, u64)>,
    at: HostTime,
    is_virtual: bool,
) -> Result<KillResult> {
    let reader = contents::open(session)?;
    let report = verify(&reader, |_| {})?;
    let cut_off = check_only_truncated(&report)?;
    let contents = Contents::read(session)?;
    let promised = promise.map_or(0, |(_, messages)| messages);
    let messages = contents.messages;
    ensure!(
        messages >= promised,
        "{messages} messages, promised were {promised}"
    );
    let mut killed = KillResult {
        number: 0,
        after_ms: 0,
        promised,
        messages,
        frames: 0,
        imu_samples: 0,
        missing: contents.gaps.iter().map(|gap| gap.count()).sum(),
        cut_off,
        lost_ns: Some(i64::MIN),
    };
    let mut newest = |time: Option<HostTime>| {
        killed.lost_ns = killed
            .lost_ns
            .zip(time)
            .map(|(lost, t)| lost.max(at.since(t)));
    };
    for name in RIG.names() {
        newest(
            contents.frames[*name]
                .last()
                .map(|f| HostTime(f.record.host_time)),
        );
        newest(
            contents.imu[&format!("{name}/imu")]
                .last()
                .map(|s| s.host_time),
        );
    }
    for (camera, name) in RIG.names().iter().enumerate() {
        if let Some((until, _)) = promise
            && is_virtual
        {
            check_reaches(&contents, name, until)?;
        }
        killed.frames += images_are_correct(&contents, name)?;
        killed.imu_samples += samples_are_correct(&contents, camera)?;
    }
    contents.check_times()?;
    check_recovery(session, &report)?;
    Ok(killed)
}

/// Checks that the kill caused nothing but a truncated end; returns whether it did.
fn check_only_truncated(report: &Report) -> Result<bool> {
    let mut sound = report.clone();
    let cuts = sound.damage.len();
    sound.damage.retain(|d| d.damage.kind != DamageKind::CutOff);
    sound.closed = true;
    ensure!(
        cuts <= 1 && sound.is_sound(),
        "more than a truncated end: {report:?}"
    );
    Ok(cuts == 1)
}

/// Checks that every frame up to `until` is present: numbers have no unexplained gap (verified), so
/// it suffices that the next frame would be later.
fn check_reaches(contents: &Contents, camera: &str, until: HostTime) -> Result<()> {
    let last = contents.frames[camera]
        .last()
        .with_context(|| format!("no frame of {camera}"))?;
    // An early clock map changes from frame to frame, within its sigma.
    let period = (NS_PER_S as f64 / RIG.rate_hz) as i64;
    let next = last.record.time + period + last.record.sigma_ns as i64;
    ensure!(
        next > until.0,
        "{camera} ends at {}, but everything up to {until} was promised",
        HostTime(last.record.time)
    );
    Ok(())
}

/// Checks that every image shows its number; returns the number of images.
fn images_are_correct(contents: &Contents, camera: &str) -> Result<u64> {
    let mut count = 0;
    contents.decode(camera, |frame, image| {
        count += 1;
        let shown = read_counter(image);
        ensure!(
            shown == Some(frame.number),
            "{camera}: frame {} shows {shown:?}",
            frame.number
        );
        Ok(())
    })?;
    Ok(count)
}

/// Checks ticks and values against the source; returns the number of samples.
fn samples_are_correct(contents: &Contents, camera: usize) -> Result<u64> {
    let name = RIG.names()[camera];
    let frames: BTreeMap<u64, i64> = contents.frames[name]
        .iter()
        .map(|f| (f.record.number, f.record.device_ticks))
        .collect();
    let samples = &contents.imu[&format!("{name}/imu")];
    let mut source = RIG.source(camera, HostTime(0))?;
    let frames_to = frames.keys().next_back().map_or(0, |number| number + 1);
    let samples_to = samples.last().map_or(0, |sample| sample.number + 1);
    let (mut compared, mut next_frame, mut next_sample) = (0, 0, 0);
    while next_frame < frames_to || next_sample < samples_to {
        match source.next_sample()?.context("the source ended")? {
            Sample::Frame(frame) => {
                next_frame = frame.number + 1;
                if let Some(ticks) = frames.get(&frame.number) {
                    let (number, right) = (frame.number, frame.device_ticks);
                    ensure!(
                        *ticks == right,
                        "{name}: frame {number} has tick {ticks}, not {right}"
                    );
                }
            }
            Sample::Imu(imu) => {
                next_sample = imu.number + 1;
                // IMU samples are never dropped, so their index is their number.
                let Some(stored) = samples.get(imu.number as usize) else {
                    continue;
                };
                let found = (stored.number, stored.ticks, stored.values);
                let right = (imu.number, imu.device_ticks, imu.values);
                ensure!(
                    found == right,
                    "{name}/imu: found {found:?}, expected {right:?}"
                );
                compared += 1;
            }
            other => {
                anyhow::bail!("{name}: a synthetic device delivered something else: {other:?}")
            }
        }
    }
    ensure!(
        compared == samples.len() as u64,
        "{name}/imu: more samples than the source delivers"
    );
    Ok(compared)
}

/// Recovery writes a valid copy with the same samples.
fn check_recovery(session: &Path, found: &Report) -> Result<()> {
    let copy = session.with_extension("recovered");
    fs::create_dir(&copy)?;
    let reader = contents::open(session)?;
    let recovered = recover(&reader, Arc::new(DiskStorage::new(&copy)), |_| {})?;
    let (copied, there) = (&recovered.copy.streams, &found.streams);
    ensure!(
        copied == there,
        "the recovered copy has {copied:?}, the session {there:?}"
    );
    ensure!(
        recovered.copy.is_sound(),
        "the recovered copy is not valid: {:?}",
        recovered.copy
    );
    Ok(())
}

/// SplitMix64 (Steele, Lea, Flood 2014) of a seed and a position.
fn random(seed: u64, position: u32) -> u64 {
    let mut z = seed.wrapping_add(
        u64::from(position)
            .wrapping_add(1)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15),
    );
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
