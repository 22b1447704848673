//! Evaluation of a bundle's depth against the ground truth of a simulated walk.
//!
//! Contract: the ground truth is the output of `paws-rig-sim render --truth`, the depth of each
//! pixel of the recorded images of both sides, and the n-th line of its list is the frame of number
//! n. Depths are compared as disparities of the rectified pair, so that near and far count alike. A
//! pixel counts where its true depth is known and the right image shows the same surface; at depth
//! discontinuities the nearest neighbour counts. Depth where the truth is sky, or beyond the range
//! of the files, is counted as invented and not as an error.

use std::io::BufReader;
use std::path::{Path, PathBuf};

use camera_models::rectify::{Map, Rectification, RectifyError, View};
use camera_models::{Eye, Lens};
use depth::evaluate::{GroundTruth, Scores};
use depth::{DepthError, DisparityMap};
use rayon::prelude::*;
use scene_bundle::outputs::depth::{DepthImage, DepthKey, DepthView};
use scene_bundle::outputs::{self, DEPTH, RIG};
use scene_bundle::{BundleError, Scene};
use serde::Serialize;

use crate::pipeline::stages::rig;

/// Maximum disparity step between neighbours on one surface, px.
const MAX_SURFACE_STEP_PX: f32 = 1.0;
/// Maximum left–right difference of disparities for a pixel visible in both images, px.
const MAX_LR_DIFFERENCE_PX: f32 = 1.0;

/// Why depth could not be compared.
#[derive(Debug, thiserror::Error)]
pub enum DepthTruthError {
    /// The bundle cannot be read.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The depth is of a camera that the rig of the bundle does not have, or of another view of it:
    /// run the stage again.
    #[error(
        "comparing depth: found depth of {0}, which is not the view that the rig of the bundle gives"
    )]
    OtherRig(String),
    /// The pair of the bundle cannot be rectified.
    #[error(transparent)]
    Rectify(#[from] RectifyError),
    /// The folder has no ground truth: give the folder that `paws-rig-sim render --truth` wrote.
    #[error("reading the truth of depth: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// An image or list does not follow the format of such walks.
    #[error("reading the truth of depth: found {found}, expected {expected}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// Images of another size.
    #[error(transparent)]
    Depth(#[from] DepthError),
}

/// Depth of one camera against the ground truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CameraDepth {
    /// Its name.
    pub camera: String,
    /// Keyframes compared.
    pub images: usize,
    /// Pixels visible in both images whose true depth is known.
    pub pixels: u64,
    /// Ratio of those that have depth.
    pub density: f64,
    /// Ratio of depths with a disparity error of more than 1, 2 and 3 px.
    pub bad: [f64; 3],
    /// Mean error of disparity, px.
    pub mean_error_px: f64,
    /// Ratio of depths within two sigma of the truth.
    pub within_2_sigma: f64,
    /// Ratio of pixels without true depth, mostly sky, that have an estimated one.
    pub invented: f64,
}

/// Sums over images.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    images: usize,
    scores: Scores,
    /// Pixels without true depth, and those of them with an estimated one.
    sky: [u64; 2],
}

/// Compares all depth of a bundle with the ground truth in a folder: a row per camera, then one for
/// all.
///
/// # Errors
/// [`DepthTruthError`].
pub fn evaluate(
    scene: &Scene,
    truth: &Path,
    progress: impl Fn(u64, u64) + Sync,
) -> Result<Vec<CameraDepth>, DepthTruthError> {
    let rig = outputs::rig::read(&scene.output(RIG)?)?;
    let reader = scene.output(DEPTH)?;
    let index = outputs::depth::read_index(&reader)?;
    let (mut rows, mut all, mut done) = (Vec::new(), Sums::default(), 0);
    for (number, view) in index.views.iter().enumerate() {
        let camera = rig.camera(&view.camera);
        let (_, camera) = camera.ok_or_else(|| DepthTruthError::OtherRig(view.camera.clone()))?;
        let rectification = Rectification::new(&rig::calibration(camera), View::Filled)?;
        if rectification.camera != view.model {
            return Err(DepthTruthError::OtherRig(view.camera.clone()));
        }
        let eyes = RectifiedPair::new(
            &rectification,
            [camera.left, camera.right].map(|m| Lens::new(&m)),
        );
        let walk = GroundTruthDepth::open(truth, &view.camera)?;
        let mut sums = Sums::default();
        for key in index.images.iter().filter(|key| key.view == number) {
            let image = outputs::depth::read(&reader, &index, key)?;
            eyes.compare(&image, view, &walk, key, &mut sums)?;
            done += 1;
            progress(done, index.images.len() as u64);
        }
        rows.push(sums.row(&view.camera));
        all.images += sums.images;
        all.scores.add(&sums.scores);
        all.sky = [0, 1].map(|k| all.sky[k] + sums.sky[k]);
    }
    rows.push(all.row("all"));
    Ok(rows)
}

