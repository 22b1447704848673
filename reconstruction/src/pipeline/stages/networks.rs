//! The user's networks: one that replaces the built-in stereo matcher, one that segments movable
//! objects, one that compares held-out images (`docs/reference/learned.md`).
//!
//! Contract: they are opened and checked before the first stage. Their hashes are settings of the
//! stage that uses them, so that another network re-runs it. A program built without the feature
//! `onnx` has none, and reports an error if one is requested.

use std::path::Path;
#[cfg(feature = "onnx")]
use std::sync::{Arc, Mutex, PoisonError};

use depth::DisparityMap;
#[cfg(feature = "onnx")]
use learned::{LearnedError, LpipsNetwork, Runtime, SegmentationNetwork, StereoNetwork};
use serde_json::{Value, json};
#[cfg(feature = "onnx")]
use session_input::Color;
use session_input::Image;

use crate::pipeline::StageError;

/// Why a network cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum NetworksError {
    /// Build with `--features onnx`.
    #[error(
        "using a network: found a program built without networks, expected one built with `--features onnx`: {0}"
    )]
    NotBuilt(String),
    /// Error of the network or of ONNX Runtime.
    #[cfg(feature = "onnx")]
    #[error(transparent)]
    Learned(#[from] LearnedError),
}

/// Files of networks.
#[derive(Clone, Copy, Debug, Default)]
pub struct NetworkFiles<'a> {
    /// Replaces the built-in stereo matcher.
    pub stereo: Option<&'a Path>,
    /// Masks what can move.
    pub segmentation: Option<&'a Path>,
    /// Compares held-out images with rendered ones.
    pub lpips: Option<&'a Path>,
}

impl<'a> NetworkFiles<'a> {
    fn first(&self) -> Option<&'a Path> {
        self.stereo.or(self.segmentation).or(self.lpips)
    }
}

/// The networks that were given.
#[derive(Clone, Debug, Default)]
pub struct Networks {
    #[cfg(feature = "onnx")]
    stereo: Option<Arc<Mutex<StereoNetwork>>>,
    #[cfg(feature = "onnx")]
    segmentation: Option<Arc<Mutex<SegmentationNetwork>>>,
    #[cfg(feature = "onnx")]
    lpips: Option<Arc<Mutex<LpipsNetwork>>>,
}

#[cfg(feature = "onnx")]
impl Networks {
    /// Opens what is given; ONNX Runtime is loaded only if something is.
    ///
    /// # Errors
    /// [`NetworksError::Learned`].
    pub fn open(files: &NetworkFiles<'_>) -> Result<Self, NetworksError> {
        match files.first() {
            Some(_) => Self::open_with(&Runtime::load(None)?, files),
            None => Ok(Self::default()),
        }
    }

    fn open_with(runtime: &Runtime, files: &NetworkFiles<'_>) -> Result<Self, NetworksError> {
        let stereo = files.stereo.map(|file| StereoNetwork::open(runtime, file));
        let segmentation = files.segmentation;
        let segmentation = segmentation.map(|file| SegmentationNetwork::open(runtime, file));
        let lpips = files.lpips.map(|file| LpipsNetwork::open(runtime, file));
        Ok(Self {
            stereo: stereo.transpose()?.map(|n| Arc::new(Mutex::new(n))),
            segmentation: segmentation.transpose()?.map(|n| Arc::new(Mutex::new(n))),
            lpips: lpips.transpose()?.map(|n| Arc::new(Mutex::new(n))),
        })
    }

    /// Hash of the stereo network, for the settings of a stage; null without one.
    pub(super) fn stereo_hash(&self) -> Value {
        json!(self.stereo.as_deref().map(|n| lock(n).hash().to_owned()))
    }

    /// Hash of the segmentation network.
    pub(super) fn segmentation_hash(&self) -> Value {
        json!(
            self.segmentation
                .as_deref()
                .map(|n| lock(n).hash().to_owned())
        )
    }

    /// Hash of the LPIPS network.
    pub(super) fn lpips_hash(&self) -> Value {
        json!(self.lpips.as_deref().map(|n| lock(n).hash().to_owned()))
    }

    /// Disparities of a rectified pair, if there is a stereo network.
    pub(super) fn disparity(
        &self,
        left: depth::ImageView<'_>,
        right: depth::ImageView<'_>,
    ) -> Result<Option<DisparityMap>, StageError> {
        let run = |network: &Mutex<StereoNetwork>| lock(network).run(&left.into(), &right.into());
        Ok(self.stereo.as_deref().map(run).transpose()?)
    }

