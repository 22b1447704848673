//! Drawing of a rig: front, side and top views; above the whole with the ground and the shoes,
//! below a close-up of the plate.
//!
//! Front is the view of a person who faces the wearer: the wearer's left is on the right. Side is
//! from the wearer's right: ahead is to the right. Top is from above: ahead is up.

use cad_transforms::rig::check::{Facts, GROUND_BELOW_RIG_M, SHOES_X_M, SHOES_Y_M, view};
use cad_transforms::{FieldOfView, Frame, FramePart, Rig, RigidTransform};
use raster::{Color, strokes};

use crate::colors::{AXES, BODY, GRID, GROUND, INK, MUTED, PALETTE, PAPER, SHOE};
use crate::sheet::Sheet;

/// Pixels.
const WIDTH: usize = 1260;
const HEIGHT: usize = 1050;
const MARGIN: f64 = 24.0;
/// Heights of the panels of the whole and of the close-up, pixels.
const WHOLE_HEIGHT: f64 = 440.0;
const CLOSE_HEIGHT: f64 = 340.0;

/// Length of a frustum that does not reach the ground, m.
const FRUSTUM_LENGTH_M: f64 = 0.6;
/// Maximum length of a frustum to the ground, m.
const MAX_GROUND_RAY_M: f64 = 3.0;
/// Length of frusta in the close-up, m.
const CLOSE_FRUSTUM_LENGTH_M: f64 = 0.05;
/// Length of drawn axes, m.
const AXIS_M: f64 = 0.03;

/// Viewing direction.
#[derive(Clone, Copy)]
enum Side {
    Front,
    Right,
    Top,
}

/// A camera prepared for drawing.
struct CameraDrawing {
    name: String,
    color: Color,
    rig_from_left: RigidTransform,
    rig_from_right: Option<RigidTransform>,
    view: Option<(String, FieldOfView)>,
}

/// Panel of the sheet for one view.
struct Panel {
    side: Side,
    /// Upper left corner and size, pixels.
    corner: [f64; 2],
    size: [f64; 2],
    /// Center of the view, m, across and up.
    middle: [f64; 2],
    /// Pixels per metre.
    scale: f64,
}

/// Draws a rig. Frusta are those of the left lenses, if their field of view is known.
pub fn draw(rig: &Rig, facts: &Facts) -> Sheet {
    let cameras = cameras(rig, facts);
    let mut sheet = Sheet::new(WIDTH, HEIGHT);
    let title = format!("{}, revision {}", rig.name(), rig.revision());
    sheet.text([MARGIN, 34.0], 20.0, INK, shorten(&title, 90));
    let provenance = rig.provenance();
    let from = format!("{}: {}", provenance.kind.as_str(), provenance.note);
    sheet.text([MARGIN, 56.0], 13.0, MUTED, shorten(&from, 150));

    let width = (WIDTH as f64 - 4.0 * MARGIN) / 3.0;
    let whole: Vec<[f64; 3]> = whole_points(&cameras);
    let close: Vec<[f64; 3]> = close_points(&cameras);
    for (points, top, height, is_whole) in [
        (&whole, 72.0, WHOLE_HEIGHT, true),
        (&close, 72.0 + WHOLE_HEIGHT + MARGIN, CLOSE_HEIGHT, false),
    ] {
        let sides = [Side::Front, Side::Right, Side::Top];
        let bounds = sides.map(|side| bounds(points, side));
        // One scale for the three views, so that they can be compared.
        let fit = bounds.iter().map(|[low, high]| {
            let room = [width - 40.0, height - 104.0];
            (0..2)
                .map(|i| room[i] / (high[i] - low[i]))
                .fold(f64::INFINITY, f64::min)
        });
        let scale = fit.fold(f64::INFINITY, f64::min);
        for (i, (side, [low, high])) in sides.into_iter().zip(bounds).enumerate() {
            let panel = Panel {
                side,
                corner: [MARGIN + i as f64 * (width + MARGIN), top],
                size: [width, height],
                middle: [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])],
                scale,
            };
            panel.frame(&mut sheet, is_whole);
            if is_whole {
                panel.surroundings(&mut sheet);
            }
            for camera in &cameras {
                panel.camera(&mut sheet, camera, is_whole);
            }
            panel.axes(&mut sheet);
            if !is_whole {
                panel.labels(&mut sheet, &cameras);
            }
        }
    }
    legend(&mut sheet, &cameras);
    sheet
}

