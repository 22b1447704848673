//! The command line: words in, one [`Verb`] out. Pure; nothing is looked up or started here.
//!
//! A word that is not known is refused with the nearest known one named, never guessed at.

use std::ffi::OsString;
use std::path::PathBuf;

use crate::deb::Architecture;
use crate::tidy::Mode;

/// What `cargo xtask help` prints.
pub(crate) const HELP: &str = "\
cargo xtask VERB: set-up and developer verbs

  setup [--no-install]
        Install the system packages that building and testing need (Debian, Ubuntu).
  demo [--no-install] [--seconds N] [--keep DIR]
        Run the main job: record N seconds (default 20) of a simulated walk in virtual time, import,
        validate, index, hand off, read back, reconstruct. Works in target/demo, emptied first, or in DIR,
        which must be new or empty.
  test [--no-install] [--quick]
        What `tidy` checks, format check, clippy, tests, documentation, cargo deny. --quick: tidy, format
        check, clippy and the unit tests only.
  tidy [--write | --list [CRATE]]
        Compare the counts of dropped words, breaches of the layers, circles of modules, long files and public
        items with docs/tidy.txt, and fail where one rose. --write: lower the counts there that fell, and add
        new ones. --list: print every place that counts, of all or of CRATE (or of the pages, `markdown`, or the charts,
        `svg`).
  bench NAME [--no-install] [ARGS...]
        Run a benchmark (archive, sync, frame_sync, frames_kept, encode, import, soak, kills, power_cuts, vm_cost, sim, sim_images,
        sim_learn, sim_physics, sim_render, sim_step, sim_truth, calib, camera_imu, rectify, calib_verify, depth, odometry,
        odometry_calibration, odometry_faults, odometry_encoding, odometry_length, odometry_monte_carlo, odometry_scale, gtsam,
        foreign, feet, feet_camera, feet_faults, feet_length, splats, confidence, tag_detectors, terrain, render, or all) in release
        mode; results go to docs/benchmarks. ARGS are handed to the benchmark. `usd` runs OpenUSD's validators on an export
        of the ground, which the tests leave out for the size of that package.
  vm-test [--no-install] [--quick] [--qemu] [--cached] [NAMES...]
        Run the tests on real kernel drivers, in virtual machines (docs/guides/vm-tests.md): the cases named,
        or all. --quick: the short form. --qemu: on the system's own kernel, which is slow. --cached:
        skip them if the kernel was not built before; building takes some five minutes.
  fuzz [SECONDS] [--no-install]
        Run each fuzz target of session-archive, scene-bundle and gaussians for SECONDS (default 60).
  guide [--no-install]
        Run every command of README.md and docs/getting-started.md as it stands there, in a fresh clone and an empty home.
        `test` does so without the builds.
  schemas
        Compile the schemas of the session format into the code that stands in crates/formats/session-archive/src/record/generated.
  deb [--no-install] [--arch amd64|arm64] [--out DIR] [--check]
        Build the Debian package of the recorder, for this machine or for the other architecture,
        into DIR (default target/deb). --check: also lintian, the symbols that the program asks
        for, and a recording by the installed package in a root folder of its architecture,
        emulated where it is not this machine's. docs/guides/packaging.md
  wheel [--no-install] [--out DIR]
        Build the Python package of the simulators into DIR (default target/wheels), and print how it is installed.
        `test` builds and tests it too, in an environment of its own.
  help  This text.

  --no-install  Install nothing; where a system package is missing, print the command and fail.

Real recordings are used where they are found: in the folder that PAWS_DATA names, or in
../shared/data beside the checkout. Without them, tests that need them say that they are skipped.

Exit code: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss (demo).
";

/// The benchmarks, in the order in which `bench all` runs them.
pub(crate) const BENCHMARKS: [&str; 41] = [
    "archive",
    "sync",
    "frame_sync",
    "frames_kept",
    "encode",
    "import",
    "soak",
    "kills",
    "power_cuts",
    "vm_cost",
    "sim",
    "sim_images",
    "sim_learn",
    "sim_physics",
    "sim_render",
    "sim_step",
    "sim_truth",
    "calib",
    "camera_imu",
    "rectify",
    "calib_verify",
    "depth",
    "odometry",
    "odometry_calibration",
    "odometry_faults",
    "odometry_encoding",
    "odometry_length",
    "odometry_monte_carlo",
    "odometry_scale",
    "gtsam",
    "foreign",
    "feet",
    "feet_camera",
    "feet_faults",
    "feet_length",
    "splats",
    "confidence",
    "tag_detectors",
    "terrain",
    "render",
    "usd",
];

