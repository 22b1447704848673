//! Poses of the lenses and IMUs of a calibrated rig, as rows of text and HTML.
//!
//! Contract: every coordinate frame of every camera is a row, in the order of the rig's cameras,
//! with its pose in the rig frame. Translations are in mm, rotations are roll, pitch and yaw in
//! degrees about the rig's fixed x, y and z, as in rig tables. Rotations of a lens are of its body
//! (x along the view, y to the left, z up in the image), so that they are zero for a lens along x;
//! those of an IMU are of its own axes. A sigma is the largest of three axes; `None` if the rig
//! states no tolerance.

use anyhow::Result;
use cad_transforms::rig::check::{CameraFacts, Facts};
use cad_transforms::{FieldOfView, Frame, FramePart, Rig, RigidTransform};
use camera_models::CameraModel;
use charts::{Cell, Page, Table};

/// Pose of one coordinate frame of a camera.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FramePose {
    pub(super) frame: Frame,
    /// x, y, z in the rig, mm.
    pub(super) at_mm: [f64; 3],
    /// Roll, pitch, yaw, degrees.
    pub(super) rpy_deg: [f64; 3],
    /// Sigma, mm and degrees.
    pub(super) sigma: Option<[f64; 2]>,
    /// Whether it is the origin by definition.
    pub(super) is_origin: bool,
}

/// The poses of all frames of all cameras of a rig.
///
/// # Errors
/// None for a rig that can be read.
pub(super) fn of(rig: &Rig) -> Result<Vec<FramePose>> {
    let origin = rig.origin_camera();
    let known: Vec<Frame> = rig.frames().collect();
    let mut all = Vec::new();
    for camera in rig.cameras() {
        for part in [FramePart::Left, FramePart::Right, FramePart::Imu] {
            let frame = Frame::of_camera(camera, part)?;
            if !known.contains(&frame) {
                continue;
            }
            let rig_from_frame = rig.transform(&Frame::rig(), &frame)?;
            let body = match part {
                FramePart::Imu => rig_from_frame,
                FramePart::Left | FramePart::Right => {
                    rig_from_frame * RigidTransform::body_from_optical().inverse()
                }
            };
            let (roll, pitch, yaw) = body.rotation().euler_angles();
            let sigma = rig.covariance(&Frame::rig(), &frame)?.map(|covariance| {
                let sigmas = covariance.sigmas();
                let most = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
                [1e3 * most(&sigmas[..3]), most(&sigmas[3..]).to_degrees()]
            });
            all.push(FramePose {
                frame,
                at_mm: rig_from_frame.translation_m().map(|v| 1e3 * v),
                rpy_deg: [roll, pitch, yaw].map(f64::to_degrees),
                sigma,
                is_origin: part == FramePart::Left && origin == Some(camera),
            });
        }
    }
    Ok(all)
}

/// A number with `digits` decimals; without sign if it rounds to zero.
fn fixed(value: f64, digits: usize) -> String {
    let unit = 10f64.powi(digits as i32);
    format!("{:.digits$}", (value * unit).round() / unit + 0.0)
}

/// Sigmas as text.
fn sigmas(placed: &FramePose) -> [String; 2] {
    match (placed.is_origin, placed.sigma) {
        (true, _) => ["origin".to_owned(), "origin".to_owned()],
        (false, Some([mm, degrees])) => [fixed(mm, 2), fixed(degrees, 3)],
        (false, None) => ["-".to_owned(), "-".to_owned()],
    }
}

/// Describes the rig frame.
fn heading(rig: &Rig) -> String {
    match rig.origin_camera() {
        Some(camera) => format!(
            "poses: the origin is the left lens of {camera}, x along its view, y to its left, z up in its image"
        ),
        None => format!(
            "poses on {:?}: x forward, y left, z up, from the datum of the plate",
            rig.name()
        ),
    }
}

/// The printed lines.
///
/// # Errors
/// As [`of`].
pub(super) fn lines(rig: &Rig) -> Result<Vec<String>> {
    let rows = of(rig)?;
    let names = rows.iter().map(|row| row.frame.as_str().len());
    let width = names.max().unwrap_or(0).max(5);
    let mut lines = vec![
        heading(rig),
        format!(
            "{:width$}  {:>8} {:>8} {:>8}  {:>7} {:>7} {:>7}  {:>8} {:>9}",
            "frame",
            "x mm",
            "y mm",
            "z mm",
            "roll\u{b0}",
            "pitch\u{b0}",
            "yaw\u{b0}",
            "sigma mm",
            "sigma deg"
        ),
    ];
    for row in &rows {
        let [x, y, z] = row.at_mm.map(|v| fixed(v, 2));
        let [roll, pitch, yaw] = row.rpy_deg.map(|v| fixed(v, 2));
        let [mm, degrees] = sigmas(row);
        let name = row.frame.as_str();
        lines.push(format!(
            "{name:width$}  {x:>8} {y:>8} {z:>8}  {roll:>7} {pitch:>7} {yaw:>7}  {mm:>8} {degrees:>9}"
        ));
    }
    Ok(lines)
}

