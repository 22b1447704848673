//! Shoe tags in the frames of stereo cameras.
//!
//! Contract: frames come in order of time, with the pose and the motion of the rig. Each tag of a
//! foot is fitted where the foot is predicted, in both eyes, with its motion; where it is not, it
//! is searched near there, and after a while in the whole image: as a quadrilateral, and, where the
//! motion of the rig blurs a tag at rest, by the pattern of such a tag. What a frame does not show
//! gives no detection, nor does one that repeats the image before it while the rig moves.
//! Detections depend on earlier frames through the prediction only: their poses are those of the
//! images.

use cad_transforms::RigidTransform;
use camera_models::Lens;
use fiducials::{Fit, Motion, Searcher, View, fit, locate, poses_from_corners};
use imaging::ImageView;
use nalgebra::Vector3;

use crate::config::Config;
use crate::eye_agreement;
use crate::poses;
use crate::prediction::{FootMotion, FootPose};
use crate::repeated_image::LastImage;
use crate::shoe::{Shoe, ShoeTag};

/// A stereo camera of the rig.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Lenses of the left and the right eye.
    pub lenses: [Lens; 2],
    /// Take points of each eye to the rig, m.
    pub rig_from_eye: [RigidTransform; 2],
    /// Time from row to row, s.
    pub line_s: f64,
}

/// A frame of one stereo camera.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Index of the camera.
    pub camera: usize,
    /// Middle of the exposure of the middle row, ns.
    pub time_ns: i64,
    /// Left and right image.
    pub images: [ImageView<'a>; 2],
    /// Exposure, s; 0 if unknown.
    pub exposure_s: f64,
    /// Pose of the rig at that time; `None` if it is unknown: then there is no prediction.
    pub rig: Option<RigState>,
}

/// Pose of the rig in the world, and its motion there.
#[derive(Clone, Copy, Debug)]
pub struct RigState {
    /// Takes points of the rig to the world, m.
    pub world_from_rig: RigidTransform,
    /// Of its origin, m/s, and its angular rate, rad/s.
    pub motion: Motion,
}

/// A tag in a frame.
#[derive(Clone, Debug)]
pub struct Detection {
    /// Time of the frame, ns.
    pub time_ns: i64,
    /// Index of the camera.
    pub camera: usize,
    /// Index of the shoe, and of the tag on it.
    pub shoe: usize,
    /// See `shoe`.
    pub tag: usize,
    /// Pose of the tag in the rig, and how it was fitted.
    pub fit: Fit,
    /// From the ray of the left eye to that of the right one at the distance that the size of the
    /// tag says, to the right and down, m; `None` where both were not compared.
    pub between_eyes: Option<[f64; 2]>,
}

/// Tracks the tags of shoes.
#[derive(Clone, Debug)]
pub struct TagTracker {
    shoes: Vec<Shoe>,
    cameras: Vec<Camera>,
    config: Config,
    /// By camera.
    searchers: Vec<Searcher>,
    /// By shoe.
    feet: Vec<Option<FootMotion>>,
    /// Number of frames before this one, by camera: frames of cameras that are triggered together
    /// alternate.
    frames: Vec<u64>,
    /// Last left image by camera, and number of frames that repeat it.
    last: Vec<LastImage>,
    repeated: u64,
}

impl TagTracker {
    /// A tracker of these shoes in these cameras.
    pub fn new(shoes: Vec<Shoe>, cameras: Vec<Camera>, config: Config) -> Self {
        let searcher = |camera: &Camera| {
            let mut detection = config.search.detection;
            let most_px = largest_px(&shoes, camera, config.search.min_distance_m);
            let extent = &mut detection.regions.max_extent_px;
            *extent = (*extent).min(most_px);
            Searcher::new(boards::Dictionary::AprilTag36h11, &detection)
        };
        Self {
            searchers: cameras.iter().map(searcher).collect(),
            feet: vec![None; shoes.len()],
            frames: vec![0; cameras.len()],
            last: vec![LastImage::default(); cameras.len()],
            repeated: 0,
            shoes,
            cameras,
            config,
        }
    }

    /// The tags in a frame.
    ///
    /// # Panics
    /// If the rig has no such camera.
    pub fn add(&mut self, frame: &Frame<'_>) -> Vec<Detection> {
        if self.is_repeated(frame) {
            self.repeated += 1;
            self.frames[frame.camera] += 1;
            return Vec::new();
        }
        let mut found = Vec::new();
        for shoe in 0..self.shoes.len() {
            found.extend(self.predicted(frame, shoe));
        }
        let missing: Vec<usize> = (0..self.shoes.len())
            .filter(|&shoe| {
                let foot = &self.feet[shoe];
                let is_lost =
                    |foot: &FootMotion| foot.age_s(frame.time_ns) > self.config.search.lost_s;
                foot.as_ref().is_none_or(is_lost) && found.iter().all(|seen| seen.shoe != shoe)
            })
            .collect();
        if !missing.is_empty() {
            found.extend(self.searched(frame, &missing));
        }
        for shoe in 0..self.shoes.len() {
            let own: Vec<&Detection> = found.iter().filter(|seen| seen.shoe == shoe).collect();
            self.update(frame, shoe, &own);
        }
        self.frames[frame.camera] += 1;
        found
    }

