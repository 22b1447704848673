//! The verbs `completions` and `man`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Command, Subcommand, ValueEnum};
use clap_complete::Shell;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};

use crate::examples::HEADING;

/// What a program can write about itself.
#[derive(Clone, Debug, Subcommand)]
pub enum Papers {
    /// Print the completion script of a shell
    #[command(
        after_help = "bash reads it with `source`, or from ~/.local/share/bash-completion/completions/PROGRAM;\n\
                      zsh from a folder of its fpath as _PROGRAM; fish from ~/.config/fish/completions/PROGRAM.fish."
    )]
    Completions {
        /// The shell
        #[arg(value_enum)]
        shell: ShellName,
    },
    /// Write the manual pages: one for the program and one for each verb
    #[command(after_help = "`man -l DIR/PROGRAM.1` shows one.")]
    Man {
        /// Folder for the pages; made if it is not there
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

/// A shell that completes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ShellName {
    /// GNU Bash
    Bash,
    /// Zsh
    Zsh,
    /// fish
    Fish,
}

impl Papers {
    /// Writes the requested output: completions to `out`, manual pages to their folder. `command`
    /// is the program's.
    ///
    /// # Errors
    /// The file system reports an I/O error, or the reader of `out` has closed it.
    pub fn write(&self, command: Command, out: &mut dyn Write) -> Result<()> {
        match self {
            Self::Completions { shell } => {
                out.write_all(&completions(command, *shell))?;
                Ok(out.flush()?)
            }
            Self::Man { out } => pages(command, out)
                .with_context(|| format!("writing manual pages to {}", out.display())),
        }
    }
}

fn completions(mut command: Command, shell: ShellName) -> Vec<u8> {
    let shell = match shell {
        ShellName::Bash => Shell::Bash,
        ShellName::Zsh => Shell::Zsh,
        ShellName::Fish => Shell::Fish,
    };
    let name = command.get_name().to_owned();
    // Into memory: the generator panics when its output is closed.
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, name, &mut script);
    script
}

fn pages(command: Command, folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    page(&command, folder)
}

fn page(command: &Command, folder: &Path) -> io::Result<()> {
    for verb in command.get_subcommands().filter(|c| !c.is_hide_set()) {
        page(verb, folder)?;
    }
    let version = command.get_version().unwrap_or_default();
    let man = Man::new(command.clone())
        .source(format!("PAWS toolkit {version}").trim_end())
        .manual("PAWS toolkit");
    let mut text = Vec::new();
    man.render_title(&mut text)?;
    man.render_name_section(&mut text)?;
    man.render_synopsis_section(&mut text)?;
    man.render_description_section(&mut text)?;
    if command.get_arguments().any(|a| !a.is_hide_set()) {
        man.render_options_section(&mut text)?;
    }
    if command.get_subcommands().any(|c| !c.is_hide_set()) {
        man.render_subcommands_section(&mut text)?;
    }
    notes(command).to_writer(&mut text)?;
    std::fs::write(folder.join(man.get_filename()), text)
}

/// What stands behind the options in the help: notes and examples, with their line breaks.
fn notes(command: &Command) -> Roff {
    let mut roff = Roff::default();
    let help = command.get_after_help().map(ToString::to_string);
    let help = help.unwrap_or_default();
    let (notes, examples) = match help.split_once(HEADING) {
        Some((notes, examples)) => (notes.trim_end(), examples),
        None => (help.trim_end(), ""),
    };
    for (title, text) in [("NOTES", notes), ("EXAMPLES", examples)] {
        if text.trim().is_empty() {
            continue;
        }
        roff.control("SH", [title]);
        roff.control("nf", []);
        for line in text.trim_matches('\n').lines() {
            roff.text([roman(line)]);
        }
        roff.control("fi", []);
    }
    roff
}

#[cfg(test)]
mod tests {
    use clap::{Arg, CommandFactory, Parser};

    use super::*;

    fn program() -> Command {
        let go = Command::new("go")
            .about("Go somewhere")
            .arg(Arg::new("fast").long("fast").help("Be quick"))
            .after_help("Slow.\n\nExamples:\n  # away\n  tool go --fast x");
        Command::new("tool")
            .version("1")
            .about("A tool")
            .subcommand(go)
    }

    #[test]
    fn each_verb_has_a_page() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("man");
        let papers = Papers::Man { out: out.clone() };
        papers.write(program(), &mut Vec::new()).unwrap();
        let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
        let go = read("tool-go.1");
        for part in [
            ".SH NAME",
            "Go somewhere",
            "\\-\\-fast",
            "Be quick",
            ".SH NOTES\n.nf\nSlow.\n.fi",
            ".SH EXAMPLES\n.nf\n  # away\n  tool go \\-\\-fast x\n.fi",
        ] {
            assert!(go.contains(part), "{part:?} is not in\n{go}");
        }
        assert!(read("tool.1").contains("A tool"));
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 2);
    }

    #[test]
    fn each_shell_has_a_script_that_knows_verbs_and_options() {
        for shell in ShellName::value_variants() {
            let mut script = Vec::new();
            let papers = Papers::Completions { shell: *shell };
            papers.write(program(), &mut script).unwrap();
            let script = String::from_utf8(script).unwrap();
            for part in ["tool", "go", "fast"] {
                assert!(script.contains(part), "{shell:?}: no {part:?} in\n{script}");
            }
        }
    }

    #[test]
    fn the_verbs_fit_into_a_program() {
        #[derive(Parser)]
        enum Verbs {
            #[command(flatten)]
            Papers(Papers),
        }
        Verbs::command().debug_assert();
        let parsed = Verbs::try_parse_from(["tool", "completions", "zsh"]);
        assert!(matches!(
            parsed,
            Ok(Verbs::Papers(Papers::Completions {
                shell: ShellName::Zsh
            }))
        ));
    }
}
