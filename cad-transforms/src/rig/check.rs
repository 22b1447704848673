//! Plausibility of a rig: errors that a file can have although it can be read.
//!
//! Contract: [`check`] reports everything in one pass, errors that make the file unreadable and
//! implausible values, each with its line. Geometry is checked on whatever could be read. Lenses
//! and factory files are the caller's: it gives plain numbers as [`Facts`]; what was not given is
//! not checked, and a note says so.
//!
//! The limits of plausibility are constants of this module, with their reasons.

use std::collections::BTreeMap;
use std::fmt;

use super::file::{ParsedRig, read};
use super::{Problem, Rig, same_serial};
use crate::cad::device::Device;
use crate::frame::{Frame, FramePart};
use crate::transform::RigidTransform;
use crate::view::FieldOfView;

/// Height of the rig's datum above the ground under a standing wearer, m: the chest of a person of
/// 1.7 m.
pub const GROUND_BELOW_RIG_M: f64 = 1.2;
/// Where the shoes of a standing wearer are, m in front of the datum: the plate hangs some 14 cm in
/// front of the hips, so that the shoes lie around the point below it.
pub const SHOES_X_M: [f64; 2] = [-0.15, 0.15];
/// Where the shoes are, m to the left.
pub const SHOES_Y_M: [f64; 2] = [-0.2, 0.2];
/// Name of the camera that has to see them.
pub const FEET_CAMERA: &str = "feet";
/// Maximum angle of an optical axis behind the plate's plane, degrees: the wearer is at negative x.
/// A camera that looks straight down and hangs a little back is fine.
const LOOKS_BACK_DEG: f64 = 10.0;
/// Farthest a lens can be from the datum of something worn on the chest, m.
const FARTHEST_LENS_M: f64 = 1.0;
/// Baselines of stereo cameras that fit on a chest, m.
const BASELINES_M: [f64; 2] = [0.01, 0.3];
/// Maximum difference of the baseline from the factory file's, m, where the rig states no
/// tolerance: 1 % of depth for the ZED Mini.
const BASELINE_TOLERANCE_M: f64 = 0.0005;
/// Number of sigmas above which a difference is an error, where the rig states a tolerance.
pub const SIGMAS: f64 = 3.0;
/// Maximum offset of the right lens above, below, in front of or behind the left one, as a share of
/// the baseline.
const BESIDE_SHARE: f64 = 0.1;
/// Maximum rotation between the two lenses, degrees.
const STEREO_TURN_DEG: f64 = 3.0;

/// What is known from elsewhere, by the name of the camera.
pub type Facts = BTreeMap<String, CameraFacts>;

/// What is known of a camera from elsewhere. What is `None` is not checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFacts {
    /// Where this is from, for the messages: the name of the factory file.
    pub source: String,
    /// Takes points in the right optical frame to the left one, as in the factory file.
    pub left_from_right: Option<RigidTransform>,
    /// What the left lens sees.
    pub view: Option<FieldOfView>,
    /// Serial number, as the source has it; see [`super::same_serial`].
    pub serial: Option<String>,
}

/// How bad a finding is, from least to most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Something was not checked.
    Note,
    /// May be intended.
    Warning,
    /// The rig is impossible, or cannot be read.
    Error,
}

/// Something found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Line in the file, from 1; 0 where it belongs to none.
    pub line: usize,
    /// How bad it is.
    pub severity: Severity,
    /// What was found and what was expected.
    pub message: String,
}

/// What a camera's left lens sees, with the source of it: what the facts say, or else what is
/// nominal for its model.
pub fn view(rig: &Rig, camera: &str, facts: &Facts) -> Option<(String, FieldOfView)> {
    if let Some(known) = facts.get(camera)
        && let Some(view) = known.view
    {
        return Some((known.source.clone(), view));
    }
    let info = rig.camera_infos().iter().find(|info| info.name == camera)?;
    let device = Device::find(info.model.as_deref()?)?;
    let [horizontal, vertical] = device.field_of_view_deg;
    let view = FieldOfView::from_degrees(horizontal, vertical)?;
    Some((format!("a nominal {}", device.title), view))
}

