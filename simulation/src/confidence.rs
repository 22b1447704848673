//! How far an image from any camera is outside of what the recording shows.
//!
//! Contract: `splats` gathered what the views of the training saw and stored it in the scene
//! bundle; this reads it back and judges images of other cameras with it. It is the measure that
//! `cargo xtask bench confidence` examines.

use scene_bundle::OutputReader;
use scene_bundle::outputs::splats::{self as output, SplatScene};
use splats::{
    Camera, Confidence, ConfidenceConfig, Coverage, Directions, ObservedGaussian, ObservedSky,
    ObservedSpace, Renderer, Scene, SplatError,
};

use crate::error::SimulationError;

/// What the views of a training saw of a scene.
#[derive(Clone, Debug)]
pub struct ObservedScene {
    coverage: Coverage,
    config: ConfidenceConfig,
}

impl ObservedScene {
    /// Reads what was seen of all sectors of a scene, in the order of their Gaussians; `None` if
    /// the scene has none, as scenes that were trained by an older version.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] if it is damaged.
    pub fn read(
        reader: &OutputReader,
        record: &SplatScene,
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
        let gaussians = content
            .gaussians
            .iter()
            .flatten()
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
        Ok(Some(Self {
            coverage: Coverage::new(gaussians.collect(), space, sky),
            config: ConfidenceConfig::default(),
        }))
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
        let image = image.map_err(|error: SplatError| SimulationError::Scene {
            place: "confidence of an image".to_owned(),
            found: error.to_string(),
            expected: "the scene that was trained".to_owned(),
        })?;
        Ok(image.confidence(&self.config.measure))
    }
}