const VERBS: [&str; 12] = [
    "setup", "demo", "test", "tidy", "bench", "vm-test", "fuzz", "guide", "schemas", "deb",
    "wheel", "help",
];

/// What the command line asks for.
#[derive(Debug, PartialEq)]
pub(crate) enum Verb {
    Help,
    Schemas,
    Tidy {
        mode: Mode,
    },
    Guide {
        install: bool,
    },
    Setup {
        install: bool,
    },
    Test {
        install: bool,
        quick: bool,
    },
    Demo {
        install: bool,
        seconds: u32,
        /// Where to work; `None` is the demo's own folder under the target folder.
        folder: Option<PathBuf>,
    },
    Bench {
        install: bool,
        names: Vec<&'static str>,
        arguments: Vec<OsString>,
    },
    VmTest {
        install: bool,
        quick: bool,
        qemu: bool,
        cached: bool,
        names: Vec<OsString>,
    },
    Fuzz {
        install: bool,
        seconds: u32,
    },
    Deb {
        install: bool,
        /// `None` is this machine's.
        architecture: Option<Architecture>,
        /// Where the package goes; `None` is `deb` in the target folder.
        out: Option<PathBuf>,
        check: bool,
    },
    Wheel {
        install: bool,
        /// Where it goes; `None` is `wheels` in the target folder.
        out: Option<PathBuf>,
    },
}

/// Reads the words after `cargo xtask`. The error is the whole message for the user.
pub(crate) fn parse(words: impl IntoIterator<Item = OsString>) -> Result<Verb, String> {
    let mut words: Vec<OsString> = words.into_iter().collect();
    if words.is_empty() {
        return Err(format!("No verb was given.\n\n{HELP}"));
    }
    let verb = words.remove(0);
    let mut words = Words(words);
    match verb.to_str().unwrap_or_default() {
        "help" | "-h" | "--help" => Ok(Verb::Help),
        "setup" => {
            let install = !words.take_flag("--no-install");
            words.end("setup", &["--no-install"])?;
            Ok(Verb::Setup { install })
        }
        "test" => {
            let install = !words.take_flag("--no-install");
            let quick = words.take_flag("--quick");
            words.end("test", &["--no-install", "--quick"])?;
            Ok(Verb::Test { install, quick })
        }
        "tidy" => Ok(Verb::Tidy {
            mode: tidy_mode(&mut words)?,
        }),
        "demo" => {
            let install = !words.take_flag("--no-install");
            let seconds = match words.take_value("--seconds")? {
                Some(value) => whole_seconds(&value, "demo --seconds")?,
                None => 20,
            };
            let folder = words.take_value("--keep")?.map(PathBuf::from);
            words.end("demo", &["--no-install", "--seconds", "--keep"])?;
            Ok(Verb::Demo {
                install,
                seconds,
                folder,
            })
        }
        "bench" => {
            let install = !words.take_flag("--no-install");
            if words.0.is_empty() {
                return Err(format!(
                    "`cargo xtask bench` needs a name: {}, or all.",
                    BENCHMARKS.join(", ")
                ));
            }
            let name = words.0.remove(0);
            let name = name.to_string_lossy();
            let names = if name == "all" {
                BENCHMARKS.to_vec()
            } else if let Some(known) = BENCHMARKS.into_iter().find(|known| *known == name) {
                vec![known]
            } else {
                let known: Vec<&str> = BENCHMARKS.into_iter().chain(["all"]).collect();
                return Err(unknown("benchmark", &name, &known));
            };
            Ok(Verb::Bench {
                install,
                names,
                arguments: words.0,
            })
        }
        "vm-test" => {
            let install = !words.take_flag("--no-install");
            let quick = words.take_flag("--quick");
            let qemu = words.take_flag("--qemu");
            let cached = words.take_flag("--cached");
            let known = ["--no-install", "--quick", "--qemu", "--cached"];
            // Names are known to the program that has the cases.
            let is_name = |word: &OsString| !word.to_string_lossy().starts_with('-');
            let (names, others) = words.0.into_iter().partition(is_name);
            Words(others).end("vm-test", &known)?;
            Ok(Verb::VmTest {
                install,
                quick,
                qemu,
                cached,
                names,
            })
        }
        "fuzz" => {
            let install = !words.take_flag("--no-install");
            let seconds = if words.0.is_empty() {
                60
            } else {
                let word = words.0.remove(0);
                whole_seconds(&word, "fuzz")?
            };
            words.end("fuzz", &["--no-install"])?;
            Ok(Verb::Fuzz { install, seconds })
        }
        "guide" => {
            let install = !words.take_flag("--no-install");
            words.end("guide", &["--no-install"])?;
            Ok(Verb::Guide { install })
        }
        "schemas" => {
            words.end("schemas", &[])?;
            Ok(Verb::Schemas)
        }
        "deb" => {
            let install = !words.take_flag("--no-install");
            let check = words.take_flag("--check");
            let architecture = match words.take_value("--arch")? {
                Some(value) => Some(named_architecture(&value)?),
                None => None,
            };
            let out = words.take_value("--out")?.map(PathBuf::from);
            words.end("deb", &["--no-install", "--arch", "--out", "--check"])?;
            Ok(Verb::Deb {
                install,
                architecture,
                out,
                check,
            })
        }
        "wheel" => {
            let install = !words.take_flag("--no-install");
            let out = words.take_value("--out")?.map(PathBuf::from);
            words.end("wheel", &["--no-install", "--out"])?;
            Ok(Verb::Wheel { install, out })
        }
        _ => Err(unknown("verb", &verb.to_string_lossy(), &VERBS)),
    }
}