    /// Number of frames so far that repeat the image before them while the rig moves: they show
    /// nothing of their time.
    pub fn repeated_images(&self) -> u64 {
        self.repeated
    }

    fn is_repeated(&mut self, frame: &Frame<'_>) -> bool {
        let config = &self.config.repeated;
        let repeats = self.last[frame.camera].is_repeated(&frame.images[0], config);
        let moves = frame.rig.is_some_and(|rig| {
            let sizes =
                [rig.motion.linear, rig.motion.angular].map(|own| Vector3::from(own).norm());
            (0..2).any(|k| sizes[k] > config.min_motion[k])
        });
        repeats && moves
    }

    /// Tags of a shoe where they are predicted, or near there.
    fn predicted(&self, frame: &Frame<'_>, shoe: usize) -> Vec<Detection> {
        let (Some(foot), Some(rig)) = (&self.feet[shoe], &frame.rig) else {
            return Vec::new();
        };
        if foot.age_s(frame.time_ns) > self.config.search.lost_s {
            return Vec::new();
        }
        let (world_from_foot, velocity) = foot.at(frame.time_ns, &self.config.prediction);
        let rig_from_foot = rig.world_from_rig.inverse() * world_from_foot;
        let tags = self.shoes[shoe].tags.iter().enumerate();
        tags.filter_map(|(tag, shoe_tag)| {
            let start = rig_from_foot * shoe_tag.foot_from_tag;
            let motion = motion_in_rig(rig, &world_from_foot, shoe_tag, &velocity);
            let at_rest = [foot.last_pose(), world_from_foot];
            let fit = self
                .fit(frame, shoe_tag, &start, &motion)
                .or_else(|| self.at_rest(frame, shoe_tag, &at_rest, self.config.search.near_m))
                .or_else(|| self.near(frame, shoe_tag, &start))?;
            let mut seen = self.detection(frame, (shoe, tag), fit)?;
            seen.between_eyes = self.between_eyes(frame, shoe_tag, &seen.fit, &motion);
            Some(seen)
        })
        .collect()
    }

    /// A tag near where it is predicted.
    fn near(
        &self,
        frame: &Frame<'_>,
        shoe_tag: &ShoeTag,
        predicted: &RigidTransform,
    ) -> Option<Fit> {
        let camera = &self.cameras[frame.camera];
        let in_left = camera.rig_from_eye[0].inverse() * *predicted;
        let at = in_left.translation();
        if at.z < 0.1 {
            return None;
        }
        let middle = camera.lenses[0].project((*at).into())?;
        let reach = self.config.search.near_m / at.z * camera.lenses[0].model().fx;
        let image = frame.images[0];
        let bounds = |middle: f64, size: usize| {
            let from = (middle - reach).max(0.0);
            let to = (middle + reach).min((size - 1) as f64);
            (to - from > 8.0).then_some((from as usize, to as usize))
        };
        let (left, right) = bounds(middle[0], image.width())?;
        let (top, bottom) = bounds(middle[1], image.height())?;
        let part = image.part([left, top], [right + 1 - left, bottom + 1 - top])?;
        let found = self.searchers[frame.camera].search(&part);
        let own = found.iter().find(|seen| seen.id == shoe_tag.tag.id)?;
        let corners = own.corners.map(|[x, y]| [x + left as f64, y + top as f64]);
        self.fit_at_corners(frame, shoe_tag, &corners)
    }

    /// A tag of a foot that is at rest near one of these places, where that blurs it.
    fn at_rest(
        &self,
        frame: &Frame<'_>,
        shoe_tag: &ShoeTag,
        places: &[RigidTransform],
        reach_m: f64,
    ) -> Option<Fit> {
        let rig = frame.rig.as_ref()?;
        let config = &self.config.search;
        let motion = motion_in_rig(rig, places.first()?, shoe_tag, &Motion::default());
        if !self.is_blurred(frame, shoe_tag, &motion) {
            return None;
        }
        let rig_from_world = rig.world_from_rig.inverse();
        let starts: Vec<RigidTransform> = places
            .iter()
            .flat_map(|place| config.turns_rad.map(|turn| poses::level(place, turn)))
            .flatten()
            .map(|place| rig_from_world * place * shoe_tag.foot_from_tag)
            .collect();
        let up = rig_from_world.rotation() * Vector3::z();
        let [left, _] = self.views(frame);
        let plane = (up.into(), reach_m);
        let place = locate(
            &left,
            &shoe_tag.tag,
            &starts,
            &motion,
            plane,
            &config.location,
        )?;
        let fit = self.fit(frame, shoe_tag, &place.reference_from_tag, &motion)?;
        (fit.agreeing_share > config.min_agreeing_share).then_some(fit)
    }

