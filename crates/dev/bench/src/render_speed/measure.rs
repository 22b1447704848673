//! Speed of a renderer, and how far its images are from the exact ones.

use std::fs;
use std::hint::black_box;

use rayon::prelude::*;
use serde::Serialize;
use splats::{Camera, DetailScene, Exposure, Image, Renderer, Scene};

use crate::meter::{median, quantile, timed};

/// Rounds over all views of which the median counts.
const ROUNDS: usize = 5;

/// Time of an image.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Speed {
    /// Images per second of elapsed time, the median of the rounds.
    pub(crate) fps: f64,
    /// Of the slowest and the fastest round.
    pub(crate) fps_range: [f64; 2],
    /// Processor time of all threads, ms, the median of the rounds.
    pub(crate) cpu_ms: f64,
    /// Of the round with the least and that with the most.
    pub(crate) cpu_ms_range: [f64; 2],
    pub(crate) rounds: usize,
    /// Load average of the machine over a minute, before.
    load: f64,
}

impl Speed {
    /// Of batches with levels of detail, over all cameras, the median of some rounds.
    pub(super) fn of(
        renderer: &Renderer,
        scene: &DetailScene,
        cameras: &[Camera],
        batch: usize,
    ) -> Self {
        Self::measure(cameras.len(), ROUNDS, || {
            for cameras in cameras.chunks(batch) {
                black_box(renderer.render_detail_batch(scene, cameras, &Exposure::NONE));
            }
        })
    }

    /// Of the exact renderer, in one batch.
    pub(super) fn exact(renderer: &Renderer, scene: &Scene, cameras: &[Camera]) -> Self {
        Self::measure(cameras.len(), 1, || {
            black_box(renderer.render_batch(scene, cameras, &Exposure::NONE));
        })
    }

    /// Of images that `render` renders, the median of some rounds.
    pub(crate) fn measure(images: usize, rounds: usize, mut render: impl FnMut()) -> Self {
        let load = load();
        let times: Vec<_> = (0..rounds).map(|_| timed(&mut render).1).collect();
        let count = images as f64;
        let fps = || times.iter().map(|time| count / time.wall_s);
        let cpu_ms = || times.iter().map(|time| 1e3 * time.cpu_s / count);
        Self {
            fps: median(fps()),
            fps_range: range(fps()),
            cpu_ms: median(cpu_ms()),
            cpu_ms_range: range(cpu_ms()),
            rounds,
            load,
        }
    }
}

/// The least and the most.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], v| {
        [least.min(v), most.max(v)]
    })
}

fn load() -> f64 {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let first = text.split_whitespace().next();
    first.and_then(|v| v.parse().ok()).unwrap_or(f64::NAN)
}

/// Images with levels of detail against exact ones.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Quality {
    /// Median over views, dB.
    pub(crate) psnr_median_db: f64,
    /// Fifth percentile over views.
    pub(crate) psnr_p5_db: f64,
    pub(crate) psnr_worst_db: f64,
    /// Median over views of the median relative difference of median depths.
    depth_median: f64,
    /// 95th percentile over views of the same.
    depth_p95: f64,
}

impl Quality {
    pub(super) fn of(
        renderer: &Renderer,
        exact: &Scene,
        detail: &DetailScene,
        cameras: &[Camera],
    ) -> Self {
        Self::of_views(differences(renderer, exact, detail, cameras))
    }

    /// Of the differences of each view.
    pub(crate) fn of_views(pairs: Vec<(f64, f64)>) -> Self {
        let (mut psnr, mut depth): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        psnr.sort_by(f64::total_cmp);
        depth.sort_by(f64::total_cmp);
        Self {
            psnr_median_db: quantile(&psnr, 0.5),
            psnr_p5_db: quantile(&psnr, 0.05),
            psnr_worst_db: quantile(&psnr, 0.0),
            depth_median: quantile(&depth, 0.5),
            depth_p95: quantile(&depth, 0.95),
        }
    }
}

/// PSNR, dB, and median relative difference of depth of each view with levels of detail.
pub(crate) fn differences(
    renderer: &Renderer,
    exact: &Scene,
    detail: &DetailScene,
    cameras: &[Camera],
) -> Vec<(f64, f64)> {
    let views = cameras.par_iter().map(|camera| {
        let exact = renderer.render(exact, camera, &Exposure::NONE);
        let found = renderer.render_detail(detail, camera, &Exposure::NONE);
        (psnr_db(&found, &exact), depth_difference(&found, &exact))
    });
    views.collect()
}

/// Largest PSNR that is stated: that of images that agree to 1e-5.
const MAX_PSNR_DB: f64 = 100.0;

/// Of colors clamped to 0 to 1, over all channels.
pub(crate) fn psnr_db(found: &Image, exact: &Image) -> f64 {
    let pairs = found.rgb.iter().flatten().zip(exact.rgb.iter().flatten());
    let square = |a: f32, b: f32| f64::from(a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).powi(2);
    let sum: f64 = pairs.map(|(a, b)| square(*a, *b)).sum();
    let mse = sum / (3 * found.alpha.len()) as f64;
    (-10.0 * libm::log10(mse)).min(MAX_PSNR_DB)
}

/// Median relative difference of median depths, over pixels that have both.
fn depth_difference(found: &Image, exact: &Image) -> f64 {
    let pairs = found.median_depth_m.iter().zip(&exact.median_depth_m);
    let both = pairs.filter(|(a, b)| a.is_finite() && b.is_finite());
    median(both.map(|(a, b)| f64::from((a - b).abs() / b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rgb: f32, depths: [f32; 3]) -> Image {
        Image {
            width: 3,
            height: 1,
            rgb: [vec![rgb; 3], vec![0.5; 3], vec![0.5; 3]],
            expected_depth_m: depths.to_vec(),
            median_depth_m: depths.to_vec(),
            alpha: vec![1.0; 3],
        }
    }

    #[test]
    fn images_are_compared_by_color_and_depth() {
        let exact = image(0.5, [2.0, f32::NAN, 4.0]);
        let found = image(0.6, [2.2, 1.0, 4.0]);
        // A tenth in one of three channels.
        let expected = -10.0 * libm::log10(0.01 / 3.0);
        assert!((psnr_db(&found, &exact) - expected).abs() < 1e-4);
        assert_eq!(psnr_db(&exact, &exact), MAX_PSNR_DB);
        // Mean of 10 and 0 %.
        assert!((depth_difference(&found, &exact) - 0.05).abs() < 1e-6);
    }
}
