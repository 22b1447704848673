//! What the end-to-end tests share, and the long runs that `bench` repeats at full length.
//!
//! - [`rig`]: made-up rigs, as configurations and as the truth about what they deliver.
//! - [`contents`]: a whole session in memory, and its decoded pictures.
//! - [`data`], [`program`]: where the real recordings and the built programs are.
//! - [`faults`]: random schedules of faults, and whether the session tells them.
//! - [`kills`]: kills a recorder at random and looks at what is left.
//! - [`soak`]: records for hours of virtual time and watches the memory.
//! - [`walks`]: simulated walks as the verification of a calibration sees them.
//!
//! Everything here says what is wrong by an error; the tests turn it into a failure.

pub mod contents;
pub mod data;
pub mod faults;
pub mod kills;
pub mod program;
pub mod rig;
pub mod soak;
pub mod walks;