    /// Movable pixels of an image, rows first, if there is a segmentation network.
    pub(super) fn movable(&self, image: &Image) -> Result<Option<Vec<bool>>, StageError> {
        let Some(network) = self.segmentation.as_deref() else {
            return Ok(None);
        };
        let (width, height) = (image.width as usize, image.height as usize);
        let image = match image.color {
            Color::Grey => learned::ImageView::gray(width, height, &image.data)?,
            Color::Rgb => learned::ImageView::rgb(width, height, &image.data)?,
        };
        Ok(Some(lock(network).run(&image)?.movable))
    }

    /// Whether there is an LPIPS network.
    pub(super) fn has_lpips(&self) -> bool {
        self.lpips.is_some()
    }

    /// LPIPS of a recorded and a rendered image, red, green and blue of each pixel, if there is a
    /// network for it.
    pub(super) fn lpips(
        &self,
        [width, height]: [usize; 2],
        recorded: &[u8],
        rendered: &[u8],
    ) -> Result<Option<f64>, StageError> {
        let Some(network) = self.lpips.as_deref() else {
            return Ok(None);
        };
        let recorded = learned::ImageView::rgb(width, height, recorded)?;
        let rendered = learned::ImageView::rgb(width, height, rendered)?;
        Ok(Some(lock(network).run(&recorded, &rendered)?))
    }
}

#[cfg(feature = "onnx")]
fn lock<T>(network: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    network.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(not(feature = "onnx"))]
impl Networks {
    /// Succeeds only if no network is given.
    ///
    /// # Errors
    /// [`NetworksError::NotBuilt`].
    pub fn open(files: &NetworkFiles<'_>) -> Result<Self, NetworksError> {
        match files.first() {
            Some(file) => Err(NetworksError::NotBuilt(file.display().to_string())),
            None => Ok(Self::default()),
        }
    }

    /// Null.
    pub(super) fn stereo_hash(&self) -> Value {
        json!(null)
    }

    /// Null.
    pub(super) fn segmentation_hash(&self) -> Value {
        json!(null)
    }

    /// None.
    pub(super) fn disparity(
        &self,
        _left: depth::ImageView<'_>,
        _right: depth::ImageView<'_>,
    ) -> Result<Option<DisparityMap>, StageError> {
        Ok(None)
    }

    /// None.
    pub(super) fn movable(&self, _image: &Image) -> Result<Option<Vec<bool>>, StageError> {
        Ok(None)
    }

    /// Null.
    pub(super) fn lpips_hash(&self) -> Value {
        json!(null)
    }

    /// False.
    pub(super) fn has_lpips(&self) -> bool {
        false
    }

    /// None.
    pub(super) fn lpips(
        &self,
        _size: [usize; 2],
        _recorded: &[u8],
        _rendered: &[u8],
    ) -> Result<Option<f64>, StageError> {
        Ok(None)
    }
}

/// The writer of small networks that the tests of `learned` use.
#[cfg(all(test, feature = "onnx"))]
#[allow(
    dead_code,
    unreachable_pub,
    reason = "it has more functions than are used here"
)]
#[path = "../../../../crates/vision/learned/tests/it/onnx.rs"]
mod onnx;

/// Location of ONNX Runtime.
#[cfg(all(test, feature = "onnx"))]
#[path = "../../../../crates/vision/learned/tests/it/library.rs"]
mod library;

/// An LPIPS network for tests: the mean square of differences of colors from -1 to 1.
#[cfg(all(test, feature = "onnx"))]
fn mean_square(folder: &Path) -> std::path::PathBuf {
    let color: [i64; 4] = [1, 3, -1, -1];
    let axes = onnx::Attribute::Values("axes", &[1, 2, 3]);
    onnx::Graph::default()
        .input("a", onnx::F32, &color)
        .input("b", onnx::F32, &color)
        .output("out", onnx::F32, &[1, 1, 1, 1])
        .node("Sub", &["a", "b"], "difference", &[])
        .node("Mul", &["difference", "difference"], "square", &[])
        .node("ReduceMean", &["square"], "out", &[axes])
        .write(folder, "lpips.onnx")
}

/// No network but [`mean_square`]; `None` without ONNX Runtime.
#[cfg(test)]
pub(super) fn only_mean_square() -> Option<Networks> {
    #[cfg(feature = "onnx")]
    if let Some(runtime) = library::runtime() {
        let folder = tempfile::tempdir().expect("a folder");
        let lpips = mean_square(folder.path());
        let files = NetworkFiles {
            lpips: Some(&lpips),
            ..NetworkFiles::default()
        };
        return Some(Networks::open_with(&runtime, &files).expect("a network"));
    }
    None
}

