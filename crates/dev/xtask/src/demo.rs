//! `cargo xtask demo`: the main job, end to end, on this machine.
//!
//! A walk with a simulated rig is recorded by `pawsd`, in virtual time: as fast as the machine can,
//! dropping nothing however busy it is; `paws` imports, validates, indexes and hands over the
//! session; `paws-reconstruct` reads every frame back and estimates the trajectory of the rig,
//! which is compared with the simulated ground truth, a point cloud and a scene of Gaussians of a
//! short training; `paws-sim` lets an agent walk through that scene; all is shown on a page. Each
//! stage is the program a user would start, with the command line shown. A stage that fails ends
//! the demo with the last lines it printed and the path of its whole output; one that finished with
//! loss, or a verdict of FAIL, is marked, the demo goes on and ends as finished with loss. Nothing
//! is written outside the demo's folder and the target folder.

mod cameras;

use std::cell::Cell;
use std::fs::{self, File};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};

use crate::process::{self, cargo, human};
use crate::setup::{self, Purpose};
use crate::{Ending, WITH_LOSS};

/// Runs the demo. `folder` must be new or empty; `None` takes `demo` in the target folder and
/// empties it first.
pub(crate) fn run(install: bool, seconds: u32, folder: Option<PathBuf>) -> Result<Ending> {
    setup::system_packages(&[Purpose::Build, Purpose::Video], install)?;
    let start = Instant::now();
    println!(
        "Building the programs: the first time takes about {BUILD_MINUTES} minutes on two cores and {BUILD_GB} GB of disk ..."
    );
    let mut build = cargo()?;
    build.args(["build", "--locked"]);
    build.args(PACKAGES.map(|package| format!("--package={package}")));
    process::run(&mut build)?;
    println!("Built in {}.", human(start.elapsed()));

    let demo = Demo::prepare(folder)?;
    demo.main_job(seconds)
}

/// What is built: all programs that the demo starts.
const PACKAGES: [&str; 4] = [
    "capture-daemon",
    "collector",
    "reconstruction",
    "simulation",
];

/// What the first build takes, measured as README.md says.
const BUILD_MINUTES: u32 = 6;
const BUILD_GB: u32 = 2;

/// Steps of the training of Gaussians: some tens of seconds on two cores.
const SPLAT_STEPS: &str = "700";

/// How often the line of a running stage is renewed.
const HEARTBEAT: Duration = Duration::from_millis(200);

/// Name of the recorded session; the library finds it by this.
const NAME: &str = "demo";

/// Where things lie while the demo runs.
struct Demo {
    folder: PathBuf,
    /// Holds `pawsd`, `paws`, `paws-reconstruct` and `paws-sim`.
    programs: PathBuf,
    /// Whether a stage finished with loss.
    with_loss: Cell<bool>,
}

impl Demo {
    fn prepare(named: Option<PathBuf>) -> Result<Self> {
        let folder = match named {
            Some(named) => {
                let occupied =
                    fs::read_dir(&named).is_ok_and(|mut entries| entries.next().is_some());
                ensure!(
                    !occupied,
                    "the demo needs a new or an empty folder, and this one holds something: {}",
                    named.display()
                );
                std::path::absolute(named).context("reading --keep")?
            }
            None => {
                let own = process::target_folder()?.join("demo");
                if own.exists() {
                    fs::remove_dir_all(&own)
                        .with_context(|| format!("emptying {}", own.display()))?;
                }
                own
            }
        };
        let logs = folder.join("logs");
        fs::create_dir_all(&logs).with_context(|| format!("making {}", logs.display()))?;
        Ok(Self {
            folder,
            programs: process::program_folder()?,
            with_loss: Cell::new(false),
        })
    }

