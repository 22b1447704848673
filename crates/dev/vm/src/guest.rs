//! One virtual machine that runs one script and ends.
//!
//! The guest sees the host's whole file system read-only under an overlay in its memory, so
//! programs built on the host run in it as they are. It shares one folder with the host for
//! writing, the job's folder (`/run/job` in the guest): what the script leaves there is the result.
//! Lines that the script prints reach the host as they are printed.
//!
//! Contract: nothing outlives a guest. *At the end* of its script it powers itself off; *late*,
//! when a limit has passed, and when it is dropped, it is killed with all processes that belong to
//! it. A kill is also how the power is cut: what the guest's kernel still held in its page cache is
//! lost, what it had handed to the disk is in the image. *On failure* of the script its exit code
//! is in [`GuestResult`]; a guest that ends without one is an error that carries its last lines.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use rustix::process::{Pid, Signal, kill_process_group};

use crate::leftovers;
use crate::machine::Machine;

/// Lines that may wait for the host.
const WAITING_LINES: usize = 4096;
/// File in the job's folder with what the machine itself says.
const MESSAGES: &str = "machine.txt";
/// Last lines that an error carries.
const LAST_LINES: usize = 15;

/// A guest to be started.
#[derive(Clone, Debug)]
pub struct Guest {
    job: PathBuf,
    script: String,
    disks: Vec<PathBuf>,
    virtual_time: bool,
    error_injection: bool,
    memory_mb: u32,
}

impl Guest {
    /// A guest that runs `script` (bash). The folder `job` is made, and is the script's working
    /// folder.
    pub fn new(job: impl Into<PathBuf>, script: impl Into<String>) -> Self {
        Self {
            job: job.into(),
            script: script.into(),
            disks: Vec::new(),
            virtual_time: false,
            error_injection: false,
            memory_mb: 1024,
        }
    }

    /// Gives it an image as its next disk: `$DISK0`, `$DISK1`, ...
    #[must_use]
    pub fn disk(mut self, image: impl Into<PathBuf>) -> Self {
        self.disks.push(image.into());
        self
    }

    /// Sleeping costs no time and computing takes none, so that what the guest does is the same in
    /// every run. Input and output of disks move the clock: record into the job's folder. Only
    /// User-Mode Linux has it.
    #[must_use]
    pub fn virtual_time(mut self) -> Self {
        self.virtual_time = true;
        self
    }

    /// The cameras get the controls that make them fail.
    #[must_use]
    pub fn error_injection(mut self) -> Self {
        self.error_injection = true;
        self
    }

    /// Memory, MiB; 1024 if this is not called.
    #[must_use]
    pub fn memory_mb(mut self, memory_mb: u32) -> Self {
        self.memory_mb = memory_mb;
        self
    }

    /// Starts it.
    ///
    /// # Errors
    /// The job's folder cannot be made, or the machine cannot be started or does not carry out the
    /// job.
    pub fn start(&self, machine: &Machine) -> Result<Running> {
        fs::create_dir_all(&self.job).with_context(|| making(&self.job))?;
        let job = fs::canonicalize(&self.job).with_context(|| making(&self.job))?;
        let name = job.to_str().unwrap_or_default();
        ensure!(
            !name.is_empty() && !name.contains(|c: char| c.is_whitespace() || "\"',=".contains(c)),
            "starting a guest: its folder's path must do on a kernel's command line, found {}",
            job.display()
        );
        let script = job.join("script.sh");
        fs::write(&script, self.whole_script(machine)?)
            .with_context(|| format!("writing {}", script.display()))?;
        let mut command = machine.command(self, &job)?;
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(job.join(MESSAGES)).with_context(|| making(&job))?)
            .process_group(0)
            .spawn()
            .with_context(|| format!("starting {}", machine.program().display()))?;
        leftovers::add(child.id());
        let stdout = child.stdout.take().context("a guest without an output")?;
        Ok(Running {
            child,
            lines: listen(stdout),
            messages: job.join(MESSAGES),
            last: VecDeque::new(),
            exit: None,
        })
    }

    /// Starts it and waits for its end.
    ///
    /// # Errors
    /// It does not start, does not end within the limit, or ends without its script's exit code.
    pub fn run(&self, machine: &Machine, limit: Duration) -> Result<GuestResult> {
        self.start(machine)?.finish(limit)
    }

    pub(crate) fn disks(&self) -> &[PathBuf] {
        &self.disks
    }

    pub(crate) fn is_in_virtual_time(&self) -> bool {
        self.virtual_time
    }

    pub(crate) fn injects_errors(&self) -> bool {
        self.error_injection
    }

    pub(crate) fn memory(&self) -> u32 {
        self.memory_mb
    }

    fn whole_script(&self, machine: &Machine) -> Result<String> {
        let programs = machine.programs();
        let mut text = String::new();
        let mut set = |name: &str, value: &Path| -> Result<()> {
            let value = value.to_str().context("a path that is no UTF-8")?;
            text += &format!("export {name}='{}'\n", value.replace('\'', r"'\''"));
            Ok(())
        };
        set("PROGRAMS", programs)?;
        // Looking through all plugins would take longer than most tests.
        set("GST_REGISTRY", machine.gst_registry())?;
        set("GST_REGISTRY_UPDATE", Path::new("no"))?;
        for (i, _) in self.disks.iter().enumerate() {
            set(&format!("DISK{i}"), Path::new(&machine.disk_name(i)))?;
        }
        if let Some(module) = machine.gpio_sim() {
            set("GPIO_SIM_MODULE", &module)?;
        }
        if self.error_injection {
            set("ERROR_INJECTION", Path::new("1"))?;
        }
        Ok(format!(
            "{text}export PATH=\"$PROGRAMS:$PATH\"\n. /run/guest/rig.sh\ncd /run/job\n{}\n",
            self.script
        ))
    }
}

