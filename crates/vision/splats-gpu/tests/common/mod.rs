//! Scenes, cameras and the device of the tests.
#![allow(dead_code, unreachable_pub, reason = "each test file uses some of it")]

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use splats::{Background, Camera, Exposure, RenderConfig, Scene, Shutter, Sky, Splats};
use splats_gpu::{Adapters, Gpu, GpuRenderer};

/// The device, software or not; `None` with a printed reason where there is none.
pub fn gpu() -> Option<Gpu> {
    match Gpu::open(Adapters::SoftwareToo) {
        Ok(gpu) => {
            println!("on {}", gpu.name());
            Some(gpu)
        }
        Err(error) => {
            assert!(
                std::env::var_os("PAWS_GPU_REQUIRED").is_none(),
                "PAWS_GPU_REQUIRED is set, but {error}"
            );
            eprintln!("skipped: {error}");
            None
        }
    }
}

pub fn random_splats(seed: u64, count: usize, degree: usize) -> Splats {
    gaussians::random_splats(seed, count, degree, -3.2).unwrap()
}

/// A camera, slightly rotated and translated.
pub fn camera(size: (u32, u32), distortion: Distortion) -> Camera {
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let model = CameraModel::new(size, [0.8 * w, 0.83 * w, 0.47 * w, 0.52 * h], distortion);
    let pose = RigidTransform::from_rotation_vector([0.05, -0.08, 0.1], [0.03, -0.02, 0.1]);
    Camera::new(model, pose.unwrap()).unwrap()
}

pub fn shutter() -> Shutter {
    Shutter {
        time_gradient_s_per_px: [2e-5, 9e-4],
        reference_px: [10.0, 12.0],
        velocity_m_s: [1.3, -0.4, 0.8],
        rate_rad_s: [0.4, -0.9, 0.3],
    }
}

pub fn exposure() -> Exposure {
    Exposure {
        matrix: [
            [1.2, 0.05, 0.0, 0.02],
            [-0.03, 0.9, 0.02, -0.01],
            [0.0, 0.04, 1.1, 0.03],
        ],
    }
}

pub fn sky(seed: u64) -> Background {
    let color = |i| std::array::from_fn(|c| counter_random::uniform(seed, c as u64, i) as f32);
    Background::Sky(Sky::from_texels(16, (0..256).map(color).collect()).unwrap())
}

/// Without the step at the smallest alpha, where rounding decides on a step of 8 bits.
pub fn smooth(compensate: bool) -> RenderConfig {
    let mut config = RenderConfig::default();
    config.min_alpha = 1e-5;
    config.compensate = compensate;
    config
}

pub struct Case {
    pub name: &'static str,
    pub scene: Scene,
    pub camera: Camera,
    pub config: RenderConfig,
}

/// Scenes of 2000 Gaussians in images of 64x48: all lenses, a rolling shutter, all degrees, a sky.
pub fn cases() -> Vec<Case> {
    let color = || Background::Constant([0.3, 0.1, 0.6]);
    let size = (64, 48);
    let radial = Distortion::RadTan5 {
        k1: -0.2,
        k2: 0.05,
        p1: 2e-3,
        p2: -1e-3,
        k3: 0.0,
    };
    let rational = Distortion::Rational8 {
        k1: 0.4,
        k2: 0.1,
        p1: -1e-3,
        p2: 5e-4,
        k3: 0.01,
        k4: 0.6,
        k5: 0.2,
        k6: 0.02,
    };
    let fisheye = Distortion::KannalaBrandt4 {
        k1: 0.03,
        k2: -0.01,
        k3: 0.002,
        k4: 0.0,
    };
    let sphere = Distortion::DoubleSphere {
        xi: 0.1,
        alpha: 0.55,
    };
    let eucm = Distortion::Eucm {
        alpha: 0.6,
        beta: 1.1,
    };
    let pinhole = camera(size, Distortion::None);
    let rolling = pinhole.clone().with_shutter(shutter()).unwrap();
    let rolling_fisheye = camera(size, fisheye).with_shutter(shutter()).unwrap();
    let all = [
        ("pinhole", 0, color(), pinhole.clone(), false),
        ("compensation", 1, color(), pinhole.clone(), true),
        ("rolling shutter", 1, color(), rolling.clone(), false),
        ("rolling shutter, compensation", 0, color(), rolling, true),
        ("radial", 2, color(), camera(size, radial), false),
        ("rational, sky", 0, sky(3), camera(size, rational), false),
        ("fisheye", 3, color(), camera(size, fisheye), false),
        ("rolling fisheye", 1, sky(4), rolling_fisheye, false),
        ("double sphere", 1, color(), camera(size, sphere), false),
        ("EUCM", 0, color(), camera(size, eucm), false),
        ("sky", 3, sky(5), pinhole, false),
    ];
    let mut out = Vec::new();
    for (seed, (name, degree, background, camera, compensate)) in (0..).zip(all) {
        let splats = random_splats(seed, 2000, degree);
        out.push(Case {
            name,
            scene: Scene { splats, background },
            camera,
            config: smooth(compensate),
        });
    }
    let mut bounded = smooth(true);
    bounded.max_slope_share = 0.02;
    out.push(Case {
        name: "bounded slope",
        scene: Scene {
            splats: random_splats(2, 2000, 1),
            background: color(),
        },
        camera: camera(size, Distortion::None)
            .with_shutter(shutter())
            .unwrap(),
        config: bounded,
    });
    out
}

/// One renderer per configuration of [`cases`]: the device compiles the kernels of each.
#[derive(Debug, Default)]
pub struct Renderers(Vec<(RenderConfig, GpuRenderer)>);

impl Renderers {
    pub fn of(&mut self, gpu: &Gpu, config: RenderConfig) -> &mut GpuRenderer {
        let at = match self.0.iter().position(|(own, _)| *own == config) {
            Some(at) => at,
            None => {
                self.0
                    .push((config, GpuRenderer::new(gpu, config).unwrap()));
                self.0.len() - 1
            }
        };
        &mut self.0[at].1
    }
}
