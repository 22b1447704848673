//! The scene that is rendered.

use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use serde_json::{Value, json};
use simulation::{GaussianStore, ResidencyConfig, SceneData, SectorGaussians};
use splats::{RenderConfig, Renderer};

/// A scene with its first sector in memory, whose Gaussians are those up to 40 m around it.
pub(super) struct OpenedScene {
    pub(super) scene: Arc<SceneData>,
    pub(super) store: Arc<GaussianStore>,
    pub(super) content: Arc<SectorGaussians>,
    /// For the exact images.
    pub(super) renderer: Renderer,
}

impl OpenedScene {
    pub(super) fn new(path: &Path) -> Result<Self> {
        let scene = Arc::new(SceneData::open(path)?);
        for missing in scene.missing() {
            println!("  without {}: {}", missing.output, missing.features);
        }
        let store = GaussianStore::new(scene.clone(), ResidencyConfig::default());
        let content = store.content(0)?;
        let mut config = RenderConfig::default();
        config.compensate = content.is_compensated;
        Ok(Self {
            store: Arc::new(store),
            renderer: Renderer::new(config)?,
            scene,
            content,
        })
    }

    pub(super) fn row(&self) -> Value {
        json!({
            "name": self.scene.name,
            "sectors": self.scene.sectors.len(),
            "gaussians": self.content.exact.splats.len(),
            "degree": self.content.exact.splats.degree(),
        })
    }
}
