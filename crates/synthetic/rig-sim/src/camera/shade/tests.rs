use camera_models::{CameraModel, Distortion};
use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::lens::Lens;
use crate::scene::{Kind, by_day};

/// Calls `look` with the shading of an image of a scene.
fn check(kind: Kind, look: impl Fn(&Shading<'_>, &Lens)) {
    let scene = by_day(kind, 2);
    let lens = Lens::new(&CameraModel {
        width: 150,
        height: 84,
        fx: 82.0,
        fy: 82.0,
        cx: 75.5,
        cy: 41.0,
        distortion: Distortion::RadTan4 {
            k1: -0.17,
            k2: 0.025,
            p1: 2e-4,
            p2: -1e-4,
        },
    });
    // Along the first leg of the route, slightly downwards.
    let [a, b] = [0, 1].map(|i| {
        let [x, y] = scene.route.points[i];
        Vector3::new(x, y, 1.3)
    });
    let ahead: Vector3<f64> = (b - a).normalize() - Vector3::z() * 0.3;
    let ahead = ahead.normalize();
    let right = ahead.cross(&Vector3::z()).normalize();
    let optical_from_world =
        Matrix3::from_columns(&[right, ahead.cross(&right), ahead]).transpose();
    let views = [View {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| optical_from_world[(i, j)] as f32)),
        origin: [a.x as f32, a.y as f32, a.z as f32],
    }];
    let mut visibility = Visibility::new(&lens);
    visibility.draw(&scene.fixed, 0, &lens, (0.0, 0.0), &views);
    let rays = lens.rays((0.0, 0.0));
    let bodies = [VisibleBody {
        first: 0,
        surfaces: &scene.fixed.surfaces,
        views: &views,
    }];
    let shading = Shading {
        scene: &scene,
        visibility: &visibility,
        bodies: &bodies,
        rays: &rays,
        weight: 0.5,
        noise: 7,
    };
    look(&shading, &lens);
}

/// Reference implementation: one pixel in f64, by the definition.
fn slowly(shading: &Shading<'_>, row: usize, column: usize) -> Option<f64> {
    let Shading { scene, rays, .. } = shading;
    let visibility = shading.visibility;
    let i = row * visibility.width + column;
    let id = visibility.triangle[i];
    if id == NOTHING {
        return None;
    }
    let vector = |v: &[f32]| Vector3::new(v[0], v[1], v[2]).map(f64::from);
    let view = &shading.bodies[0].views[0];
    let turn = Matrix3::from_rows(&view.rotation.map(|row| vector(&row).transpose()));
    let surface = &shading.bodies[0].surfaces[id as usize];
    let material = &scene.materials[surface.material as usize];
    let ray = turn.transpose() * Vector3::new(rays[i][0], rays[i][1], 1.0).map(f64::from);
    let origin = vector(&view.origin);
    let normal = vector(&surface.normal);
    let depth = (f64::from(surface.offset) - normal.dot(&origin)) / normal.dot(&ray);
    let hit = origin + ray * depth;
    let linear = |f: &[f32; 4]| vector(f).dot(&hit) + f64::from(f[3]);
    let texel_m = f64::from(material.texel_m);
    let (u, v) = (linear(&surface.u) / texel_m, linear(&surface.v) / texel_m);
    // Texels that a pixel covers, and from them the level, dithered.
    let middle = (visibility.height / 2) * visibility.width + visibility.width / 2;
    let pixel = f64::from(rays[middle + 1][0] - rays[middle][0]);
    let cosine = normal.dot(&ray).abs() / ray.norm();
    let area = (depth * pixel / texel_m).powi(2) / cosine;
    let dither =
        column as f64 * 0.618_033_988_749_895 + random::uniform(shading.noise, 0, row as u64);
    let level = (0.5 * area.log2() + dither.fract() - 0.5).clamp(0.0, 9.0) as u32;
    let texture = &scene.textures[material.texture as usize];
    let at = |u: f64, v: f64, level: u32, center: f64| {
        let scale = 0.5_f64.powi(level as i32);
        let place = |x: f64| ((x + center) * scale - center) as f32;
        texture.sample(place(u), place(v), level)
    };
    let (tone, mix) = at(u, v, level, 0.5);
    let coarser = |a: f64, b: f64| 0.087 * (0.829 * a + 0.559 * b);
    let (broad, _) = at(coarser(u, -v), coarser(v, u), level.saturating_sub(3), 0.0);
    let light = linear(&surface.light).max(0.0) + f64::from(material.glow);
    let tone = f64::from(tone) * (0.45 + 0.55 * f64::from(broad));
    let (own, other) = (luminance(material.albedo), luminance(material.other_albedo));
    let albedo = f64::from(own) + f64::from(other - own) * f64::from(mix);
    Some(f64::from(shading.weight) * light * tone * albedo)
}

/// Levels are computed by an approximate logarithm, to 0.012, and texture positions are rounded to
/// some hundredths of a texel: one pixel in fifty gets another level.
#[test]
fn row_shading_agrees_with_the_reference_per_pixel() {
    for kind in [Kind::Pavement, Kind::Trail, Kind::Room] {
        check(kind, |shading, lens| {
            let (width, height) = (lens.model().width as usize, lens.model().height as usize);
            let mut radiance = Radiance::new(width, height);
            shading.add(&mut radiance);
            let (mut compared, mut off) = (0, 0);
            for row in 0..height {
                for column in 0..width {
                    let found = f64::from(radiance.luminance[row * width + column]);
                    let Some(expected) = slowly(shading, row, column) else {
                        assert!(found > 0.0, "the sky is bright");
                        continue;
                    };
                    compared += 1;
                    off += i32::from((found - expected).abs() > 0.01 * expected);
                }
            }
            assert!(compared > 5000, "{}: {compared}", kind.name());
            assert!(50 * off < compared, "{}: {off} of {compared}", kind.name());
        });
    }
}

/// With and without vector instructions: the same bits.
#[test]
fn shading_is_identical_with_and_without_vector_instructions() {
    check(Kind::Trail, |shading, lens| {
        let (width, height) = (lens.model().width as usize, lens.model().height as usize);
        let (mut plain, mut best) = (Radiance::new(width, height), Radiance::new(width, height));
        shading.add(&mut plain);
        add(
            &mut best,
            shading.scene,
            shading.visibility,
            shading.bodies,
            shading.rays,
            shading.weight,
            shading.noise,
        );
        assert_eq!(plain.luminance, best.luminance);
        assert_eq!(plain.color, best.color);
    });
}
