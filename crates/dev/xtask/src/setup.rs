//! System packages: which ones a verb needs and why, which are missing, and installing those.
//!
//! On Debian and its relatives (tried: Debian 12; the names are the same on Ubuntu 22.04 and
//! later) `dpkg-query` says what is missing and `apt-get` installs it. On any other system nothing
//! is installed: each need is tried, and the ones that fail are named in plain words. With
//! installing switched off nothing is changed; a missing package is an error that carries the
//! command.

use std::collections::BTreeSet;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};

use crate::process::{self, command, succeeds};

/// What a package is needed for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Purpose {
    /// Compiling the workspace.
    Build,
    /// Encoding and decoding video while recording, validating and reading back.
    Video,
    /// Rendering on a GPU, without one.
    Graphics,
    /// The tests that open our sessions with other people's readers.
    Interoperability,
    /// The foreign renderer of a benchmark.
    Rendering,
    /// The fuzz targets.
    Fuzzing,
    /// Building a Debian package.
    Packaging,
    /// Compiling for arm64 on another machine.
    CrossArm64,
    /// The same, where the Rust toolchain at hand cannot be completed for arm64.
    DebianRust,
    /// Checking a Debian package.
    PackageCheck,
    /// Running programs of another processor.
    Emulation,
    /// The kernel of the virtual machines, and their disks.
    Machines,
    /// Virtual machines with the system's own kernel.
    Qemu,
}

struct Package {
    name: &'static str,
    purpose: Purpose,
    /// Ends the sentence "needed for ...".
    reason: &'static str,
}

const fn package(name: &'static str, purpose: Purpose, reason: &'static str) -> Package {
    Package {
        name,
        purpose,
        reason,
    }
}

const PACKAGES: [Package; 35] = [
    package(
        "gcc",
        Purpose::Build,
        "the C code inside SQLite, zstd and BLAKE3, and linking",
    ),
    package("libc6-dev", Purpose::Build, "the C library's headers"),
    package("pkg-config", Purpose::Build, "finding GStreamer"),
    package(
        "libgstreamer1.0-dev",
        Purpose::Build,
        "building against GStreamer",
    ),
    package(
        "libgstreamer-plugins-base1.0-dev",
        Purpose::Build,
        "GStreamer's app and video libraries",
    ),
    package(
        "gstreamer1.0-tools",
        Purpose::Video,
        "gst-inspect-1.0 and gst-launch-1.0",
    ),
    package(
        "gstreamer1.0-plugins-base",
        Purpose::Video,
        "appsrc, appsink, videoconvert",
    ),
    package(
        "gstreamer1.0-plugins-good",
        Purpose::Video,
        "the MP4 muxer of the export",
    ),
    package("gstreamer1.0-plugins-ugly", Purpose::Video, "x264enc"),
    package(
        "gstreamer1.0-plugins-bad",
        Purpose::Video,
        "h264parse, h265parse, x265enc and the hardware encoders",
    ),
    package(
        "gstreamer1.0-libav",
        Purpose::Video,
        "decoding H.264 and H.265",
    ),
    package(
        "mesa-vulkan-drivers",
        Purpose::Graphics,
        "Vulkan on the processor, for the tests of the renderer on the GPU",
    ),
    package(
        "python3-venv",
        Purpose::Interoperability,
        "an environment for the Python readers",
    ),
    package(
        "libllvm19",
        Purpose::Rendering,
        "Mitsuba's compiler; without it the renderer is several times slower",
    ),
    package("g++", Purpose::Fuzzing, "libFuzzer"),
    package(
        "dpkg-dev",
        Purpose::Packaging,
        "readelf and strip beside dpkg",
    ),
    package(
        "gcc-aarch64-linux-gnu",
        Purpose::CrossArm64,
        "C code and linking for arm64",
    ),
    package(
        "rustc-web",
        Purpose::DebianRust,
        "a Rust compiler with an arm64 standard library beside it",
    ),
    package(
        "lintian",
        Purpose::PackageCheck,
        "Debian's rules for packages",
    ),
    package(
        "man-db",
        Purpose::PackageCheck,
        "lintian's look at the manual page",
    ),
    package(
        "proot",
        Purpose::PackageCheck,
        "running programs in a root folder without being root",
    ),
    package(
        "qemu-user-static",
        Purpose::Emulation,
        "running programs of another processor",
    ),
    package("make", Purpose::Machines, "building the guests' kernel"),
    package("flex", Purpose::Machines, "building the guests' kernel"),
    package("bison", Purpose::Machines, "building the guests' kernel"),
    package("bc", Purpose::Machines, "building the guests' kernel"),
    package(
        "xz-utils",
        Purpose::Machines,
        "unpacking the kernel's source",
    ),
    package("e2fsprogs", Purpose::Machines, "disks with ext4"),
    package("f2fs-tools", Purpose::Machines, "disks with F2FS"),
    package("dmsetup", Purpose::Machines, "disks that fail"),
    package("v4l-utils", Purpose::Machines, "setting up the cameras"),
    package("qemu-system-x86", Purpose::Qemu, "running a stock kernel"),
    package(
        "busybox-static",
        Purpose::Qemu,
        "the stock kernel's first root",
    ),
    package("cpio", Purpose::Qemu, "the stock kernel's first root"),
    package("kmod", Purpose::Qemu, "the stock kernel's modules"),
];