impl Sums {
    fn row(&self, camera: &str) -> CameraDepth {
        let scores = &self.scores;
        CameraDepth {
            camera: camera.to_owned(),
            images: self.images,
            pixels: scores.pixels,
            density: scores.density(),
            bad: [1, 2, 3].map(|k| scores.bad_ratio(k)),
            mean_error_px: scores.mean_error_px(),
            within_2_sigma: scores.coverage(),
            invented: self.sky[1] as f64 / self.sky[0].max(1) as f64,
        }
    }
}

/// Ground-truth files of one camera, by frame number.
struct GroundTruthDepth {
    root: PathBuf,
    names: Vec<String>,
}

impl GroundTruthDepth {
    fn open(folder: &Path, camera: &str) -> Result<Self, DepthTruthError> {
        let root = folder.join(camera).join("mav0");
        let path = root.join("depth0/data.csv");
        let text = plain_file::read_to_string(&path, plain_file::DOCUMENT_LIMIT);
        let text = text.map_err(|source| DepthTruthError::Read { path, source })?;
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let names = lines.filter_map(|line| Some(line.split_once(',')?.1.trim().to_owned()));
        Ok(Self {
            names: names.collect(),
            root,
        })
    }

    /// Depths of one side, mm; 0 is none.
    fn depth(&self, eye: usize, frame: u64, size: [u32; 2]) -> Result<Vec<u16>, DepthTruthError> {
        let list = self.root.join("depth0/data.csv");
        let name = usize::try_from(frame).ok().and_then(|k| self.names.get(k));
        let name = name.ok_or_else(|| DepthTruthError::Malformed {
            path: list,
            found: format!("{} images", self.names.len()),
            expected: format!("one of frame {frame}"),
        })?;
        let path = self.root.join(format!("depth{eye}/data")).join(name);
        let file = plain_file::open(&path).map_err(|source| DepthTruthError::Read {
            path: path.clone(),
            source,
        })?;
        let malformed = |found: String| DepthTruthError::Malformed {
            path: path.clone(),
            found,
            expected: format!("a grey PNG of 16 bits, {}x{}", size[0], size[1]),
        };
        let decoder = png::Decoder::new(BufReader::new(file));
        let mut reader = decoder.read_info().map_err(|e| malformed(e.to_string()))?;
        // An image of another size is not decoded, however large its header claims it is.
        let info = reader.info();
        let kind = (info.color_type, info.bit_depth, [info.width, info.height]);
        if kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen, size) {
            return Err(malformed(format!("{kind:?}")));
        }
        let bytes = reader.output_buffer_size();
        let mut data = vec![0; bytes.ok_or_else(|| malformed("a size beyond memory".to_owned()))?];
        let info = reader
            .next_frame(&mut data)
            .map_err(|e| malformed(e.to_string()))?;
        let kind = (info.color_type, info.bit_depth, [info.width, info.height]);
        if kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen, size) {
            return Err(malformed(format!("{kind:?}")));
        }
        data.truncate(info.buffer_size());
        let pairs = data.chunks_exact(2);
        Ok(pairs.map(|p| u16::from_be_bytes([p[0], p[1]])).collect())
    }
}

/// A rectified pair, prepared for its ground truth.
struct RectifiedPair {
    /// Focal length times baseline, px m.
    scale: f32,
    maps: [Map; 2],
    sizes: [[u32; 2]; 2],
    /// Depth along the rectified axis for each metre along the recorded one, for each recorded
    /// pixel.
    stretch: [Vec<f32>; 2],
}

impl RectifiedPair {
    fn new(rectification: &Rectification, lenses: [Lens; 2]) -> Self {
        let turns = [
            rectification.rectified_from_left,
            rectification.rectified_from_right,
        ];
        let sizes = lenses
            .each_ref()
            .map(|lens| [lens.model().width, lens.model().height]);
        let stretch = [0, 1].map(|eye| {
            let (lens, turn) = (&lenses[eye], &turns[eye]);
            let [width, height] = sizes[eye];
            let of = |i: u32| {
                let pixel = [f64::from(i % width), f64::from(i / width)];
                let ray = lens.unproject(pixel)?;
                Some((turn.rotate(ray)[2] / ray[2]) as f32)
            };
            let pixels = (0..width * height).into_par_iter();
            pixels.map(|i| of(i).unwrap_or(f32::NAN)).collect()
        });
        Self {
            scale: (rectification.camera.fx * rectification.baseline_m) as f32,
            maps: [Eye::Left, Eye::Right].map(|eye| rectification.map(eye)),
            sizes,
            stretch,
        }
    }

    /// True disparities of the rectified image of one side, px; 0 is sky.
    fn disparities(&self, eye: usize, depth_mm: &[u16]) -> Vec<f32> {
        let of = |(depth, stretch): (&u16, &f32)| match depth {
            0 => 0.0,
            mm => self.scale / (f32::from(*mm) * 1e-3 * stretch),
        };
        let recorded: Vec<f32> = depth_mm.iter().zip(&self.stretch[eye]).map(of).collect();
        let map = &self.maps[eye];
        let places = map.x.par_iter().zip(&map.y);
        places
            .map(|(x, y)| between(&recorded, self.sizes[eye], [*x, *y]))
            .collect()
    }

