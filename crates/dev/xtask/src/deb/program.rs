//! The release build of `pawsd` for one architecture, linked against the root of that architecture.
//!
//! The same steps for this machine's architecture and another: what the program asks of a system is
//! decided by the root and not by what happens to be installed here. Paths of this machine do not
//! get into the program.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use super::Architecture;
use super::files::output;
use super::root::Root;
use crate::process::{self, cargo, command};
use crate::setup::{self, Purpose};

/// Builds and returns the program, with its symbols.
pub(super) fn build(
    architecture: Architecture,
    root: &Root,
    work: &Path,
    install: bool,
) -> Result<PathBuf> {
    let (gnu, target) = (architecture.gnu(), architecture.target());
    let rust = Rust::find(architecture, root, work, install)?;
    let workspace = process::root()?;
    let home = cargo_home()?;
    let here = [(workspace.as_path(), "."), (home.as_path(), "/cargo")];

    let sysroot = root.folder().display();
    let mut rustflags: Vec<String> = here
        .iter()
        .map(|(from, to)| format!("--remap-path-prefix={}={to}", from.display()))
        .collect();
    rustflags.push(format!("-Clink-arg=--sysroot={sysroot}"));
    if let Some(library) = &rust.library {
        rustflags.push(format!("--sysroot={}", library.display()));
    }
    let mut cflags = format!("--sysroot={sysroot} -fstack-protector-strong -D_FORTIFY_SOURCE=2");
    for (from, to) in here {
        cflags.push_str(&format!(" -ffile-prefix-map={}={to}", from.display()));
    }

    // How the crates that build C code, and Cargo, spell a target in a variable's name.
    let lower = target.replace('-', "_");
    let upper = lower.to_uppercase();
    let folder = work.join("build");
    let mut build = cargo()?;
    build
        .args(["build", "--release", "--locked", "--package=capture-daemon"])
        .args(["--bin=pawsd", "--target", &target, "--target-dir"])
        .arg(&folder)
        .env("CARGO_ENCODED_RUSTFLAGS", rustflags.join("\u{1f}"))
        .env(format!("CARGO_TARGET_{upper}_LINKER"), format!("{gnu}-gcc"))
        .env(format!("CC_{lower}"), format!("{gnu}-gcc"))
        .env(format!("AR_{lower}"), format!("{gnu}-ar"))
        .env(format!("CFLAGS_{lower}"), cflags)
        .env("PKG_CONFIG_ALLOW_CROSS", "1")
        .env("PKG_CONFIG_SYSROOT_DIR", root.folder())
        .env("PKG_CONFIG_LIBDIR", {
            let mut folders = root.libraries().join("pkgconfig").into_os_string();
            folders.push(":");
            folders.push(root.folder().join("usr/share/pkgconfig"));
            folders
        });
    if let Some(compiler) = &rust.compiler {
        build.env("RUSTC", compiler);
    }
    println!("Building pawsd for {target} (the first time takes minutes) ...");
    process::run(&mut build)?;
    Ok(folder.join(&target).join("release/pawsd"))
}

/// A Rust compiler that can make programs for the architecture.
#[derive(Default)]
struct Rust {
    /// `None` is the one of this toolchain.
    compiler: Option<PathBuf>,
    /// Where its libraries are; `None` is where it looks itself.
    library: Option<PathBuf>,
}

impl Rust {
    /// This toolchain, completed by rustup if need be; where that cannot be, Debian's compiler.
    fn find(architecture: Architecture, root: &Root, work: &Path, install: bool) -> Result<Self> {
        let target = architecture.target();
        if has_library(&target)? {
            return Ok(Self::default());
        }
        let mut rustup = command("rustup")?;
        rustup.args(["target", "add", &target]);
        ensure!(
            install,
            "the Rust toolchain cannot build for {target} and --no-install was given. Complete it with:\n\n    {}\n",
            process::line(&rustup)
        );
        println!("{}", process::line(&rustup));
        if let Err(error) = process::run(&mut rustup) {
            println!("note: {error:#}; taking Debian's Rust compiler");
            return Self::debian(architecture, root, work);
        }
        ensure!(
            has_library(&target)?,
            "`{}` ended well, and the compiler still has no library for {target}",
            process::line(&rustup)
        );
        Ok(Self::default())
    }

    /// Debian's compiler, which is installed, with the library of the other architecture, which is
    /// unpacked beside the root.
    fn debian(architecture: Architecture, root: &Root, work: &Path) -> Result<Self> {
        setup::system_packages(&[Purpose::DebianRust], true)?;
        let folder = work.join(architecture.name()).join("rust");
        root.download("libstd-rust-web-dev", &folder)?;
        // One folder has to hold both libraries: the compiler looks for its own machine's too.
        let host = Architecture::here()?.target();
        let link = folder.join("usr/lib/rustlib").join(&host);
        std::os::unix::fs::symlink(Path::new("/usr/lib/rustlib").join(&host), &link)
            .with_context(|| format!("linking {}", link.display()))?;
        Ok(Self {
            compiler: Some("/usr/bin/rustc".into()),
            library: Some(folder.join("usr")),
        })
    }
}

/// Whether this toolchain has the standard library of the target.
fn has_library(target: &str) -> Result<bool> {
    let compiler = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let folder = output(command(compiler)?.args(["--print", "target-libdir", "--target", target]))?;
    Ok(Path::new(folder.trim()).exists())
}

/// Where Cargo keeps the sources of other people's crates.
pub(super) fn cargo_home() -> Result<PathBuf> {
    if let Some(home) = std::env::var_os("CARGO_HOME") {
        return Ok(home.into());
    }
    let home = std::env::var_os("HOME").context("neither CARGO_HOME nor HOME is set")?;
    Ok(Path::new(&home).join(".cargo"))
}
