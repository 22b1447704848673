//! Times of rendering over the number of Gaussians and the size of the image, in a simulated
//! street.
//!
//! `cargo run --release -p splats --example measure`, with the number of Gaussians in thousands as
//! arguments. Times are processor times, the median of several runs.
#![expect(clippy::disallowed_methods, reason = "this program measures time")]

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use rustix::time::{ClockId, clock_gettime};
use splats::{
    Background, Camera, DetailConfig, DetailScene, Exposure, ImageGradient, RenderConfig, Renderer,
    Scene, Splat, Splats, TrainConfig, Trainer, TrainingView, reference,
};

fn main() -> Result<(), splats::SplatError> {
    let mut thousands: Vec<usize> = std::env::args()
        .skip(1)
        .filter_map(|v| v.parse().ok())
        .collect();
    if thousands.is_empty() {
        thousands = vec![10, 30, 100, 300];
    }
    let renderer = Renderer::new(RenderConfig::default())?;
    println!("threads {}", rayon::current_num_threads());
    println!("Gaussians  image       visible    pairs  pairs/px  CPU ms");
    for count in thousands {
        let scene = street(count * 1000)?;
        for (width, height) in [(64, 64), (96, 96), (256, 256), (672, 376), (1280, 720)] {
            let camera = camera(width, height)?;
            let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
            let stats = pass.stats;
            let ms = median_ms(15, || renderer.render(&scene, &camera, &Exposure::NONE));
            let per_pixel = stats.pairs as f64 * 256.0 / camera.pixels() as f64;
            println!(
                "{:9}  {width:4}x{height:<4}  {:8} {:8}  {per_pixel:8.1}  {ms:.2}",
                scene.splats.len(),
                stats.visible,
                stats.pairs,
            );
        }
        let camera = camera(672, 376)?;
        let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
        let plane = vec![1e-3; camera.pixels()];
        let gradient = ImageGradient {
            rgb: [plane.clone(), plane.clone(), plane],
            ..ImageGradient::default()
        };
        let ms = median_ms(9, || {
            renderer.backward(&scene, &camera, &Exposure::NONE, &pass, &gradient)
        });
        println!("backward at 672x376: {ms:.2} ms");
        let image = pass.image;
        let bytes = (0..3 * camera.pixels())
            .map(|i| (image.rgb[i % 3][i / 3] * 230.0 + (i % 17) as f32) as u8)
            .collect();
        let view = TrainingView::new(camera, bytes, 0);
        let mut config = TrainConfig::default();
        (config.quarter_until, config.full_from, config.growth.stop) = (0.0, 0.0, 0.0);
        let views = vec![view];
        let mut trainer = Trainer::new(scene.clone(), views, config, RenderConfig::default(), 1)?;
        let mut failed = Ok(());
        let ms = median_ms(9, || {
            if let Err(error) = trainer.step() {
                failed = Err(error);
            }
        });
        failed?;
        println!("training step at 672x376: {ms:.2} ms");
        detail(&renderer, &scene)?;
    }
    let scene = street(2000)?;
    let camera = camera(168, 94)?;
    let slow = reference::Scene::from(&scene);
    let config = RenderConfig::default();
    let ms = median_ms(1, || {
        reference::render(&slow, &camera, &Exposure::NONE, &config)
    });
    let fast = median_ms(15, || renderer.render(&scene, &camera, &Exposure::NONE));
    println!("2000 Gaussians at 168x94: reference {ms:.0} ms, renderer {fast:.2} ms");
    Ok(())
}

/// Batches of small images, exact and with levels of detail.
fn detail(renderer: &Renderer, scene: &Scene) -> Result<(), splats::SplatError> {
    for edge in [64, 96, 256] {
        let cameras = vec![camera(edge, edge)?; 16];
        let exact = renderer.render(scene, &cameras[0], &Exposure::NONE);
        let render = || renderer.render_batch(scene, &cameras, &Exposure::NONE);
        let ms = median_ms(3, render) / 16.0;
        println!("batch at {edge}x{edge}: exact {ms:.3} CPU ms an image");
        for max_sigma_px in [0.5, 0.6, 0.7, 0.8] {
            let mut config = DetailConfig::default();
            config.max_sigma_px = max_sigma_px;
            let levels = DetailScene::new(scene, &config)?;
            let image = renderer.render_detail(&levels, &cameras[0], &Exposure::NONE);
            let pairs = exact.rgb.iter().flatten().zip(image.rgb.iter().flatten());
            let sum: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
            let psnr = -10.0 * (sum / (3 * edge * edge) as f64).log10();
            let render = || renderer.render_detail_batch(&levels, &cameras, &Exposure::NONE);
            let ms = median_ms(5, render) / 16.0;
            let count = levels.count(&cameras[0]);
            println!("  detail {max_sigma_px}: {count} Gaussians, {ms:.3} CPU ms, {psnr:.1} dB");
        }
    }
    Ok(())
}

/// Ground and two walls of 60 m, covered with discs.
fn street(count: usize) -> Result<Scene, splats::SplatError> {
    let mut splats = Splats::empty(1)?;
    let (length, width, height) = (60.0, 8.0, 6.0);
    let area = length * (width + 2.0 * height);
    let radius = 0.7 * (area / count as f32).sqrt();
    for i in 0..count as u64 {
        let uniform = |k: u64| counter_random::uniform(1, k, i) as f32;
        let across = uniform(0) * (width + 2.0 * height) - height;
        let z = uniform(1) * length - 5.0;
        let (x, y, normal) = match across {
            a if a < 0.0 => (-width / 2.0, 1.5 + a, 0),
            a if a > width => (width / 2.0, 1.5 - (a - width), 0),
            a => (a - width / 2.0, 1.5, 1),
        };
        let mut splat = Splat::sphere(0.5 * radius, [uniform(2), uniform(3), uniform(4)]);
        splat.position_m = [x, y, z];
        splat.log_scale[normal] = (0.1 * radius).ln();
        splat.opacity_logit = 1.0 + 3.0 * (uniform(5) - 0.3);
        splats.push(&splat)?;
    }
    let background = Background::Constant([0.6, 0.7, 0.9]);
    Ok(Scene { splats, background })
}

fn camera(width: u32, height: u32) -> Result<Camera, splats::SplatError> {
    let [w, h] = [width, height].map(f64::from);
    let lens = [0.55 * w, 0.55 * w, (w - 1.0) / 2.0, (h - 1.0) / 2.0];
    let model = CameraModel::new((width, height), lens, Distortion::None);
    Camera::new(model, RigidTransform::identity())
}

/// Median over runs of the processor time of all threads, ms: on a busy machine the elapsed time
/// means little.
fn median_ms<T>(runs: usize, mut run: impl FnMut() -> T) -> f64 {
    let now = || {
        let time = clock_gettime(ClockId::ProcessCPUTime);
        time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
    };
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = now();
            std::hint::black_box(run());
            now() - start
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[runs / 2]
}
