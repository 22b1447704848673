//! Shared code of the end-to-end tests, and the long runs that `bench` repeats at full length.
//!
//! - [`rig`]: synthetic rigs, as configurations and as ground truth of their data.
//! - [`cameras`]: two USB cameras of a simulated walk, without hardware.
//! - [`contents`]: a whole session in memory, and its decoded images.
//! - [`data`], [`program`]: paths of the real recordings and the built programs.
//! - [`faults`]: random fault schedules, and whether the session accounts for them.
//! - [`footage`]: a simulated walk as bags and video files of other tools.
//! - [`kills`]: kills a recorder at random and checks the result.
//! - [`sequences`]: frame sets with ground truth for odometry: real recordings and simulated walks.
//! - [`soak`]: records for hours of virtual time and monitors the memory.
//! - [`tracking`]: odometry over a sequence, as poses that can be compared with ground truth.
//! - [`walks`]: simulated walks as input of the verification of a calibration.
//!
//! Failures are returned as errors; the tests turn them into panics.

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
