//! What is in the package, and where it goes.
//!
//! The layout for Debian 12 and Ubuntu 22.04: units and udev rules below `/lib`, where both look.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use super::files::{make_folder, output, read, set_mode, write};
use crate::process::{self, cargo};

/// Where `deploy/README.md` installs the program by hand; Debian keeps that folder for the
/// administrator.
const BY_HAND: &str = "/usr/local/bin/pawsd";
const PACKAGED: &str = "/usr/bin/pawsd";

/// Pages for operators of the recorder; a folder stands for the files in it. What is below `deploy`
/// goes to the top of the package's documents, the rest keeps its place.
const PAGES: [&str; 7] = [
    "deploy/README.md",
    "deploy/runbooks",
    "docs/guides/hardware.md",
    "docs/images/led-table.png",
    "docs/images/led-table.svg",
    "docs/reference/led-table.md",
    "docs/guides/packaging.md",
];

/// Configurations to start from; folders, and where their files go.
const EXAMPLES: [(&str, &str); 3] = [
    ("deploy/examples", "usr/share/doc/pawsd/examples"),
    ("deploy/rigs", "usr/share/doc/pawsd/examples/rigs"),
    ("cad-transforms/rigs", "usr/share/doc/pawsd/examples/rigs"),
];

/// Where the shells look for completions.
const COMPLETIONS: [(&str, &str); 3] = [
    ("bash", "usr/share/bash-completion/completions/pawsd"),
    ("fish", "usr/share/fish/vendor_completions.d/pawsd.fish"),
    ("zsh", "usr/share/zsh/vendor-completions/_pawsd"),
];

/// The folder that becomes the package.
pub(super) struct Contents<'a> {
    pub(super) folder: &'a Path,
    /// The checkout.
    pub(super) source: &'a Path,
}

impl Contents<'_> {
    /// Everything but the program, the changelogs and the notice of other people's code.
    pub(super) fn put_files(&self) -> Result<()> {
        let unit = read(&self.source.join("deploy/pawsd.service"))?;
        self.put("lib/systemd/system/pawsd.service", packaged_unit(&unit)?)?;
        for (from, to) in [
            ("deploy/70-paws.rules", "lib/udev/rules.d/70-paws.rules"),
            ("deploy/paws.sysusers.conf", "usr/lib/sysusers.d/pawsd.conf"),
            ("deploy/paws.tmpfiles.conf", "usr/lib/tmpfiles.d/pawsd.conf"),
            ("deploy/pawsd.toml", "etc/paws/pawsd.toml"),
            (
                "deploy/pawsd.toml",
                "usr/share/doc/pawsd/examples/pawsd.toml",
            ),
            (
                "deploy/debian/lintian-overrides",
                "usr/share/lintian/overrides/pawsd",
            ),
        ] {
            self.put(to, read(&self.source.join(from))?)?;
        }
        for (folder, to) in EXAMPLES {
            for file in files_of(&self.source.join(folder))? {
                let name = file.file_name().context("a file has a name")?;
                self.put(Path::new(to).join(name), bytes_of(&file)?)?;
            }
        }
        for page in PAGES {
            for file in files_of(&self.source.join(page))? {
                let place = file.strip_prefix(self.source).context("a page of ours")?;
                let bytes = bytes_of(&file)?;
                let doc = Path::new("usr/share/doc/pawsd");
                match place.strip_prefix("deploy") {
                    Ok(place) => {
                        let text = String::from_utf8(bytes)
                            .with_context(|| format!("reading {}", file.display()))?;
                        self.put(doc.join(place), one_folder_up(&text))?;
                    }
                    Err(_) => self.put(doc.join(place), bytes)?,
                }
            }
        }
        let copyright = read(&self.source.join("deploy/debian/copyright"))?;
        let ours = read(&self.source.join("LICENSE-MIT"))?;
        self.put(
            "usr/share/doc/pawsd/copyright",
            copyright.replace("@MIT@", &as_field(&ours)),
        )?;
        self.put_papers()
    }

    /// The manual pages and the shells' completions, as the program writes them itself. It is the
    /// one for this machine that does so: the packaged one may be for another processor.
    fn put_papers(&self) -> Result<()> {
        let pawsd = || -> Result<Command> {
            let mut program = cargo()?;
            program.args(["run", "--quiet", "--locked", "--package=capture-daemon"]);
            program.args(["--bin=pawsd", "--"]);
            Ok(program)
        };
        let folder = self.folder.with_file_name("manual");
        if folder.exists() {
            fs::remove_dir_all(&folder)
                .with_context(|| format!("emptying {}", folder.display()))?;
        }
        process::run(pawsd()?.args(["man", "--out"]).arg(&folder))?;
        for page in files_of(&folder)? {
            let name = page.file_name().context("a page has a name")?;
            let to = format!("usr/share/man/man1/{}", name.to_string_lossy());
            self.put_compressed(&to, bytes_of(&page)?)?;
        }
        for (shell, to) in COMPLETIONS {
            self.put(to, output(pawsd()?.args(["completions", shell]))?)?;
        }
        Ok(())
    }

    /// A file that all may read.
    pub(super) fn put(&self, path: impl AsRef<Path>, bytes: impl AsRef<[u8]>) -> Result<()> {
        let to = self.folder.join(path);
        make_folder(to.parent().context("a file has a folder")?)?;
        write(&to, bytes)?;
        set_mode(&to, 0o644)
    }

    /// The same, compressed as Debian wants its documents: with the ending `.gz`, the same bytes
    /// every time.
    pub(super) fn put_compressed(&self, path: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        self.put(path, bytes)?;
        let mut gzip = process::command("gzip")?;
        process::run(gzip.args(["-9", "--no-name"]).arg(self.folder.join(path)))
    }
}

