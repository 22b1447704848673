//! Where the Gaussians of a sector come from. They are loaded when they are needed.

use std::fmt;
use std::sync::Arc;

use gaussians::{Plane, Splats};
use scene_bundle::outputs::splats::{SplatBackground, SplatScene};
use scene_bundle::{BundleError, OutputReader, error_chain, outputs};
use splats::{Background, Camera, Scene, Sky};

use super::hash::bytes::floats;
use crate::confidence::ObservedScene;
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
    Memory(Arc<Scene>, Observation),
    Bundle(Arc<BundleGaussians>),
}

/// What is known of what was seen of Gaussians in memory.
#[derive(Clone)]
enum Observation {
    Nothing,
    /// Cameras that recorded them without any error.
    By(Arc<[Camera]>),
    Scene(Arc<ObservedScene>),
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
            storage: Storage::Memory(Arc::new(scene), Observation::Nothing),
        })
    }

    /// With what the training saw of Gaussians in memory. Of those in a bundle it is in the bundle.
    #[must_use]
    pub fn with_observed(self, observed: ObservedScene) -> Self {
        self.with(Observation::Scene(Arc::new(observed)))
    }

    /// With the cameras that recorded Gaussians in memory without any error: what they saw is
    /// gathered when it is needed.
    #[must_use]
    pub(crate) fn recorded_by(self, cameras: Vec<Camera>) -> Self {
        self.with(Observation::By(cameras.into()))
    }

    fn with(mut self, observed: Observation) -> Self {
        if let Storage::Memory(_, own) = &mut self.storage {
            *own = observed;
        }
        self
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
            Storage::Memory(scene, _) => {
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
            Storage::Memory(scene, _) => Ok(scene.clone()),
            Storage::Bundle(gaussians) => gaussians.load().map(Arc::new),
        }
    }

    /// Whether it is known what the training saw of them.
    pub fn is_observed(&self) -> bool {
        match &self.storage {
            Storage::Memory(_, observed) => !matches!(observed, Observation::Nothing),
            Storage::Bundle(gaussians) => gaussians.record.coverage.is_some(),
        }
    }

    /// What the training saw of them, in the order of [`Self::load`]; `None` where that is not
    /// known.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] with sector and file where files changed since the scene was
    /// opened.
    pub fn observed(&self) -> Result<Option<Arc<ObservedScene>>, SimulationError> {
        match &self.storage {
            Storage::Memory(_, Observation::Nothing) => Ok(None),
            Storage::Memory(_, Observation::Scene(observed)) => Ok(Some(observed.clone())),
            Storage::Memory(scene, Observation::By(cameras)) => {
                let observed = ObservedScene::gather(scene, self.is_compensated, cameras)?;
                Ok(Some(Arc::new(observed)))
            }
            Storage::Bundle(gaussians) => Ok(gaussians.observed()?.map(Arc::new)),
        }
    }
}

impl fmt::Debug for GaussianSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} Gaussians of degree {}", self.count, self.degree)
    }
}

impl BundleGaussians {
    fn reader(&self) -> Result<OutputReader, SimulationError> {
        let reader = self.scene.output(outputs::SPLATS);
        reader.map_err(|source| self.wrong(source))
    }

    fn wrong(&self, source: BundleError) -> SimulationError {
        SimulationError::Scene {
            place: format!("Gaussians of sector {}", self.name),
            found: error_chain(&source),
            expected: "the files as they were when the scene was opened".to_owned(),
        }
    }

    /// Each part that reaches into view: its number, its Gaussians, and which of them are used.
    fn parts<'a>(
        &'a self,
        reader: &'a OutputReader,
    ) -> impl Iterator<Item = Result<(usize, Splats, Vec<usize>), SimulationError>> + 'a {
        self.parts.iter().map(|part| {
            let splats = outputs::splats::read_sector(reader, &self.record, *part);
            let splats = splats.map_err(|source| self.wrong(source))?;
            let kept = indices_in_box(&splats, self.min_m, self.max_m);
            Ok((*part, splats, kept))
        })
    }

    fn observed(&self) -> Result<Option<ObservedScene>, SimulationError> {
        if self.record.coverage.is_none() {
            return Ok(None);
        }
        let reader = self.reader()?;
        let kept = self.parts(&reader).map(|part| {
            let (part, _, kept) = part?;
            Ok((part, kept))
        });
        let kept: Vec<(usize, Vec<usize>)> = kept.collect::<Result<_, SimulationError>>()?;
        ObservedScene::read_parts(&reader, &self.record, |seen| {
            let used = kept.iter().flat_map(|(part, kept)| {
                let of_part = &seen[*part];
                kept.iter().map(|index| of_part[*index])
            });
            used.collect()
        })
    }

    fn load(&self) -> Result<Scene, SimulationError> {
        let reader = self.reader()?;
        let mut planes = vec![Vec::new(); Plane::count(self.record.degree)];
        for part in self.parts(&reader) {
            let (_, splats, kept) = part?;
            for (all, plane) in planes.iter_mut().zip(splats.planes()) {
                all.extend(kept.iter().map(|index| plane[*index]));
            }
        }
        let texels = outputs::splats::read_sky(&reader, &self.record);
        let texels = texels.map_err(|source| self.wrong(source))?;
        let background = background(&self.record, texels);
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
