//! The optimizer on the device: moments, steps, and what is gathered for growth.

use bytemuck::{Pod, Zeroable};
use splats::{
    GrowthStatistics, Plane, SplatError, Splats, TrainConfig, TrainingState, TrainingStep,
};
use wgpu::ComputePass;

use crate::backward::Backward;
use crate::device::Gpu;
use crate::error::GpuError;
use crate::kernel::Kernel;
use crate::memory::{Store, Uniform, floats};
use crate::scene::GpuScene;
use crate::shaders::THREADS;

const ADAM: &str = include_str!("shaders/adam.wgsl");

/// Planes of what is observed of each Gaussian.
const OBSERVED: usize = 6;

/// `Step` in the kernels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Settings {
    counts: [u32; 4],
    flags: [u32; 4],
    rates: [f32; 4],
    more_rates: [f32; 4],
    moments: [f32; 4],
    size: [f32; 4],
}

#[derive(Debug)]
pub(crate) struct AdamKernels {
    check_finite: Kernel,
    halt: Kernel,
    step_splats: Kernel,
    observe: Kernel,
    step_background: Kernel,
    settings: Uniform,
}

/// State of a training on the device, beside its scene.
#[derive(Debug)]
pub(crate) struct Moments {
    moments: Store,
    steps: Store,
    observed: Store,
    background: Store,
    corrections: Store,
}

impl Moments {
    pub(crate) fn new(
        gpu: &Gpu,
        state: &TrainingState,
        corrections: &[f32],
    ) -> Result<Self, GpuError> {
        let first = state.first.iter().flatten();
        let both = first.zip(state.second.iter().flatten());
        let moments: Vec<[f32; 2]> = both.map(|(first, second)| [*first, *second]).collect();
        let steps: Vec<u32> = state
            .steps
            .iter()
            .flatten()
            .map(|n| u32::from(*n))
            .collect();
        let of = &state.observed;
        let mut observed: Vec<u32> = Vec::with_capacity(OBSERVED * of.len());
        observed.extend(of.iter().map(|o| o.error_px.to_bits()));
        observed.extend(of.iter().map(|o| o.instants));
        observed.extend(of.iter().map(|o| instant(o.last_instant)));
        observed.extend(of.iter().map(|o| o.gradient.to_bits()));
        observed.extend(of.iter().map(|o| o.views));
        observed.extend(of.iter().map(|o| o.weight_px.to_bits()));
        let pairs = moments.as_flattened();
        let background = state.background.as_flattened().as_flattened();
        Ok(Self {
            moments: Store::of(gpu, "moments", pairs)?,
            steps: Store::of(gpu, "steps of the Gaussians", &steps)?,
            observed: Store::of(gpu, "observations", &observed)?,
            background: Store::of(gpu, "moments of the background", background)?,
            corrections: Store::of(gpu, "corrections of moments", corrections)?,
        })
    }

    /// Buffers that hold the state, with their lengths: those of [`Moments::state`].
    pub(crate) fn stores<'a>(&'a self, scene: &'a GpuScene) -> [(&'a Store, usize); 6] {
        let (splats, planes) = (scene.splats, Plane::count(scene.degree));
        let colors = 3 * scene.texels();
        [
            (&scene.planes, planes * splats),
            (&scene.background, colors),
            (&self.moments, 2 * planes * splats),
            (&self.steps, 2 * splats),
            (&self.observed, OBSERVED * splats),
            (&self.background, 2 * colors),
        ]
    }

    /// The state from the values of the buffers; `before` is where the run began.
    pub(crate) fn state(
        before: &TrainingState,
        values: &[Vec<u32>],
    ) -> Result<TrainingState, SplatError> {
        let mut out = before.clone();
        let degree = before.scene.splats.degree();
        let splats = before.scene.splats.len();
        let [planes, colors, moments, steps, observed, background] = values else {
            return Ok(out);
        };
        let length = splats.max(1);
        let planes = floats(planes);
        let planes = match splats {
            0 => vec![Vec::new(); Plane::count(degree)],
            _ => planes.chunks_exact(length).map(<[f32]>::to_vec).collect(),
        };
        out.scene.splats = Splats::from_planes(degree, planes)?;
        out.scene.background = match &before.scene.background {
            splats::Background::Constant(_) => {
                splats::Background::Constant(std::array::from_fn(|c| f32::from_bits(colors[c])))
            }
            splats::Background::Sky(sky) => {
                let texels = floats(colors).as_chunks().0.to_vec();
                splats::Background::Sky(splats::Sky::from_texels(sky.size(), texels)?)
            }
        };
        let moments = floats(moments);
        let pairs = moments.as_chunks::<2>().0.chunks_exact(length);
        let planes = out.first.iter_mut().zip(&mut out.second);
        for ((first, second), pairs) in planes.zip(pairs) {
            *first = pairs.iter().map(|pair| pair[0]).collect();
            *second = pairs.iter().map(|pair| pair[1]).collect();
        }
        for (of, values) in out.steps.iter_mut().zip(steps.chunks_exact(length)) {
            *of = values.iter().map(|n| *n as u16).collect();
        }
        for (i, of) in out.observed.iter_mut().enumerate() {
            let value = |plane: usize| observed[plane * splats + i];
            *of = GrowthStatistics {
                error_px: f32::from_bits(value(0)),
                instants: value(1),
                last_instant: value(2).checked_sub(1),
                gradient: f32::from_bits(value(3)),
                views: value(4),
                weight_px: f32::from_bits(value(5)),
            };
        }
        let pairs = floats(background).as_chunks().0.to_vec();
        out.background = pairs.as_chunks().0.to_vec();
        Ok(out)
    }
}

