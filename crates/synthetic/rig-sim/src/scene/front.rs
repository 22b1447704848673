//! House fronts: rows of them along a line, and the windows of any wall.
//!
//! Contract: a row runs to the right for a viewer who looks out of its houses; each house is one
//! instance. Nothing protrudes from a wall by more than 0.4 m below 2.5 m, or by more than 1.1 m
//! above.

use nalgebra::Vector3;

use super::build::Builder;
use super::mesh::Stuff;
use super::palette;
use super::surface::Class;

/// A line of fronts: its origin and direction; the space in front of it is on the left.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    from: [f64; 2],
    /// Direction of the line, rad.
    yaw: f64,
}

/// Materials of fronts.
#[derive(Clone, Debug)]
pub(super) struct FrontMaterials {
    walls: Vec<u16>,
    pub(super) trim: u16,
    /// Dark ones and lit ones.
    panes: [u16; 2],
    doors: [u16; 2],
    cloths: [u16; 2],
    pipe: u16,
}

/// Style of houses.
#[derive(Clone, Copy, Debug)]
pub(super) struct Style {
    /// Share of houses with shops.
    pub(super) shops: f64,
    /// Least and most floors above the ground floor.
    pub(super) floors: [u32; 2],
}

/// Size of a window, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) width: f64,
    pub(super) height: f64,
}

const GROUND_FLOOR: f64 = 3.4;
const FLOOR: f64 = 2.9;
/// Share of windows behind which there is light at night.
const AT_HOME: f64 = 0.25;

impl FrontMaterials {
    pub(super) fn new(b: &mut Builder) -> Self {
        use palette::{BRICK, DOOR, METAL, PLASTER, TRIM, VARNISH};
        let plasters = [
            PLASTER,
            PLASTER.dyed([0.56, 0.55, 0.51], [0.52, 0.51, 0.48]),
            PLASTER.dyed([0.5, 0.33, 0.24], [0.47, 0.32, 0.24]),
        ];
        let bricks = [BRICK, BRICK.dyed([0.4, 0.31, 0.21], [0.42, 0.39, 0.34])];
        let mut walls = Vec::new();
        for finish in plasters.iter().chain(&bricks) {
            walls.push(finish.of(Class::Wall, b));
        }
        Self {
            walls,
            trim: TRIM.of(Class::Wall, b),
            panes: [palette::PANE, palette::LIT_PANE].map(|finish| finish.of(Class::Wall, b)),
            doors: [DOOR, DOOR.dyed([0.05, 0.12, 0.1], [0.02, 0.04, 0.04])]
                .map(|finish| finish.of(Class::Wall, b)),
            cloths: [
                VARNISH.dyed([0.42, 0.09, 0.08], [0.35, 0.07, 0.06]),
                VARNISH.dyed([0.1, 0.22, 0.16], [0.13, 0.26, 0.2]),
            ]
            .map(|finish| finish.of(Class::Obstacle, b)),
            pipe: METAL.of(Class::Wall, b),
        }
    }
}

impl Row {
    /// From a point, in the direction of x rotated by `quarters` times 90° to the left.
    pub(super) fn new(from: [f64; 2], quarters: f64) -> Self {
        Self {
            from,
            yaw: 0.5 * std::f64::consts::PI * quarters,
        }
    }

    /// Point at distances along the row, out of it, and up, m.
    pub(super) fn at(&self, along: f64, out: f64, up: f64) -> Vector3<f64> {
        let (s, c) = (libm::sin(self.yaw), libm::cos(self.yaw));
        Vector3::new(
            self.from[0] + c * along - s * out,
            self.from[1] + s * along + c * out,
            up,
        )
    }