    /// Tags of shoes anywhere in a frame.
    fn searched(&self, frame: &Frame<'_>, shoes: &[usize]) -> Vec<Detection> {
        let found = self.searchers[frame.camera].search(&frame.images[0]);
        let mut detections = Vec::new();
        for &shoe in shoes {
            let before = detections.len();
            for (tag, shoe_tag) in self.shoes[shoe].tags.iter().enumerate() {
                let own = found.iter().filter(|seen| seen.id == shoe_tag.tag.id);
                let mut own = own.filter_map(|seen| {
                    let fit = self.fit_at_corners(frame, shoe_tag, &seen.corners)?;
                    self.detection(frame, (shoe, tag), fit)
                });
                detections.extend(own.next());
            }
            if detections.len() == before {
                detections.extend(self.landed(frame, shoe));
            }
        }
        detections
    }

    /// Tags of a foot that is at rest somewhere below the rig.
    fn landed(&self, frame: &Frame<'_>, shoe: usize) -> Vec<Detection> {
        let (Some(foot), Some(rig)) = (&self.feet[shoe], &frame.rig) else {
            return Vec::new();
        };
        if foot.age_s(frame.time_ns) < self.config.search.landing_s {
            return Vec::new();
        }
        let last = foot.last_pose();
        let below = rig.world_from_rig.translation();
        let heights = self.heights(shoe);
        let places: Vec<RigidTransform> = heights
            .iter()
            .filter_map(|height| {
                poses::pose(last.rotation(), &Vector3::new(below.x, below.y, *height))
            })
            .collect();
        let tags = self.shoes[shoe].tags.iter().enumerate();
        tags.filter_map(|(tag, shoe_tag)| {
            let fit = self.at_rest(frame, shoe_tag, &places, self.config.search.landing_m)?;
            self.detection(frame, (shoe, tag), fit)
        })
        .collect()
    }

    /// Heights at which a foot may be at rest: its last one, that of another foot, and as far
    /// beyond that.
    fn heights(&self, shoe: usize) -> Vec<f64> {
        let height = |foot: &FootMotion| foot.last_pose().translation().z;
        let Some(own) = self.feet[shoe].as_ref().map(height) else {
            return Vec::new();
        };
        let mut heights = vec![own];
        let others = self.feet.iter().enumerate().filter(|(k, _)| *k != shoe);
        for other in others.filter_map(|(_, foot)| foot.as_ref().map(height)) {
            for height in [other, 2.0 * other - own] {
                let is_new = |known: &f64| (known - height).abs() > self.config.search.height_m;
                if heights.iter().all(is_new) {
                    heights.push(height);
                }
            }
        }
        heights
    }

    /// Fits a tag with these corners in the left image.
    fn fit_at_corners(
        &self,
        frame: &Frame<'_>,
        shoe_tag: &ShoeTag,
        corners: &[[f64; 2]; 4],
    ) -> Option<Fit> {
        let camera = &self.cameras[frame.camera];
        let poses = poses_from_corners(&camera.lenses[0], &shoe_tag.tag, corners)?;
        let fits = poses.into_iter().filter_map(|pose| {
            let start = camera.rig_from_eye[0] * pose;
            self.fit(frame, shoe_tag, &start, &Motion::default())
        });
        fits.min_by(|a, b| a.rms_levels.total_cmp(&b.rms_levels))
    }

    fn fit(
        &self,
        frame: &Frame<'_>,
        shoe_tag: &ShoeTag,
        start: &RigidTransform,
        motion: &Motion,
    ) -> Option<Fit> {
        let views = self.views(frame);
        fit(&views, &shoe_tag.tag, start, motion, &self.config.fit)
    }

