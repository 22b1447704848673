//! The kernel of the guests: User-Mode Linux, built once from Debian's source and kept.
//!
//! It is a program like any other: it needs no root and no help from the processor. The source is
//! Debian's package `linux-source-6.1`, with the options in `kernel/uml.config` and the changes in
//! `EDITS`. What was built lies in `$PAWS_VM_CACHE`, or `paws/vm` in the user's cache folder, in a
//! folder that is named by options, changes and version of the source; another one of these is
//! another kernel.
//!
//! *Where it cannot be built* (no apt, no network, another system) a kernel that was built before
//! from another version of the same source is taken; without one the answer is
//! [`KernelError::Unavailable`], which is a reason to skip tests and not to fail them.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::cache_home;

/// Debian's package with the source.
const PACKAGE: &str = "linux-source-6.1";
/// Options beyond the default ones.
const CONFIG: &str = include_str!("../kernel/uml.config");
/// The program's name in its folder.
const NAME: &str = "uml-linux";

/// A change of the source. The text must be there, once.
struct Edit {
    file: &'static str,
    from: &'static str,
    to: &'static str,
}

const EDITS: [Edit; 3] = [
    // A processor with AMX has 11 KB of registers to save; with less room the first process fails
    // with "ptrace set fp regs failed, errno = 14".
    Edit {
        file: "arch/x86/um/user-offsets.c",
        from: "DEFINE_LONGS(HOST_FP_SIZE, 2696)",
        to: "DEFINE_LONGS(HOST_FP_SIZE, 12288)",
    },
    // vivid paces its frames by ticks of the kernel: 10 ms would be a jitter that no camera has.
    Edit {
        file: "arch/um/Kconfig",
        from: "config HZ\n\tint\n\tdefault 100\n",
        to: "config HZ\n\tint\n\tdefault 1000\n",
    },
    // A fault of F2FS that the power cuts have found: the first fsync after a checkpoint has number
    // 0, which f2fs_wait_on_node_pages_writeback takes for "nothing to wait for", so the cache is
    // flushed before the inode has been written. docs/guides/vm-tests.md says what that means for a
    // rig.
    Edit {
        file: "fs/f2fs/node.c",
        from: "fn->seq_id = sbi->fsync_seg_id++;",
        to: "fn->seq_id = ++sbi->fsync_seg_id;",
    },
];

/// Why there is no kernel.
#[derive(Debug, thiserror::Error)]
pub enum KernelError {
    /// This machine has none and cannot build one: skip what needs it.
    #[error("no kernel for User-Mode Linux here: {0}")]
    Unavailable(String),
    /// It should have been built and was not.
    #[error("building the kernel: {what}; its log: {}", log.display())]
    Build {
        /// The step, and what was found.
        what: String,
        /// What the steps printed.
        log: PathBuf,
    },
    /// Debian's kernel should have been unpacked and was not.
    #[error("preparing Debian's kernel: {what}: {}", folder.display())]
    Stock {
        /// The step, and what was found.
        what: String,
        /// Where it was to be.
        folder: PathBuf,
    },
    /// The cache cannot be used.
    #[error("keeping the kernel: {}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// A kernel that was built.
#[derive(Clone, Debug)]
pub struct Kernel {
    path: PathBuf,
}

impl Kernel {
    /// The kernel from the cache, or none if it would have to be built.
    ///
    /// # Errors
    /// There is no cache folder to look in.
    pub fn cached() -> Result<Option<Self>, KernelError> {
        let cache = cache()?;
        Ok(source_version()
            .map(|version| cache.join(folder(&version)).join(NAME))
            .filter(|path| path.is_file())
            .or_else(|| of_other_version(&cache))
            .map(|path| Self { path }))
    }

    /// The kernel from the cache, or a new one: some five minutes on two processors. `tell`
    /// receives a line for every step that takes long.
    ///
    /// # Errors
    /// See [`KernelError`].
    pub fn get(tell: impl Fn(&str)) -> Result<Self, KernelError> {
        let cache = cache()?;
        let Some(version) = source_version() else {
            let reason = format!("apt knows no package {PACKAGE}");
            return Self::cached()?.ok_or(KernelError::Unavailable(reason));
        };
        let place = cache.join(folder(&version));
        let path = place.join(NAME);
        if path.is_file() {
            return Ok(Self { path });
        }
        match Build::new(&cache, &version)?.run(&place, tell) {
            Err(KernelError::Unavailable(reason)) => match of_other_version(&cache) {
                Some(path) => Ok(Self { path }),
                None => Err(KernelError::Unavailable(reason)),
            },
            Err(error) => Err(error),
            Ok(()) => Ok(Self { path }),
        }
    }