    /// A box without a back that protrudes from the wall by `size[1]`: `middle` along it, from `up`
    /// on.
    pub(super) fn relief(
        &self,
        b: &mut Builder,
        [middle, up]: [f64; 2],
        [width, depth, height]: [f64; 3],
        stuff: Stuff,
    ) {
        let (l, r) = (middle - 0.5 * width, middle + 0.5 * width);
        let (low, high) = (up, up + height);
        let at = |along: f64, out: f64, up: f64| self.at(along, out * depth, up);
        let faces = [
            [
                at(r, 1.0, low),
                at(l, 1.0, low),
                at(l, 1.0, high),
                at(r, 1.0, high),
            ],
            [
                at(l, 1.0, low),
                at(l, 0.0, low),
                at(l, 0.0, high),
                at(l, 1.0, high),
            ],
            [
                at(r, 0.0, low),
                at(r, 1.0, low),
                at(r, 1.0, high),
                at(r, 0.0, high),
            ],
            [
                at(r, 1.0, high),
                at(l, 1.0, high),
                at(l, 0.0, high),
                at(r, 0.0, high),
            ],
            [
                at(r, 0.0, low),
                at(l, 0.0, low),
                at(l, 1.0, low),
                at(r, 1.0, low),
            ],
        ];
        for face in faces {
            b.mesh.tiled_quad(face, [middle, up], 1.2, stuff);
        }
    }

    /// A window with frame, bars and sill, `middle` along, its sill at `up`.
    pub(super) fn window(
        &self,
        b: &mut Builder,
        materials: &FrontMaterials,
        [middle, up]: [f64; 2],
        window: Window,
        wall: Stuff,
    ) {
        let of = |material: u16| Stuff { material, ..wall };
        let lit = usize::from(b.draw(0.0, 1.0) < AT_HOME);
        let Window { width, height } = window;
        let (pane, trim) = (of(materials.panes[lit]), of(materials.trim));
        let (l, r) = (middle - 0.5 * width, middle + 0.5 * width);
        let [a, c, d, e] = [(r, up), (l, up), (l, up + height), (r, up + height)]
            .map(|(along, up)| self.at(along, 0.02, up));
        b.mesh.tiled_quad([a, c, d, e], [middle, up], 1.2, pane);
        for along in [l - 0.055, r + 0.055] {
            self.relief(b, [along, up], [0.11, 0.09, height], trim);
        }
        let lintel = [width + 0.22, 0.1, 0.12];
        self.relief(b, [middle, up + height], lintel, trim);
        // Bars well in front of the pane, so that depth order is unambiguous from afar.
        self.relief(b, [middle, up], [0.05, 0.07, height], trim);
        self.relief(b, [middle, up + 0.66 * height], [width, 0.075, 0.05], trim);
        self.relief(b, [middle, up - 0.08], [width + 0.38, 0.16, 0.08], trim);
    }

    /// Fills `length` m of the row with houses.
    pub(super) fn houses(
        &self,
        b: &mut Builder,
        materials: &FrontMaterials,
        style: Style,
        length: f64,
    ) {
        let mut along = 0.0;
        while along < length - 0.5 {
            let left = length - along;
            let width = b.draw(5.5, 8.5);
            // No slivers.
            let width = if left - width < 4.0 { left } else { width };
            self.house(b, materials, style, [along, width]);
            along += width;
        }
    }