/// Makes sure that the packages for these purposes are there. Prints nothing when they all are,
/// beyond one line.
pub(crate) fn system_packages(purposes: &[Purpose], install: bool) -> Result<()> {
    if !installs_packages()? {
        return check_by_trying(purposes);
    }
    let wanted = wanted(purposes);
    let names: Vec<&str> = wanted.iter().map(|package| package.name).collect();
    let missing = missing(&wanted, &installed(&names)?);
    if missing.is_empty() {
        println!("System packages: all {} are installed.", wanted.len());
        return Ok(());
    }

    println!("System packages to install:");
    for package in &missing {
        println!("  {:34} needed for {}", package.name, package.reason);
    }
    let user = command("id")?.arg("-u").output().context("running id -u")?;
    let as_root = user.stdout.trim_ascii() == b"0";
    let sudo = !as_root && succeeds(command("sudo")?.arg("--version"));
    let names: Vec<&str> = missing.iter().map(|package| package.name).collect();
    let [update, install_them] = apt_commands(&names, !as_root);
    let typed = format!(
        "{} && {}",
        process::line(&update),
        process::line(&install_them)
    );
    ensure!(
        install,
        "system packages are missing and --no-install was given. Install them with:\n\n    {typed}\n"
    );
    ensure!(
        as_root || sudo,
        "installing system packages needs root, and there is no sudo here. As root, run:\n\n    {typed}\n"
    );

    println!("\n{typed}\n");
    let [mut update, mut install_them] = [update, install_them];
    if let Err(error) = process::run(&mut update) {
        // One broken third-party package source must not stop an install from the good ones.
        println!("note: {error:#}; trying the install with the package lists at hand");
    }
    process::run(&mut install_them).context("installing system packages")
}

/// Whether packages are installed here, so that nothing that they contain may be missing.
pub(crate) fn installs_packages() -> Result<bool> {
    Ok(succeeds(command("dpkg-query")?.arg("--version")))
}

/// Makes sure that `cargo fmt` and `cargo clippy` are there: the minimal toolchain has neither.
pub(crate) fn rust_components(install: bool) -> Result<()> {
    let mut missing = Vec::new();
    for (component, verb) in [("rustfmt", "fmt"), ("clippy", "clippy")] {
        if !succeeds(process::cargo()?.args([verb, "--version"])) {
            missing.push(component);
        }
    }
    if missing.is_empty() {
        return Ok(());
    }
    let mut rustup = command("rustup")?;
    rustup.args(["component", "add"]).args(&missing);
    let typed = process::line(&rustup);
    if !install || !succeeds(command("rustup")?.arg("--version")) {
        bail!(
            "the Rust toolchain has no {}. Add it with:\n\n    {typed}\n",
            missing.join(" and no ")
        );
    }
    println!("{typed}");
    process::run(&mut rustup).context("completing the Rust toolchain")
}

