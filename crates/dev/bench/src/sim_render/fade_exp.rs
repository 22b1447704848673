//! Temporary experiment.
use super::route::{self, FRAME_M, around_loop};
use crate::meter::{thread_cpu_s, quantile};
use crate::render_speed::measure::psnr_db;
use anyhow::Result;
use cad_transforms::RigidTransform;
use simulation::testing::SyntheticScene;
use simulation::{CameraConfig, GaussianStore, ResidencyConfig};
use splats::{Camera, DetailConfig, DetailScene, Exposure, Image, RenderConfig, Renderer};

pub(super) fn run() -> Result<()> {
    let scene = SyntheticScene::corridor_loop_with(0.03)?.scene;
    let store = GaussianStore::new(scene.clone(), ResidencyConfig::default());
    let renderer = Renderer::new(RenderConfig::default())?;
    let mut details = Vec::new();
    for sector in 0..3 {
        let content = store.content(sector)?;
        let with = |s: f32| { let mut c = DetailConfig::default(); c.max_sigma_px = s; DetailScene::new(&content.exact, &c) };
        let all: Vec<DetailScene> = [0.8, 1.6, 3.2].into_iter().map(|s| with(s).map_err(anyhow::Error::from)).collect::<Result<_>>()?;
        details.push((content.clone(), all));
    }
    let steps = route::route(&scene, &around_loop(1, FRAME_M)?, 0)?;
    let model = CameraConfig::pinhole([320, 240], std::f64::consts::FRAC_PI_2)?.model;
    let half = CameraConfig::pinhole([160, 120], std::f64::consts::FRAC_PI_2)?.model;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| -> Result<()> {
        let mut found: Vec<(f32, Vec<(f64, f64)>)> = Vec::new();
        for step in &steps {
            if step.sector > 2 { continue; }
            let pose = step.sector_from_body * RigidTransform::body_from_optical();
            let Some((edge, weight)) = scene.fade(step.sector, pose.translation_m()) else { continue };
            if edge.to > 2 { continue; }
            let small = weight.min(1.0 - weight) as f32;
            // The side with the smaller weight.
            let (main, other, main_pose, other_pose) = if weight <= 0.5 { (step.sector, edge.to, pose, edge.to_from_here.carry(&pose)) } else { (edge.to, step.sector, edge.to_from_here.carry(&pose), pose) };
            let camera = |m, p: &RigidTransform| Camera::new(m, p.inverse());
            let timed = |f: &dyn Fn() -> Image| { let t = thread_cpu_s(); let i = f(); (i, 1e3 * (thread_cpu_s() - t)) };
            let (a, ta) = timed(&|| renderer.render_detail(&details[main].0.detail, &camera(model, &main_pose).unwrap(), &Exposure::NONE));
            let cb = camera(model, &other_pose)?;
            let (b, tb) = timed(&|| renderer.render_detail(&details[other].0.detail, &cb, &Exposure::NONE));
            let blend = |b: &Image| { let mut o = a.clone(); for k in 0..3 { for (v, w) in o.rgb[k].iter_mut().zip(&b.rgb[k]) { *v = (1.0 - small) * *v + small * w; } } o };
            let exact = blend(&b);
            let mut row = vec![(ta, 0.0), (tb, 0.0)];
            for d in &details[other].1 {
                let (c, t) = timed(&|| renderer.render_detail(d, &cb, &Exposure::NONE));
                row.push((t, psnr_db(&blend(&c), &exact)));
            }
            let (h, t) = timed(&|| renderer.render_detail(&details[other].0.detail, &camera(half, &other_pose).unwrap(), &Exposure::NONE));
            let mut up = b.clone();
            for k in 0..3 { for y in 0..240usize { for x in 0..320usize {
                let fx = (x as f32 * 0.5 - 0.25).clamp(0.0, 159.0); let fy = (y as f32 * 0.5 - 0.25).clamp(0.0, 119.0);
                let (x0, y0) = (fx as usize, fy as usize); let (x1, y1) = ((x0 + 1).min(159), (y0 + 1).min(119));
                let (u, v) = (fx - x0 as f32, fy - y0 as f32);
                let g = |x: usize, y: usize| h.rgb[k][y * 160 + x];
                up.rgb[k][y * 320 + x] = (1.0 - v) * ((1.0 - u) * g(x0, y0) + u * g(x1, y0)) + v * ((1.0 - u) * g(x0, y1) + u * g(x1, y1));
            } } }
            row.push((t, psnr_db(&blend(&up), &exact)));
            println!("w {small:.2} {}", row.iter().map(|(t, d)| format!("{t:.1} ms {d:.1} dB")).collect::<Vec<_>>().join(" | "));
            found.push((small, row));
        }
        for k in 0..6 {
            let mut t: Vec<f64> = found.iter().map(|r| r.1[k].0 / r.1[0].0).collect(); t.sort_by(f64::total_cmp);
            let mut d: Vec<f64> = found.iter().map(|r| r.1[k].1).collect(); d.sort_by(f64::total_cmp);
            println!("{k}: cost over main p50 {:.2} p95 {:.2}; dB worst {:.1} p50 {:.1}", quantile(&t, 0.5), quantile(&t, 0.95), quantile(&d, 0.0), quantile(&d, 0.5));
        }
        Ok(())
    })
}