fn making(folder: &Path) -> String {
    format!("making the folder of a guest's job {}", folder.display())
}

/// The lines of an output, read by a thread so that waiting for one can have a limit.
fn listen(output: impl Read + Send + 'static) -> Receiver<String> {
    let (to, lines) = sync_channel(WAITING_LINES);
    thread::spawn(move || {
        let mut output = BufReader::new(output);
        let mut line = Vec::new();
        loop {
            line.clear();
            match output.read_until(b'\n', &mut line) {
                // An incomplete line, cut off with the power, is dropped.
                Ok(_) if line.last() == Some(&b'\n') => {
                    let text = String::from_utf8_lossy(&line);
                    if to.send(text.trim_end().to_owned()).is_err() {
                        return;
                    }
                }
                _ => return,
            }
        }
    });
    lines
}

/// A guest that runs. Dropping it kills it.
#[derive(Debug)]
pub struct Running {
    child: Child,
    lines: Receiver<String>,
    messages: PathBuf,
    last: VecDeque<String>,
    exit: Option<i32>,
}

/// Result of a guest.
#[derive(Clone, Debug)]
pub struct GuestResult {
    /// Everything that it printed and that was not taken before.
    pub lines: Vec<String>,
    /// Its script's exit code.
    pub exit: i32,
}

impl GuestResult {
    /// Its lines, if its script ended with 0.
    ///
    /// # Errors
    /// It did not; the message has its last lines.
    pub fn success(self) -> Result<Vec<String>> {
        let from = self.lines.len().saturating_sub(LAST_LINES);
        ensure!(
            self.exit == 0,
            "the guest's script ended with {}; its last lines:\n  {}",
            self.exit,
            self.lines[from..].join("\n  ")
        );
        Ok(self.lines)
    }
}

impl Running {
    /// The next line, or none at the end.
    ///
    /// # Errors
    /// None comes within the limit.
    pub fn line(&mut self, limit: Duration) -> Result<Option<String>> {
        match self.lines.recv_timeout(limit) {
            Ok(line) => {
                if let Some(code) = line.strip_prefix("guest: exit ") {
                    self.exit = code.parse().ok();
                }
                if self.last.len() == LAST_LINES {
                    self.last.pop_front();
                }
                self.last.push_back(line.clone());
                Ok(Some(line))
            }
            Err(RecvTimeoutError::Disconnected) => Ok(None),
            Err(RecvTimeoutError::Timeout) => {
                bail!(
                    "the guest printed nothing for {} s{}",
                    limit.as_secs(),
                    self.last_lines()
                )
            }
        }
    }

    /// Waits for the first line that begins so, and gives what follows.
    ///
    /// # Errors
    /// It does not come within the limit, or the guest ends before.
    #[expect(
        clippy::disallowed_methods,
        reason = "a guest's limit is real time, whatever time the guest has"
    )]
    pub fn wait_for(&mut self, beginning: &str, limit: Duration) -> Result<String> {
        let until = Instant::now() + limit;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.line(left)? {
                Some(line) => {
                    if let Some(rest) = line.strip_prefix(beginning) {
                        return Ok(rest.trim().to_owned());
                    }
                }
                None => bail!(
                    "the guest ended before it printed {beginning:?}{}",
                    self.last_lines()
                ),
            }
        }
    }

    /// Kills it with everything that belongs to it; gives the lines that nobody took yet.
    pub fn cut_power(mut self) -> Vec<String> {
        self.kill();
        self.lines.iter().collect()
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// It does not end within the limit, or without its script's exit code.
    #[expect(
        clippy::disallowed_methods,
        reason = "a guest's limit is real time, whatever time the guest has"
    )]
    pub fn finish(mut self, limit: Duration) -> Result<GuestResult> {
        let until = Instant::now() + limit;
        let mut lines = Vec::new();
        while let Some(line) = self
            .line(until.saturating_duration_since(Instant::now()))
            .with_context(|| format!("the guest had {} s", limit.as_secs()))?
        {
            lines.push(line);
        }
        self.kill();
        match self.exit {
            Some(exit) => Ok(GuestResult { lines, exit }),
            None => bail!("the guest ended without a word{}", self.last_lines()),
        }
    }

    fn last_lines(&self) -> String {
        let messages = fs::read_to_string(&self.messages).unwrap_or_default();
        let lines = self.last.iter().map(String::as_str).chain(messages.lines());
        let lines: Vec<&str> = lines.collect();
        if lines.is_empty() {
            return String::new();
        }
        format!("; its last lines:\n  {}", lines.join("\n  "))
    }

    fn kill(&mut self) {
        // The helpers of User-Mode Linux and the guest's processes would live on, and the image
        // with them.
        if let Some(group) = Pid::from_raw(self.child.id() as i32) {
            let _ = kill_process_group(group, Signal::KILL);
        }
        let _ = self.child.wait();
        leftovers::remove(self.child.id());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
    }
}