fn cameras(rig: &Rig, facts: &Facts) -> Vec<CameraDrawing> {
    let place = |camera: &str, part| {
        let frame = Frame::of_camera(camera, part).ok()?;
        rig.transform(&Frame::rig(), &frame).ok()
    };
    let names = rig.cameras().into_iter().enumerate();
    names
        .filter_map(|(i, name)| {
            Some(CameraDrawing {
                name: name.to_owned(),
                color: PALETTE[i % PALETTE.len()],
                rig_from_left: place(name, FramePart::Left)?,
                rig_from_right: place(name, FramePart::Right),
                view: view(rig, name, facts),
            })
        })
        .collect()
}

/// Apex and ends of the corner rays in `rig`. The rays of a camera that points well down extend to
/// the ground.
fn frustum(
    camera: &CameraDrawing,
    reach_m: f64,
    to_ground: bool,
) -> Option<([f64; 3], [[f64; 3]; 4])> {
    let (_, view) = camera.view.as_ref()?;
    let eye = camera.rig_from_left.translation_m();
    let ahead = camera.rig_from_left.rotate([0.0, 0.0, 1.0]);
    let ground = view.on_level(&camera.rig_from_left, -GROUND_BELOW_RIG_M);
    let near = |corners: &[[f64; 3]; 4]| {
        corners
            .iter()
            .all(|c| (0..3).map(|i| (c[i] - eye[i]).powi(2)).sum::<f64>().sqrt() < MAX_GROUND_RAY_M)
    };
    if to_ground
        && ahead[2] < -0.7
        && let Some(corners) = ground.filter(near)
    {
        return Some((eye, corners));
    }
    let ends = view
        .corners()
        .map(|ray| camera.rig_from_left.apply(ray.map(|v| v * reach_m)));
    Some((eye, ends))
}

/// Boxes that represent the wearer, m: low and high corner.
const TORSO: [[f64; 3]; 2] = [[-0.26, -0.19, -0.42], [-0.02, 0.19, 0.16]];
const HEAD: [[f64; 3]; 2] = [[-0.24, -0.08, 0.22], [-0.04, 0.08, 0.46]];
const LEGS: [[[f64; 3]; 2]; 2] = [
    [[-0.22, 0.02, -1.12], [-0.08, 0.16, -0.42]],
    [[-0.22, -0.16, -1.12], [-0.08, -0.02, -0.42]],
];

/// The outlines of the two shoes on the ground, half of the region each.
fn shoes() -> [[[f64; 3]; 4]; 2] {
    let [back, front] = SHOES_X_M;
    let z = -GROUND_BELOW_RIG_M;
    let shoe = |low: f64, high: f64| {
        [
            [back, low, z],
            [front, low, z],
            [front, high, z],
            [back, high, z],
        ]
    };
    [shoe(0.03, SHOES_Y_M[1]), shoe(SHOES_Y_M[0], -0.03)]
}

fn whole_points(cameras: &[CameraDrawing]) -> Vec<[f64; 3]> {
    let mut points: Vec<[f64; 3]> = [TORSO, HEAD].into_iter().flatten().collect();
    points.extend(shoes().into_iter().flatten());
    points.push([0.0, 0.0, -GROUND_BELOW_RIG_M - 0.05]);
    for camera in cameras {
        if let Some((eye, ends)) = frustum(camera, FRUSTUM_LENGTH_M, true) {
            points.push(eye);
            points.extend(ends);
        }
        points.push(camera.rig_from_left.translation_m());
    }
    points
}

fn close_points(cameras: &[CameraDrawing]) -> Vec<[f64; 3]> {
    let mut points = vec![[0.0; 3]];
    for camera in cameras {
        for lens in [Some(camera.rig_from_left), camera.rig_from_right]
            .into_iter()
            .flatten()
        {
            let at = lens.translation_m();
            let room = 1.3 * CLOSE_FRUSTUM_LENGTH_M;
            points.extend([at.map(|v| v - room), at.map(|v| v + room)]);
        }
    }
    points
}

fn bounds(points: &[[f64; 3]], side: Side) -> [[f64; 2]; 2] {
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    for point in points {
        let flat = side.flat(*point);
        for i in 0..2 {
            low[i] = low[i].min(flat[i]);
            high[i] = high[i].max(flat[i]);
        }
    }
    [low, high]
}

impl Side {
    /// Across to the right, and up, m.
    fn flat(self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        match self {
            Self::Front => [y, z],
            Self::Right => [x, z],
            Self::Top => [-y, x],
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Front => "front: facing the wearer",
            Self::Right => "side: from the wearer's right",
            Self::Top => "top: ahead is up",
        }
    }
}