/// The unit with the program where the package has it.
fn packaged_unit(unit: &str) -> Result<String> {
    let unit = unit.replace(BY_HAND, PACKAGED);
    let starts = format!("ExecStart={PACKAGED} ");
    ensure!(
        unit.contains(&starts),
        "deploy/pawsd.service should start {BY_HAND}, and has no line that begins with {starts:?}"
    );
    Ok(unit)
}

/// A page of `deploy` with its links to `docs` for a place one folder up.
fn one_folder_up(page: &str) -> String {
    page.replace("](../docs/", "](docs/")
        .replace("](../../docs/", "](../docs/")
}

/// A text as a field of a control file: indented, with a dot for every empty line.
fn as_field(text: &str) -> String {
    text.lines()
        .map(|line| match line.trim_end() {
            "" => " .".to_owned(),
            line => format!(" {line}"),
        })
        .collect::<Vec<_>>()
        .join("\n")
}

/// The files of a folder, in their order; of a file, itself.
fn files_of(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let reading = || format!("reading {}", path.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(path).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        if path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn bytes_of(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("reading {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_packaged_unit_starts_the_packaged_program() -> Result<()> {
        let unit = packaged_unit(include_str!("../../../../../deploy/pawsd.service"))?;
        assert!(unit.contains("ExecStart=/usr/bin/pawsd run"));
        assert!(!unit.contains("/usr/local"));
        assert!(packaged_unit("ExecStart=/opt/pawsd run").is_err());
        Ok(())
    }

    #[test]
    fn links_of_pages_follow_their_new_place() {
        assert_eq!(
            one_folder_up("[a](../docs/a.md) [b](../../docs/b.md) [c](runbooks/c.md)"),
            "[a](docs/a.md) [b](../docs/b.md) [c](runbooks/c.md)"
        );
    }

    #[test]
    fn empty_lines_of_a_field_are_dots() {
        assert_eq!(as_field("one\n\ntwo\n"), " one\n .\n two");
    }
}