    /// The program.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Where kernels are kept.
pub(crate) fn cache() -> Result<PathBuf, KernelError> {
    match std::env::var_os("PAWS_VM_CACHE").filter(|named| !named.is_empty()) {
        Some(named) => Ok(named.into()),
        None => cache_home()
            .map(|home| home.join("paws/vm"))
            .map_err(|error| KernelError::Unavailable(error.to_string())),
    }
}

/// Name of the folder of a kernel: the requested configuration, then the source's version.
fn folder(version: &str) -> String {
    format!("{}-{version}", recipe())
}

/// The lines of [`CONFIG`] that are no comments.
fn options() -> impl Iterator<Item = &'static str> {
    CONFIG
        .lines()
        .filter(|line| line.starts_with("CONFIG_") || line.starts_with("# CONFIG_"))
}

/// Options and changes, as a name.
fn recipe() -> String {
    let mut hasher = blake3::Hasher::new();
    for option in options() {
        hasher.update(option.as_bytes());
    }
    for edit in &EDITS {
        for part in [edit.file, edit.from, edit.to] {
            hasher.update(part.as_bytes());
        }
    }
    hasher.finalize().to_hex()[..12].to_owned()
}

/// A kernel of the same recipe from another version of the source.
fn of_other_version(cache: &Path) -> Option<PathBuf> {
    let ours = format!("{}-", recipe());
    let mut found: Vec<PathBuf> = fs::read_dir(cache)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(&ours) && path.join(NAME).is_file()
        })
        .collect();
    found.sort();
    found.pop().map(|folder| folder.join(NAME))
}

/// The version that apt would download; none where there is no apt, or it does not know the
/// package.
fn source_version() -> Option<String> {
    let output = Command::new("apt-cache")
        .args(["show", "--no-all-versions", PACKAGE])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let version = text.lines().find_map(|line| line.strip_prefix("Version: "));
    version.map(|version| version.trim().to_owned())
}

/// Whether a line of the required options holds for a configuration. An option that is left out may
/// not even be mentioned.
fn is_met(wanted: &str, taken: &str) -> bool {
    let left_out = wanted
        .strip_prefix("# CONFIG_")
        .and_then(|rest| rest.strip_suffix(" is not set"));
    match left_out {
        Some(option) => !taken
            .lines()
            .any(|line| line.starts_with(&format!("CONFIG_{option}="))),
        None => taken.lines().any(|line| line == wanted),
    }
}

/// What the folders of builds are called, in front of the process that builds.
const BUILD: &str = "build-";

