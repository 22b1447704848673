//! From a built program to a Debian package: the same commit and program give the same bytes.
//!
//! What depends on the moment is the commit's: the version, the changelog's date, the times of
//! files.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use super::Architecture;
use super::changelog;
use super::contents::Contents;
use super::files::{make_folder, output, read, set_mode, write};
use super::symbols::Need;
use super::third_party;
use crate::process::{self, command};

/// There is no public address yet; lintian-overrides says so.
const MAINTAINER: &str = "The PAWS toolkit authors <maintainers@paws.invalid>";

/// The commit that is packaged.
pub(super) struct Commit {
    /// Seconds since 1970.
    seconds: String,
    /// As Debian's changelogs write it.
    date: String,
    /// `202611221232.gb5e2e6c`, with `.changed` where files differ from the commit.
    label: String,
}

impl Commit {
    pub(super) fn read() -> Result<Self> {
        let git = |arguments: &[&str]| -> Result<String> {
            let mut git = command("git")?;
            git.args(arguments).env("TZ", "UTC").env("LC_ALL", "C");
            Ok(output(&mut git)?.trim().to_owned())
        };
        let log = |format: &str| git(&["log", "-1", "--date=format-local:%Y%m%d%H%M", format]);
        let changed = !git(&["status", "--porcelain", "--untracked-files=no"])?.is_empty();
        let seconds = log("--format=%ct")?;
        Ok(Self {
            date: debian_date(&format!("@{seconds}"))?,
            label: log("--format=%cd.g%h")? + if changed { ".changed" } else { "" },
            seconds,
        })
    }

    /// The package's version. Before a release it sorts below that release.
    pub(super) fn version(&self, changelog: &str) -> Result<String> {
        let version = env!("CARGO_PKG_VERSION");
        Ok(if changelog::is_unreleased(changelog)? {
            format!("{version}~{}-1", self.label)
        } else {
            format!("{version}-1")
        })
    }
}

/// A date that coreutils understand, in the form of RFC 5322.
fn debian_date(date: &str) -> Result<String> {
    let mut program = command("date")?;
    program.args(["--utc", "--rfc-email", "--date", date]);
    Ok(output(program.env("LC_ALL", "C"))?.trim().to_owned())
}

/// Makes the package of the program, which still has its symbols, in the folder `out`.
pub(super) fn assemble(
    architecture: Architecture,
    commit: &Commit,
    program: &Path,
    needs: &[Need],
    work: &Path,
    out: &Path,
) -> Result<PathBuf> {
    let source = process::root()?;
    let folder = work.join(architecture.name()).join("package");
    if folder.exists() {
        fs::remove_dir_all(&folder).with_context(|| format!("emptying {}", folder.display()))?;
    }
    let contents = Contents {
        folder: &folder,
        source: &source,
    };
    let markdown = read(&source.join("CHANGELOG.md"))?;
    let version = commit.version(&markdown)?;

    make_folder(&folder.join("usr/bin"))?;
    fs::copy(program, folder.join("usr/bin/pawsd"))
        .with_context(|| format!("copying {}", program.display()))?;
    set_mode(&folder.join("usr/bin/pawsd"), 0o755)?;
    contents.put_files()?;
    let doc = "usr/share/doc/pawsd";
    contents.put_compressed(&format!("{doc}/changelog"), &markdown)?;
    contents.put_compressed(
        &format!("{doc}/changelog.Debian"),
        changelog::debian(&markdown, &version, &commit.date, MAINTAINER, debian_date)?,
    )?;
    contents.put_compressed(
        &format!("{doc}/third-party.txt"),
        third_party::notice(architecture)?,
    )?;

    put_control(&contents, architecture, &version, needs)?;
    let mut folders = vec![folder.clone()];
    while let Some(folder) = folders.pop() {
        // Whatever the umask of this machine is.
        set_mode(&folder, 0o755)?;
        for entry in fs::read_dir(&folder).context("reading the package's folders")? {
            let path = entry.context("reading the package's folders")?.path();
            if path.is_dir() {
                folders.push(path);
            }
        }
    }

    make_folder(out)?;
    let file = out.join(format!("pawsd_{version}_{}.deb", architecture.name()));
    process::run(
        command("dpkg-deb")?
            .args(["--root-owner-group", "-Zxz", "--build"])
            .arg(&folder)
            .arg(&file)
            .env("SOURCE_DATE_EPOCH", &commit.seconds)
            .stdout(std::process::Stdio::null()),
    )?;
    Ok(file)
}