fn wanted(purposes: &[Purpose]) -> Vec<&'static Package> {
    PACKAGES
        .iter()
        .filter(|package| purposes.contains(&package.purpose))
        .collect()
}

fn missing<'a>(wanted: &[&'a Package], installed: &BTreeSet<String>) -> Vec<&'a Package> {
    wanted
        .iter()
        .filter(|package| !installed.contains(package.name))
        .copied()
        .collect()
}

fn installed(names: &[&str]) -> Result<BTreeSet<String>> {
    let mut query = command("dpkg-query")?;
    query
        .args(["--show", "--showformat=${Package} ${db:Status-Status}\\n"])
        .args(names);
    // It ends with 1 as soon as one name is unknown, and still lists the others.
    let output = query
        .stderr(Stdio::null())
        .output()
        .context("asking dpkg-query what is installed")?;
    Ok(parse_status(&String::from_utf8_lossy(&output.stdout)))
}

/// The names of `NAME STATUS` lines whose status is `installed`; removed packages stay listed.
fn parse_status(listing: &str) -> BTreeSet<String> {
    listing
        .lines()
        .filter_map(|line| line.strip_suffix(" installed"))
        .map(str::to_owned)
        .collect()
}

/// `apt-get update` and `apt-get install`, waiting for a package manager that is already at work
/// (fresh cloud machines update themselves at boot), and never asking a question.
fn apt_commands(names: &[&str], with_sudo: bool) -> [Command; 2] {
    let apt = |arguments: &[&str]| {
        let mut command = Command::new(if with_sudo { "sudo" } else { "env" });
        if with_sudo {
            command.arg("env");
        }
        command
            .arg("DEBIAN_FRONTEND=noninteractive")
            .args(["apt-get", "-o", "DPkg::Lock::Timeout=600"])
            .args(arguments)
            .stdin(Stdio::null());
        command
    };
    let install = ["install", "-y", "--no-install-recommends"];
    [apt(&["update"]), apt(&[&install[..], names].concat())]
}

/// A system without dpkg: each need is tried, and what fails is described for a person to install.
fn check_by_trying(purposes: &[Purpose]) -> Result<()> {
    let mut lacking = Vec::new();
    for purpose in purposes {
        for (need, program, arguments) in trials(*purpose) {
            if !succeeds(command(program)?.args(*arguments)) {
                lacking.push(*need);
            }
        }
    }
    if lacking.is_empty() {
        println!(
            "System packages: this is not a Debian-like system; all that is needed was found."
        );
        return Ok(());
    }
    bail!(
        "this is not a Debian-like system, so nothing can be installed for you. Please install:\n  - {}",
        lacking.join("\n  - ")
    )
}

/// Per purpose: the need in words, and a command that works where it is met.
type Trial = (&'static str, &'static str, &'static [&'static str]);

