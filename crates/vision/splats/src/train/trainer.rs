//! A training, step by step.

pub(super) mod device;

use std::sync::Arc;

use rayon::prelude::*;

use super::adam::{Adam, Rates, corrections, update};
use super::codec::{Codec, State, broken};
use super::config::TrainConfig;
use super::evaluate::{Evaluation, psnr_db};
use super::exposures::Exposures;
use super::grow::{self, Growth, Round};
use super::loss::{self, Loss};
use super::poses::Poses;
use super::schedule;
use super::view::TrainingView;
use crate::camera::Camera;
use crate::confidence::{Coverage, CoverageConfig};
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::render::{Gradients, Renderer};
use crate::scene::{Background, Exposure, Scene, Sky, Splats, morton_order};

/// Smallest radius of a scene, m: cameras may stand at one position.
const MIN_RADIUS_M: f32 = 0.5;

/// A training: the scene with its optimizer.
///
/// The same scene, views, configuration and seed give the same result on any number of threads.
/// A copy continues as the original does.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::{
///     Background, Camera, RenderConfig, Scene, StartPoint, TrainConfig, Trainer, TrainingView,
///     splats_from_points,
/// };
///
/// // An orange wall in front of one camera.
/// let model = CameraModel::new((48, 32), [40.0, 40.0, 23.5, 15.5], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
/// let view = TrainingView::new(camera, [230, 120, 20].repeat(48 * 32), 0);
/// let mut points = Vec::new();
/// for i in 0..160 {
///     let (x, y) = ((i % 16) as f32 * 0.2 - 1.5, (i / 16) as f32 * 0.2 - 0.9);
///     let normal = Some([0.0, 0.0, -1.0]);
///     let (position_m, color) = ([x, y, 2.0], [0.5; 3]);
///     points.push(StartPoint { position_m, normal, spacing_m: 0.2, sigma_m: 0.01, color });
/// }
/// let background = Background::Constant([0.0; 3]);
/// let scene = Scene { splats: splats_from_points(&points)?, background };
///
/// let mut config = TrainConfig::default();
/// config.steps = 100;
/// let mut trainer = Trainer::new(scene, vec![view.clone()], config, RenderConfig::default(), 7)?;
/// let before = trainer.evaluate(&[view.clone()]).mean_psnr_db();
/// while trainer.steps() < config.steps {
///     trainer.step()?;
/// }
/// let after = trainer.evaluate(&[view]).mean_psnr_db();
/// assert!(after > before + 2.0, "{before} dB before, {after} dB after");
/// # Ok::<(), splats::SplatError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Trainer {
    scene: Scene,
    views: Arc<Vec<TrainingView>>,
    config: TrainConfig,
    renderer: Renderer,
    seed: u64,
    steps: usize,
    radius_m: f32,
    adam: Adam,
    /// Moments of the background's colors.
    background: Vec<[[f32; 2]; 3]>,
    corrections: Arc<Vec<f32>>,
    exposures: Exposures,
    poses: Poses,
    growth: Growth,
    grows: bool,
}

/// A step of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReport {
    /// Number of the step, from 0.
    pub step: usize,
    /// Index of the view.
    pub view: usize,
    /// The loss.
    pub loss: f64,
    /// Mean absolute difference of colors, 0 to 1.
    pub l1: f64,
    /// Mean structural similarity, at most 1.
    pub ssim: f64,
    /// Mean robust squared error of depth, sigmas².
    pub depth: f64,
    /// Gaussians after the step.
    pub splats: usize,
    /// Gaussians that the view shows.
    pub visible: usize,
}

