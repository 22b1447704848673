//! Where the Gaussians of a sector come from. They are loaded when they are needed.

use std::fmt;
use std::sync::Arc;

use gaussians::{Plane, Splats};
use scene_bundle::outputs;
use scene_bundle::outputs::splats::{SplatBackground, SplatScene};
use scene_bundle::{BundleError, error_chain};
use splats::{Background, Scene, Sky};

use super::hash::bytes::floats;
use crate::error::SimulationError;

/// Memory of Gaussians together with their [`splats::DetailScene`], in units of the Gaussians
/// themselves. Measured: 5.6 to 7.3, for 17 thousand to a million Gaussians of degree 0 and 3.
const RESIDENT_RATIO: f64 = 7.5;

/// Gaussians of a sector, in memory or in files.
#[derive(Clone)]
pub struct GaussianSource {
    count: usize,
    degree: usize,
    is_compensated: bool,
    storage: Storage,
}

#[derive(Clone)]
enum Storage {
    Memory(Arc<Scene>),
    Bundle(Arc<BundleGaussians>),
}

/// Gaussians in a bundle.
pub(super) struct BundleGaussians {
    pub(super) scene: scene_bundle::Scene,
    pub(super) record: Arc<SplatScene>,
    /// Name of the sector, for messages.
    pub(super) name: String,
    /// Sectors of the record that reach into view.
    pub(super) parts: Vec<usize>,
    /// Gaussians are used that are in this box.
    pub(super) min_m: [f64; 3],
    pub(super) max_m: [f64; 3],
}

impl GaussianSource {
    /// Gaussians in memory, in the frame of the sector.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a scene without Gaussians.
    pub fn new(scene: Scene, is_compensated: bool) -> Result<Self, SimulationError> {
        if scene.splats.is_empty() {
            return Err(SimulationError::Scene {
                place: "Gaussians of a sector".to_owned(),
                found: "0 Gaussians".to_owned(),
                expected: "at least one".to_owned(),
            });
        }
        Ok(Self {
            count: scene.splats.len(),
            degree: scene.splats.degree(),
            is_compensated,
            storage: Storage::Memory(Arc::new(scene)),
        })
    }

    pub(super) fn of_bundle(count: usize, gaussians: BundleGaussians) -> Self {
        Self {
            count,
            degree: gaussians.record.degree,
            is_compensated: gaussians.record.compensated,
            storage: Storage::Bundle(Arc::new(gaussians)),
        }
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Degree of their spherical harmonics.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Whether opacities are compensated for the dilation in the image (Mip-Splatting), as
    /// [`splats::RenderConfig::compensate`] has to be set.
    pub fn is_compensated(&self) -> bool {
        self.is_compensated
    }

    /// Upper bound by measurement of the memory of the Gaussians with all levels of detail, bytes.
    pub fn resident_bytes(&self) -> u64 {
        let bytes = self.count * Plane::count(self.degree) * size_of::<f32>();
        (bytes as f64 * RESIDENT_RATIO) as u64
    }

    /// Adds them to a hash: the content in memory, the hashes of files.
    pub(super) fn hash(&self, hasher: &mut blake3::Hasher) {
        match &self.storage {
            Storage::Memory(scene) => {
                for plane in scene.splats.planes() {
                    floats(hasher, plane);
                }
                match &scene.background {
                    Background::Constant(color) => floats(hasher, color),
                    Background::Sky(sky) => floats(hasher, sky.texels().as_flattened()),
                }
            }
            Storage::Bundle(gaussians) => {
                let output = gaussians.scene.manifest().outputs.get(outputs::SPLATS);
                hasher.update(output.map_or(&[], |output| output.hash.as_bytes()));
            }
        }
    }

    /// Reads them.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] with sector and file where files changed since the scene was
    /// opened.
    pub fn load(&self) -> Result<Arc<Scene>, SimulationError> {
        match &self.storage {
            Storage::Memory(scene) => Ok(scene.clone()),
            Storage::Bundle(gaussians) => gaussians.load().map(Arc::new),
        }
    }
}

impl fmt::Debug for GaussianSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} Gaussians of degree {}", self.count, self.degree)
    }
}

impl BundleGaussians {
    fn load(&self) -> Result<Scene, SimulationError> {
        let bundle_error = |error: BundleError| SimulationError::Scene {
            place: format!("Gaussians of sector {}", self.name),
            found: error_chain(&error),
            expected: "the files as they were when the scene was opened".to_owned(),
        };
        let reader = self.scene.output(outputs::SPLATS);
        let reader = reader.map_err(bundle_error)?;
        let mut planes = vec![Vec::new(); Plane::count(self.record.degree)];
        for part in &self.parts {
            let splats = outputs::splats::read_sector(&reader, &self.record, *part);
            let splats = splats.map_err(bundle_error)?;
            let kept = indices_in_box(&splats, self.min_m, self.max_m);
            for (all, plane) in planes.iter_mut().zip(splats.planes()) {
                all.extend(kept.iter().map(|index| plane[*index]));
            }
        }
        let texels = outputs::splats::read_sky(&reader, &self.record);
        let background = background(&self.record, texels.map_err(bundle_error)?);
        let splats = Splats::from_planes(self.record.degree, planes).map_err(|e| e.to_string());
        let place = format!("Gaussians of sector {}", self.name);
        scene_of(splats, background, &place)
    }
}

/// A scene of its parts, or what is wrong with them.
fn scene_of(
    splats: Result<Splats, String>,
    background: Result<Background, String>,
    place: &str,
) -> Result<Scene, SimulationError> {
    let wrong = |found: String| SimulationError::Scene {
        place: place.to_owned(),
        found,
        expected: "finite Gaussians and sky".to_owned(),
    };
    Ok(Scene {
        splats: splats.map_err(wrong)?,
        background: background.map_err(wrong)?,
    })
}

fn background(record: &SplatScene, texels: Vec<[f32; 3]>) -> Result<Background, String> {
    match record.background {
        SplatBackground::Constant(color) => Ok(Background::Constant(color)),
        SplatBackground::Sky { size } => Sky::from_texels(size, texels)
            .map(Background::Sky)
            .map_err(|e| e.to_string()),
    }
}

/// Gaussians whose means are in a box.
pub(super) fn indices_in_box(splats: &Splats, min_m: [f64; 3], max_m: [f64; 3]) -> Vec<usize> {
    let means = &splats.planes()[Plane::POSITION..Plane::POSITION + 3];
    let is_inside = |index: &usize| {
        (0..3).all(|k| (min_m[k]..=max_m[k]).contains(&f64::from(means[k][*index])))
    };
    (0..splats.len()).filter(is_inside).collect()
}
