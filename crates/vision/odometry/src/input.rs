//! What odometry is fed with.

use calib::verify::ImageView;

/// The pictures of one instant, one entry for each camera of the rig, in its order; `None` where a camera has none.
#[derive(Clone, Debug)]
pub struct FrameSet<'a> {
    /// Time of the set, ns. The pose is asked for at this time.
    pub time_ns: i64,
    /// The pictures.
    pub views: Vec<Option<View<'a>>>,
}

/// The stereo picture of one camera.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Middle of the exposure of the middle row, ns; may differ from the set's.
    pub time_ns: i64,
    /// Left eye.
    pub left: ImageView<'a>,
    /// Right eye.
    pub right: ImageView<'a>,
    /// Which pixels of the left eye's picture may be followed, rows first: 0 may not, since something moves there. None for all:
    /// what moves is found out by its going elsewhere, too.
    pub mask: Option<&'a [u8]>,
}

/// One reading of an IMU, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time, ns.
    pub time_ns: i64,
    /// Turn rate, rad/s.
    pub gyro: [f64; 3],
    /// Specific force, m/s².
    pub accel: [f64; 3],
}
