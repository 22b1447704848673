//! Keyframes of a walk: rectified images, true depth, and stereo depth as the stage `depth` has it.
//!
//! Rendered images are kept in `bench-terrain` in the target folder. The first keyframe of a walk
//! is rendered in every run; if it is not the stored one, the simulator has changed, and all are
//! rendered again.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use camera_models::rectify::{Rectification, Remap, View};
use camera_models::{Eye, Lens};
use depth::{Band, BandedMatcher, Config, Geometry};
use rayon::prelude::*;
use rig_sim::camera::Shutter;
use rig_sim::scene::surface::Class;
use rig_sim::simulation::seconds;
use scene_bundle::outputs::depth::{DEPTH_UNIT_M, DepthImage, SIGMA_UNIT_M};
use terrain::{DepthView, PixelClass, RowMotion};

use super::walks::{KeyframeId, WalkInputs, transform};
use crate::depth::frames::{inverse_depth, sample};
use crate::meter;

/// Units of a stored true depth, 1/m.
const UNITS_PER_M: f32 = 8000.0;
/// Margin of the mask around people and the wearer, in 640ths of the image width.
pub(crate) const MASK_MARGIN: usize = 10;
/// Constants of the stage `depth`: minimum distance, m, number of disparities, and maximum ratio of
/// sigma and depth.
pub(crate) const MIN_DISTANCE_M: f64 = 0.25;
pub(crate) const MAX_DISPARITIES: usize = 256;
pub(crate) const MAX_RELATIVE_SIGMA: f64 = 0.2;
/// Disparity sigma that views of the true depth state, px.
const TRUE_SIGMA_PX: f64 = 0.03;
/// Of poses, m, as the stage `terrain` states it; here poses are true.
const POSE_SIGMA_M: f64 = 0.003;

/// Rectified cameras of a walk.
struct Camera {
    rectification: Rectification,
    geometry: Geometry,
    rig_from_view: RigidTransform,
    line_s: f64,
    recorded: camera_models::CameraModel,
}

/// A keyframe as rendered; rows first.
pub(crate) struct Keyframe {
    pub(crate) size: [usize; 2],
    geometry: Geometry,
    pub(crate) world_from_view: RigidTransform,
    pub(crate) row_motion: RowMotion,
    eyes: [Vec<u8>; 2],
    /// True depth, m; 0 for none and for more than 8 m.
    truth_m: Vec<f32>,
    classes: Vec<PixelClass>,
}

/// Depth of a keyframe.
#[derive(Clone)]
pub(crate) struct DepthFrame {
    pub(crate) size: [usize; 2],
    pub(crate) focal_px: [f64; 2],
    pub(crate) center_px: [f64; 2],
    pub(crate) world_from_view: RigidTransform,
    pub(crate) row_motion: RowMotion,
    pub(crate) depth_m: Vec<f32>,
    pub(crate) sigma_m: Vec<f32>,
    pub(crate) classes: Vec<PixelClass>,
}

/// Where depth comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// Preset `balanced` on rendered images, with its stated sigma.
    Stereo,
    /// The truth.
    Truth,
}

impl Source {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Stereo => "stereo",
            Self::Truth => "true depth",
        }
    }
}

/// All keyframes of a walk, rendered or read.
///
/// # Errors
/// A pair that cannot be rectified, or an I/O error.
pub(crate) fn keyframes(prepared: &WalkInputs, ids: &[KeyframeId]) -> Result<Vec<Keyframe>> {
    let count = prepared.simulation.cameras().len();
    let cameras: Vec<Camera> = (0..count)
        .map(|camera| Camera::new(prepared, camera))
        .collect::<Result<_>>()?;
    let folder = folder(&prepared.walk.name())?;
    let path = |id: &KeyframeId| folder.join(format!("{}-{}.bin", id.camera, id.frame));
    if let Some(first) = ids.first() {
        let fresh = Renderer::new(prepared, first, &cameras[first.camera]).render(first);
        if fs::read(path(first)).is_ok_and(|stored| stored != fresh) {
            fs::remove_dir_all(&folder)?;
            fs::create_dir_all(&folder)?;
        }
    }
    (0..count).into_par_iter().try_for_each(|camera| {
        let own: Vec<&KeyframeId> = ids.iter().filter(|id| id.camera == camera).collect();
        if own.iter().all(|id| path(id).exists()) {
            return Ok(());
        }
        // Automatic exposure continues from one keyframe to the next.
        let Some(first) = own.first() else {
            return Ok(());
        };
        let mut renderer = Renderer::new(prepared, first, &cameras[camera]);
        own.iter().try_for_each(|id| {
            let path = path(id);
            fs::write(&path, renderer.render(id))
                .with_context(|| format!("writing {}", path.display()))
        })
    })?;
    ids.iter()
        .map(|id| {
            let path = path(id);
            let bytes = fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
            cameras[id.camera].keyframe(prepared, id, &bytes)
        })
        .collect()
}