    fn house(
        &self,
        b: &mut Builder,
        materials: &FrontMaterials,
        style: Style,
        [along, width]: [f64; 2],
    ) {
        let kind = b.draw(0.0, materials.walls.len() as f64) as usize;
        let wall = b.of_thing(materials.walls[kind]);
        let of = |material: u16| Stuff { material, ..wall };
        let trim = of(materials.trim);
        let [least, most] = style.floors.map(f64::from);
        let floors = b.draw(least, most + 1.0) as u32;
        let height = GROUND_FLOOR + FLOOR * f64::from(floors) + 0.3;
        let middle = along + 0.5 * width;
        let (l, r) = (along, along + width);
        let [a, c, d, e] =
            [(l, -0.1), (r, -0.1), (r, height), (l, height)].map(|(x, z)| self.at(x, 0.0, z));
        // Seen from in front, the row runs to the left.
        b.mesh.tiled_quad([c, a, e, d], [along, 0.0], 1.1, wall);
        // Sides and a flat roof; the back is not visible.
        let at = |along: f64, back: f64, up: f64| self.at(along, -14.0 * back, up);
        for face in [
            [
                at(l, 0.0, -0.1),
                at(l, 1.0, -0.1),
                at(l, 1.0, height),
                at(l, 0.0, height),
            ],
            [
                at(r, 1.0, -0.1),
                at(r, 0.0, -0.1),
                at(r, 0.0, height),
                at(r, 1.0, height),
            ],
            [
                at(r, 0.0, height),
                at(l, 0.0, height),
                at(l, 1.0, height),
                at(r, 1.0, height),
            ],
        ] {
            b.mesh.tiled_quad(face, [along, 0.0], 3.5, wall);
        }
        self.relief(b, [middle, -0.05], [width - 0.02, 0.05, 0.5], trim);
        let band = [width - 0.02, 0.1, 0.18];
        self.relief(b, [middle, GROUND_FLOOR - 0.2], band, trim);
        let cornice = [width - 0.02, 0.3, 0.25];
        self.relief(b, [middle, height - 0.3], cornice, trim);
        let gutter = [0.1, height - 0.35].map(|z| self.at(along + 0.2, 0.1, z));
        b.mesh.tube(gutter, [0.045; 2], 8, 1.5, of(materials.pipe));

        let bays = ((width / 2.0) as u32).max(2);
        let door = b.draw(0.0, f64::from(bays)) as u32;
        let is_shop = b.draw(0.0, 1.0) < style.shops;
        let cloth = of(materials.cloths[usize::from(b.draw(0.0, 1.0) < 0.5)]);
        let wood = of(materials.doors[usize::from(b.draw(0.0, 1.0) < 0.5)]);
        for i in 0..bays {
            let at = along + (f64::from(i) + 0.5) * width / f64::from(bays);
            if i == door {
                self.door(b, at, [wood, trim]);
            } else if is_shop {
                let size = Window {
                    width: 1.42,
                    height: 1.9,
                };
                self.window(b, materials, [at, 0.7], size, wall);
                self.awning(b, at, cloth);
            } else {
                let size = Window {
                    width: 0.98,
                    height: 1.5,
                };
                self.window(b, materials, [at, 1.05], size, wall);
            }
            for floor in 0..floors {
                let size = Window {
                    width: 0.98,
                    height: 1.45,
                };
                let sill = GROUND_FLOOR + 0.8 + FLOOR * f64::from(floor);
                self.window(b, materials, [at, sill], size, wall);
            }
        }
    }

    fn door(&self, b: &mut Builder, at: f64, [wood, trim]: [Stuff; 2]) {
        self.relief(b, [at, 0.0], [1.35, 0.05, 2.55], trim);
        self.relief(b, [at, 0.1], [1.0, 0.11, 2.2], wood);
        self.relief(b, [at, -0.05], [1.3, 0.3, 0.15], trim);
        // Handle, letter slot, number.
        self.relief(b, [at + 0.4, 1.05], [0.03, 0.18, 0.14], trim);
        self.relief(b, [at, 0.95], [0.3, 0.14, 0.05], trim);
        self.relief(b, [at - 0.85, 1.75], [0.16, 0.02, 0.16], trim);
    }

    /// A sheet with two sides over a window.
    fn awning(&self, b: &mut Builder, at: f64, cloth: Stuff) {
        let corner = |s: f64, out: f64, up: f64| self.at(at + s, out, up);
        let (l, r) = (-0.9, 0.9);
        let [a, c, d, e] = [
            corner(l, 1.0, 2.55),
            corner(r, 1.0, 2.55),
            corner(r, 0.1, 3.1),
            corner(l, 0.1, 3.1),
        ];
        b.mesh.tiled_quad([a, c, d, e], [0.0, 0.0], 0.6, cloth);
        b.mesh.tiled_quad([c, a, e, d], [0.0, 0.0], 0.6, cloth);
    }
}