impl Trainer {
    /// Prepares a training. Harmonics of the scene above degree 0 are kept if the configuration has
    /// them.
    ///
    /// # Errors
    /// [`SplatError::Views`] if there are no views or one has no usable pixel,
    /// [`SplatError::Size`] if a buffer does not fit its image, [`SplatError::Setting`].
    pub fn new(
        scene: Scene,
        mut views: Vec<TrainingView>,
        config: TrainConfig,
        render: RenderConfig,
        seed: u64,
    ) -> Result<Self, SplatError> {
        let reason = |reason: String| Err(SplatError::Views { reason });
        if views.is_empty() {
            return reason("there are none".to_owned());
        }
        for (index, view) in views.iter().enumerate() {
            view.check()?;
            if view.valid_pixels() == 0 {
                return reason(format!("view {index} has no usable pixel"));
            }
        }
        let mut groups: Vec<u32> = views.iter().map(|view| view.exposure_group).collect();
        groups.sort_unstable();
        groups.dedup();
        for view in &mut views {
            view.exposure_group =
                groups.partition_point(|group| *group < view.exposure_group) as u32;
        }
        let Scene { splats, background } = scene;
        let degree = splats.degree().min(config.degree);
        let splats = splats.with_degree(degree)?;
        let splats = splats.select(&morton_order(&splats));
        let texels = match &background {
            Background::Constant(_) => 1,
            Background::Sky(sky) => sky.texels().len(),
        };
        Ok(Self {
            adam: Adam::new(&splats, &config.optimizer),
            growth: Growth::new(splats.len(), seed),
            scene: Scene { splats, background },
            radius_m: radius_m(&views),
            exposures: Exposures::new(groups.len()),
            poses: Poses::new(views.len()),
            views: Arc::new(views),
            config,
            renderer: Renderer::new(render)?,
            seed,
            steps: 0,
            background: vec![[[0.0; 2]; 3]; texels],
            corrections: Arc::new(corrections(&config.optimizer)),
            grows: true,
        })
    }

    /// Trains on one view.
    ///
    /// # Errors
    /// [`SplatError::Diverged`] if a gradient is not finite: the scene remains as it was before the
    /// step. [`SplatError::Gaussians`] from the configuration.
    pub fn step(&mut self) -> Result<StepReport, SplatError> {
        let step = self.steps;
        self.raise_degree(step)?;
        let index = schedule::view(self.seed, step, self.views.len());
        let reduction = schedule::reduction(&self.config, step);
        let views = Arc::clone(&self.views);
        let reduced = match reduction {
            1 => None,
            _ => Some(views[index].reduced(reduction)?),
        };
        let view = reduced.as_ref().unwrap_or(&views[index]);
        let camera = self.poses.of(index, &view.camera, &self.config.poses)?;
        let exposure = self.exposures.of(view, &self.config.exposure);
        let (loss, gradients) = self.gradients(view, &camera, &exposure)?;
        check_finite(step, &loss, &gradients)?;

        let trains_harmonics = step.is_multiple_of(self.config.harmonics_interval.max(1));
        let rates = Rates {
            position_m: schedule::position_rate(&self.config, step) * self.radius_m,
            position_by_size: schedule::position_rate_by_size(&self.config, step),
            harmonics: match trains_harmonics {
                true => self.config.optimizer.harmonics,
                false => 0.0,
            },
        };
        let config = self.config;
        let optimizer = &config.optimizer;
        self.adam
            .step(&mut self.scene.splats, &gradients, &rates, optimizer);
        self.step_background(&gradients);
        let (exposure, poses) = (&config.exposure, &config.poses);
        if exposure.refine {
            let by = &gradients.exposure;
            self.exposures
                .step(view, by, exposure, optimizer, &self.corrections);
        }
        if poses.refine && step >= poses.start {
            self.poses.step(
                index,
                &gradients.motion,
                poses,
                optimizer,
                &self.corrections,
            );
        }
        self.growth
            .gather(&gradients, view, reduction, &self.config.growth);
        self.finish_steps(1);
        Ok(StepReport {
            step,
            view: index,
            loss: loss.total,
            l1: loss.l1,
            ssim: loss.ssim,
            depth: loss.depth,
            splats: self.scene.splats.len(),
            visible: gradients.indices.len(),
        })
    }

