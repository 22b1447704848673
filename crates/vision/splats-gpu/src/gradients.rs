//! Gradients as data.

use splats::{Camera, Exposure, Gradients, ImageGradient, Plane, SplatError};

use crate::backward::{Backward, EXTRAS, GRADIENT_PLANES, TOTALS_LEN};
use crate::error::GpuError;
use crate::forward::{GpuRenderer, encoder, submit};
use crate::frame::status;
use crate::memory::{Download, floats};
use crate::scene::GpuScene;

impl GpuRenderer {
    /// Gradients of a loss whose gradient with respect to the image is given. Renders the image.
    ///
    /// # Errors
    /// [`GpuError::Splats`] if a plane has not one value per pixel; others of the device.
    pub fn backward(
        &mut self,
        scene: &GpuScene,
        camera: &Camera,
        exposure: &Exposure,
        gradient: &ImageGradient,
    ) -> Result<Gradients, GpuError> {
        let gpu = self.gpu.clone();
        let planes = planes(gradient, camera.pixels())?;
        let mut backward = match self.backward.take() {
            Some(backward) => backward,
            None => Backward::new(&gpu)?,
        };
        let (values, texels) = (Plane::count(scene.degree) * scene.splats, scene.texels());
        let found = loop {
            let mut encoder = encoder(&gpu);
            let encoded = self.encode(&mut encoder, scene, camera, exposure)?;
            backward.reserve(&gpu, &self.frame, scene, &encoded)?;
            for (k, plane) in planes.iter().enumerate() {
                backward.gradient.write(&gpu, k * plane.len(), plane);
            }
            let description = wgpu::ComputePassDescriptor::default();
            let mut pass = encoder.begin_compute_pass(&description);
            backward.encode(&gpu, &mut pass, &self.frame, scene, &encoded, true);
            drop(pass);
            let from = [
                (&self.frame.status, status::LEN),
                (&backward.by_parameter, values),
                (&backward.extras, EXTRAS * scene.splats),
                (&backward.totals, TOTALS_LEN),
                (&backward.by_texel, 3 * texels),
            ];
            let download = Download::new(&gpu, &mut encoder, &from)?;
            submit(&gpu, "gradients", encoder)?;
            let found = download.read(&gpu)?;
            if self.fits(&found[0])? {
                break found;
            }
        };
        self.backward = Some(backward);
        let [by_parameter, extras, totals] = [1, 2, 3].map(|k| floats(&found[k]));
        let mut gradients = gather(scene.splats, &by_parameter, &extras, &totals);
        gradients.background = floats(&found[4]).as_chunks().0.to_vec();
        Ok(gradients)
    }
}

/// The planes of the gradient of an image, zeros where there are none.
fn planes(of: &ImageGradient, pixels: usize) -> Result<[Vec<f32>; GRADIENT_PLANES], SplatError> {
    let [red, green, blue] = &of.rgb;
    let all = [
        ("gradient of red", red, false),
        ("gradient of green", green, false),
        ("gradient of blue", blue, false),
        ("gradient of the expected depth", &of.expected_depth, true),
        ("gradient of the accumulated alpha", &of.alpha, true),
        ("error", &of.error, true),
    ];
    let mut out: [Vec<f32>; GRADIENT_PLANES] = Default::default();
    for (out, (what, plane, may_be_empty)) in out.iter_mut().zip(all) {
        *out = match plane.len() {
            found if found == pixels => plane.clone(),
            0 if may_be_empty => vec![0.0; pixels],
            found => {
                let expected = pixels;
                return Err(SplatError::Size {
                    what,
                    found,
                    expected,
                });
            }
        };
    }
    Ok(out)
}

/// Gradients of the visible Gaussians, without those of the background.
fn gather(splats: usize, by_parameter: &[f32], extras: &[f32], totals: &[f32]) -> Gradients {
    let extra = |k: usize| &extras[k * splats..(k + 1) * splats];
    let visible: Vec<usize> = (0..splats).filter(|i| extras[*i] > 0.0).collect();
    let of = |plane: &[f32]| visible.iter().map(|i| plane[*i]).collect::<Vec<f32>>();
    let absolute = of(extra(1)).into_iter().zip(of(extra(2)));
    let wide = |k: usize| f64::from(totals[k]);
    Gradients {
        indices: visible.iter().map(|i| *i as u32).collect(),
        planes: by_parameter.chunks_exact(splats.max(1)).map(of).collect(),
        absolute: absolute.map(|(x, y)| [x, y]).collect(),
        error: of(extra(3)),
        weight: of(extra(4)),
        motion: std::array::from_fn(|k| wide(16 + k)),
        exposure: std::array::from_fn(|row| std::array::from_fn(|k| wide(4 * row + k))),
        background: Vec::new(),
    }
}