#[cfg(test)]
mod tests {
    #[cfg(feature = "onnx")]
    use super::onnx::{Attribute, F32, Graph};
    use super::*;

    #[test]
    fn without_networks_there_are_no_results() {
        let networks = Networks::open(&NetworkFiles::default()).expect("nothing");
        let [left, right] = [rectified(&[0; 6]), rectified(&[0; 6])];
        assert!(networks.disparity(left, right).expect("none").is_none());
        assert!(
            networks
                .movable(&recorded(&[0; 6]))
                .expect("none")
                .is_none()
        );
        assert_eq!(networks.stereo_hash(), Value::Null);
        assert_eq!(networks.segmentation_hash(), Value::Null);
        let lpips = networks.lpips([1, 1], &[0; 3], &[0; 3]);
        assert_eq!(lpips.expect("none"), None);
        assert_eq!(networks.lpips_hash(), Value::Null);
    }

    fn rectified(pixels: &[u8; 6]) -> depth::ImageView<'_> {
        depth::ImageView::packed(3, 2, pixels).expect("an image")
    }

    fn recorded(pixels: &[u8; 6]) -> Image {
        Image {
            width: 3,
            height: 2,
            color: session_input::Color::Grey,
            data: pixels.to_vec().into(),
        }
    }

    #[test]
    fn a_network_that_cannot_be_used_is_an_error() {
        let file = Some(Path::new("a.onnx"));
        for given in 0..3 {
            let files = NetworkFiles {
                stereo: file.filter(|_| given == 0),
                segmentation: file.filter(|_| given == 1),
                lpips: file.filter(|_| given == 2),
            };
            let error = Networks::open(&files).expect_err("no such network");
            let said = error.to_string();
            let without = said.ends_with("--features onnx`: a.onnx");
            assert_eq!(without, cfg!(not(feature = "onnx")), "{said}");
        }
    }

    #[cfg(feature = "onnx")]
    #[test]
    fn networks_replace_the_built_in_methods() {
        let Some(runtime) = super::library::runtime() else {
            return;
        };
        let folder = tempfile::tempdir().expect("a folder");
        let image: [i64; 4] = [1, 1, -1, -1];
        let stereo = Graph::default()
            .input("left", F32, &image)
            .input("right", F32, &image)
            .output("out", F32, &image)
            .node("Sub", &["left", "right"], "out", &[])
            .write(folder.path(), "stereo.onnx");
        std::fs::write(
            stereo.with_extension("toml"),
            "stereo = { factor = 1.0, both_ways = false }",
        )
        .expect("settings");
        // Class 1 is where the image is brighter than 0.
        let segmentation = Graph::default()
            .input("image", F32, &image)
            .output("out", F32, &[1, 2, -1, -1])
            .node("Sub", &["image", "image"], "zero", &[])
            .node(
                "Concat",
                &["zero", "image"],
                "out",
                &[Attribute::Number("axis", 1)],
            )
            .write(folder.path(), "segmentation.onnx");
        std::fs::write(
            segmentation.with_extension("toml"),
            "segmentation = { enlarge = 'nearest', masked = { person = 1 } }",
        )
        .expect("settings");
        let lpips = mean_square(folder.path());
        let files = NetworkFiles {
            stereo: Some(&stereo),
            segmentation: Some(&segmentation),
            lpips: Some(&lpips),
        };
        let networks = Networks::open_with(&runtime, &files).expect("all");
        let lpips = networks.lpips([2, 1], &[0, 0, 0, 255, 255, 255], &[0; 6]);
        assert_eq!(lpips.expect("ran"), Some(2.0));
        assert_ne!(networks.lpips_hash(), Value::Null);
        let (left, right) = ([9, 9, 9, 0, 9, 9], [9, 8, 7, 0, 9, 9]);
        let found = networks
            .disparity(rectified(&left), rectified(&right))
            .expect("ran")
            .expect("a map");
        assert_eq!(found.disparity, [0.0, 1.0, 2.0, 0.0, 0.0, 0.0]);
        let movable = networks.movable(&recorded(&left));
        let movable = movable.expect("ran").expect("a mask");
        assert_eq!(movable, [true, true, true, false, true, true]);
        std::fs::write(
            stereo.with_extension("toml"),
            "stereo = { factor = 2.0, both_ways = false }",
        )
        .expect("settings");
        let other = Networks::open_with(&runtime, &files).expect("all");
        assert_ne!(other.stereo_hash(), networks.stereo_hash());
        assert_eq!(other.segmentation_hash(), networks.segmentation_hash());
    }
}