    fn views<'a>(&'a self, frame: &Frame<'a>) -> [View<'a>; 2] {
        let camera = &self.cameras[frame.camera];
        [0, 1].map(|eye| View {
            image: frame.images[eye],
            lens: &camera.lenses[eye],
            eye_from_reference: camera.rig_from_eye[eye].inverse(),
            line_s: camera.line_s,
            exposure_s: frame.exposure_s,
        })
    }

    /// Whether a motion blurs a tag so much that no detector of corners finds it.
    fn is_blurred(&self, frame: &Frame<'_>, shoe_tag: &ShoeTag, motion: &Motion) -> bool {
        let moved_m = Vector3::from(motion.linear).norm() * frame.exposure_s;
        moved_m >= self.config.search.min_blur_cells * shoe_tag.tag.cell_m()
    }

    /// How far the rays of both eyes are apart, of a whole tag in some of the frames.
    fn between_eyes(
        &self,
        frame: &Frame<'_>,
        shoe_tag: &ShoeTag,
        fit: &Fit,
        motion: &Motion,
    ) -> Option<[f64; 2]> {
        let is_whole = fit.visible_share.iter().all(|share| *share == 1.0);
        let is_next = self.frames[frame.camera].is_multiple_of(self.config.eye_check_frames);
        if !is_whole || !is_next || self.is_blurred(frame, shoe_tag, motion) {
            return None;
        }
        let views = self.views(frame);
        let (tag, pose) = (&shoe_tag.tag, &fit.reference_from_tag);
        eye_agreement::between_eyes(&views, tag, pose, motion, &self.config.fit)
    }

    /// A detection, if the foot can be there.
    fn detection(
        &self,
        frame: &Frame<'_>,
        (shoe, tag): (usize, usize),
        fit: Fit,
    ) -> Option<Detection> {
        let distance = fit.reference_from_tag.translation().norm();
        let seen = self.foot_pose(frame, (shoe, tag), &fit);
        let is_slow = self.feet[shoe].zip(seen).is_none_or(|(foot, seen)| {
            foot.age_s(frame.time_ns) > self.config.search.lost_s
                || foot.speed_to(&seen) < self.config.max_speed
        });
        (distance < self.config.max_distance_m && is_slow).then_some(Detection {
            time_ns: frame.time_ns,
            camera: frame.camera,
            shoe,
            tag,
            fit,
            between_eyes: None,
        })
    }

    /// Pose of a foot in the world, where that of the rig is known.
    fn foot_pose(
        &self,
        frame: &Frame<'_>,
        (shoe, tag): (usize, usize),
        fit: &Fit,
    ) -> Option<FootPose> {
        let rig = frame.rig?;
        let tag_from_foot = self.shoes[shoe].tags[tag].foot_from_tag.inverse();
        Some(FootPose {
            time_ns: frame.time_ns,
            world_from_foot: rig.world_from_rig * fit.reference_from_tag * tag_from_foot,
        })
    }

    /// Updates the prediction of a foot by the detection with the smallest covariance.
    fn update(&mut self, frame: &Frame<'_>, shoe: usize, seen: &[&Detection]) {
        let trace = |seen: &&&Detection| seen.fit.covariance.trace();
        let best = seen.iter().min_by(|a, b| trace(a).total_cmp(&trace(b)));
        let Some(best) = best else { return };
        let Some(pose) = self.foot_pose(frame, (shoe, best.tag), &best.fit) else {
            return;
        };
        let config = &self.config.prediction;
        self.feet[shoe] = Some(FootMotion::new(pose, self.feet[shoe].as_ref(), config));
    }
}

/// Extent of the largest tag in an image at a distance: its diagonal, px.
fn largest_px(shoes: &[Shoe], camera: &Camera, distance_m: f64) -> usize {
    let tags = shoes.iter().flat_map(|shoe| &shoe.tags);
    let largest_m = tags.map(|own| own.tag.size_m).fold(0.0, f64::max);
    let model = camera.lenses[0].model();
    let diagonal_m = std::f64::consts::SQRT_2 * largest_m;
    (model.fx.max(model.fy) * diagonal_m / distance_m).ceil() as usize
}

/// Motion of a tag in the rig.
fn motion_in_rig(
    rig: &RigState,
    world_from_foot: &RigidTransform,
    shoe_tag: &ShoeTag,
    velocity: &Motion,
) -> Motion {
    let tag = *world_from_foot * shoe_tag.foot_from_tag;
    let from_foot = tag.translation() - world_from_foot.translation();
    let from_rig = tag.translation() - rig.world_from_rig.translation();
    let [foot_rate, rig_rate] = [velocity.angular, rig.motion.angular].map(Vector3::from);
    let of_foot = Vector3::from(velocity.linear) + foot_rate.cross(&from_foot);
    let of_rig = Vector3::from(rig.motion.linear) + rig_rate.cross(&from_rig);
    let back = rig.world_from_rig.rotation().inverse();
    Motion {
        linear: (back * (of_foot - of_rig)).into(),
        angular: (back * (foot_rate - rig_rate)).into(),
    }
}
