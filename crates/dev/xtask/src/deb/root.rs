//! A root folder of Debian for one architecture: what the recorder is linked against, and where its
//! package is installed and run.
//!
//! It is made without being root and without changing this machine: apt, with a state of its own
//! and none of this machine's packages, says what belongs together and fetches it from this
//! machine's sources; the packages are unpacked and entered as installed. **No script of these
//! packages runs**, which would take minutes under emulation; only the accounts that every Debian
//! has are put in place. The scripts of our own package do run, through the root's own dpkg.
//!
//! Programs in it run through proot: a change of root that needs no rights, follows every program
//! that is started, and puts QEMU before those of another processor. Once made, a root is kept
//! until [`PACKAGES`] change or its folder is deleted; one whose making was broken off is made
//! again.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};

use super::Architecture;
use super::files::{make_folder, output, write};
use crate::process::{self, command};

/// What the root holds, beside what these depend on.
const PACKAGES: [&str; 8] = [
    // What every Debian has: a shell, dpkg, the C library, what maintainer scripts use.
    "?essential",
    "systemd",
    "udev",
    // To link against.
    "libgstreamer1.0-dev",
    "libgstreamer-plugins-base1.0-dev",
    // To record with: what our package depends on, and x264enc, which it recommends.
    "gstreamer1.0-plugins-base",
    "gstreamer1.0-plugins-bad",
    "gstreamer1.0-plugins-ugly",
];

/// A Debian root folder.
pub(super) struct Root {
    folder: PathBuf,
    architecture: Architecture,
    apt: Apt,
}