/// 0 is none.
fn instant(of: Option<u32>) -> u32 {
    of.map_or(0, |instant| instant.saturating_add(1))
}

impl AdamKernels {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let kernel = |name| Kernel::new(gpu, name, &[ADAM]);
        Ok(Self {
            check_finite: kernel("check_finite")?,
            halt: kernel("halt")?,
            step_splats: kernel("step_splats")?,
            observe: kernel("observe")?,
            step_background: kernel("step_background")?,
            settings: Uniform::new::<Settings>(gpu, &Zeroable::zeroed())?,
        })
    }

    /// Sets the rates of a step.
    pub(crate) fn prepare(
        &self,
        gpu: &Gpu,
        scene: &GpuScene,
        step: &TrainingStep<'_>,
        config: &TrainConfig,
        corrections: &[f32],
    ) {
        let optimizer = &config.optimizer;
        let model = step.view.camera.model();
        let half = [model.width, model.height].map(|v| v as f32 / 2.0);
        let area = (step.reduction * step.reduction) as f32;
        let colors = 3 * scene.texels();
        let correction = corrections[step.step.min(corrections.len() - 1)];
        let settings = Settings {
            counts: [
                scene.splats as u32,
                Plane::count(scene.degree) as u32,
                step.step as u32,
                colors as u32,
            ],
            flags: [
                instant(Some(step.view.instant)),
                u32::from(step.harmonics_rate > 0.0),
                0,
                0,
            ],
            rates: [
                step.position_rate_m,
                optimizer.scale,
                optimizer.rotation,
                optimizer.opacity,
            ],
            more_rates: [
                optimizer.color,
                step.harmonics_rate,
                optimizer.background,
                optimizer.epsilon,
            ],
            moments: [
                1.0 - optimizer.beta1,
                1.0 - optimizer.beta2,
                correction,
                config.growth.min_error_px,
            ],
            size: [half[0], half[1], area, step.position_rate_by_size],
        };
        self.settings.write(gpu, &settings);
    }

    /// Encodes the work after that of the gradients.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        (scene, moments): (&GpuScene, &Moments),
        backward: &Backward,
        status: &Store,
    ) {
        let groups = |threads: usize| [threads.div_ceil(THREADS) as u32, 1];
        let (splats, colors) = (scene.splats, 3 * scene.texels());
        let settings = (0, self.settings.buffer());
        let status = (1, status.buffer());
        let extras = (2, backward.extras.buffer());
        let by_parameter = (3, backward.by_parameter.buffer());
        let by_texel = (9, backward.by_texel.buffer());
        let all = [settings, status, extras, by_parameter, by_texel];
        let both = groups(splats.max(colors));
        self.check_finite.run(gpu, pass, &all, both);
        self.halt.run(gpu, pass, &[settings, status], [1, 1]);
        let all = [
            settings,
            status,
            extras,
            by_parameter,
            (4, scene.planes.buffer()),
            (5, moments.moments.buffer()),
            (6, moments.steps.buffer()),
            (7, moments.corrections.buffer()),
        ];
        self.step_splats.run(gpu, pass, &all, groups(splats));
        let all = [settings, status, extras, (8, moments.observed.buffer())];
        self.observe.run(gpu, pass, &all, groups(splats));
        let all = [
            settings,
            status,
            by_texel,
            (10, scene.background.buffer()),
            (11, moments.background.buffer()),
        ];
        self.step_background.run(gpu, pass, &all, groups(colors));
    }
}
