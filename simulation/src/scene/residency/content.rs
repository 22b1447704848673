//! What is resident of a sector.

use std::sync::Arc;

use splats::{DetailScene, Scene};

/// Gaussians of a sector, ready to render.
#[derive(Debug)]
pub struct SectorGaussians {
    /// As they were trained.
    pub exact: Arc<Scene>,
    /// With levels of detail, for small images.
    pub detail: DetailScene,
    /// Whether opacities are compensated for the dilation in the image.
    pub is_compensated: bool,
}