impl Panel {
    fn place(&self, point: [f64; 3]) -> [f64; 2] {
        let [across, up] = self.side.flat(point);
        [
            self.corner[0] + 0.5 * self.size[0] + self.scale * (across - self.middle[0]),
            // The title needs some of the height.
            self.corner[1] + 0.5 * self.size[1] + 4.0 - self.scale * (up - self.middle[1]),
        ]
    }

    /// The border, the title and a bar for the scale.
    fn frame(&self, sheet: &mut Sheet, is_whole: bool) {
        let ([x, y], [w, h]) = (self.corner, self.size);
        sheet.outline(&[[x, y], [x + w, y], [x + w, y + h], [x, y + h]], GRID, 1.5);
        sheet.text([x + 10.0, y + 20.0], 13.0, INK, self.side.title());
        let metres = [0.5, 0.2, 0.1, 0.05, 0.02, 0.01]
            .into_iter()
            .find(|m| m * self.scale < 0.4 * w)
            .unwrap_or(0.01);
        let (right, base) = (x + w - 12.0, y + h - 12.0);
        let left = right - metres * self.scale;
        sheet.line(
            &[
                [left, base - 4.0],
                [left, base],
                [right, base],
                [right, base - 4.0],
            ],
            MUTED,
            1.5,
        );
        let label = if is_whole {
            format!("{metres} m")
        } else {
            format!("{} mm", (metres * 1e3).round())
        };
        let middle = 0.5 * (left + right) - 0.5 * strokes::width(&label, 12.0);
        sheet.text([middle, base - 8.0], 12.0, MUTED, label);
    }

    /// The wearer, the ground and the shoes.
    fn surroundings(&self, sheet: &mut Sheet) {
        for [low, high] in [LEGS[0], LEGS[1], TORSO, HEAD] {
            let [a, b] = [self.place(low), self.place(high)];
            sheet.area(&[a, [b[0], a[1]], b, [a[0], b[1]]], BODY, 1.0);
        }
        let z = -GROUND_BELOW_RIG_M;
        match self.side {
            Side::Front | Side::Right => {
                let y = self.place([0.0, 0.0, z])[1];
                let [x, w] = [self.corner[0], self.size[0]];
                sheet.line(&[[x + 8.0, y], [x + w - 8.0, y]], GROUND, 2.0);
                sheet.text([x + 12.0, y + 16.0], 12.0, GROUND, "ground");
                for shoe in shoes() {
                    let [a, b] = [self.place(shoe[0]), self.place(shoe[2])];
                    sheet.area(
                        &[a, [a[0], a[1] - 7.0], [b[0], a[1] - 7.0], [b[0], a[1]]],
                        SHOE,
                        0.9,
                    );
                }
            }
            Side::Top => {
                for shoe in shoes() {
                    let corners = shoe.map(|corner| self.place(corner));
                    sheet.area(&corners, SHOE, 0.55);
                }
            }
        }
    }

    fn camera(&self, sheet: &mut Sheet, camera: &CameraDrawing, is_whole: bool) {
        let reach = if is_whole {
            FRUSTUM_LENGTH_M
        } else {
            CLOSE_FRUSTUM_LENGTH_M
        };
        if let Some((eye, ends)) = frustum(camera, reach, is_whole) {
            let eye = self.place(eye);
            let ends = ends.map(|end| self.place(end));
            for i in 0..4 {
                sheet.area(&[eye, ends[i], ends[(i + 1) % 4]], camera.color, 0.06);
            }
            for end in ends {
                sheet.line(&[eye, end], camera.color, 1.2);
            }
            sheet.outline(&ends, camera.color, 1.6);
            // Image up direction, to show a camera that is mounted upside down.
            let [a, b] = [ends[0], ends[1]];
            sheet.line(&[a, b], camera.color, 3.4);
        }
        let left = self.place(camera.rig_from_left.translation_m());
        if !is_whole {
            for (i, color) in AXES.into_iter().enumerate() {
                let mut tip = [0.0; 3];
                tip[i] = AXIS_M;
                let tip = self.place(camera.rig_from_left.apply(tip));
                sheet.line(&[left, tip], color, 2.0);
            }
        }
        let radius = if is_whole { 3.0 } else { 4.5 };
        if let Some(right) = &camera.rig_from_right {
            let right = self.place(right.translation_m());
            sheet.line(&[left, right], camera.color, 2.0);
            sheet.dot(right, radius, camera.color);
            sheet.dot(right, radius - 1.8, PAPER);
        }
        sheet.dot(left, radius, camera.color);
    }