/// Checks the text of a rig file; the worst first, then by line.
pub fn check(text: &str, facts: &Facts) -> Vec<Finding> {
    let parsed = read(text);
    let mut findings: Vec<Finding> = parsed
        .problems
        .iter()
        .map(|Problem { line, message }| Finding {
            line: *line,
            severity: Severity::Error,
            message: message.clone(),
        })
        .collect();
    if !parsed.hopeless {
        findings.extend(of_parsed(&parsed, facts));
    }
    findings.sort_by(|a, b| (b.severity, a.line).cmp(&(a.severity, b.line)));
    findings
}

/// Everything beyond the reading.
fn of_parsed(parsed: &ParsedRig, facts: &Facts) -> Vec<Finding> {
    let mut checks = Checks {
        parsed,
        findings: Vec::new(),
    };
    let rig = &parsed.rig;
    let cameras: Vec<String> = rig.cameras().into_iter().map(str::to_owned).collect();
    let origin = rig.origin_camera();
    for camera in &cameras {
        checks.place(camera, origin.is_none());
        checks.stereo(camera, facts.get(camera));
        checks.serial(camera, facts.get(camera));
    }
    checks.sides(&cameras, origin.is_none());
    match origin {
        None => checks.feet(&cameras, facts),
        Some(origin) => {
            let message = format!(
                "the rig's frame is that of {origin}, not of the plate: what follows from how the plate is worn \
                 (a camera that looks into the wearer, hangs upside down or misses the feet) was not checked"
            );
            checks.add(0, Severity::Note, message);
        }
    }
    for camera in facts.keys().filter(|camera| !cameras.contains(camera)) {
        let known = cameras.join(", ");
        let message = format!("{camera} has a calibration but no frames here; cameras are {known}");
        checks.add(0, Severity::Error, message);
    }
    checks.findings
}

struct Checks<'p> {
    parsed: &'p ParsedRig,
    findings: Vec<Finding>,
}

