//! Feature tracks of a burst: corners of the left image, matched in the right image and tracked for
//! a third of a second.
//!
//! Contract: the result depends on the images alone; the nominal calibration only sets the start of
//! searches. Eyes rotated against each other by up to 1.5° are matched, and a gyroscope only
//! predicts positions. A feature that cannot be found reliably is dropped.

use camera_models::{Lens, StereoCalibration};
use imaging::{ImageView, klt};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::config::{Config, TrackingConfig};
use super::corners::corners;
use super::epipolar_search::{self, Area};
use super::gyro::{Gyro, IntegratedGyro};
use super::pyramid::ScaledPyramid;

/// Side of tracked patches, px.
const PATCH_SIDE: usize = 11;

/// One stereo frame.
#[derive(Clone, Copy, Debug)]
pub struct StereoFrame<'a> {
    /// Mid-exposure of the middle row, ns.
    pub time_ns: i64,
    /// Left image.
    pub left: ImageView<'a>,
    /// Right image.
    pub right: ImageView<'a>,
}

/// A feature, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feature {
    /// Position in the left image.
    pub left: [f64; 2],
    /// Position in the right image, if matched.
    pub right: Option<[f64; 2]>,
    /// Position in the left image at the end of the segment, if tracked.
    pub later: Option<[f64; 2]>,
}

/// Feature tracks between two frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackSegment {
    /// Time of the first frame, ns.
    pub from_ns: i64,
    /// Time of the last frame, ns.
    pub to_ns: i64,
    /// The features.
    pub features: Vec<Feature>,
}

/// Feature tracks of a burst of frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Burst {
    /// In order of time.
    pub segments: Vec<TrackSegment>,
}

/// Tracks features through the frames of one burst of one camera.
pub struct FeatureTracker<'a> {
    config: TrackingConfig,
    lenses: [Lens; 2],
    right_from_left: (UnitQuaternion<f64>, Vector3<f64>),
    /// Gyroscope for prediction, with its extrinsics.
    gyro: Option<(UnitQuaternion<f64>, IntegratedGyro<'a>)>,
    previous: Option<PreviousFrame>,
    burst: Burst,
}

/// The previous frame and the features being tracked.
struct PreviousFrame {
    left: ScaledPyramid,
    time_ns: i64,
    /// Oldest first.
    sets: Vec<Set>,
}

/// Features detected in one frame.
struct Set {
    from_ns: i64,
    features: Vec<TrackedFeature>,
}

impl Set {
    /// Number of stereo-matched features, and of those still tracked.
    fn tracked_counts(&self) -> (usize, usize) {
        let both = self.features.iter().filter(|f| f.feature.right.is_some());
        (
            both.clone().count(),
            both.filter(|f| f.now.is_some()).count(),
        )
    }
}

struct TrackedFeature {
    feature: Feature,
    /// Current position, pixels of the pyramid's first level; `None` once it is lost.
    now: Option<[f32; 2]>,
    /// Error of the last prediction.
    off: [f32; 2],
}

impl<'a> FeatureTracker<'a> {
    /// Tracker for a camera with this calibration; `gyro` is the camera's own.
    pub fn new(calibration: &StereoCalibration, gyro: Option<&'a Gyro>, config: &Config) -> Self {
        let right_from_left = &calibration.right_from_left;
        let imu = calibration.imu.as_ref().zip(gyro);
        let gyro = imu.map(|(imu, gyro)| {
            let rotation = *imu.imu_from_left.rotation();
            (
                rotation,
                gyro.integrate(
                    Vector3::repeat(1.0),
                    Vector3::zeros(),
                    config.camera_imu.max_gap_s,
                ),
            )
        });
        Self {
            config: config.tracking,
            lenses: [Lens::new(&calibration.left), Lens::new(&calibration.right)],
            right_from_left: (*right_from_left.rotation(), *right_from_left.translation()),
            gyro,
            previous: None,
            burst: Burst::default(),
        }
    }

    /// Adds the next frame of the burst.
    pub fn push(&mut self, frame: &StereoFrame<'_>) {
        let left = ScaledPyramid::new(&frame.left, &self.config);
        let (time_ns, scale) = (frame.time_ns, left.scale);
        let mut sets = Vec::new();
        if let Some(before) = self.previous.take() {
            let rotation = self.rotation(time_ns, before.time_ns);
            for mut set in before.sets {
                for tracked in &mut set.features {
                    self.track(tracked, &before.left, &left, &rotation);
                }
                let seconds = (time_ns - set.from_ns) as f64 * 1e-9;
                let (both, tracked_counts) = set.tracked_counts();
                let is_thin = (tracked_counts as f64) < self.config.min_tracked_ratio * both as f64;
                if is_thin || seconds >= self.config.segment_s - 1e-3 {
                    self.finish(set, time_ns, scale);
                } else {
                    sets.push(set);
                }
            }
        }
        let newest = sets.last().map(|s| (time_ns - s.from_ns) as f64 * 1e-9);
        if newest.is_none_or(|age_s| age_s >= self.config.detection_interval_s - 1e-3) {
            sets.push(self.start(&left, frame));
        }
        self.previous = Some(PreviousFrame {
            left,
            time_ns,
            sets,
        });
    }

    /// Ends the burst.
    pub fn end(&mut self) -> Burst {
        if let Some(before) = self.previous.take() {
            let scale = before.left.scale;
            for set in before.sets {
                self.finish(set, before.time_ns, scale);
            }
        }
        std::mem::take(&mut self.burst)
    }

