//! How much a program says on standard error.

use clap::{ArgAction, Args};
use env_logger::Builder;
use log::LevelFilter;

/// `-v` and `-q`, before or behind the verb.
#[derive(Args, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verbosity {
    /// Say more on standard error; -vv: everything
    #[arg(short, long, global = true, action = ArgAction::Count, conflicts_with = "quiet")]
    verbose: u8,
    /// Say on standard error only what failed: no progress, no warnings
    #[arg(short, long, global = true)]
    quiet: bool,
}

impl Verbosity {
    /// Whether nothing but failures is to be said.
    pub fn is_quiet(self) -> bool {
        self.quiet
    }

    /// The options that say the same to another program.
    pub fn options(self) -> Vec<&'static str> {
        let mut options = vec!["-v"; self.verbose.into()];
        if self.quiet {
            options.push("-q");
        }
        options
    }

    /// The level for a program that logs at `usual` when nobody says otherwise.
    pub fn level(self, usual: LevelFilter) -> LevelFilter {
        match (self.quiet, self.verbose) {
            (true, _) => LevelFilter::Error,
            (false, 0) => usual,
            (false, 1) if usual < LevelFilter::Info => LevelFilter::Info,
            (false, 1) => LevelFilter::Debug,
            (false, _) => LevelFilter::Trace,
        }
    }

    /// A logger at that level. Without `-v` and `-q` the variable `RUST_LOG` counts, where it is
    /// set.
    pub fn logger(self, usual: LevelFilter) -> Builder {
        if self == Self::default() {
            let usual = env_logger::Env::default().default_filter_or(usual.to_string());
            return Builder::from_env(usual);
        }
        let mut builder = Builder::new();
        builder.filter_level(self.level(usual));
        builder
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        verbosity: Verbosity,
    }

    fn level(words: &[&str], usual: LevelFilter) -> Option<LevelFilter> {
        let words = ["test"].iter().chain(words);
        let cli = Cli::try_parse_from(words).ok()?;
        Some(cli.verbosity.level(usual))
    }

    #[test]
    fn more_and_less() {
        use LevelFilter::{Debug, Error, Info, Trace, Warn};
        for (words, from_warn, from_info) in [
            (&[][..], Warn, Info),
            (&["-v"], Info, Debug),
            (&["-vv"], Trace, Trace),
            (&["-v", "--verbose"], Trace, Trace),
            (&["--quiet"], Error, Error),
        ] {
            assert_eq!(level(words, Warn), Some(from_warn), "{words:?}");
            assert_eq!(level(words, Info), Some(from_info), "{words:?}");
        }
        assert_eq!(level(&["-q", "-v"], Warn), None);
    }
}