/// The words after the verb that no one has claimed yet.
struct Words(Vec<OsString>);

impl Words {
    fn take_flag(&mut self, flag: &str) -> bool {
        let before = self.0.len();
        self.0.retain(|word| word != flag);
        self.0.len() < before
    }

    fn take_value(&mut self, flag: &str) -> Result<Option<OsString>, String> {
        let Some(at) = self.0.iter().position(|word| word == flag) else {
            return Ok(None);
        };
        self.0.remove(at);
        if at == self.0.len() {
            return Err(format!("{flag} needs a value after it."));
        }
        Ok(Some(self.0.remove(at)))
    }

    fn end(&self, verb: &str, known: &[&str]) -> Result<(), String> {
        match self.0.first() {
            None => Ok(()),
            Some(word) => {
                let what = format!("argument of `{verb}`");
                Err(unknown(&what, &word.to_string_lossy(), known))
            }
        }
    }
}

fn tidy_mode(words: &mut Words) -> Result<Mode, String> {
    let write = words.take_flag("--write");
    let list = words.take_flag("--list");
    let is_name = |word: &OsString| !word.to_string_lossy().starts_with('-');
    let of = if list && words.0.first().is_some_and(is_name) {
        Some(words.0.remove(0).to_string_lossy().into_owned())
    } else {
        None
    };
    words.end("tidy", &["--write", "--list"])?;
    match (write, list) {
        (false, false) => Ok(Mode::Check),
        (true, false) => Ok(Mode::Write),
        (false, true) => Ok(Mode::List(of)),
        (true, true) => Err("tidy: --write and --list exclude each other.".into()),
    }
}

fn whole_seconds(word: &OsString, what: &str) -> Result<u32, String> {
    word.to_str()
        .and_then(|text| text.parse().ok())
        .filter(|seconds| *seconds > 0)
        .ok_or_else(|| {
            format!(
                "{what}: found {:?}, expected a whole number of seconds above zero.",
                word.to_string_lossy()
            )
        })
}

fn named_architecture(word: &OsString) -> Result<Architecture, String> {
    let word = word.to_string_lossy();
    Architecture::ALL
        .into_iter()
        .find(|architecture| architecture.name() == word)
        .ok_or_else(|| {
            let known = Architecture::ALL.map(Architecture::name);
            unknown("architecture", &word, &known)
        })
}

fn unknown(what: &str, word: &str, known: &[&str]) -> String {
    let nearest = nearest(word, known);
    let known = known.join(", ");
    format!("Unknown {what} {word:?}; the nearest known one is {nearest:?}. Known: {known}.")
}