/// Renders the frames of a camera.
struct Renderer<'a> {
    camera: &'a Camera,
    images: rig_sim::simulation::FrameRenderer,
    truth: rig_sim::simulation::GroundTruth<'a>,
    remaps: [Remap; 2],
}

impl<'a> Renderer<'a> {
    /// With the exposure of the first frame.
    fn new(prepared: &'a WalkInputs, first: &KeyframeId, camera: &'a Camera) -> Self {
        let [width, height] = [camera.recorded.width, camera.recorded.height];
        let maps = [Eye::Left, Eye::Right].map(|eye| camera.rectification.map(eye));
        let mut images = prepared.simulation.frames(first.camera);
        images.settle(first.time_ns);
        Self {
            camera,
            images,
            truth: prepared.simulation.ground_truth(first.camera),
            remaps: maps.map(|map| Remap::new(&map, width, height)),
        }
    }

    /// Both images, true depths in units, and classes.
    fn render(&mut self, id: &KeyframeId) -> Vec<u8> {
        let camera = self.camera;
        let width = camera.recorded.width as usize;
        let shot = self.images.expose(id.frame, id.time_ns);
        let mut bytes = Vec::new();
        for eye in 0..2 {
            bytes.extend(self.remaps[eye].apply(&shot.gray(eye), 0));
        }
        let seen = self.truth.render(0, id.time_ns);
        let lens = Lens::new(&camera.recorded);
        let view_from_left = camera.rectification.rectified_from_left;
        let inverse = inverse_depth(&seen, &lens, &view_from_left, width);
        let map = camera.rectification.map(Eye::Left);
        for (x, y) in map.x.iter().zip(&map.y) {
            let depth = 1.0 / sample(&inverse, width, *x, *y);
            let units = (UNITS_PER_M * depth).round();
            let stored = if (1.0..65_535.0).contains(&units) {
                units as u16
            } else {
                0
            };
            bytes.extend(stored.to_le_bytes());
        }
        for (x, y) in map.x.iter().zip(&map.y) {
            let [u, v] = [x.round(), y.round()];
            let inside = u >= 0.0 && v >= 0.0;
            let pixel = (v * width as f32 + u) as usize;
            let class = seen.class.get(pixel).filter(|_| inside);
            bytes.push(class.map_or(0, |class| *class as u8));
        }
        bytes
    }
}

impl Camera {
    fn new(prepared: &WalkInputs, number: usize) -> Result<Self> {
        let simulation = &prepared.simulation;
        let calibration = simulation.calibration(number);
        let rectification = Rectification::new(&calibration, View::Filled)?;
        let camera = &simulation.cameras()[number];
        let model = rectification.camera;
        Ok(Self {
            geometry: Geometry {
                focal_px: model.fx,
                center: [model.cx, model.cy],
                baseline_m: rectification.baseline_m,
                offset_px: 0.0,
            },
            rig_from_view: camera.rig_from_eye[0] * rectification.rectified_from_left.inverse(),
            line_s: match camera.shutter {
                Shutter::Global => 0.0,
                Shutter::Rolling { line_s } => line_s,
            },
            recorded: calibration.left,
            rectification,
        })
    }

    fn keyframe(&self, prepared: &WalkInputs, id: &KeyframeId, bytes: &[u8]) -> Result<Keyframe> {
        let model = self.rectification.camera;
        let size = [model.width as usize, model.height as usize];
        let pixels = size[0] * size[1];
        ensure!(
            bytes.len() == 5 * pixels,
            "found {} bytes of a keyframe, expected {}",
            bytes.len(),
            5 * pixels
        );
        let pose = |time_ns: i64| -> Result<RigidTransform> {
            let rig = prepared.simulation.walker().rig(seconds(time_ns));
            Ok(transform(&rig.position, &rig.rotation)? * self.rig_from_view)
        };
        let truth = bytes[2 * pixels..4 * pixels].chunks_exact(2);
        let truth = truth.map(|b| f32::from(u16::from_le_bytes([b[0], b[1]])) / UNITS_PER_M);
        let is_person: Vec<bool> = bytes[4 * pixels..]
            .iter()
            .map(|class| *class == Class::Person as u8)
            .collect();
        let margin = MASK_MARGIN * size[0] / 640;
        let classes = dilated(&is_person, size, margin).into_iter();
        Ok(Keyframe {
            size,
            geometry: self.geometry,
            world_from_view: pose(id.time_ns)?,
            row_motion: self.row_motion(
                pose(id.time_ns - HALF_STEP_NS)?,
                pose(id.time_ns + HALF_STEP_NS)?,
            ),
            eyes: [0, 1].map(|eye| bytes[eye * pixels..(eye + 1) * pixels].to_vec()),
            truth_m: truth.collect(),
            classes: classes
                .map(|is| {
                    if is {
                        PixelClass::Excluded
                    } else {
                        PixelClass::Static
                    }
                })
                .collect(),
        })
    }

