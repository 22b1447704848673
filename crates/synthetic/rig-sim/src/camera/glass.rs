//! Panes: reflections over the transmitted image.
//!
//! Contract: only the nearest pane is rendered, without refraction or tint. It reflects its
//! surroundings as one uniform color, and lamps as bright discs: enough to be taken for a surface
//! by stereo matching, or to be missed.

use crate::camera::raster::{View, Visibility};
use crate::camera::shade::{Radiance, luminance};
use crate::scene::Scene;
use crate::scene::body::Surface;
use crate::scene::light::Lamp;

/// Reflectance of two faces of window glass (index 1.5) at normal incidence.
const NORMAL_REFLECTANCE: f32 = 0.08;
/// Transmitted fraction of the light that is not reflected.
const TRANSMITTANCE: f32 = 0.95;
/// Radius of a lamp's image, m.
const LAMP_M: f32 = 0.15;

/// A ray that a plane mirrors, in the world frame.
pub(super) struct Reflection {
    /// Where the ray meets the plane, m.
    pub(super) hit: [f32; 3],
    /// Direction of the mirrored ray, of length 1.
    pub(super) away: [f32; 3],
    /// Cosine of the angle to the normal.
    pub(super) cosine: f32,
}

impl Reflection {
    /// Of the ray of a pixel; `view` is that of the world.
    pub(super) fn new(surface: &Surface, view: &View, [x, y]: [f32; 2]) -> Self {
        // The ray is scaled to 1 m along the optical axis.
        let r = &view.rotation;
        let ray = [0, 1, 2].map(|k| r[0][k] * x + r[1][k] * y + r[2][k]);
        let along = dot(&surface.normal, &ray);
        let length = dot(&ray, &ray).sqrt();
        let depth = (surface.offset - dot(&surface.normal, &view.origin)) / along;
        Self {
            hit: [0, 1, 2].map(|k| view.origin[k] + ray[k] * depth),
            away: [0, 1, 2].map(|k| (ray[k] - 2.0 * along * surface.normal[k]) / length),
            cosine: along.abs() / length,
        }
    }

    /// Luminance of a lamp, if the mirrored ray meets it.
    pub(super) fn lamp(&self, lamp: &Lamp) -> Option<f32> {
        let arm = [0, 1, 2].map(|k| lamp.position[k] as f32 - self.hit[k]);
        let ahead = dot(&arm, &self.away);
        let is_met = ahead > 0.0 && dot(&arm, &arm) - ahead * ahead < LAMP_M * LAMP_M;
        // A disc of this luminance gives the lamp's irradiance at 1 m.
        is_met.then_some(lamp.strength as f32 / (LAMP_M * LAMP_M))
    }
}

/// Reflectance of a pane by the cosine of the angle to its normal (Schlick 1994).
pub(super) fn mirrored(cosine: f32) -> f32 {
    let miss = 1.0 - cosine.min(1.0);
    let square = miss * miss;
    NORMAL_REFLECTANCE + (1.0 - NORMAL_REFLECTANCE) * square * square * miss
}

/// Blends panes over an image without panes that has weight `weight`. `views` are those of the
/// world.
pub(super) fn cover(
    image: &mut Radiance,
    scene: &Scene,
    behind: &Visibility,
    panes: &Visibility,
    views: &[View],
    rays: &[[f32; 2]],
    weight: f32,
) {
    let width = panes.width;
    for (i, &id) in panes.triangle.iter().enumerate() {
        if !panes.is_nearer(behind, i) {
            continue;
        }
        let (row, column) = (i / width, i % width);
        let view = &views[row.min(views.len() - 1)];
        let surface = &scene.glass.surfaces[id as usize];
        let material = &scene.materials[surface.material as usize];
        let reflection = Reflection::new(surface, view, rays[i]);
        let share = mirrored(reflection.cosine);
        let [gx, gy, gz, constant] = surface.light;
        let mut light = (dot(&[gx, gy, gz], &reflection.hit) + constant).max(0.0);
        for lamp in &scene.light.lamps {
            light += reflection.lamp(lamp).unwrap_or(0.0);
        }
        let through = TRANSMITTANCE * (1.0 - share);
        let over = weight * share * light;
        let luma = &mut image.luminance[i];
        *luma = *luma * through + over * luminance(material.albedo);
        if row % 2 == 0 && column % 2 == 0 {
            let color = &mut image.color[row / 2 * (width / 2) + column / 2];
            let tint = scene.light.tint;
            *color = [0, 1, 2].map(|k| color[k] * through + over * material.albedo[k] * tint[k]);
        }
    }
}

pub(super) fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

    use super::*;
    use crate::camera::Shot;
    use crate::camera::sensor::{Exposure, SensorModel};
    use crate::camera::truth::TruthCamera;
    use crate::camera::{MonoCamera, Quality, SceneBody, Shutter, TEST_CAMERA};
    use crate::scene::body::Body;
    use crate::scene::surface::Class;
    use crate::scene::{Kind, Lighting};

    #[test]
    fn pane_reflectance_is_low_at_normal_and_total_at_grazing_incidence() {
        assert!((mirrored(1.0) - 0.08).abs() < 1e-6);
        assert!((mirrored(0.0) - 1.0).abs() < 1e-6);
        // At 60 degrees two faces reflect about 0.16 (Fresnel's equations).
        assert!((mirrored(0.5) - 0.13).abs() < 0.05, "{}", mirrored(0.5));
    }

    /// The screen in the room is at x = 5.7 m; the camera looks at it along x.
    #[test]
    fn pane_reduces_contrast_behind_it_and_is_in_ground_truth() {
        let with = Scene::new(Kind::Room, Lighting::Day, 1);
        let mut without = with.clone();
        without.glass = Body::default();
        let quality = Quality::FAST;
        let mut eye = MonoCamera::new(&TEST_CAMERA, Shutter::Global, SensorModel::SMALL, quality);
        let mut true_eye = TruthCamera::new(&TEST_CAMERA, Shutter::Global);
        let axes = Matrix3::from_columns(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let pose = |_: f64| (Vector3::new(4.9, 3.5, 1.2), turn);
        let still = |_: f64| (Vector3::zeros(), UnitQuaternion::identity());
        let exposure = Exposure {
            seconds: 0.01,
            gain: 1.0,
        };
        let mut see = |scene: &Scene| {
            let placed = [SceneBody {
                body: &scene.fixed,
                first: 0,
                pose: &still,
            }];
            let seen = eye.expose(
                scene,
                &placed,
                &pose,
                &Shot {
                    time_s: 0.0,
                    exposure,
                    quality,
                    noise: 1,
                },
            );
            let luminance = seen.luminance.clone();
            (luminance, true_eye.render(scene, &placed, &pose, 0.0))
        };
        let ((veiled, truth), (clear, bare)) = (see(&with), see(&without));
        let mut panes = 0;
        for (i, class) in truth.class.iter().enumerate() {
            let (a, b) = (veiled[i], clear[i]);
            if *class == Class::Glass {
                panes += 1;
                assert!(
                    (truth.depth[i] - 0.8).abs() < 1e-3,
                    "{i}: {}",
                    truth.depth[i]
                );
                assert!(bare.depth[i] > truth.depth[i], "{i}");
                assert!(a > 0.7 * b && a != b, "{i}: {a} {b}");
            } else {
                assert_eq!((a, truth.depth[i]), (b, bare.depth[i]), "{i}");
            }
        }
        assert!(panes > 10_000, "{panes}");
        assert!(bare.class.iter().all(|c| *c != Class::Glass));
    }
}
