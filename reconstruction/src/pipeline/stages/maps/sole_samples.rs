//! Ground under soles at rest, as samples of the maps.
//!
//! Contract: one sample for each cell whose center is below the sole, on the plane of the sole.

use nalgebra::{Vector2, Vector3};
use scene_bundle::outputs::contacts::FootContact;
use terrain::maps::GroundSample;

use super::config::MapsConfig;

/// Samples of a contact with its number; `outline_m` is that of the sole in the frame of the foot.
pub(super) fn sole_samples(
    number: usize,
    contact: &FootContact,
    outline_m: &[[f64; 2]],
    config: &MapsConfig,
) -> Vec<GroundSample> {
    let cell_m = config.maps.cell_m;
    let corner = |[x, y]: &[f64; 2]| contact.world_from_foot.apply([*x, *y, 0.0]);
    let corners: Vec<Vector2<f64>> = outline_m
        .iter()
        .map(|point| Vector3::from(corner(point)).xy())
        .collect();
    let range = |k: usize| {
        let values = corners.iter().map(|corner| corner[k] / cell_m);
        let low = values.clone().fold(f64::INFINITY, f64::min).floor();
        let high = values.fold(f64::NEG_INFINITY, f64::max).floor();
        low as i64..=high as i64
    };
    let middle = Vector3::from(contact.world_from_foot.translation_m());
    let normal = Vector3::from(contact.world_from_foot.rotate([0.0, 0.0, 1.0]));
    let foot_from_world = contact.world_from_foot.inverse();
    let [_, _, z_sigma, about_x, about_y, _] = contact.covariance.sigmas();
    let cells = range(1).flat_map(|row| range(0).map(move |column| [column, row]));
    let centers = cells.map(|cell| Vector2::from(cell.map(|k| (k as f64 + 0.5) * cell_m)));
    let below = centers.filter(|center| is_inside(center, &corners));
    below
        .map(|center| {
            let away = center - middle.xy();
            let height = middle.z - normal.xy().dot(&away) / normal.z;
            let position = [center.x, center.y, height];
            let [x, y, _] = foot_from_world.apply(position);
            let sigmas = [z_sigma, y * about_x, x * about_y, config.contact_sigma_m];
            GroundSample {
                position,
                sigma_m: sigmas.iter().map(|s| s * s).sum::<f64>().sqrt(),
                contact: number,
            }
        })
        .collect()
}

/// Whether a point is within a polygon, convex or not, of either orientation: a ray to the right
/// crosses an odd number of its sides.
fn is_inside(point: &Vector2<f64>, corners: &[Vector2<f64>]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crossed = corners.iter().zip(next).filter(|(a, b)| {
        let is_beside = (a.y > point.y) != (b.y > point.y);
        is_beside && point.x < a.x + (b.x - a.x) * (point.y - a.y) / (b.y - a.y)
    });
    crossed.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use cad_transforms::rig::Foot;
    use cad_transforms::{Covariance, RigidTransform};
    use scene_bundle::outputs::contacts::ContactEvent;

    use super::*;

    const OUTLINE: [[f64; 2]; 4] = [[-0.12, -0.05], [0.16, -0.05], [0.16, 0.05], [-0.12, 0.05]];

    /// A foot that points to the left, on ground that rises by 10 % in its direction.
    fn contact() -> FootContact {
        let place = RigidTransform::from_rotation_vector([0.0; 3], [1.0, 2.0, 0.5]);
        let heading = RigidTransform::from_rotation_vector([0.0, 0.0, 0.7], [0.0; 3]);
        let slope = RigidTransform::from_rotation_vector([0.0, -0.1_f64.atan(), 0.0], [0.0; 3]);
        let event = ContactEvent {
            time_ns: 0,
            sigma_s: 0.01,
            is_seen: true,
        };
        FootContact {
            foot: Foot::Left,
            events: [event; 4],
            world_from_foot: place.expect("finite")
                * heading.expect("finite")
                * slope.expect("finite"),
            covariance: Covariance::from_sigmas([0.004; 3], [0.01; 3]).expect("positive"),
        }
    }

    #[test]
    fn cells_below_the_sole_have_its_height() {
        let config = MapsConfig::default();
        let samples = sole_samples(0, &contact(), &OUTLINE, &config);
        // 0.028 m2.
        let cell_m2 = config.maps.cell_m * config.maps.cell_m;
        let area = samples.len() as f64 * cell_m2;
        assert!((0.02..0.036).contains(&area), "{area}");
        for sample in &samples {
            let [x, y, z] = sample.position;
            let ahead = (x - 1.0) * 0.7_f64.cos() + (y - 2.0) * 0.7_f64.sin();
            assert!((z - 0.5 - 0.1 * ahead).abs() < 1e-9, "{sample:?}");
            let aside = (y - 2.0) * 0.7_f64.cos() - (x - 1.0) * 0.7_f64.sin();
            assert!(
                (-0.13..0.17).contains(&ahead) && aside.abs() < 0.051,
                "{sample:?}"
            );
            let cell = (x / config.maps.cell_m).fract();
            assert!((cell - 0.5).abs() < 1e-6, "a center: {sample:?}");
            let nearest = 0.004_f64.hypot(config.contact_sigma_m);
            assert!(
                (nearest..nearest + 0.002).contains(&sample.sigma_m),
                "{sample:?}"
            );
        }
    }

    /// A waist on both sides, as of most soles.
    #[test]
    fn a_concave_outline_has_all_its_cells() {
        let outline = [
            [-0.12, -0.04],
            [0.02, -0.03],
            [0.16, -0.05],
            [0.16, 0.05],
            [0.02, 0.03],
            [-0.12, 0.04],
        ];
        let config = MapsConfig::default();
        let samples = sole_samples(0, &contact(), &outline, &config);
        // Two trapezoids, 0.0210 m2 (0.14 m times 0.07 and 0.08 m): 13 cells, and those at its rim.
        let area = samples.len() as f64 * config.maps.cell_m * config.maps.cell_m;
        assert!((0.016..0.027).contains(&area), "{area}");
    }

    #[test]
    fn a_sole_without_outline_has_no_samples() {
        assert!(sole_samples(0, &contact(), &[], &MapsConfig::default()).is_empty());
    }
}
