//! Output `depth`: for each keyframe with depth a depth map and a map of its standard deviation,
//! 16-bit gray, and `depth.json`, the index of views and maps.
//!
//! Contract. Depth is along the view's z axis, not along the ray, in units of 1 mm: 1 to 65535 are
//! 1 mm to 65.535 m, 0 is no depth (not measured, or farther). Sigma is of the depth, one standard
//! deviation, in units of 0.1 mm: 65535 is 6.5535 m or more, or not known; 0 goes with no depth.
//! The view of a camera is its rectified left image: the optical center of the left image, rotated
//! so that rows match those of the right image, with a pinhole model of its own. There are too many
//! files for the manifest; the listing has their hashes.

use std::sync::{Mutex, PoisonError};

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use serde::{Deserialize, Serialize};

use super::gray_png::{GraySamples, decode, encode16};
use super::{read_json, refused, write_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::layout;
use crate::scene::OutputReader;

const INDEX: &str = "depth.json";
/// Metres in a unit of depth.
pub const DEPTH_UNIT_M: f64 = 1e-3;
/// Metres in a unit of sigma. *Why finer than depth:* near the feet sigma is a few millimetres, and
/// two digits of it are required.
pub const SIGMA_UNIT_M: f64 = 1e-4;

/// The rectified view of a camera's depth maps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthView {
    /// The camera's name in the output `rig`.
    pub camera: String,
    /// Size and intrinsics of the depth maps, without distortion.
    pub model: CameraModel,
    /// Takes points in the left optical frame to the view's. A rotation alone.
    pub view_from_left: RigidTransform,
}

/// A keyframe that has depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthKey {
    /// The view: its index in [`DepthIndex::views`], from 0.
    pub view: usize,
    /// Time of the frame, ns.
    pub time_ns: i64,
    /// Number of the frame among those of its camera.
    pub frame: u64,
    /// Number of the frame set that it belongs to.
    pub set: u64,
}

/// Index of the depth maps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthIndex {
    /// Always [`DEPTH_UNIT_M`]; for readers that use only this file.
    pub depth_unit_m: f64,
    /// Always [`SIGMA_UNIT_M`].
    pub sigma_unit_m: f64,
    /// One view per camera at most.
    pub views: Vec<DepthView>,
    /// Sorted by view and time.
    #[serde(alias = "pictures")]
    pub images: Vec<DepthKey>,
}

/// Depth of one keyframe as stored, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DepthImage {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Along the view's z axis, in [`DEPTH_UNIT_M`]; 0 is none.
    pub depth: Vec<u16>,
    /// One standard deviation of it, in [`SIGMA_UNIT_M`].
    pub sigma: Vec<u16>,
}

/// Paths of depth and sigma of a frame in the output's folder.
pub fn paths(camera: &str, frame: u64) -> [String; 2] {
    ["depth", "sigma"].map(|what| format!("{camera}/{what}/{frame:06}.png"))
}

/// Stored depth of a depth in metres. Values that are NaN, not positive or too far become 0.
pub fn stored_depth(depth_m: f32) -> u16 {
    let units = (f64::from(depth_m) / DEPTH_UNIT_M).round();
    // Less than half a millimetre rounds to 0, which means no depth.
    if (1.0..=65535.0).contains(&units) {
        units as u16
    } else {
        0
    }
}

/// Stored sigma of a sigma in metres.
pub fn stored_sigma(sigma_m: f32) -> u16 {
    let units = (f64::from(sigma_m) / SIGMA_UNIT_M).round();
    if units.is_nan() || units < 0.0 {
        u16::MAX
    } else {
        units.clamp(1.0, 65535.0) as u16
    }
}

