//! Visual front end: corner detection, tracking over time (by [`imaging::klt`]), stereo and
//! cross-camera matching.

pub(crate) mod descriptor;
pub(crate) mod detector;
pub(crate) mod stale_image;
pub(crate) mod tracker;
