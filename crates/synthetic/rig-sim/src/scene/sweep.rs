//! A closed skin around a curved axis: limbs, roots, trunks, bowls.

use nalgebra::Vector3;

use super::mesh::{Corner, Mesh, Stuff, Triangle};

/// A cross-section.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ring {
    /// On the axis, m.
    pub(super) center: Vector3<f64>,
    /// Half the width to the side and half of that across both side and axis, m.
    pub(super) radii: [f64; 2],
}

impl Ring {
    /// With the same radius all round.
    pub(super) fn round(center: Vector3<f64>, radius: f64) -> Self {
        Self {
            center,
            radii: [radius, radius],
        }
    }
}

/// Skins the rings, of `sides` corners each, and closes the first and the last one. `aside` is the
/// direction to the side, never along the axis. Textures run along u.
pub(super) fn sweep(
    mesh: &mut Mesh,
    rings: &[Ring],
    aside: Vector3<f64>,
    sides: usize,
    stuff: Stuff,
) {
    let last = rings.len() - 1;
    let around = 2.0
        * std::f64::consts::PI
        * rings
            .iter()
            .map(|ring| 0.5 * (ring.radii[0] + ring.radii[1]))
            .fold(0.0, f64::max);
    let mut along = 0.0;
    let mut skin: Vec<Vec<Corner>> = Vec::with_capacity(rings.len());
    for (i, ring) in rings.iter().enumerate() {
        let before = rings[i.saturating_sub(1)].center;
        let axis = (rings[(i + 1).min(last)].center - before).normalize();
        let side = (aside - axis * aside.dot(&axis)).normalize();
        let across = axis.cross(&side);
        let wider = ring.radii[0] - rings[i.saturating_sub(1)].radii[0];
        along += libm::hypot((ring.center - before).norm(), wider);
        let corner = |k: usize| {
            // The first and the last corner are identical, bit by bit.
            let angle = 2.0 * std::f64::consts::PI * (k % sides) as f64 / sides as f64;
            let out = side * (ring.radii[0] * libm::cos(angle))
                + across * (ring.radii[1] * libm::sin(angle));
            Corner {
                position: ring.center + out,
                uv: [along, around * k as f64 / sides as f64],
            }
        };
        skin.push((0..=sides).map(corner).collect());
    }
    let mut push = |corners: [Corner; 3]| {
        let [a, b, c] = corners.map(|c| c.position);
        if (b - a).cross(&(c - a)).norm_squared() > 1e-18 {
            mesh.triangles.push(Triangle {
                corners,
                material: stuff.material,
                instance: stuff.instance,
            });
        }
    };
    for pair in skin.windows(2) {
        for k in 0..sides {
            let (a, b, c, d) = (pair[0][k], pair[0][k + 1], pair[1][k + 1], pair[1][k]);
            push([a, b, c]);
            push([a, c, d]);
        }
    }
    for (end, turned) in [(0, true), (last, false)] {
        let middle = Corner {
            position: rings[end].center,
            uv: [0.0, 0.0],
        };
        // Seen along the axis, the skin of an end is a disc.
        let flat = |corner: &Corner| {
            let arm = corner.position - middle.position;
            let right = skin[end][0].position - middle.position;
            let right = right / right.norm().max(1e-9);
            let up = arm - right * arm.dot(&right);
            let above = corner.uv[1] < 0.5 * around;
            Corner {
                uv: [arm.dot(&right), if above { up.norm() } else { -up.norm() }],
                ..*corner
            }
        };
        for k in 0..sides {
            let (a, b) = (flat(&skin[end][k]), flat(&skin[end][k + 1]));
            push(if turned {
                [middle, b, a]
            } else {
                [middle, a, b]
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sweep_is_closed_and_faces_outwards() {
        for tip in [Vector3::new(0.3, 0.2, 2.0), Vector3::new(1.5, -0.4, -0.6)] {
            let rings: Vec<Ring> = (0..=20)
                .map(|i| Ring {
                    center: tip * (f64::from(i) / 20.0),
                    radii: [0.3, 0.1],
                })
                .collect();
            let mut mesh = Mesh::default();
            let stuff = Stuff {
                material: 0,
                instance: 0,
            };
            sweep(&mut mesh, &rings, Vector3::y(), 64, stuff);
            let six_volumes: f64 = mesh
                .triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.corners.map(|c| c.position);
                    a.dot(&b.cross(&c))
                })
                .sum();
            let expected = std::f64::consts::PI * 0.03 * tip.norm();
            assert!((six_volumes / 6.0 / expected - 1.0).abs() < 0.01, "{tip}");
        }
    }
}
