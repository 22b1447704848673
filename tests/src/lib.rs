//! What the end-to-end tests share, and the long runs that `bench` repeats at full length.
//!
//! - [`rig`]: made-up rigs, as configurations and as the truth about what they deliver.
//! - [`cameras`]: two USB cameras of a simulated walk, without a device.
//! - [`contents`]: a whole session in memory, and its decoded pictures.
//! - [`data`], [`program`]: where the real recordings and the built programs are.
//! - [`faults`]: random schedules of faults, and whether the session tells them.
//! - [`footage`]: a simulated walk as bags and video files, as others would have recorded it.
//! - [`kills`]: kills a recorder at random and looks at what is left.
//! - [`sequences`]: frame sets with their truth for odometry: real recordings and simulated walks.
//! - [`soak`]: records for hours of virtual time and watches the memory.
//! - [`tracking`]: odometry over a sequence, as poses that can be compared with the truth.
//! - [`walks`]: simulated walks as the verification of a calibration sees them.
//!
//! Everything here says what is wrong by an error; the tests turn it into a failure.

pub mod cameras;
pub mod contents;
pub use test_data as data;
pub mod faults;
pub mod footage;
pub mod kills;
pub mod program;
pub mod rig;
pub mod sequences;
pub mod soak;
pub mod tracking;
pub mod walks;