impl DepthImage {
    /// From values in metres; no depth where the value is NaN or not positive.
    ///
    /// # Panics
    /// If the number of values differs from the number of pixels.
    ///
    /// ```
    /// use scene_bundle::outputs::depth::DepthImage;
    ///
    /// let image = DepthImage::from_metres(2, 1, &[1.25, f32::NAN], &[0.003, f32::NAN]);
    /// assert_eq!((image.depth[0], image.sigma[0]), (1250, 30));
    /// assert_eq!(image.depth_m(0, 0), Some(1.25));
    /// assert_eq!(image.depth_m(1, 0), None);
    /// ```
    pub fn from_metres(width: u32, height: u32, depth_m: &[f32], sigma_m: &[f32]) -> Self {
        let pixels = width as usize * height as usize;
        assert_eq!((depth_m.len(), sigma_m.len()), (pixels, pixels), "values");
        let depth: Vec<u16> = depth_m.iter().map(|d| stored_depth(*d)).collect();
        let sigma = depth.iter().zip(sigma_m);
        let sigma = sigma
            .map(|(d, s)| if *d == 0 { 0 } else { stored_sigma(*s) })
            .collect();
        Self {
            width,
            height,
            depth,
            sigma,
        }
    }

    /// Depth of a pixel in metres.
    pub fn depth_m(&self, column: u32, row: u32) -> Option<f64> {
        match self.depth[self.pixel_index(column, row)] {
            0 => None,
            units => Some(f64::from(units) * DEPTH_UNIT_M),
        }
    }

    /// One standard deviation of the depth of a pixel in metres.
    pub fn sigma_m(&self, column: u32, row: u32) -> Option<f64> {
        match self.sigma[self.pixel_index(column, row)] {
            0 => None,
            units => Some(f64::from(units) * SIGMA_UNIT_M),
        }
    }

    fn pixel_index(&self, column: u32, row: u32) -> usize {
        row as usize * self.width as usize + column as usize
    }
}

/// Writes depth maps one by one, from any number of threads.
///
/// ```
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion};
/// use scene_bundle::outputs::depth::{self, DepthImage, DepthKey, DepthView, DepthWriter};
/// # use scene_bundle::{Bundle, outputs};
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
///
/// let view = DepthView {
///     camera: "feet".to_owned(),
///     model: CameraModel::new((4, 2), [3.0, 3.0, 1.5, 0.5], Distortion::None),
///     view_from_left: RigidTransform::identity(),
/// };
/// let draft = bundle.begin(outputs::DEPTH)?;
/// let writer = DepthWriter::new(&draft, vec![view])?;
/// let key = DepthKey { view: 0, time_ns: 33_333_333, frame: 12, set: 4 };
/// writer.write(key, &DepthImage::from_metres(4, 2, &[2.5; 8], &[0.01; 8]))?;
/// writer.finish()?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::DEPTH)?;
/// let index = depth::read_index(&reader)?;
/// assert_eq!(index.images, [key]);
/// assert_eq!(depth::read(&reader, &index, &key)?.depth_m(3, 1), Some(2.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct DepthWriter<'a> {
    draft: &'a Draft,
    views: Vec<DepthView>,
    images: Mutex<Vec<DepthKey>>,
}

impl<'a> DepthWriter<'a> {
    /// Begins.
    ///
    /// # Errors
    /// [`BundleError::Refused`] for a view with distortion or another centre, a name that is not a
    /// folder name, or a duplicate camera.
    pub fn new(draft: &'a Draft, views: Vec<DepthView>) -> Result<Self, BundleError> {
        if let Some(found) = validate(&views) {
            let expected =
                "one pinhole view per camera, rotated about the center of its left image";
            return Err(refused(draft, INDEX, found, expected));
        }
        Ok(Self {
            draft,
            views,
            images: Mutex::default(),
        })
    }

    /// Writes the depth map and the sigma map of a keyframe.
    ///
    /// # Errors
    /// [`BundleError::Refused`] for another size than the view's, an unknown view, or a duplicate
    /// frame; [`BundleError::Io`].
    pub fn write(&self, key: DepthKey, image: &DepthImage) -> Result<(), BundleError> {
        let Some(view) = self.views.get(key.view) else {
            let found = format!("depth of view {}", key.view);
            return Err(refused(
                self.draft,
                INDEX,
                found,
                &format!("one of {} views", self.views.len()),
            ));
        };
        let [depth, sigma] = paths(&view.camera, key.frame);
        let (width, height) = (view.model.width, view.model.height);
        let pixels = width as usize * height as usize;
        let found = (
            image.width,
            image.height,
            image.depth.len(),
            image.sigma.len(),
        );
        if found != (width, height, pixels, pixels) {
            let found = format!("an image of {}x{}", image.width, image.height);
            return Err(refused(
                self.draft,
                &depth,
                found,
                &format!("{width}x{height}, as the view has"),
            ));
        }
        for (path, samples) in [(depth, &image.depth), (sigma, &image.sigma)] {
            let file = encode16(width, height, samples);
            self.draft.write_listed(&path, &file)?;
        }
        self.images
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(key);
        Ok(())
    }