    /// Tracks one feature into the next frame.
    fn track(
        &self,
        tracked: &mut TrackedFeature,
        before: &ScaledPyramid,
        left: &ScaledPyramid,
        rotation: &UnitQuaternion<f64>,
    ) {
        let Some(at) = tracked.now else { return };
        let predicted = self.predict(at, rotation, left.scale);
        let guess = [predicted[0] + tracked.off[0], predicted[1] + tracked.off[1]];
        tracked.now = klt::track::<PATCH_SIDE>(
            &self.config.klt,
            &before.pyramid,
            &left.pyramid,
            at,
            guess,
            self.config.max_level,
        );
        if let Some(now) = tracked.now {
            tracked.off = [now[0] - predicted[0], now[1] - predicted[1]];
        }
    }

    /// Finishes the segment of a feature set.
    fn finish(&mut self, set: Set, time_ns: i64, scale: f64) {
        let is_long = (time_ns - set.from_ns) as f64 * 1e-9 >= self.config.min_segment_s;
        let features = set.features.into_iter().map(|f| Feature {
            later: f
                .now
                .filter(|_| is_long)
                .map(|at| at.map(|v| f64::from(v) * scale)),
            ..f.feature
        });
        self.burst.segments.push(TrackSegment {
            from_ns: set.from_ns,
            to_ns: time_ns,
            features: features.collect(),
        });
    }

    /// Detects features and matches them in the right image.
    fn start(&self, left: &ScaledPyramid, frame: &StereoFrame<'_>) -> Set {
        let right = ScaledPyramid::new(&frame.right, &self.config);
        let scale = left.scale;
        let found = corners(
            &left.pyramid.levels[0],
            self.config.max_corners,
            &self.config.corners,
        );
        let features = found.into_iter().map(|at| {
            let pixel = at.map(|v| f64::from(v) * scale);
            let match_stereo = self.match_stereo(left, &right, at, pixel);
            TrackedFeature {
                feature: Feature {
                    left: pixel,
                    right: match_stereo.map(|at| at.map(|v| f64::from(v) * scale)),
                    later: None,
                },
                now: Some(at),
                off: [0.0; 2],
            }
        });
        Set {
            from_ns: frame.time_ns,
            features: features.collect(),
        }
    }

    fn match_stereo(
        &self,
        left: &ScaledPyramid,
        right: &ScaledPyramid,
        at: [f32; 2],
        pixel: [f64; 2],
    ) -> Option<[f32; 2]> {
        let ray = Vector3::from(self.lenses[0].unproject(pixel)?);
        let (rotation, origin) = self.right_from_left;
        let seen = |per_metre: f64| {
            let x = rotation * ray + origin * per_metre;
            self.lenses[1].project([x.x, x.y, x.z])
        };
        let far = seen(0.0)?;
        let near = seen(1.0 / self.config.min_distance_m).unwrap_or(far);
        let model = self.lenses[1].model();
        let (reach_x, reach_y) = {
            let side = f64::from(model.width.max(model.height));
            let most = self.config.max_stereo_rotation_rad;
            let tilt = 0.5 * side * most;
            (model.fx * most, model.fy * most + 0.5 * tilt)
        };
        let level = self.config.search_level.min(left.pyramid.levels.len() - 1);
        let per_level = left.scale * f64::from(1_u32 << level);
        let area = Area {
            x: [
                (far[0].min(near[0]) - reach_x) / per_level,
                (far[0].max(near[0]) + reach_x) / per_level,
            ],
            y: [
                (far[1].min(near[1]) - reach_y) / per_level,
                (far[1].max(near[1]) + reach_y) / per_level,
            ],
        };
        let coarse = at.map(|v| v / (1_u32 << level) as f32);
        let found = epipolar_search::search(
            &left.pyramid.levels[level],
            &right.pyramid.levels[level],
            coarse,
            &area,
            &self.config.search,
        )?;
        // The patch is at subpixel positions in the left image as well.
        let guess = found.map(|v| v * (1_u32 << level) as f32);
        let (left, right) = (&left.pyramid, &right.pyramid);
        klt::track::<PATCH_SIDE>(&self.config.klt, left, right, at, guess, level)
    }

    /// Rotation between two frames by the gyroscope, identity if unknown.
    fn rotation(&self, to_ns: i64, from_ns: i64) -> UnitQuaternion<f64> {
        let rotation = self.gyro.as_ref().and_then(|(imu_from_left, gyro)| {
            let rotation = gyro.to_from(to_ns as f64, from_ns as f64)?;
            Some(imu_from_left.inverse() * rotation * imu_from_left)
        });
        rotation.unwrap_or_default()
    }

    /// Predicted position of a far point after a rotation, pixels of the first level.
    fn predict(&self, at: [f32; 2], rotation: &UnitQuaternion<f64>, scale: f64) -> [f32; 2] {
        let lens = &self.lenses[0];
        let moved = || {
            let pixel = at.map(|v| f64::from(v) * scale);
            let ray = Vector3::from(lens.unproject(pixel)?);
            let (was, x) = (lens.project(ray.into())?, rotation * ray);
            let is = lens.project(x.into())?;
            Some([0, 1].map(|k| at[k] + ((is[k] - was[k]) / scale) as f32))
        };
        moved().unwrap_or(at)
    }
}
