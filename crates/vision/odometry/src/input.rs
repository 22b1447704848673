//! Input of the estimator: frame sets and IMU samples.

use calib::verify::ImageView;

/// Frame set: the frames of one instant, one entry per camera in the order of the rig; `None` if a
/// camera has no frame.
#[derive(Clone, Debug)]
pub struct FrameSet<'a> {
    /// Time of the set, ns. The pose is estimated at this time.
    pub time_ns: i64,
    /// Frames of the cameras.
    pub views: Vec<Option<View<'a>>>,
}

/// Stereo frame of one camera.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Mid-exposure of the middle row, ns; may differ from the time of the set.
    pub time_ns: i64,
    /// Left image.
    pub left: ImageView<'a>,
    /// Right image.
    pub right: ImageView<'a>,
    /// Mask of the left image, row-major: features are not tracked at 0, since the image moves
    /// there. `None` for all pixels: moving features are also rejected as outliers.
    pub mask: Option<&'a [u8]>,
}

/// One IMU sample, in the frame of the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time, ns.
    pub time_ns: i64,
    /// Angular rate, rad/s.
    pub gyro: [f64; 3],
    /// Specific force, m/s².
    pub accel: [f64; 3],
}