    /// The stages in their order. All command lines of the programs stand here.
    fn main_job(&self, seconds: u32) -> Result<Ending> {
        let start = Instant::now();
        let path = |name: &str| self.folder.join(name).display().to_string();
        let (config, recorded, library) = (path("pawsd.toml"), path("recorded"), path("library"));
        let (report, verdict) = (path("report.html"), path("report.json"));
        let (frames, scene) = (path("frames"), path("walk.scene"));
        let page = path("reconstruction.html");

        let rig = process::root()?.join("cad-transforms/rigs/recommended.toml");
        let text = cameras::configuration(&rig, seconds);
        fs::write(&config, text).with_context(|| format!("writing {config}"))?;
        println!(
            "\nA walk over a pavement with a simulated rig: three stereo cameras and their IMUs."
        );
        println!(
            "{seconds} s are recorded in virtual time, as fast as this machine can: nothing is dropped, and it says\n\
             nothing of what the machine could record in real time.\n"
        );

        let length = seconds.to_string();
        let session = self.stage(
            "record",
            "pawsd",
            &[
                "record",
                "--virtual",
                "--config",
                &config,
                "--out",
                &recorded,
                "--seconds",
                &length,
                "--name",
                NAME,
            ],
        )?;
        if !Path::new(&session).is_dir() {
            bail!(
                "the last line of `pawsd record` should be the session's folder, and is {session:?}"
            );
        }
        let in_library = ["--library", library.as_str()];
        let paws = |stage: &str, arguments: &[&str]| {
            self.stage(stage, "paws", &[arguments, &in_library].concat())
        };
        paws("import", &["import", &session])?;
        let verdict_line = paws(
            "validate",
            &["validate", NAME, "--html", &report, "--json", &verdict],
        )?;
        paws("index", &["index", NAME])?;
        let handoff = paws("hand off", &["handoff", NAME, "--accept", "FAIL"])?;
        self.stage(
            "read back",
            "paws-reconstruct",
            &["frames", &handoff, "--out", &frames],
        )?;
        self.stage(
            "reconstruct",
            "paws-reconstruct",
            &[
                "run",
                &handoff,
                "--out",
                &scene,
                "--splat-preset",
                "fast",
                "--splat-steps",
                SPLAT_STEPS,
            ],
        )?;
        self.stage("simulate", "paws-sim", &["film", &scene])?;
        let truth = Path::new(&handoff).with_file_name("rig/truth.left_shoulder.csv");
        let truth = truth.display().to_string();
        let off = self.stage(
            "report",
            "paws-reconstruct",
            &["report", &scene, "--truth", &truth, "--out", &page],
        )?;

        println!();
        println!(
            "The main job ran from end to end in {}.",
            human(start.elapsed())
        );
        println!();
        println!(
            "  session   {session}, {:.1} MB",
            megabytes(Path::new(&session))?
        );
        println!("  verdict   {}", verdict_line);
        println!(
            "  frames    {} PNG files in {frames}",
            count_png(Path::new(&frames))?
        );
        println!("  library   {library}");
        println!("  recording {report}");
        println!("  scene     {scene}");
        let off = off.strip_suffix(&format!(": {page}")).unwrap_or(&off);
        println!("  error     {off}");
        println!("  report    {page}");
        Ok(match self.with_loss.get() {
            false => Ending::Whole,
            true => {
                println!(
                    "\nSomething recorded is missing or was judged unfit, see above and the report: exit code {WITH_LOSS}."
                );
                Ending::WithLoss
            }
        })
    }

    /// Runs one program to its end with its output in `logs/`, and shows one line about it: the
    /// last line of its standard output that is not empty, which is returned.
    fn stage(&self, name: &str, program: &str, arguments: &[&str]) -> Result<String> {
        print!("  {name:11} ");
        std::io::stdout()
            .flush()
            .context("writing to the terminal")?;
        let log = |kind: &str| {
            let file = format!("{}.{kind}.txt", name.replace(' ', "-"));
            self.folder.join("logs").join(file)
        };
        let (output, messages) = (log("output"), log("messages"));
        let create = |path: &Path| {
            File::create(path).with_context(|| format!("making the log {}", path.display()))
        };
        let mut command = process::command(self.programs.join(program))?;
        command
            .args(arguments)
            .stdout(create(&output)?)
            .stderr(create(&messages)?);

        let start = Instant::now();
        let mut child = command
            .spawn()
            .with_context(|| format!("starting `{}`", process::line(&command)))?;
        let status = wait(&mut child, name, start)?;
        let took = start.elapsed();
        let text = |path: &Path| {
            let bytes =
                fs::read(path).with_context(|| format!("reading the log {}", path.display()))?;
            Ok::<_, anyhow::Error>(String::from_utf8_lossy(&bytes).into_owned())
        };
        let printed = text(&output)?;
        let said = printed.lines().rfind(|line| !line.trim().is_empty());
        let said = said.unwrap_or_default().trim().to_owned();
        // A verdict of FAIL is an answer: the session can be handed over in spite of it.
        let is_judged = name == "validate" && said.starts_with("FAIL ");
        let with_loss = is_judged || status.code() == Some(WITH_LOSS.into());
        self.with_loss.set(self.with_loss.get() || with_loss);
        if !status.success() && !with_loss {
            println!("failed after {}", human(took));
            bail!(
                "`{}` ended with {status}. Its last lines:\n\n{}{}\nThe whole of it: {} and {}",
                process::line(&command),
                tail(&printed, 15),
                tail(&text(&messages)?, 15),
                output.display(),
                messages.display(),
            );
        }
        let note = if with_loss {
            format!(" (with loss: {})", messages.display())
        } else {
            String::new()
        };
        println!("{:>8}  {said}{note}", human(took));
        Ok(said)
    }
}