/// The known word with the fewest edits to the one given; the first of them on a tie.
fn nearest<'a>(word: &str, known: &[&'a str]) -> &'a str {
    known
        .iter()
        .min_by_key(|known| strsim::damerau_levenshtein(word, known))
        .copied()
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_line(line: &str) -> Result<Verb, String> {
        parse(line.split_whitespace().map(OsString::from))
    }

    #[test]
    fn flags_are_read_in_any_order() {
        let expected = Verb::Demo {
            install: false,
            seconds: 5,
            folder: Some("there".into()),
        };
        for line in [
            "demo --no-install --seconds 5 --keep there",
            "demo --keep there --seconds 5 --no-install",
        ] {
            assert_eq!(parse_line(line).as_ref(), Ok(&expected), "{line}");
        }
    }

    #[test]
    fn a_verb_alone_installs_and_takes_its_defaults() {
        assert_eq!(
            parse_line("demo"),
            Ok(Verb::Demo {
                install: true,
                seconds: 20,
                folder: None
            })
        );
        assert_eq!(
            parse_line("fuzz"),
            Ok(Verb::Fuzz {
                install: true,
                seconds: 60
            })
        );
    }

    #[test]
    fn a_package_is_for_the_named_architecture() {
        assert_eq!(
            parse_line("deb --check --arch arm64 --out there"),
            Ok(Verb::Deb {
                install: true,
                architecture: Some(Architecture::Arm64),
                out: Some("there".into()),
                check: true,
            })
        );
    }

    #[test]
    fn a_wheel_goes_into_the_named_folder() {
        assert_eq!(
            parse_line("wheel --out there"),
            Ok(Verb::Wheel {
                install: true,
                out: Some("there".into()),
            })
        );
    }

    #[test]
    fn tidy_checks_unless_it_is_to_write_or_to_list() {
        for (line, mode) in [
            ("tidy", Mode::Check),
            ("tidy --write", Mode::Write),
            ("tidy --list", Mode::List(None)),
            ("tidy --list calib", Mode::List(Some("calib".into()))),
        ] {
            assert_eq!(parse_line(line), Ok(Verb::Tidy { mode }), "{line}");
        }
    }

    #[test]
    fn benchmark_arguments_pass_through_untouched() {
        assert_eq!(
            parse_line("bench sync --no-install --seconds 3"),
            Ok(Verb::Bench {
                install: false,
                names: vec!["sync"],
                arguments: vec!["--seconds".into(), "3".into()],
            })
        );
        let Ok(Verb::Bench { names, .. }) = parse_line("bench all") else {
            panic!("bench all is not understood");
        };
        assert_eq!(names, BENCHMARKS);
    }

    #[test]
    fn every_benchmark_has_its_name_here() {
        let program = include_str!("../../bench/src/main.rs");
        let there = program.lines().filter_map(|line| {
            let name = line.trim().strip_prefix("(\"")?;
            name.strip_suffix("::run),")?
                .split_once('"')
                .map(|(name, _)| name)
        });
        let mut there: Vec<&str> = there.collect();
        there.sort_unstable();
        // `usd` is a test.
        let mut here = BENCHMARKS.to_vec();
        here.retain(|name| *name != "usd");
        here.sort_unstable();
        assert_eq!(there, here);
    }

    #[test]
    fn an_unknown_word_is_refused_with_the_nearest_known_one() {
        for (line, nearest) in [
            ("tset", "test"),
            ("demos", "demo"),
            ("bench arhive", "archive"),
            ("demo --second 5", "--seconds"),
            ("vm-test --quik", "--quick"),
            ("test --quik", "--quick"),
            ("deb --arch arm46", "arm64"),
            ("deb --chek", "--check"),
            ("tydi", "tidy"),
            ("tidy --lits", "--list"),
        ] {
            let message = parse_line(line).expect_err(line);
            let named = format!("nearest known one is {nearest:?}");
            assert!(message.contains(&named), "{line}: {message}");
        }
    }

    #[test]
    fn a_missing_or_wrong_value_is_refused() {
        for line in [
            "",
            "demo --seconds",
            "demo --seconds 0",
            "demo --seconds 1.5",
            "demo --keep",
            "bench",
            "fuzz soon",
            "fuzz 5 5",
            "deb --arch",
            "tidy calib",
            "tidy --write --list",
            "tidy --list calib depth",
        ] {
            assert!(parse_line(line).is_err(), "{line:?} was taken");
        }
    }
}
