//! The judge of views of one lens in one sector.

use std::sync::Arc;

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use splats::{Camera, Renderer, Scene};

use crate::confidence::{ObservedScene, cannot_judge, renderer};
use crate::error::SimulationError;
use crate::scene::GaussianSource;

/// Predicts the PSNR of images of one lens in one sector by what the training saw.
///
/// ```
/// use simulation::ViewJudge;
/// use simulation::testing::SyntheticScene;
///
/// let room = SyntheticScene::room()?.scene;
/// let sector = &room.sectors[0];
/// let gaussians = sector.gaussians.as_ref().unwrap();
/// let lens = simulation::pinhole([48, 36], 1.6)?;
/// let judge = ViewJudge::new(gaussians, gaussians.load()?, lens)?.unwrap();
/// // Where it was recorded, and inside of a wall.
/// let recorded = judge.psnr_db(&sector.references[0])?;
/// let outside = judge.psnr_db(&cad_transforms::RigidTransform::identity())?;
/// assert!(recorded > outside);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct ViewJudge {
    observed: Arc<ObservedScene>,
    scene: Arc<Scene>,
    renderer: Renderer,
    lens: CameraModel,
}

impl ViewJudge {
    /// Of the Gaussians of a sector as they were loaded; `None` where it is not known what the
    /// training saw.
    ///
    /// # Errors
    /// As [`GaussianSource::observed`].
    pub fn new(
        gaussians: &GaussianSource,
        scene: Arc<Scene>,
        lens: CameraModel,
    ) -> Result<Option<Self>, SimulationError> {
        let Some(observed) = gaussians.observed()? else {
            return Ok(None);
        };
        Ok(Some(Self {
            observed,
            scene,
            renderer: renderer(gaussians.is_compensated())?,
            lens,
        }))
    }

    /// Predicted PSNR of the image of a camera at a pose in the sector, dB.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a lens that images cannot be rendered with, and if the
    /// Gaussians are not those of which views were gathered.
    pub fn psnr_db(&self, sector_from_camera: &RigidTransform) -> Result<f32, SimulationError> {
        let camera = Camera::new(self.lens, sector_from_camera.inverse());
        let camera = camera.map_err(|error| cannot_judge(&error))?;
        let found = self
            .observed
            .confidence(&self.renderer, &self.scene, &camera)?;
        Ok(found.psnr_db)
    }
}