fn trials(purpose: Purpose) -> &'static [Trial] {
    match purpose {
        Purpose::Build => &[
            ("a C compiler that answers to `cc`", "cc", &["--version"]),
            (
                "pkg-config and the development files of GStreamer 1.20 or later with its base libraries (app, video)",
                "pkg-config",
                &[
                    "--atleast-version=1.20",
                    "gstreamer-1.0",
                    "gstreamer-app-1.0",
                    "gstreamer-video-1.0",
                ],
            ),
        ],
        Purpose::Video => &[
            (
                "GStreamer's tools and its base plugins",
                "gst-inspect-1.0",
                &["--exists", "videoconvert"],
            ),
            (
                "GStreamer's good plugins (MP4 muxer)",
                "gst-inspect-1.0",
                &["--exists", "mp4mux"],
            ),
            (
                "GStreamer's ugly plugins (x264enc)",
                "gst-inspect-1.0",
                &["--exists", "x264enc"],
            ),
            (
                "GStreamer's bad plugins (h264parse)",
                "gst-inspect-1.0",
                &["--exists", "h264parse"],
            ),
            (
                "GStreamer's libav plugin (avdec_h264)",
                "gst-inspect-1.0",
                &["--exists", "avdec_h264"],
            ),
        ],
        Purpose::Interoperability => &[(
            "Python 3.10 or later with its venv module",
            "python3",
            &["-m", "venv", "--help"],
        )],
        Purpose::Machines => &[
            ("mkfs.ext4 (e2fsprogs)", "mkfs.ext4", &["-V"]),
            ("mkfs.f2fs (f2fs-tools)", "mkfs.f2fs", &["-V"]),
            ("dmsetup", "dmsetup", &["--version"]),
            ("v4l2-ctl (v4l-utils)", "v4l2-ctl", &["--version"]),
        ],
        Purpose::Qemu => &[
            ("QEMU for x86-64", "qemu-system-x86_64", &["--version"]),
            ("a static busybox", "busybox", &["true"]),
            ("cpio", "cpio", &["--version"]),
        ],
        // Without a driver the tests skip themselves.
        Purpose::Graphics => &[],
        // Without LLVM the renderer interprets.
        Purpose::Rendering => &[],
        Purpose::Fuzzing => &[(
            "a C++ compiler that answers to `c++`",
            "c++",
            &["--version"],
        )],
        // Packages of Debian are made of Debian: without its tools and archives there is no way.
        Purpose::Packaging => &[("Debian's packaging tools", "dpkg-deb", &["--version"])],
        Purpose::CrossArm64 => &[("GCC for arm64", "aarch64-linux-gnu-gcc", &["--version"])],
        Purpose::DebianRust => &[(
            "a Rust toolchain with the target aarch64-unknown-linux-gnu",
            "/usr/bin/rustc",
            &["--version"],
        )],
        Purpose::PackageCheck => &[
            ("lintian", "lintian", &["--version"]),
            ("proot", "proot", &["--version"]),
        ],
        Purpose::Emulation => &[(
            "QEMU's user-mode emulation of arm64",
            "qemu-aarch64-static",
            &["--version"],
        )],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn removed_and_half_installed_packages_count_as_missing() {
        let listing = "gcc installed\nlibc6-dev config-files\npkg-config half-installed\n\
                       libgstreamer1.0-dev installed\n";
        let missing: Vec<&str> = missing(&wanted(&[Purpose::Build]), &parse_status(listing))
            .iter()
            .map(|package| package.name)
            .collect();
        assert_eq!(
            missing,
            [
                "libc6-dev",
                "pkg-config",
                "libgstreamer-plugins-base1.0-dev"
            ]
        );
    }

    #[test]
    fn only_what_a_verb_needs_is_wanted() {
        let names = |purposes: &[Purpose]| -> Vec<&str> {
            wanted(purposes).iter().map(|p| p.name).collect()
        };
        assert!(!names(&[Purpose::Build, Purpose::Video]).contains(&"python3-venv"));
        assert!(names(&[]).is_empty());
    }

    #[test]
    fn the_printed_command_is_the_one_that_runs() {
        let [update, install] = apt_commands(&["gcc", "libc6-dev"], true);
        assert_eq!(
            process::line(&update),
            "sudo env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=600 update"
        );
        assert!(
            process::line(&install).ends_with("install -y --no-install-recommends gcc libc6-dev")
        );
        let [update, _] = apt_commands(&[], false);
        assert!(process::line(&update).starts_with("env DEBIAN_FRONTEND="));
    }
}