    /// As the stage `terrain` has it.
    fn row_motion(&self, before: RigidTransform, after: RigidTransform) -> RowMotion {
        if self.line_s == 0.0 {
            return RowMotion::default();
        }
        let (model, left) = (self.rectification.camera, self.recorded);
        let step_s = 2e-9 * HALF_STEP_NS as f64;
        let motion = before.inverse() * after;
        let row_s = self.line_s * left.fy / model.fy;
        let middle = 0.5 * f64::from(left.height - 1);
        RowMotion {
            first_s: self.line_s * (left.cy - middle) - row_s * model.cy,
            row_s,
            velocity: motion.translation_m().map(|v| v / step_s),
            angular_rate: motion.rotation_vector().map(|w| w / step_s),
        }
    }
}

const HALF_STEP_NS: i64 = 5_000_000;

/// A mask that is wider by a number of pixels to all sides.
pub(crate) fn dilated(mask: &[bool], [width, height]: [usize; 2], margin: usize) -> Vec<bool> {
    let wider = |mask: &[bool], length: usize, stride: usize| {
        let mut out = vec![false; mask.len()];
        for start in 0..mask.len() {
            let at = start / stride % length;
            if mask[start] {
                for other in at.saturating_sub(margin)..(at + margin + 1).min(length) {
                    out[start + other * stride - at * stride] = true;
                }
            }
        }
        out
    };
    wider(&wider(mask, width, 1), height, width)
}

/// The folder of a walk's images.
fn folder(name: &str) -> Result<PathBuf> {
    let release = meter::on_disk(None)?;
    let target = release.parent().unwrap_or(Path::new("."));
    let folder = target.join("bench-terrain").join(name);
    fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    Ok(folder)
}

/// Depth of keyframes.
///
/// # Errors
/// The matcher fails.
pub(crate) fn depth_frames(keyframes: &[Keyframe], source: Source) -> Result<Vec<DepthFrame>> {
    keyframes.iter().map(|own| own.depth(source)).collect()
}

impl Keyframe {
    fn depth(&self, source: Source) -> Result<DepthFrame> {
        let focal_baseline = self.geometry.focal_px * self.geometry.baseline_m;
        let (depth_m, sigma_m) = match source {
            Source::Truth => {
                let sigma = |z: &f32| (z * z * (TRUE_SIGMA_PX / focal_baseline) as f32).max(5e-4);
                (
                    self.truth_m.clone(),
                    self.truth_m.iter().map(sigma).collect(),
                )
            }
            Source::Stereo => self.stereo()?,
        };
        Ok(DepthFrame {
            size: self.size,
            focal_px: [self.geometry.focal_px; 2],
            center_px: self.geometry.center,
            world_from_view: self.world_from_view,
            row_motion: self.row_motion,
            depth_m,
            sigma_m,
            classes: self.classes.clone(),
        })
    }

    /// Depth and sigma as the stage `depth` stores them.
    fn stereo(&self) -> Result<(Vec<f32>, Vec<f32>)> {
        let [width, height] = self.size;
        let nearest = self.geometry.focal_px * self.geometry.baseline_m / MIN_DISTANCE_M;
        let range = (nearest.ceil() as usize + 1).min(MAX_DISPARITIES);
        let band = Band::full(0, range, height)?;
        let mut matcher = BandedMatcher::new(Config::default(), width, band)?;
        let [left, right] =
            [0, 1].map(|eye: usize| depth::ImageView::packed(width, height, &self.eyes[eye]));
        let (map, _) = matcher.run(&left?, &right?, None)?;
        let depth = self.geometry.depth(map, MAX_RELATIVE_SIGMA)?;
        let stored =
            DepthImage::from_metres(width as u32, height as u32, &depth.depth_m, &depth.sigma_m);
        let metres = |units: &[u16], unit_m: f64| -> Vec<f32> {
            let one = |units: &u16| (f64::from(*units) * unit_m) as f32;
            units.iter().map(one).collect()
        };
        Ok((
            metres(&stored.depth, DEPTH_UNIT_M),
            metres(&stored.sigma, SIGMA_UNIT_M),
        ))
    }
}

impl DepthFrame {
    /// Depths of static pixels, m; 0 for others.
    pub(crate) fn static_depths(&self) -> Vec<f32> {
        let pixels = self.depth_m.iter().zip(&self.classes);
        pixels
            .map(
                |(depth, class)| match *class == PixelClass::Static && depth.is_finite() {
                    true => *depth,
                    false => 0.0,
                },
            )
            .collect()
    }

    /// As the crate `terrain` takes it.
    pub(crate) fn view(&self) -> DepthView<'_> {
        DepthView {
            size: self.size,
            focal_px: self.focal_px,
            center_px: self.center_px,
            world_from_view: self.world_from_view,
            row_motion: self.row_motion,
            pose_sigma_m: POSE_SIGMA_M,
            depth_m: &self.depth_m,
            sigma_m: &self.sigma_m,
            color: None,
            classes: Some(&self.classes),
        }
    }
}
