//! Highlights of lamps and of the sun on glossy ground.
//!
//! Contract: ground reflects light sources that it sees, as discs; it does not reflect its
//! surroundings. A highlight is at the mirror image of its source, below the ground: the two eyes
//! see it at other places of the ground, so that stereo matching finds it too far away. The ground
//! truth remains that of the ground.

use nalgebra::Vector3;

use super::glass::{self, Reflection};
use super::raster::{View, Visibility};
use super::shade::{Radiance, luminance};
use crate::scene::Scene;

/// Angular radius of the sun's image on ground that is not a perfect mirror, rad.
const SUN_RADIUS: f32 = 0.026;
/// Objects farther away do not hide the sun, m.
const SUN_DISTANCE_M: f64 = 200.0;
/// Distance from a lamp within which nothing hides it: its cover, m.
const LAMP_COVER_M: f64 = 0.05;
/// Height above the ground from which light sources are seen, m.
const ABOVE_GROUND_M: f64 = 0.02;

/// Adds highlights to an image of weight `weight`. `views` are those of the world.
pub(super) fn add(
    image: &mut Radiance,
    scene: &Scene,
    visible: &Visibility,
    views: &[View],
    rays: &[[f32; 2]],
    weight: f32,
) {
    let width = visible.width;
    let tint = scene.light.tint;
    for (i, &id) in visible.triangle.iter().enumerate() {
        // Triangles of other bodies have higher numbers.
        let Some(surface) = scene.fixed.surfaces.get(id as usize) else {
            continue;
        };
        if !scene.materials[surface.material as usize].walkable {
            continue;
        }
        let (row, column) = (i / width, i % width);
        let view = &views[row.min(views.len() - 1)];
        let reflection = Reflection::new(surface, view, rays[i]);
        let light = source(scene, &reflection);
        if light == 0.0 {
            continue;
        }
        let light = weight * scene.gloss * glass::mirrored(reflection.cosine) * light;
        image.luminance[i] += light * luminance(tint);
        if row % 2 == 0 && column % 2 == 0 {
            let color = &mut image.color[row / 2 * (width / 2) + column / 2];
            *color = [0, 1, 2].map(|k| color[k] + light * tint[k]);
        }
    }
}

/// Luminance of the light sources that a reflected ray meets, and that the ground sees.
fn source(scene: &Scene, reflection: &Reflection) -> f32 {
    let start = Vector3::from(reflection.hit).map(f64::from) + Vector3::z() * ABOVE_GROUND_M;
    let is_seen = |arm: Vector3<f64>| {
        let reach = arm.norm();
        !scene.is_hidden(&start, &(arm / reach), reach - LAMP_COVER_M)
    };
    let mut light = 0.0;
    for lamp in &scene.light.lamps {
        if let Some(luminance) = reflection.lamp(lamp)
            && is_seen(lamp.position - start)
        {
            light += luminance;
        }
    }
    if let Some((direction, strength)) = &scene.light.sun {
        let cosine = glass::dot(&direction.map(|v| v as f32).into(), &reflection.away);
        let is_met = cosine > 0.0 && 1.0 - cosine * cosine < SUN_RADIUS * SUN_RADIUS;
        if is_met && is_seen(direction * SUN_DISTANCE_M) {
            light += *strength as f32 / (SUN_RADIUS * SUN_RADIUS);
        }
    }
    light
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

    use crate::camera::sensor::{Exposure, SensorModel};
    use crate::camera::{MonoCamera, Quality, Shot, Shutter, TEST_CAMERA, placed};
    use crate::scene::{Kind, Lighting, Scene, Scenery};

    /// A camera above the middle of the corridor looks ahead and down.
    fn seen(scene: &Scene) -> Vec<f32> {
        let mut eye = MonoCamera::new(
            &TEST_CAMERA,
            Shutter::Global,
            SensorModel::SMALL,
            Quality::FAST,
        );
        let [x, y] = scene.route.points[0];
        let axes = Matrix3::from_columns(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
        let ahead = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let down = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.6);
        let ground = scene.ground(x, y, 1.0).expect("ground below the route");
        let pose = |_: f64| (Vector3::new(x, y, ground.height + 1.4), down * ahead);
        let shot = Shot {
            time_s: 0.0,
            exposure: Exposure {
                seconds: 0.01,
                gain: 1.0,
            },
            quality: Quality::FAST,
            noise: 1,
        };
        let image = eye.expose(scene, &placed(scene), &pose, &shot);
        image.luminance.clone()
    }

    #[test]
    fn glossy_ground_has_highlights_and_dull_ground_is_unchanged() {
        let dull = Scene::new(Kind::Corridor, Lighting::Day, 1);
        let mut glossy = dull.clone();
        glossy.furnish(&Scenery {
            gloss: 0.5,
            ..Scenery::default()
        });
        let (dull, glossy) = (seen(&dull), seen(&glossy));
        let brighter = dull.iter().zip(&glossy).filter(|(a, b)| **b > 1.5 * **a);
        let brighter = brighter.count();
        assert!((10..4000).contains(&brighter), "{brighter}");
        assert!(dull.iter().zip(&glossy).all(|(a, b)| b >= a));
    }
}
