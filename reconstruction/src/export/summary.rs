//! Counts of an export.

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Name of each camera and number of stereo frames written, two images each.
    pub cameras: Vec<(String, u64)>,
    /// Name of each IMU and samples written.
    pub imus: Vec<(String, u64)>,
    /// Frame sets written.
    pub sets: u64,
    /// Everything selected that could not be read, with the reason.
    pub lost: Vec<String>,
}
