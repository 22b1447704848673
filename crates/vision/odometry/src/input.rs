//! Input of the estimator: frame sets and IMU samples.

use imaging::ImageView;

/// Frame set: the frames of one instant, one entry per camera in the order of the rig; `None` if a
/// camera has no frame.
///
/// A camera without a frame has `None` in its place; without any frame the pose has no inliers:
///
/// ```
/// use odometry::{Config, FrameSet, Odometry, Preset, Rig, Status};
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion};
/// # use odometry::rig::StereoCamera;
/// # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
/// # let camera = StereoCamera {
/// #     name: "front".to_owned(),
/// #     left: lens,
/// #     right: lens,
/// #     rig_from_left: RigidTransform::identity(),
/// #     covariance: None,
/// #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
/// #     right_from_left_covariance: None,
/// #     line_s: 0.0,
/// # };
/// # let rig = Rig { cameras: vec![camera], imus: Vec::new() };
/// let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
/// let estimate = odometry.add_frames(&FrameSet { time_ns: 5, views: vec![None] });
/// assert_eq!((estimate.time_ns, estimate.inliers), (5, 0));
/// assert_ne!(estimate.status, Status::Tracked);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FrameSet<'a> {
    /// Time of the set, ns. The pose is estimated at this time.
    pub time_ns: i64,
    /// Frames of the cameras.
    pub views: Vec<Option<View<'a>>>,
}

/// Stereo frame of one camera.
///
/// Features are not tracked where the mask is 0, here in the right half:
///
/// ```
/// use odometry::{Config, FrameSet, Odometry, Preset, Rig, View};
/// # use cad_transforms::RigidTransform;
/// # use imaging::ImageView;
/// # use camera_models::{CameraModel, Distortion};
/// # use odometry::rig::StereoCamera;
/// # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
/// # let camera = StereoCamera {
/// #     name: "front".to_owned(),
/// #     left: lens,
/// #     right: lens,
/// #     rig_from_left: RigidTransform::identity(),
/// #     covariance: None,
/// #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
/// #     right_from_left_covariance: None,
/// #     line_s: 0.0,
/// # };
/// # // Gray patches of 5 x 5 pixels, shifted to the left, with sensor noise of each image.
/// # let image = |shift: usize, noise: u64| -> Vec<u8> {
/// #     let hash = |a: u64| (a.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as u8;
/// #     let gray = |i: usize| {
/// #         let (x, y) = (i % 160, i / 160);
/// #         let patch = hash(((x + shift) / 5 * 1009 + y / 5) as u64);
/// #         40 + patch / 2 + hash(noise.wrapping_mul(7919) + i as u64) % 3
/// #     };
/// #     (0..160 * 120).map(gray).collect()
/// # };
/// # let rig = Rig { cameras: vec![camera], imus: Vec::new() };
/// let mask: Vec<u8> = (0..160 * 120).map(|i| if i % 160 < 80 { 255 } else { 0 }).collect();
/// let (left, right) = (image(0, 1), image(4, 2));
/// let [left, right] = [&left, &right].map(|pixels| ImageView::new(160, 120, 160, pixels).unwrap());
/// let view = View { time_ns: 0, left, right, mask: Some(&mask) };
/// let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
/// odometry.add_frames(&FrameSet { time_ns: 0, views: vec![Some(view)] });
///
/// let features = odometry.tracked_features(0);
/// assert!(features.len() > 5, "{} features", features.len());
/// assert!(features.iter().all(|(_, at)| at[0] < 80.0), "{features:?}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
