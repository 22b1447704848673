//! Visual front end: image pyramids, corner detection, KLT tracking, stereo and cross-camera matching.

pub(crate) mod descriptor;
pub(crate) mod detector;
pub(crate) mod klt;
pub(crate) mod pyramid;
pub(crate) mod stale_image;
pub(crate) mod tracker;