impl Checks<'_> {
    fn rig(&self) -> &Rig {
        &self.parsed.rig
    }

    fn add(&mut self, line: usize, severity: Severity, message: String) {
        self.findings.push(Finding {
            line,
            severity,
            message,
        });
    }

    /// Line of the entry that places this frame.
    fn line(&self, frame: &Frame) -> usize {
        let edges = self.rig().edges().iter().zip(&self.parsed.edge_lines);
        let of = |edge: &super::Edge| edge.child == *frame || edge.parent == *frame;
        let child = edges.clone().find(|(edge, _)| edge.child == *frame);
        let any = child.or_else(|| edges.clone().find(|(edge, _)| of(edge)));
        any.map_or(0, |(_, line)| *line)
    }

    /// `rig_from_frame` and the line, if the tree has the frame.
    fn placed(&self, camera: &str, part: FramePart) -> Option<(RigidTransform, usize)> {
        let frame = Frame::of_camera(camera, part).ok()?;
        let rig_from_frame = self.rig().transform(&Frame::rig(), &frame).ok()?;
        Some((rig_from_frame, self.line(&frame)))
    }

    /// The position of a camera and, where the axes of the rig are the wearer's, its viewing
    /// direction.
    fn place(&mut self, camera: &str, is_worn: bool) {
        let Some((rig_from_left, line)) = self.placed(camera, FramePart::Left) else {
            return;
        };
        let metres = rig_from_left.distance_m();
        if metres > FARTHEST_LENS_M {
            let message = format!(
                "{camera}/left is {metres:.3} m from the rig's datum, expected at most {FARTHEST_LENS_M} m: not in metres?"
            );
            self.add(line, Severity::Error, message);
        }
        if !is_worn {
            return;
        }
        let axis = rig_from_left.rotate([0.0, 0.0, 1.0]);
        let back_deg = (-axis[0]).clamp(-1.0, 1.0).asin().to_degrees();
        if back_deg > LOOKS_BACK_DEG {
            let message = format!(
                "{camera} looks into the wearer: its optical axis points {back_deg:.1} deg behind the plate \
                 ([{:.3}, {:.3}, {:.3}] in rig, x is forward), expected at most {LOOKS_BACK_DEG} deg; \
                 is the optical frame x right, y down, z forward?",
                axis[0], axis[1], axis[2]
            );
            self.add(line, Severity::Error, message);
        }
        let down = rig_from_left.rotate([0.0, 1.0, 0.0]);
        if down[2] > 0.5 {
            let message = format!("{camera} hangs upside down: down in its image is up in the rig");
            self.add(line, Severity::Warning, message);
        } else if axis[2].abs() < 0.7 && down[2].abs() < 0.5 {
            let message =
                format!("{camera} is turned on its side: down in its image is sideways in the rig");
            self.add(line, Severity::Warning, message);
        }
    }

    /// Left and right lens against each other and against the factory file.
    fn stereo(&mut self, camera: &str, facts: Option<&CameraFacts>) {
        let frame = |part| Frame::of_camera(camera, part).expect("a camera of the rig");
        let (left, right) = (frame(FramePart::Left), frame(FramePart::Right));
        let Ok(left_from_right) = self.rig().transform(&left, &right) else {
            if facts.is_some_and(|facts| facts.left_from_right.is_some()) {
                let message =
                    format!("{camera} has no right frame here, so its baseline was not checked");
                self.add(self.line(&left), Severity::Note, message);
            }
            return;
        };
        let line = self.line(&right);
        let [x, y, z] = left_from_right.translation_m();
        let baseline = left_from_right.distance_m();
        if x <= 0.0 {
            let message = format!(
                "left and right of {camera} are swapped: the right lens is at x = {:.2} mm in the left one's frame, expected above 0",
                1e3 * x
            );
            self.add(line, Severity::Error, message);
        } else if y.abs().max(z.abs()) > BESIDE_SHARE * baseline {
            let message = format!(
                "the right lens of {camera} is not beside the left one: it is at [{:.2}, {:.2}, {:.2}] mm in the left one's frame",
                1e3 * x,
                1e3 * y,
                1e3 * z
            );
            self.add(line, Severity::Error, message);
        }
        if !(BASELINES_M[0]..=BASELINES_M[1]).contains(&baseline) {
            let message = format!(
                "the baseline of {camera} is {:.2} mm, expected {} to {} mm: not in metres?",
                1e3 * baseline,
                1e3 * BASELINES_M[0],
                1e3 * BASELINES_M[1]
            );
            self.add(line, Severity::Error, message);
        }
        let turn_deg = left_from_right.angle_rad().to_degrees();
        if turn_deg > STEREO_TURN_DEG {
            let message = format!(
                "the lenses of {camera} are turned {turn_deg:.2} deg against each other, expected at most {STEREO_TURN_DEG}"
            );
            self.add(line, Severity::Warning, message);
        }
        let Some((source, factory)) =
            facts.and_then(|facts| Some((&facts.source, facts.left_from_right?)))
        else {
            let message = format!(
                "{camera}: no factory file given, so the baseline was not checked against one"
            );
            self.add(line, Severity::Note, message);
            return;
        };
        let off = baseline - factory.distance_m();
        let covariance = self.rig().covariance(&left, &right).ok().flatten();
        let sigma = covariance.map(|c| c.sigmas()[0]);
        let allowed = sigma.map_or(BASELINE_TOLERANCE_M, |sigma| {
            (SIGMAS * sigma).max(BASELINE_TOLERANCE_M)
        });
        if off.abs() > allowed {
            let message = format!(
                "the baseline of {camera} is {:.3} mm, {source} has {:.3} mm: off by {:+.3} mm, allowed are {:.3} mm",
                1e3 * baseline,
                1e3 * factory.distance_m(),
                1e3 * off,
                1e3 * allowed
            );
            self.add(line, Severity::Error, message);
        }
        let turn_deg = (factory.inverse() * left_from_right)
            .angle_rad()
            .to_degrees();
        if turn_deg > STEREO_TURN_DEG {
            let message = format!(
                "the lenses of {camera} are rotated by {turn_deg:.2} deg against {source}, expected at most {STEREO_TURN_DEG}"
            );
            self.add(line, Severity::Warning, message);
        }
    }

    /// Whether the facts are of this camera.
    fn serial(&mut self, camera: &str, facts: Option<&CameraFacts>) {
        let Some(CameraFacts { source, serial, .. }) = facts else {
            return;
        };
        let at = self
            .rig()
            .camera_infos()
            .iter()
            .position(|info| info.name == camera);
        let line = at
            .and_then(|at| self.parsed.camera_lines.get(at))
            .copied()
            .unwrap_or(0);
        let (severity, message) = match (self.rig().serial(camera), serial) {
            (Some(serial), Some(known)) if same_serial(serial, known) => return,
            (Some(serial), Some(known)) => (
                Severity::Error,
                format!(
                    "the serial of {camera} is {serial}, {source} is for {known}: another camera's file?"
                ),
            ),
            (None, Some(_)) => (
                Severity::Note,
                format!(
                    "serial of {camera} not checked: it has none here, so whose file {source} is is not known"
                ),
            ),
            (_, None) => (
                Severity::Note,
                format!("serial of {camera} not checked: {source} tells none"),
            ),
        };
        self.add(line, severity, message);
    }

    /// `left_X` is to the left of `right_X`; otherwise an error. Where the axes are those of a
    /// camera, which may be mounted on its side, it is a warning.
    fn sides(&mut self, cameras: &[String], is_worn: bool) {
        for camera in cameras {
            let Some(rest) = camera.strip_prefix("left_") else {
                continue;
            };
            let other = format!("right_{rest}");
            let centre = |name: &str| {
                let (left, line) = self.placed(name, FramePart::Left)?;
                let right = self
                    .placed(name, FramePart::Right)
                    .map_or(left, |(right, _)| right);
                let y = 0.5 * (left.translation_m()[1] + right.translation_m()[1]);
                Some((y, line))
            };
            if let (Some((left_y, line)), Some((right_y, _))) = (centre(camera), centre(&other))
                && left_y <= right_y
            {
                let message = format!(
                    "{camera} and {other} are swapped: they are at y = {:.1} mm and {:.1} mm, and y is to the left",
                    1e3 * left_y,
                    1e3 * right_y
                );
                let severity = match is_worn {
                    true => Severity::Error,
                    false => Severity::Warning,
                };
                self.add(line, severity, message);
            }
        }
    }

    /// The feet camera has the shoes in its image.
    fn feet(&mut self, cameras: &[String], facts: &Facts) {
        if !cameras.iter().any(|camera| camera == FEET_CAMERA) {
            let message = format!(
                "there is no camera called {FEET_CAMERA}, so nothing was checked to see the shoes"
            );
            self.add(0, Severity::Note, message);
            return;
        }
        let Some((rig_from_left, line)) = self.placed(FEET_CAMERA, FramePart::Left) else {
            return;
        };
        let Some((source, view)) = view(self.rig(), FEET_CAMERA, facts) else {
            let message = format!(
                "the field of view of {FEET_CAMERA} is not known (no calibration given, no model in the file), so whether it has the shoes was not checked"
            );
            self.add(line, Severity::Note, message);
            return;
        };
        let left_from_rig = rig_from_left.inverse();
        let mut missed = Vec::new();
        for (x, fore) in [(SHOES_X_M[1], "toe"), (SHOES_X_M[0], "heel")] {
            for (y, side) in [(SHOES_Y_M[1], "left"), (SHOES_Y_M[0], "right")] {
                let corner = left_from_rig.apply([x, y, -GROUND_BELOW_RIG_M]);
                match view.beyond(corner) {
                    Some(beyond) if beyond <= 0.0 => {}
                    Some(beyond) => {
                        missed.push(format!("{side} {fore} by {:.1} deg", beyond.to_degrees()))
                    }
                    None => missed.push(format!("{side} {fore}, which is behind it")),
                }
            }
        }
        let severity = match missed.len() {
            0 => return,
            4 => Severity::Error,
            _ => Severity::Warning,
        };
        let [h, v] = view.degrees();
        let message = format!(
            "the field of view of {FEET_CAMERA} misses the feet: {} (shoes of a standing wearer at x {} to {} m, \
             y {} to {} m, {} m below the datum; view {h:.0} x {v:.0} deg of {source})",
            missed.join(", "),
            SHOES_X_M[0],
            SHOES_X_M[1],
            SHOES_Y_M[0],
            SHOES_Y_M[1],
            GROUND_BELOW_RIG_M
        );
        self.add(line, severity, message);
    }
}

impl Severity {
    /// One word.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Note => "note",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(f, "{}: {}", self.severity.as_str(), self.message),
            line => write!(
                f,
                "line {line}: {}: {}",
                self.severity.as_str(),
                self.message
            ),
        }
    }
}

#[cfg(test)]
mod tests;
