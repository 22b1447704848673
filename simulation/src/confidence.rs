//! How far an image from any camera is outside of what the recording shows.
//!
//! Contract: `splats` gathered what the views of the training saw and stored it in the scene
//! bundle; this reads it back and judges images of other cameras with it. It is the measure that
//! `cargo xtask bench confidence` examines.

use scene_bundle::OutputReader;
use scene_bundle::outputs::splats::{self as output, SplatObservation, SplatScene};
use splats::{
    Camera, Confidence, ConfidenceConfig, Coverage, Directions, Exposure, ObservedGaussian,
    ObservedSky, ObservedSpace, RenderConfig, Renderer, Scene, SplatError, TrainingView,
};

use crate::error::SimulationError;

/// What the views of a training saw of a scene.
#[derive(Clone, Debug)]
pub struct ObservedScene {
    coverage: Coverage,
    config: ConfidenceConfig,
}

impl ObservedScene {
    /// With what the crate `splats` gathered.
    pub fn new(coverage: Coverage) -> Self {
        Self {
            coverage,
            config: ConfidenceConfig::default(),
        }
    }

    /// Reads what was seen of all sectors of a scene, in the order of their Gaussians; `None` if
    /// the scene has none, as scenes that were trained by an older version.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] if it is damaged.
    pub fn read(
        reader: &OutputReader,
        record: &SplatScene,
    ) -> Result<Option<Self>, SimulationError> {
        Self::read_parts(reader, record, |parts| {
            parts.into_iter().flatten().collect()
        })
    }

    /// The same of the Gaussians that `select` takes out of those of each sector of the record.
    pub(crate) fn read_parts(
        reader: &OutputReader,
        record: &SplatScene,
        select: impl FnOnce(Vec<Vec<SplatObservation>>) -> Vec<SplatObservation>,
    ) -> Result<Option<Self>, SimulationError> {
        let damaged = |found: String| SimulationError::Scene {
            place: reader.folder().to_owned(),
            found,
            expected: "what the training saw, as it was written".to_owned(),
        };
        let content = output::read_coverage(reader, record);
        let content = content.map_err(|error| damaged(scene_bundle::error_chain(&error)))?;
        let Some((layout, content)) = record.coverage.as_ref().zip(content) else {
            return Ok(None);
        };
        let gaussians = select(content.gaussians)
            .into_iter()
            .map(|seen| ObservedGaussian {
                instants: seen.instants,
                directions: Directions(seen.directions),
                finest_m: seen.finest_m,
                color_error: seen.color_error,
                depth_error: seen.depth_error,
            });
        let blocks = content
            .space
            .iter()
            .map(|block| (block.index, block.voxels));
        let space = ObservedSpace::from_blocks([layout.voxel_m, layout.range_m], blocks);
        let sky = ObservedSky::from_texels(layout.sky_texels, content.sky);
        let sky = sky.map_err(|error| damaged(error.to_string()))?;
        let coverage = Coverage::new(gaussians.collect(), space, sky);
        Ok(Some(Self::new(coverage)))
    }

    /// What cameras see that record a scene without any error, as those of synthetic scenes do.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a scene that cannot be rendered.
    pub(crate) fn gather(
        scene: &Scene,
        is_compensated: bool,
        cameras: &[Camera],
    ) -> Result<Self, SimulationError> {
        let renderer = renderer(is_compensated)?;
        let views = cameras.iter().zip(0..).map(|(camera, number)| {
            let image = renderer.render(scene, camera, &Exposure::NONE);
            let rgb = (0..camera.pixels()).flat_map(|pixel| {
                let channels = [0, 1, 2].map(|c: usize| image.rgb[c][pixel]);
                channels.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
            });
            TrainingView::new(camera.clone(), rgb.collect(), number)
        });
        let views: Vec<TrainingView> = views.collect();
        let config = ConfidenceConfig::default().coverage;
        let coverage = Coverage::gather(&renderer, scene, &views, &config);
        Ok(Self::new(coverage.map_err(|error| cannot_judge(&error))?))
    }

    /// What was gathered.
    pub(crate) fn coverage(&self) -> &Coverage {
        &self.coverage
    }

    /// The confidence of an image of a camera. It is a slower pass than rendering; images of some
    /// ten thousand pixels are enough for a verdict.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] if the scene is not that of which views were gathered.
    pub fn confidence(
        &self,
        renderer: &Renderer,
        scene: &Scene,
        camera: &Camera,
    ) -> Result<Confidence, SimulationError> {
        let image = self.coverage.render(renderer, scene, camera);
        let image = image.map_err(|error| cannot_judge(&error))?;
        Ok(image.confidence(&self.config.measure))
    }
}

/// A renderer for Gaussians that were trained with or without compensation.
pub(crate) fn renderer(is_compensated: bool) -> Result<Renderer, SimulationError> {
    let mut config = RenderConfig::default();
    config.compensate = is_compensated;
    Renderer::new(config).map_err(|error| cannot_judge(&error))
}

pub(crate) fn cannot_judge(error: &SplatError) -> SimulationError {
    SimulationError::Scene {
        place: "confidence of an image".to_owned(),
        found: error.to_string(),
        expected: "the scene that was trained".to_owned(),
    }
}