impl Root {
    /// Makes the root in `work`, or takes the one that is there.
    pub(super) fn prepare(architecture: Architecture, work: &Path) -> Result<Self> {
        let work = work.join(architecture.name());
        let root = Self {
            folder: work.join("root"),
            architecture,
            apt: Apt::new(architecture, &work.join("apt"))?,
        };
        let stamp = work.join("root.packages");
        let wanted = PACKAGES.join("\n");
        if fs::read_to_string(&stamp).is_ok_and(|made| made == wanted) {
            return Ok(root);
        }
        println!(
            "Making a Debian root for {} in {} ...",
            architecture.name(),
            root.folder.display()
        );
        if root.folder.exists() {
            fs::remove_dir_all(&root.folder)
                .with_context(|| format!("emptying {}", root.folder.display()))?;
        }
        let archives = root.apt.fetch(&PACKAGES)?;
        root.unpack(&archives)?;
        fs::write(&stamp, wanted).with_context(|| format!("writing {}", stamp.display()))?;
        Ok(root)
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Libraries of the architecture.
    pub(super) fn libraries(&self) -> PathBuf {
        self.folder.join("usr/lib").join(self.architecture.gnu())
    }

    /// Fetches one package of the architecture without what it depends on, and unpacks it into
    /// `folder`.
    pub(super) fn download(&self, package: &str, folder: &Path) -> Result<()> {
        if folder.exists() {
            fs::remove_dir_all(folder).with_context(|| format!("emptying {}", folder.display()))?;
        }
        make_folder(folder)?;
        process::run(
            self.apt
                .get()?
                .args(["-qq", "download", package])
                .current_dir(folder),
        )?;
        for archive in packages_in(folder)? {
            process::run(
                command("dpkg-deb")?
                    .arg("--extract")
                    .arg(&archive)
                    .arg(folder),
            )?;
        }
        Ok(())
    }

    /// What a package says of the symbols of its libraries: Debian's `symbols` file.
    pub(super) fn symbols(&self, package: &str) -> Option<PathBuf> {
        let info = self.folder.join("var/lib/dpkg/info");
        let names = [
            format!("{package}:{}.symbols", self.architecture.name()),
            format!("{package}.symbols"),
        ];
        names
            .into_iter()
            .map(|name| info.join(name))
            .find(|path| path.exists())
    }

    /// Whether another processor than this machine's is needed.
    pub(super) fn is_emulated(&self) -> Result<bool> {
        Ok(self.architecture != Architecture::here()?)
    }

    /// Makes ready for [`command`](Self::command): compiles `older_kernel.c`, which states why it
    /// is needed.
    pub(super) fn make_runnable(&self) -> Result<()> {
        let source = process::root()?.join("crates/dev/xtask/src/deb/older_kernel.c");
        process::run(
            command("cc")?
                .args(["-O2", "-Wall", "-Wextra", "-o"])
                .args([&self.older_kernel(), &source]),
        )
    }

    /// A program inside the root, as a user that it takes for root, with a plain environment.
    pub(super) fn command(&self, program: &str) -> Result<Command> {
        let mut here = command(self.older_kernel())?;
        here.arg("proot");
        if self.is_emulated()? {
            here.arg(format!(
                "--qemu=qemu-{}-static",
                self.architecture.machine()
            ));
        }
        here.arg(format!("--rootfs={}", self.folder.display()))
            .args(["--root-id", "--bind=/proc", "--bind=/dev", "--cwd=/"])
            .arg(program)
            .env_clear()
            .env("PATH", "/usr/sbin:/usr/bin:/sbin:/bin")
            .env("HOME", "/root")
            .env("LC_ALL", "C.UTF-8")
            .env("DEBIAN_FRONTEND", "noninteractive");
        Ok(here)
    }

    fn older_kernel(&self) -> PathBuf {
        self.folder.with_file_name("older-kernel")
    }

    fn unpack(&self, archives: &[PathBuf]) -> Result<()> {
        let dpkg = self.folder.join("var/lib/dpkg");
        let info = dpkg.join("info");
        for folder in ["usr/bin", "usr/sbin", "usr/lib", "var/lib/dpkg/info"] {
            make_folder(&self.folder.join(folder))?;
        }
        // Merged /usr, as every Debian 12 has it.
        for name in ["bin", "sbin", "lib"] {
            std::os::unix::fs::symlink(format!("usr/{name}"), self.folder.join(name))
                .with_context(|| format!("linking /{name} in the root"))?;
        }
        let mut status = String::new();
        for archive in archives {
            let entry = self
                .unpack_one(archive, &info)
                .with_context(|| format!("unpacking {}", archive.display()))?;
            status.push_str(&entry);
            status.push('\n');
        }
        write(&dpkg.join("status"), &status)?;
        write(&info.join("format"), "1\n")?;
        for (from, to) in [("passwd.master", "passwd"), ("group.master", "group")] {
            let from = self.folder.join("usr/share/base-passwd").join(from);
            fs::copy(&from, self.folder.join("etc").join(to))
                .with_context(|| format!("copying {}", from.display()))?;
        }
        // A linker with `--sysroot` does not follow absolute links into it.
        make_links_relative(&self.libraries())
    }

    /// Unpacks one package; the answer is its entry in dpkg's list.
    fn unpack_one(&self, archive: &Path, info: &Path) -> Result<String> {
        let control = output(Command::new("dpkg-deb").arg("--field").arg(archive))?;
        let field = |name: &str| {
            let start = format!("{name}: ");
            control.lines().find_map(|line| line.strip_prefix(&start))
        };
        let package = field("Package").context("the package has no name")?;
        // dpkg names the files of packages that may be there for several architectures by both.
        let file = match (field("Multi-Arch"), field("Architecture")) {
            (Some("same"), Some(architecture)) => format!("{package}:{architecture}"),
            _ => package.to_owned(),
        };

        let mut reader = Command::new("dpkg-deb")
            .arg("--fsys-tarfile")
            .arg(archive)
            .stdout(Stdio::piped())
            .spawn()
            .context("starting dpkg-deb")?;
        let tar = reader.stdout.take().context("dpkg-deb gives nothing")?;
        let names = output(
            Command::new("tar")
                .args(["--extract", "--verbose", "--keep-directory-symlink"])
                .args(["--no-same-owner", "--directory"])
                .arg(&self.folder)
                .stdin(tar),
        )?;
        let status = reader.wait().context("waiting for dpkg-deb")?;
        ensure!(status.success(), "dpkg-deb ended with {status}");

        let list: String = names
            .lines()
            .map(
                |name| match name.trim_start_matches('.').trim_end_matches('/') {
                    "" => "/.\n".to_owned(),
                    name => format!("{name}\n"),
                },
            )
            .collect();
        write(&info.join(format!("{file}.list")), &list)?;
        let symbols = Command::new("dpkg-deb")
            .arg("--info")
            .arg(archive)
            .arg("symbols")
            .stderr(Stdio::null())
            .output()
            .context("starting dpkg-deb")?;
        if symbols.status.success() {
            let path = info.join(format!("{file}.symbols"));
            fs::write(&path, symbols.stdout)
                .with_context(|| format!("writing {}", path.display()))?;
        }
        Ok(control.replacen('\n', "\nStatus: install ok installed\n", 1))
    }
}

/// apt for one architecture, with a state of its own.
struct Apt {
    configuration: PathBuf,
    archives: PathBuf,
}

impl Apt {
    fn new(architecture: Architecture, folder: &Path) -> Result<Self> {
        for part in ["lists/partial", "archives/partial"] {
            make_folder(&folder.join(part))?;
        }
        let (name, at) = (architecture.name(), folder.display());
        let configuration = folder.join("apt.conf");
        write(&folder.join("status"), "")?;
        write(
            &configuration,
            format!(
                "APT::Architecture \"{name}\";\nAPT::Architectures {{ \"{name}\"; }};\n\
                 APT::Install-Recommends \"false\";\nAPT::Sandbox::User \"\";\n\
                 Dir::State \"{at}\";\nDir::State::lists \"{at}/lists\";\n\
                 Dir::State::status \"{at}/status\";\n\
                 Dir::Cache \"{at}\";\nDir::Cache::archives \"{at}/archives\";\n"
            ),
        )?;
        Ok(Self {
            configuration,
            archives: folder.join("archives"),
        })
    }