    /// Counts steps, and changes the number of Gaussians after the last one where it is due.
    fn finish_steps(&mut self, count: usize) {
        self.steps += count;
        if self.grows && schedule::is_growth_round(&self.config, self.steps) {
            self.grow(self.config.growth.max_share);
        }
        if schedule::is_reset(&self.config, self.steps) {
            let opacity = self.config.growth.reset_opacity;
            grow::reset_opacities(&mut self.scene.splats, &mut self.adam, opacity);
        }
    }

    /// Compares the scene with views, at their given poses and exposures.
    ///
    /// # Panics
    /// If a buffer of a view does not fit its image.
    pub fn evaluate(&self, views: &[TrainingView]) -> Evaluation {
        Evaluation::new(&self.renderer, &self.scene, views)
    }

    /// PSNR of views, dB.
    pub(super) fn psnr_db(&self, views: &[&TrainingView]) -> Vec<f64> {
        let of = |view: &&TrainingView| {
            let image = self
                .renderer
                .render(&self.scene, &view.camera, &view.exposure);
            psnr_db(&image, view)
        };
        views.iter().map(of).collect()
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The configuration.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Steps so far.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The camera of a view, at its refined pose.
    ///
    /// # Errors
    /// [`SplatError::Camera`] if the pose is not finite.
    ///
    /// # Panics
    /// If there is no view of this index.
    pub fn camera(&self, view: usize) -> Result<Camera, SplatError> {
        self.poses
            .of(view, &self.views[view].camera, &self.config.poses)
    }

    /// The exposure of a view, with its refined gain.
    ///
    /// # Panics
    /// If there is no view of this index.
    pub fn exposure(&self, view: usize) -> Exposure {
        self.exposures.of(&self.views[view], &self.config.exposure)
    }

    /// What the views of the training see of the scene as it is now, at their refined poses and
    /// exposures.
    ///
    /// # Errors
    /// [`SplatError::Camera`] if a pose is not finite, [`SplatError::Setting`].
    pub fn coverage(&self, config: &CoverageConfig) -> Result<Coverage, SplatError> {
        let posed = (0..self.views.len()).map(|k| Ok((self.camera(k)?, self.exposure(k))));
        let posed: Result<Vec<(Camera, Exposure)>, SplatError> = posed.collect();
        Coverage::gather_at(&self.renderer, &self.scene, &self.views, &posed?, config)
    }

    /// Passes what changes in a training: the scene, moments, corrections, what was gathered.
    pub(super) fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.steps.visit(codec)?;
        self.grows.visit(codec)?;
        let mut degree = self.scene.splats.degree();
        degree.visit(codec)?;
        let mut planes = match codec {
            Codec::Write(_) => self.scene.splats.planes().to_vec(),
            Codec::Read(_) => Vec::new(),
        };
        planes.visit(codec)?;
        if let Codec::Read(_) = codec {
            self.scene.splats = Splats::from_planes(degree, planes)?;
        }
        match &mut self.scene.background {
            Background::Constant(color) => color.visit(codec)?,
            Background::Sky(sky) => {
                let mut texels = sky.texels().to_vec();
                texels.visit(codec)?;
                *sky = Sky::from_texels(sky.size(), texels)?;
            }
        }
        self.adam.visit(codec)?;
        self.background.visit(codec)?;
        self.exposures.visit(codec)?;
        self.poses.visit(codec)?;
        self.growth.visit(codec)
    }

    /// Takes the state from a checkpoint. After an error the trainer must not be used.
    pub(super) fn load(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        let sizes = |of: &Self| [of.background.len(), of.exposures.len(), of.poses.len()];
        let expected = sizes(self);
        self.visit(codec)?;
        let splats = &self.scene.splats;
        let is_later = self.steps > self.config.steps || splats.degree() > self.config.degree;
        if sizes(self) != expected || is_later {
            return Err(broken("it is of a training with other views or settings"));
        }
        if !self.adam.is_of(splats) || self.growth.len() != splats.len() {
            return Err(broken("its parts are of different numbers of Gaussians"));
        }
        Ok(())
    }

