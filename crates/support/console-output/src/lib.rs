//! What commands on the host write, the same in every program.
//!
//! * [`Console`]: results on standard output, and the clocks ([`Clock`]) of a command.
//! * [`Progress`] over bytes, on standard error.
//! * [`Outcome`]: what a command returns, and its exit code.
//! * [`run_command`]: the run of one command in a program, with its errors.
//! * [`text`]: numbers as text.

mod clock;
mod console;
mod outcome;
mod program;
mod progress;
pub mod text;

pub use clock::Clock;
pub use console::Console;
pub use outcome::Outcome;
pub use program::{BadArguments, run_command, start_logger};
pub use progress::{Progress, Show};