/// What dpkg reads: who depends on what, which files are the administrator's, sums, scripts.
fn put_control(
    contents: &Contents<'_>,
    architecture: Architecture,
    version: &str,
    needs: &[Need],
) -> Result<()> {
    let templates = contents.source.join("deploy/debian");
    let mut files = Vec::new();
    list_files(contents.folder, contents.folder, &mut files)?;
    files.sort();

    let mut sums = command("md5sum")?;
    let sums = output(sums.args(&files).current_dir(contents.folder))?;
    let mut bytes = 0;
    for file in &files {
        let path = contents.folder.join(file);
        let data = fs::metadata(&path).with_context(|| format!("reading {}", path.display()))?;
        bytes += data.len();
    }
    let depends: Vec<String> = needs
        .iter()
        .map(|need| format!("{} (>= {})", need.package, need.version))
        .collect();
    let control = filled(
        &read(&templates.join("control.in"))?,
        &[
            ("VERSION", version),
            ("ARCHITECTURE", architecture.name()),
            ("MAINTAINER", MAINTAINER),
            ("INSTALLED_SIZE", &bytes.div_ceil(1024).to_string()),
            ("DEPENDS", &depends.join(", ")),
        ],
    )?;
    contents.put("DEBIAN/control", control)?;
    contents.put("DEBIAN/md5sums", sums)?;
    let configuration: String = files
        .iter()
        .filter(|file| file.starts_with("etc"))
        .map(|file| format!("/{}\n", file.display()))
        .collect();
    contents.put("DEBIAN/conffiles", configuration)?;
    for script in ["postinst", "prerm", "postrm"] {
        let to = contents.folder.join("DEBIAN").join(script);
        write(&to, read(&templates.join(script))?)?;
        set_mode(&to, 0o755)?;
    }
    Ok(())
}

/// The template with its `@NAME@` filled in; one that is left over is an error.
fn filled(template: &str, values: &[(&str, &str)]) -> Result<String> {
    let mut text = template.to_owned();
    for (name, value) in values {
        text = text.replace(&format!("@{name}@"), value);
    }
    let left = text
        .split('@')
        .find(|word| !word.is_empty() && word.chars().all(|c| c.is_ascii_uppercase() || c == '_'));
    ensure!(
        left.is_none(),
        "nothing fills in @{}@",
        left.unwrap_or_default()
    );
    Ok(text)
}

/// Every file below the folder, relative to `root`.
fn list_files(root: &Path, folder: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let reading = || format!("reading {}", folder.display());
    for entry in fs::read_dir(folder).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        if path.is_dir() {
            list_files(root, &path, files)?;
        } else {
            files.push(path.strip_prefix(root).with_context(reading)?.to_owned());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_template_is_filled_whole_or_refused() -> Result<()> {
        let template = "Version: @VERSION@\nMaintainer: @MAINTAINER@\n";
        let some = [("VERSION", "1"), ("MAINTAINER", "me <me@example.org>")];
        assert_eq!(
            filled(template, &some)?,
            "Version: 1\nMaintainer: me <me@example.org>\n"
        );
        let error = filled(template, &some[1..]).expect_err("a value is missing");
        assert!(error.to_string().contains("@VERSION@"), "{error}");
        Ok(())
    }
}