    /// Writes the index. The draft is not committed by this.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    pub fn finish(self) -> Result<(), BundleError> {
        let mut images = self
            .images
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        images.sort();
        let index = DepthIndex {
            depth_unit_m: DEPTH_UNIT_M,
            sigma_unit_m: SIGMA_UNIT_M,
            views: self.views,
            images,
        };
        write_json(self.draft, INDEX, &index)
    }
}

fn validate(views: &[DepthView]) -> Option<String> {
    for (place, view) in views.iter().enumerate() {
        let camera = &view.camera;
        if !layout::is_file_path(camera) {
            return Some(format!("a view of a camera called {camera:?}"));
        }
        if view.view_from_left.distance_m() != 0.0 {
            let apart = view.view_from_left.distance_m();
            return Some(format!(
                "a view of {camera} that is {apart} m from its left image's center"
            ));
        }
        if view.model.distortion != camera_models::Distortion::None {
            return Some(format!(
                "a view of {camera} with distortion {}",
                view.model.distortion.name()
            ));
        }
        if views[..place].iter().any(|other| other.camera == *camera) {
            return Some(format!("two views of {camera}"));
        }
    }
    None
}

/// Reads the index.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_index(reader: &OutputReader) -> Result<DepthIndex, BundleError> {
    let index: DepthIndex = read_json(reader, INDEX)?;
    let wrong = |found: String, expected: &str| BundleError::Malformed {
        path: reader.file_path(INDEX),
        place: "content".to_owned(),
        found,
        expected: expected.to_owned(),
    };
    if let Some(found) = validate(&index.views) {
        return Err(wrong(found, "one pinhole view per camera"));
    }
    let units = [index.depth_unit_m, index.sigma_unit_m];
    if units != [DEPTH_UNIT_M, SIGMA_UNIT_M] {
        let expected = format!("{DEPTH_UNIT_M} and {SIGMA_UNIT_M}");
        return Err(wrong(
            format!("units of {} and {} m", units[0], units[1]),
            &expected,
        ));
    }
    if let Some(key) = index
        .images
        .iter()
        .find(|key| key.view >= index.views.len())
    {
        let found = format!("frame {} of view {}", key.frame, key.view);
        return Err(wrong(found, &format!("one of {} views", index.views.len())));
    }
    Ok(index)
}

/// Reads the depth of one keyframe of the index.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
///
/// # Panics
/// When the key is of another index, with more views.
pub fn read(
    reader: &OutputReader,
    index: &DepthIndex,
    key: &DepthKey,
) -> Result<DepthImage, BundleError> {
    let view = &index.views[key.view];
    let size = (view.model.width, view.model.height);
    let samples = |path: &str| {
        let place = reader.file_path(path);
        match decode(&reader.read(path)?, &place)? {
            (width, height, GraySamples::Bits16(samples)) if (width, height) == size => Ok(samples),
            (width, height, samples) => Err(BundleError::Malformed {
                path: place,
                place: "image".to_owned(),
                found: format!(
                    "{width}x{height} of {} bits",
                    if matches!(samples, GraySamples::Bits8(_)) {
                        8
                    } else {
                        16
                    }
                ),
                expected: format!("{}x{} of 16 bits", size.0, size.1),
            }),
        }
    };
    let [depth, sigma] = paths(&view.camera, key.frame);
    Ok(DepthImage {
        width: size.0,
        height: size.1,
        depth: samples(&depth)?,
        sigma: samples(&sigma)?,
    })
}