    /// Whether rounds of growth change the number of Gaussians.
    pub(super) fn set_growth(&mut self, grows: bool) {
        self.grows = grows;
    }

    /// Whether the next step ends with a round of growth, if there is growth.
    pub(super) fn is_before_round(&self) -> bool {
        schedule::is_growth_round(&self.config, self.steps + 1)
    }

    /// Splits up to a share of the Gaussians, and removes useless ones.
    pub(super) fn grow(&mut self, max_share: f32) {
        let round = Round {
            radius_m: self.radius_m,
            max_share,
        };
        let growth = &self.config.growth;
        self.growth
            .round(&mut self.scene.splats, &mut self.adam, growth, round);
    }

    fn raise_degree(&mut self, step: usize) -> Result<(), SplatError> {
        let degree = schedule::degree(&self.config, step);
        if degree > self.scene.splats.degree() {
            self.scene.splats = self.scene.splats.clone().with_degree(degree)?;
            self.adam.set_planes(&self.scene.splats);
        }
        Ok(())
    }

    fn gradients(
        &self,
        view: &TrainingView,
        camera: &Camera,
        exposure: &Exposure,
    ) -> Result<(Loss, Gradients), SplatError> {
        let pass = self.renderer.forward(&self.scene, camera, exposure);
        let depth_weight = schedule::depth_weight(&self.config, self.steps);
        let level = self.renderer.level();
        let loss = loss::loss(&pass.image, view, &self.config.loss, depth_weight, level);
        let renderer = &self.renderer;
        let gradients = renderer.backward(&self.scene, camera, exposure, &pass, &loss.gradient)?;
        Ok((loss, gradients))
    }

    fn step_background(&mut self, gradients: &Gradients) {
        let optimizer = &self.config.optimizer;
        let correction = self.corrections[self.steps.min(self.corrections.len() - 1)];
        let colors: &mut [[f32; 3]] = match &mut self.scene.background {
            Background::Constant(color) => std::slice::from_mut(color),
            Background::Sky(sky) => sky.texels_mut(),
        };
        let all = colors
            .iter_mut()
            .zip(&mut self.background)
            .zip(&gradients.background);
        for ((color, moments), gradient) in all {
            for c in 0..3 {
                // A texel that the view does not show keeps its moments.
                if gradient[c] != 0.0 {
                    let [first, second] = &mut moments[c];
                    let change = update(first, second, gradient[c], correction, optimizer);
                    color[c] -= optimizer.background * change;
                }
            }
        }
    }
}

/// Largest coordinate of a camera relative to their mean, m: Splatfacto's unit of length.
fn radius_m(views: &[TrainingView]) -> f32 {
    let centers: Vec<[f64; 3]> = views
        .iter()
        .map(|view| view.camera.camera_from_world().inverse().translation_m())
        .collect();
    let mut largest = 0.0_f64;
    for k in 0..3 {
        let mean = centers.iter().map(|center| center[k]).sum::<f64>() / centers.len() as f64;
        let distances = centers.iter().map(|center| (center[k] - mean).abs());
        largest = distances.fold(largest, f64::max);
    }
    (largest as f32).max(MIN_RADIUS_M)
}

fn check_finite(step: usize, loss: &Loss, gradients: &Gradients) -> Result<(), SplatError> {
    // Without an early end, which vectorizes.
    let all = |plane: &[f32]| plane.iter().fold(true, |all, g| all & g.is_finite());
    let planes = gradients.planes.par_iter().all(|plane| all(plane));
    let background = all(gradients.background.as_flattened());
    let reason = match (loss.total.is_finite(), planes && background) {
        (true, true) => return Ok(()),
        (false, _) => format!("the loss is {}", loss.total),
        (true, false) => "a gradient is not a finite number".to_owned(),
    };
    Err(SplatError::Diverged { step, reason })
}