    fn compare(
        &self,
        image: &DepthImage,
        view: &DepthView,
        walk: &GroundTruthDepth,
        key: &DepthKey,
        sums: &mut Sums,
    ) -> Result<(), DepthTruthError> {
        let truths = [0, 1].map(|eye| {
            let depth = walk.depth(eye, key.frame, self.sizes[eye])?;
            Ok::<_, DepthTruthError>(self.disparities(eye, &depth))
        });
        let [left, right] = truths;
        let (left, right) = (left?, right?);
        let width = view.model.width as usize;
        let visible: Vec<bool> = (0..left.len())
            .map(|i| {
                left[i] > 0.0 && is_seen(&right[i / width * width..][..width], i % width, left[i])
            })
            .collect();
        let (mut disparity, mut sigma) = (Vec::new(), Vec::new());
        for (depth, sigma_of) in image.depth.iter().zip(&image.sigma) {
            let depth_m = f32::from(*depth) * outputs::depth::DEPTH_UNIT_M as f32;
            let sigma_m = f32::from(*sigma_of) * outputs::depth::SIGMA_UNIT_M as f32;
            let found = if *depth == 0 {
                f32::NAN
            } else {
                self.scale / depth_m
            };
            disparity.push(found);
            sigma.push(found * sigma_m / depth_m);
        }
        let sky = left
            .iter()
            .zip(&image.depth)
            .filter(|(truth, _)| **truth == 0.0);
        for (_, depth) in sky {
            sums.sky[0] += 1;
            sums.sky[1] += u64::from(*depth > 0);
        }
        let map = DisparityMap {
            width,
            height: image.height as usize,
            disparity,
            sigma,
        };
        let truth = GroundTruth {
            disparity: &left,
            visible: &visible,
        };
        sums.scores.add(&Scores::of(&map, truth)?);
        sums.images += 1;
        Ok(())
    }
}

/// Value between four pixels: interpolated on one surface, else that of the nearest.
fn between(values: &[f32], [width, height]: [u32; 2], [x, y]: [f32; 2]) -> f32 {
    let last = [width - 1, height - 1].map(|n| n as f32);
    // NaN is in no range.
    if !((0.0..=last[0]).contains(&x) && (0.0..=last[1]).contains(&y)) {
        return f32::NAN;
    }
    let at = |x: f32, y: f32| values[y as usize * width as usize + x as usize];
    let (left, top) = (x.floor().min(last[0] - 1.0), y.floor().min(last[1] - 1.0));
    let [a, b] = [at(left, top), at(left + 1.0, top)];
    let [c, d] = [at(left, top + 1.0), at(left + 1.0, top + 1.0)];
    let (least, most) = (a.min(b).min(c).min(d), a.max(b).max(c).max(d));
    if most - least > MAX_SURFACE_STEP_PX || least == 0.0 {
        return at(x.round(), y.round());
    }
    let (u, v) = (x - left, y - top);
    let (upper, lower) = (a + (b - a) * u, c + (d - c) * u);
    upper + (lower - upper) * v
}

/// Whether the right image shows the surface that has this disparity in the left one.
fn is_seen(right: &[f32], x: usize, disparity: f32) -> bool {
    let there = x as f32 - disparity;
    let near = [there.floor(), there.ceil()];
    let inside = |c: f32| c >= 0.0 && c < right.len() as f32;
    near.iter()
        .any(|c| inside(*c) && (right[*c as usize] - disparity).abs() <= MAX_LR_DIFFERENCE_PX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truth_is_interpolated_on_one_surface_and_nearest_at_edges() {
        let values = [10.0, 10.4, 10.2, 10.6, 30.0, 0.0];
        let size = [2, 3];
        assert!((between(&values, size, [0.5, 0.5]) - 10.3).abs() < 1e-6);
        assert_eq!(between(&values, size, [0.2, 1.8]), 30.0);
        assert_eq!(between(&values, size, [0.9, 1.9]), 0.0);
        assert!((between(&values, size, [1.0, 0.0]) - 10.4).abs() < 1e-6);
        for outside in [[-0.1, 0.0], [1.1, 0.0], [0.0, 2.2], [f32::NAN, 0.0]] {
            assert!(between(&values, size, outside).is_nan());
        }
    }

    #[test]
    fn pixels_occluded_in_the_right_image_do_not_count() {
        let right = [5.0, 5.0, 2.0, 2.0, 2.0];
        assert!(is_seen(&right, 4, 2.3));
        assert!(!is_seen(&right, 4, 3.5), "hidden");
        assert!(!is_seen(&right, 1, 5.0), "outside");
    }
}
