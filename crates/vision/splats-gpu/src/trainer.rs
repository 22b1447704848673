//! Steps of a training on the device.

use std::collections::VecDeque;

use splats::{RenderConfig, SplatError, TrainingDevice, TrainingRun, TrainingState};

use crate::adam::{AdamKernels, Moments};
use crate::backward::Backward;
use crate::device::Gpu;
use crate::error::GpuError;
use crate::forward::{GpuRenderer, encoder, submit};
use crate::frame::status;
use crate::loss::{LossKernels, LossWork, Losses};
use crate::memory::{Download, floats};
use crate::scene::GpuScene;

/// Steps that the processor is ahead of the device: each holds its image in memory.
const AHEAD: usize = 4;

/// Runs the steps of a training on the device, without a read-back between them.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::{
///     Background, Camera, RenderConfig, Scene, Splat, Splats, TrainConfig, Trainer, TrainingView,
/// };
/// use splats_gpu::{Adapters, Gpu, GpuTrainer};
///
/// let gpu = match Gpu::open(Adapters::SoftwareToo) {
///     Ok(gpu) => gpu,
///     Err(error) => {
///         println!("skipped: {error}");
///         return Ok(());
///     }
/// };
/// // A gray ball in front of a camera that saw an orange one.
/// let model = CameraModel::new((32, 32), [30.0, 30.0, 15.5, 15.5], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
/// let view = TrainingView::new(camera, [230, 120, 20].repeat(32 * 32), 0);
/// let mut splats = Splats::empty(0)?;
/// splats.push(&Splat { position_m: [0.0, 0.0, 2.0], ..Splat::sphere(1.0, [0.5; 3]) })?;
/// let scene = Scene { splats, background: Background::Constant([0.0; 3]) };
///
/// let mut config = TrainConfig::default();
/// config.steps = 40;
/// let views = vec![view.clone()];
/// let mut trainer = Trainer::new(scene, views, config, RenderConfig::default(), 7)?;
/// let before = trainer.evaluate(&[view.clone()]).mean_psnr_db();
/// let mut device = GpuTrainer::new(&gpu)?;
/// while trainer.steps() < config.steps {
///     trainer.run_on(&mut device, config.steps)?;
/// }
/// assert!(trainer.evaluate(&[view]).mean_psnr_db() > before + 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct GpuTrainer {
    renderer: GpuRenderer,
    backward: Backward,
    loss: LossKernels,
    adam: AdamKernels,
    losses: Losses,
    failure: Option<GpuError>,
}

impl GpuTrainer {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// [`GpuError`] of the device.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            // Each run has the configuration of its trainer.
            renderer: GpuRenderer::new(gpu, RenderConfig::default())?,
            backward: Backward::new(gpu)?,
            loss: LossKernels::new(gpu)?,
            adam: AdamKernels::new(gpu)?,
            losses: Losses::default(),
            failure: None,
        })
    }

    /// The loss of the last step.
    pub fn losses(&self) -> Losses {
        self.losses
    }

    /// Why the device failed, after [`SplatError::Device`].
    pub fn failure(&self) -> Option<&GpuError> {
        self.failure.as_ref()
    }

    fn run_steps(
        &mut self,
        run: &TrainingRun<'_>,
        before: &TrainingState,
    ) -> Result<TrainingState, GpuError> {
        let gpu = self.renderer.gpu.clone();
        self.renderer.config = *run.renderer().config();
        let scene = GpuScene::new(&gpu, &before.scene)?;
        let moments = Moments::new(&gpu, before, run.corrections())?;
        self.renderer.frame.clear_flags(&gpu);
        let mut next = run.steps.start;
        loop {
            let mut last = None;
            let mut submitted = VecDeque::new();
            for step in next..run.steps.end {
                last = Some(self.submit_step(run, step, &scene, &moments)?);
                submitted.push_back(gpu.queue.submit([]));
                if submitted.len() > AHEAD {
                    gpu.wait_for(submitted.pop_front())?;
                }
            }
            let mut encoder = encoder(&gpu);
            let mut from = vec![
                (&self.renderer.frame.status, status::LEN),
                (&self.loss.losses, 4),
            ];
            from.extend(moments.stores(&scene));
            let download = Download::new(&gpu, &mut encoder, &from)?;
            submit(&gpu, "results of a training", encoder)?;
            let found = download.read(&gpu)?;
            let of = &found[0];
            let halted_at = of[status::HALTED_AT] as usize;
            // First: gradients of pairs that did not fit are incomplete.
            if !self.renderer.fits(of)? {
                // The steps from that one on changed nothing.
                next = halted_at;
                continue;
            }
            if of[status::NOT_FINITE] != 0 {
                let (step, reason) = (halted_at, "a gradient is not a finite number".to_owned());
                return Err(SplatError::Diverged { step, reason }.into());
            }
            if let Some(work) = last {
                self.losses = Losses::new(&floats(&found[1]), work.count);
            }
            return Ok(Moments::state(before, &found[2..])?);
        }
    }

    fn submit_step(
        &mut self,
        run: &TrainingRun<'_>,
        step: usize,
        scene: &GpuScene,
        moments: &Moments,
    ) -> Result<LossWork, GpuError> {
        let gpu = self.renderer.gpu.clone();
        let step = run.step(step)?;
        let config = run.config();
        let weight = step.depth_weight;
        let work = self.loss.prepare(&gpu, &step.view, &config.loss, weight)?;
        self.adam
            .prepare(&gpu, scene, &step, config, run.corrections());
        let mut encoder = encoder(&gpu);
        let renderer = &mut self.renderer;
        let encoded = renderer.encode(&mut encoder, scene, &step.camera, &step.exposure)?;
        self.backward
            .reserve(&gpu, &renderer.frame, scene, &encoded)?;
        let description = wgpu::ComputePassDescriptor::default();
        let mut pass = encoder.begin_compute_pass(&description);
        let backward = &self.backward;
        self.loss
            .encode(&gpu, &mut pass, work, &renderer.frame, backward);
        let frame = &renderer.frame;
        backward.encode(&gpu, &mut pass, frame, scene, &encoded, false);
        let state = (scene, moments);
        let status = &renderer.frame.status;
        self.adam.encode(&gpu, &mut pass, state, backward, status);
        drop(pass);
        submit(&gpu, "a step of a training", encoder)?;
        Ok(work)
    }
}

impl TrainingDevice for GpuTrainer {
    fn run(
        &mut self,
        run: &TrainingRun<'_>,
        state: TrainingState,
    ) -> Result<TrainingState, SplatError> {
        match self.run_steps(run, &state) {
            Ok(state) => Ok(state),
            Err(GpuError::Splats(error)) => Err(error),
            Err(error) => {
                let reason = error.to_string();
                self.failure = Some(error);
                Err(SplatError::Device { reason })
            }
        }
    }
}