/// Builds whose process was killed leave a gigabyte.
fn remove_abandoned(cache: &Path) {
    for entry in fs::read_dir(cache).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let process = name
            .strip_prefix(BUILD)
            .and_then(|id| id.parse::<u32>().ok());
        if process.is_some_and(|id| !Path::new(&format!("/proc/{id}")).exists()) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// A build in a folder of its own, which is removed in the end.
struct Build {
    work: PathBuf,
    log: PathBuf,
}

impl Build {
    fn new(cache: &Path, version: &str) -> Result<Self, KernelError> {
        remove_abandoned(cache);
        let name = format!("{BUILD}{}", std::process::id());
        let build = Self {
            work: cache.join(name),
            log: cache.join(format!("build-{}-{version}.log", recipe())),
        };
        fs::create_dir_all(build.work.join("source")).map_err(|e| build.io(e))?;
        fs::write(&build.log, "").map_err(|e| build.io(e))?;
        Ok(build)
    }

    fn io(&self, source: io::Error) -> KernelError {
        KernelError::Io {
            path: self.work.clone(),
            source,
        }
    }

    fn failed(&self, what: impl Into<String>) -> KernelError {
        KernelError::Build {
            what: what.into(),
            log: self.log.clone(),
        }
    }

    fn run(&self, place: &Path, tell: impl Fn(&str)) -> Result<(), KernelError> {
        tell("downloading the kernel's source, 140 MB");
        self.download()?;
        self.edit()?;
        self.configure()?;
        tell("building the kernel, some five minutes on two processors");
        let jobs = std::thread::available_parallelism().map_or(1, usize::from);
        self.make(&[&format!("-j{jobs}"), "linux"])?;
        self.step(Command::new("strip").arg("linux"), "source")?;
        // Another build of the same may have been faster.
        fs::create_dir_all(place).map_err(|e| self.io(e))?;
        fs::rename(self.work.join("source/linux"), place.join(NAME)).map_err(|e| self.io(e))?;
        let _ = fs::remove_file(&self.log);
        tell("built the kernel");
        Ok(())
    }

    /// The source, in `source/`.
    fn download(&self) -> Result<(), KernelError> {
        let unavailable = |_| {
            KernelError::Unavailable(format!(
                "{PACKAGE} cannot be downloaded; `apt-get download {PACKAGE}` says why"
            ))
        };
        self.step(Command::new("apt-get").args(["download", PACKAGE]), "")
            .map_err(unavailable)?;
        let package = fs::read_dir(&self.work)
            .map_err(|e| self.io(e))?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .find(|path| path.extension().is_some_and(|e| e == "deb"))
            .ok_or_else(|| self.failed("apt-get download left no package"))?;
        let mut unpack = Command::new("dpkg-deb");
        self.step(unpack.arg("-x").arg(&package).arg("package"), "")?;
        let archive = format!("../package/usr/src/{PACKAGE}.tar.xz");
        let mut unpack = Command::new("tar");
        self.step(
            unpack.args(["--strip-components=1", "-xJf", &archive]),
            "source",
        )
    }

    fn edit(&self) -> Result<(), KernelError> {
        for Edit { file, from, to } in &EDITS {
            let path = self.work.join("source").join(file);
            let text = fs::read_to_string(&path).map_err(|e| self.io(e))?;
            let found = text.matches(from).count();
            if found != 1 {
                let what = format!("{from:?} is {found} times in {file}, expected once");
                return Err(self.failed(what));
            }
            fs::write(&path, text.replace(from, to)).map_err(|e| self.io(e))?;
        }
        Ok(())
    }

    fn configure(&self) -> Result<(), KernelError> {
        let path = self.work.join("source/.config");
        self.make(&["defconfig"])?;
        let defaults = fs::read_to_string(&path).map_err(|e| self.io(e))?;
        // Of an option that occurs twice the last one counts.
        fs::write(&path, defaults + CONFIG).map_err(|e| self.io(e))?;
        self.make(&["olddefconfig"])?;
        let taken = fs::read_to_string(&path).map_err(|e| self.io(e))?;
        let refused: Vec<&str> = options().filter(|wanted| !is_met(wanted, &taken)).collect();
        if refused.is_empty() {
            return Ok(());
        }
        Err(self.failed(format!("options not taken: {}", refused.join(", "))))
    }

    fn make(&self, arguments: &[&str]) -> Result<(), KernelError> {
        let mut make = Command::new("make");
        self.step(make.arg("ARCH=um").args(arguments), "source")
    }

    /// One command, its output in the log.
    fn step(&self, command: &mut Command, folder: &str) -> Result<(), KernelError> {
        let log = File::options().append(true).open(&self.log);
        let log = log.map_err(|e| self.io(e))?;
        let also = log.try_clone().map_err(|e| self.io(e))?;
        let status = command
            .current_dir(self.work.join(folder))
            .stdin(Stdio::null())
            .stdout(log)
            .stderr(also)
            .status();
        match status {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(self.failed(format!("{command:?} ended with {status}"))),
            Err(error) => Err(self.failed(format!("{command:?}: {error}"))),
        }
    }
}

impl Drop for Build {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.work);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_that_were_not_taken_are_found() {
        let taken = "CONFIG_A=y\nCONFIG_B=m\n# CONFIG_C is not set\nCONFIG_HZ=1000\n";
        for met in [
            "CONFIG_A=y",
            "# CONFIG_C is not set",
            "# CONFIG_D is not set",
        ] {
            assert!(is_met(met, taken), "{met}");
        }
        for refused in [
            "CONFIG_B=y",
            "CONFIG_C=y",
            "CONFIG_HZ=100",
            "# CONFIG_B is not set",
        ] {
            assert!(!is_met(refused, taken), "{refused}");
        }
    }

    #[test]
    fn a_recipe_is_a_name_and_every_option_is_said_once() {
        assert!(recipe().chars().all(|c| c.is_ascii_hexdigit()));
        let mut options: Vec<&str> = options()
            .filter_map(|line| line.trim_start_matches("# ").split(['=', ' ']).next())
            .collect();
        let count = options.len();
        options.sort_unstable();
        options.dedup();
        assert_eq!(options.len(), count);
    }
}