/// Waits for a stage; on a terminal its line counts the seconds.
fn wait(child: &mut Child, name: &str, start: Instant) -> Result<ExitStatus> {
    let mut out = std::io::stdout();
    if !out.is_terminal() {
        return child.wait().context("waiting for a stage");
    }
    loop {
        if let Some(status) = child.try_wait().context("waiting for a stage")? {
            write!(out, "\r  {name:11} ").context("writing to the terminal")?;
            return Ok(status);
        }
        write!(out, "\r  {name:11} {:>8}  ...", human(start.elapsed()))
            .and_then(|()| out.flush())
            .context("writing to the terminal")?;
        // The stage is another program: there is nothing else to wait on with a limit.
        std::thread::sleep(HEARTBEAT);
    }
}

/// The last `count` lines, indented.
fn tail(text: &str, count: usize) -> String {
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(count)..]
        .iter()
        .map(|line| format!("    {line}\n"))
        .collect()
}

/// Size of all files in a folder and the folders below it, in megabytes (10^6 bytes).
fn megabytes(folder: &Path) -> Result<f64> {
    let mut bytes = 0;
    each_file(folder, &mut |_, size| bytes += size)?;
    Ok(bytes as f64 / 1e6)
}

fn count_png(folder: &Path) -> Result<usize> {
    let mut count = 0;
    each_file(folder, &mut |path, _| {
        count += usize::from(path.extension().is_some_and(|extension| extension == "png"));
    })?;
    Ok(count)
}

fn each_file(folder: &Path, take: &mut impl FnMut(&Path, u64)) -> Result<()> {
    let reading = || format!("reading the folder {}", folder.display());
    for entry in fs::read_dir(folder).with_context(reading)? {
        let entry = entry.with_context(reading)?;
        let data = entry.metadata().with_context(reading)?;
        if data.is_dir() {
            each_file(&entry.path(), take)?;
        } else {
            take(&entry.path(), data.len());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_is_no_failure() -> Result<()> {
        let folder = std::env::temp_dir().join(format!("xtask-demo-{}", std::process::id()));
        fs::create_dir_all(folder.join("logs"))?;
        let demo = Demo {
            folder: folder.clone(),
            programs: "/bin".into(),
            with_loss: Cell::default(),
        };
        let end_with = |code: i32| {
            let script = format!("echo the session; exit {code}");
            demo.stage("record", "sh", &["-c", &script])
        };
        // The verdict FAIL is an exit code 1 that says so in its last line.
        let judged = |line: &str| {
            let script = format!("echo {line}; exit 1");
            demo.stage("validate", "sh", &["-c", &script])
        };
        for (code, with_loss) in [(0, false), (3, true), (0, true)] {
            assert_eq!(end_with(code)?, "the session");
            assert_eq!(demo.with_loss.get(), with_loss, "it ends with 3 once");
        }
        demo.with_loss.set(false);
        assert_eq!(judged("'FAIL  walk: frames'")?, "FAIL  walk: frames");
        assert!(demo.with_loss.get());
        judged("'no such session'").expect_err("that is a failure");
        for code in [1, 2] {
            let error = end_with(code).expect_err("that is a failure");
            assert!(error.to_string().contains("the session"), "{error}");
        }
        fs::remove_dir_all(folder)?;
        Ok(())
    }
}
