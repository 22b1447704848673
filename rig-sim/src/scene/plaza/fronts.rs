//! The house fronts round the square and along the streets that leave it.

use nalgebra::Vector3;

use super::{HALF, Palette, STREET_M};
use crate::scene::build::Builder;
use crate::scene::mesh::Stuff;

/// A row of house fronts: a base line, and the direction into the square to the left of it.
struct Row {
    from: [f64; 2],
    /// Direction of the base line, rad.
    yaw: f64,
    length: f64,
}

impl Row {
    /// The place so far along the row, out of it, and up, m.
    fn at(&self, along: f64, out: f64, up: f64) -> Vector3<f64> {
        let (s, c) = (libm::sin(self.yaw), libm::cos(self.yaw));
        Vector3::new(
            self.from[0] + c * along - s * out,
            self.from[1] + s * along + c * out,
            up,
        )
    }

    /// A box that stands against the row: `middle` along it, from `up` on, half of it in the wall.
    fn proud(&self, b: &mut Builder, [middle, up]: [f64; 2], size: [f64; 3], stuff: Stuff) {
        let [width, depth, height] = size;
        let size = Vector3::new(width, 2.0 * depth, height);
        b.standing_box(self.at(middle, 0.0, up), size, self.yaw, 1.2, stuff);
    }
}

pub(super) fn build(b: &mut Builder, p: &Palette) {
    let [w, h] = HALF;
    let quarter = 0.5 * std::f64::consts::PI;
    let rows = [
        Row {
            from: [-w, -h],
            yaw: 0.0,
            length: 2.0 * w - STREET_M,
        },
        Row {
            from: [w, -h],
            yaw: quarter,
            length: 2.0 * h,
        },
        Row {
            from: [w, h],
            yaw: 2.0 * quarter,
            length: 2.0 * w - STREET_M,
        },
        Row {
            from: [-w, h],
            yaw: 3.0 * quarter,
            length: 2.0 * h,
        },
        // The ends of the two streets.
        Row {
            from: [w - STREET_M - 2.0, -h - 14.0],
            yaw: 0.0,
            length: STREET_M + 4.0,
        },
        Row {
            from: [STREET_M + 2.0 - w, h + 14.0],
            yaw: 2.0 * quarter,
            length: STREET_M + 4.0,
        },
        // Their other sides.
        Row {
            from: [w, -h - 14.0],
            yaw: quarter,
            length: 14.0,
        },
        Row {
            from: [-w, h + 14.0],
            yaw: 3.0 * quarter,
            length: 14.0,
        },
    ];
    for row in &rows {
        let mut along = 0.0;
        while along < row.length - 0.5 {
            let left = row.length - along;
            let width = b.draw(5.5, 8.5);
            // No slivers.
            let width = if left - width < 4.0 { left } else { width };
            house(b, p, row, along, width);
            along += width;
        }
    }
}

fn house(b: &mut Builder, p: &Palette, row: &Row, along: f64, width: f64) {
    let kind = b.draw(0.0, 3.0) as usize;
    let wall = b.of_thing(p.walls[kind]);
    let of = |material: u16| Stuff { material, ..wall };
    let floors = 2 + b.draw(0.0, 2.0) as usize;
    let height = 3.6 + 2.9 * floors as f64;
    let middle = along + 0.5 * width;
    let (l, r) = (along, along + width);
    let front = [(l, 0.0), (r, 0.0), (r, height), (l, height)].map(|(x, z)| row.at(x, 0.0, z));
    // The row runs to the right of someone who looks out of it.
    let [a, c, d, e] = front;
    b.mesh.tiled_quad([c, a, e, d], [along, 0.0], 1.1, wall);
    // What is behind is hardly seen.
    let depth = 14.0;
    let size = Vector3::new(width, depth, height);
    b.standing_box(
        row.at(middle, -0.5 * depth - 0.03, 0.0),
        size,
        row.yaw,
        7.0,
        wall,
    );
    row.proud(b, [middle, 0.0], [width - 0.02, 0.05, 0.45], of(p.trim));
    row.proud(b, [middle, 3.35], [width - 0.02, 0.12, 0.2], of(p.trim));
    row.proud(
        b,
        [middle, height - 0.3],
        [width - 0.02, 0.3, 0.25],
        of(p.trim),
    );
    let bays = ((width / 2.0) as usize).max(2);
    let door = b.draw(0.0, bays as f64) as usize;
    let awning = b.draw(0.0, 1.0) < 0.6;
    let cloth = of(p.awning[usize::from(b.draw(0.0, 1.0) < 0.5)]);
    for i in 0..bays {
        let at = along + (i as f64 + 0.5) * width / bays as f64;
        if i == door {
            row.proud(b, [at, 0.0], [1.35, 0.08, 2.6], of(p.trim));
            row.proud(b, [at, 0.0], [1.05, 0.1, 2.35], of(p.door));
        } else {
            row.proud(b, [at, 0.6], [1.6, 0.07, 2.1], of(p.trim));
            row.proud(b, [at, 0.7], [1.42, 0.09, 1.9], of(p.pane));
            row.proud(b, [at, 0.7], [0.06, 0.11, 1.9], of(p.trim));
            if awning {
                // A sheet with two sides.
                let corner = |s: f64, out: f64, up: f64| row.at(at + s, out, up);
                let (l, r) = (-0.9, 0.9);
                let sheet = [
                    corner(l, 1.0, 2.55),
                    corner(r, 1.0, 2.55),
                    corner(r, 0.1, 3.1),
                    corner(l, 0.1, 3.1),
                ];
                let [a, c, d, e] = sheet;
                b.mesh.tiled_quad([a, c, d, e], [0.0, 0.0], 0.6, cloth);
                b.mesh.tiled_quad([c, a, e, d], [0.0, 0.0], 0.6, cloth);
            }
        }
        for floor in 0..floors {
            let sill = 4.3 + 2.9 * floor as f64;
            row.proud(b, [at, sill], [1.2, 0.05, 1.65], of(p.trim));
            row.proud(b, [at, sill + 0.08], [0.98, 0.07, 1.45], of(p.pane));
            row.proud(b, [at, sill + 0.08], [0.05, 0.09, 1.45], of(p.trim));
            row.proud(b, [at, sill + 0.95], [0.98, 0.085, 0.05], of(p.trim));
            row.proud(b, [at, sill - 0.08], [1.36, 0.16, 0.08], of(p.trim));
        }
    }
}