/// A section of a page: the same table, and a drawing of the rig from three sides. `lenses` are
/// left lenses by camera.
///
/// # Errors
/// As [`of`].
pub(super) fn section(page: Page, rig: &Rig, lenses: &[(&str, &CameraModel)]) -> Result<Page> {
    let mut table = Table::new([
        "Frame",
        "x mm",
        "y mm",
        "z mm",
        "Roll \u{b0}",
        "Pitch \u{b0}",
        "Yaw \u{b0}",
        "Sigma mm",
        "Sigma \u{b0}",
    ]);
    for row in of(rig)? {
        let [x, y, z] = row.at_mm.map(|v| Cell::number(fixed(v, 2)));
        let [roll, pitch, yaw] = row.rpy_deg.map(|v| Cell::number(fixed(v, 2)));
        let [mm, degrees] = sigmas(&row).map(Cell::number);
        let frame = Cell::from(row.frame.as_str());
        table = table.row([frame, x, y, z, roll, pitch, yaw, mm, degrees]);
    }
    let heading = heading(rig);
    let heading = format!("{}{}.", heading[..1].to_uppercase(), &heading[1..]);
    let facts: Facts = lenses
        .iter()
        .map(|(camera, lens)| {
            let size = [lens.width, lens.height];
            let facts = CameraFacts {
                source: "this calibration".to_owned(),
                view: FieldOfView::from_pinhole(size, [lens.fx, lens.fy], [lens.cx, lens.cy]),
                ..CameraFacts::default()
            };
            ((*camera).to_owned(), facts)
        })
        .collect();
    let page = page
        .section("Poses of cameras and IMUs")
        .text(&format!(
            "{heading} Roll, pitch and yaw are rotations about these axes; sigma is the largest of three axes, one standard deviation."
        ))
        .table(&table)
        .dark(rig_drawing::DARK);
    let caption = "Front, side and top; the ground is drawn 1.2 m below the origin.";
    Ok(page.figure(&rig_drawing::draw(rig, &facts).svg(), caption))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example, with sigmas of 0.2 mm and 0.1 degrees.
    fn example() -> Rig {
        let rig = Rig::parse(include_str!("../../cad-transforms/rigs/example.toml")).unwrap();
        let mut parts = rig.to_parts();
        for edge in &mut parts.edges {
            let sigma =
                cad_transforms::Covariance::from_sigmas([2e-4; 3], [0.1f64.to_radians(); 3]);
            edge.covariance = (edge.child.as_str() != "feet/imu").then(|| sigma.unwrap());
        }
        Rig::from_parts(parts).unwrap()
    }

    #[test]
    fn every_color_of_the_page_has_a_dark_replacement() {
        let page = section(Page::new("places"), &example(), &[]).unwrap();
        let html = page.to_html();
        let (_, drawing) = html.split_once("<svg ").unwrap();
        let mut colors = 0;
        for part in drawing.split("=\"#").skip(1) {
            let color = format!("#{}", part.split('"').next().unwrap());
            let rule = format!("svg [fill=\"{color}\"] {{ fill: ");
            assert!(html.contains(&rule), "{color} has no colour for the dark");
            colors += 1;
        }
        assert!(colors > 20, "{colors}");
    }

    #[test]
    fn every_frame_has_position_rotation_and_sigma() {
        let rows = of(&example()).unwrap();
        let names: Vec<&str> = rows.iter().map(|row| row.frame.as_str()).collect();
        assert_eq!(names.len(), 9, "{names:?}");
        let row = |name: &str| rows.iter().find(|row| row.frame.as_str() == name).unwrap();
        // 30 degrees to the left, and 10 degrees from straight down.
        let close = |found: [f64; 3], expected: [f64; 3]| {
            let off = found.iter().zip(expected).map(|(f, e)| (f - e).abs());
            assert!(
                off.fold(0.0, f64::max) < 0.01,
                "{found:?}, expected {expected:?}"
            );
        };
        close(row("left_shoulder/left").at_mm, [7.53, 161.6, 100.0]);
        close(row("left_shoulder/left").rpy_deg, [0.0, 0.0, 30.0]);
        close(row("feet/left").rpy_deg, [0.0, 80.0, 0.0]);
        let [mm, degrees] = row("feet/left").sigma.unwrap();
        assert!((mm - 0.2).abs() < 1e-9 && (degrees - 0.1).abs() < 1e-9);
        assert_eq!(row("feet/imu").sigma, None);
        let text = lines(&example()).unwrap().join("\n");
        let line = "left_shoulder/left        7.53   161.60   100.00     0.00    0.00   30.00      0.20     0.100";
        assert!(text.contains(line), "{text}");
        assert!(text.contains("from the datum of the plate"), "{text}");
    }
}