    /// Fetches the packages and all that they depend on.
    fn fetch(&self, packages: &[&str]) -> Result<Vec<PathBuf>> {
        process::run(self.get()?.args(["-qq", "update"])).context(
            "reading the package lists; the root is made from this machine's apt sources",
        )?;
        // Only the required files may be there: all of it is unpacked.
        if self.archives.exists() {
            fs::remove_dir_all(&self.archives)
                .with_context(|| format!("emptying {}", self.archives.display()))?;
        }
        make_folder(&self.archives.join("partial"))?;
        process::run(
            self.get()?
                .args(["-qq", "--yes", "--download-only", "install"])
                .args(packages)
                .stdout(Stdio::null()),
        )
        .context("fetching the packages of the root")?;
        packages_in(&self.archives)
    }

    fn get(&self) -> Result<Command> {
        let mut apt = command("apt-get")?;
        apt.env("APT_CONFIG", &self.configuration);
        Ok(apt)
    }
}

/// Absolute links in the library folder `usr/lib/GNU`, made relative: `/lib/GNU/libz.so.1` becomes
/// `../../../lib/GNU/libz.so.1`.
fn make_links_relative(libraries: &Path) -> Result<()> {
    let reading = || format!("reading {}", libraries.display());
    for entry in fs::read_dir(libraries).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        let Ok(target) = fs::read_link(&path) else {
            continue;
        };
        if let Ok(inside) = target.strip_prefix("/") {
            fs::remove_file(&path).with_context(|| format!("removing {}", path.display()))?;
            std::os::unix::fs::symlink(Path::new("../../..").join(inside), &path)
                .with_context(|| format!("linking {}", path.display()))?;
        }
    }
    Ok(())
}

/// The packages that lie in a folder, in their order.
fn packages_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let reading = || format!("reading {}", folder.display());
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        if path.extension().is_some_and(|extension| extension == "deb") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}
