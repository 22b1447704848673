//! What the command lines of all programs share, so that they behave alike.
//!
//! * [`examples`]: the section `Examples` at the end of each verb's help, and a check that every
//!   example is a command line that the program takes.
//! * [`help`]: a check that helps list the words that options take, and name the units of numbers.
//! * [`Papers`]: the verbs `completions` and `man`, made by clap's own generators out of what the
//!   program itself reads.
//! * [`Verbosity`]: `-v` and `-q`.
//! * [`remedy`]: command lines that calibrate a rig, for messages about one that is not.
//! * [`output`]: results on standard output and messages on standard error, for which nobody has to
//!   be listening.
//!
//! `docs/reference/command-line.md` says what a user may rely on.

pub mod examples;
pub mod help;
pub mod output;
mod papers;
pub mod remedy;
mod verbosity;

pub use self::papers::Papers;
pub use self::verbosity::Verbosity;