    /// The axes of `rig` at its datum.
    fn axes(&self, sheet: &mut Sheet) {
        let length = 34.0 / self.scale;
        let datum = self.place([0.0; 3]);
        for (i, color) in AXES.into_iter().enumerate() {
            let mut tip = [0.0; 3];
            tip[i] = length;
            let tip = self.place(tip);
            if (tip[0] - datum[0]).hypot(tip[1] - datum[1]) > 1.0 {
                sheet.line(&[datum, tip], color, 2.4);
                let away = |k: usize| tip[k] + 0.35 * (tip[k] - datum[k]);
                sheet.text(
                    [away(0) - 4.0, away(1) + 4.0],
                    13.0,
                    color,
                    ["x", "y", "z"][i],
                );
            }
        }
        sheet.dot(datum, 3.0, INK);
    }

    /// Names of the cameras, moved up if they would overlap.
    fn labels(&self, sheet: &mut Sheet, cameras: &[CameraDrawing]) {
        const SIZE: f64 = 12.0;
        let mut taken: Vec<[f64; 4]> = Vec::new();
        for camera in cameras {
            // Above the camera's shapes.
            let mut points: Vec<[f64; 3]> = [Some(camera.rig_from_left), camera.rig_from_right]
                .into_iter()
                .flatten()
                .map(|lens| lens.translation_m())
                .collect();
            let ends = frustum(camera, CLOSE_FRUSTUM_LENGTH_M, false).map(|(_, ends)| ends);
            points.extend(ends.into_iter().flatten());
            let places: Vec<[f64; 2]> = points.into_iter().map(|point| self.place(point)).collect();
            let bound = |axis: usize, pick: fn(f64, f64) -> f64, start: f64| {
                places.iter().map(|p| p[axis]).fold(start, pick)
            };
            let left = bound(0, f64::min, f64::INFINITY);
            let right = bound(0, f64::max, f64::NEG_INFINITY);
            let width = strokes::width(&camera.name, SIZE);
            let low = self.corner[0] + 6.0;
            let high = self.corner[0] + self.size[0] - width - 6.0;
            let x = (0.5 * (left + right - width)).clamp(low, high.max(low));
            let mut y = bound(1, f64::min, f64::INFINITY) - 8.0;
            let overlaps = |y: f64, taken: &[[f64; 4]]| {
                taken
                    .iter()
                    .any(|[l, t, r, b]| x < *r && x + width > *l && y - SIZE < *b && y > *t)
            };
            while overlaps(y, &taken) {
                y -= 3.0;
            }
            taken.push([x, y - SIZE, x + width, y + 4.0]);
            sheet.text([x, y], SIZE, camera.color, camera.name.clone());
        }
    }
}

/// One line per camera, and the legend of symbols.
fn legend(sheet: &mut Sheet, cameras: &[CameraDrawing]) {
    let mut y = 72.0 + WHOLE_HEIGHT + CLOSE_HEIGHT + 2.0 * MARGIN + 14.0;
    for camera in cameras {
        let [x, side, z] = camera.rig_from_left.translation_m().map(|v| 1e3 * v);
        let axis = camera.rig_from_left.rotate([0.0, 0.0, 1.0]);
        let left_deg = axis[1].atan2(axis[0]).to_degrees() + 0.0;
        let up_deg = axis[2].clamp(-1.0, 1.0).asin().to_degrees();
        let view = match &camera.view {
            Some((source, view)) => {
                let [h, v] = view.degrees();
                format!("view {h:.0} x {v:.0} deg ({source})")
            }
            None => "view not known, no frustum drawn".to_owned(),
        };
        sheet.area(
            &[
                [MARGIN, y - 10.0],
                [MARGIN + 16.0, y - 10.0],
                [MARGIN + 16.0, y],
                [MARGIN, y],
            ],
            camera.color,
            1.0,
        );
        let text = format!(
            "{}: left lens at {x:.1}, {side:.1}, {z:.1} mm, view {left_deg:.1} deg left, {up_deg:.1} deg up; {view}",
            camera.name
        );
        sheet.text([MARGIN + 26.0, y], 13.0, INK, shorten(&text, 148));
        y += 21.0;
    }
    let signs = "filled dot: left lens; ring: right lens; thick edge: top of the image; axes x red, y green, z blue \
                 (of rig at its datum, below also of the lenses)";
    sheet.text([MARGIN, y + 4.0], 12.0, MUTED, shorten(signs, 165));
    let whole = format!(
        "the wearer is a sketch; ground {GROUND_BELOW_RIG_M} m below the datum; shoes as paws rig check assumes them"
    );
    sheet.text([MARGIN, y + 22.0], 12.0, MUTED, whole);
}

fn shorten(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let short: String = text.chars().take(most.saturating_sub(3)).collect();
    short + "..."
}
