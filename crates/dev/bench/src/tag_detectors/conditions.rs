//! What the images differ in: one variable at a time, around a usual point.

use serde::Serialize;

/// Conditions of an image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Condition {
    /// Focal length times side of the tag by its distance along the optical axis, px.
    pub(super) size_px: f64,
    /// Angle between the tag's normal and the ray to its middle, degrees.
    pub(super) tilt_deg: f64,
    /// Motion during the exposure, cells of the tag.
    pub(super) motion_cells: f64,
    /// Standard deviation of a pixel, gray levels.
    pub(super) noise_levels: f64,
    pub(super) curve: Curve,
    pub(super) camera: Resolution,
}

/// From light to gray levels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Curve {
    Srgb,
    Linear,
}

/// Image of one eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) enum Resolution {
    #[serde(rename = "672x376")]
    Vga,
    #[serde(rename = "1280x720")]
    Hd,
}

/// The condition that all sweeps share: a shoe of the example rig that stands.
pub(super) const USUAL: Condition = Condition {
    size_px: 20.0,
    tilt_deg: 17.0,
    motion_cells: 0.0,
    noise_levels: 3.0,
    curve: Curve::Srgb,
    camera: Resolution::Vga,
};

/// One variable, and a condition for each of its values.
pub(super) struct Sweep {
    pub(super) variable: &'static str,
    pub(super) points: Vec<(f64, Condition)>,
}

impl Sweep {
    fn new(variable: &'static str, values: &[f64], set: impl Fn(&mut Condition, f64)) -> Self {
        let point = |value: &f64| {
            let mut condition = USUAL;
            set(&mut condition, *value);
            (*value, condition)
        };
        Self {
            variable,
            points: values.iter().map(point).collect(),
        }
    }
}

/// All sweeps; of quick ones the ends and the usual point.
pub(super) fn sweeps(quick: bool) -> Vec<Sweep> {
    let sizes: &[f64] = match quick {
        true => &[12.0, 20.0, 60.0],
        false => &[12.0, 14.0, 16.0, 20.0, 25.0, 60.0],
    };
    let tilts: &[f64] = match quick {
        true => &[17.0, 60.0],
        false => &[17.0, 40.0, 50.0, 60.0],
    };
    let motions: &[f64] = match quick {
        true => &[0.0, 2.0],
        false => &[0.0, 0.5, 1.0, 2.0, 4.0],
    };
    let noises: &[f64] = match quick {
        true => &[3.0, 12.0],
        false => &[1.0, 3.0, 12.0],
    };
    vec![
        Sweep::new("size", sizes, |own, value| own.size_px = value),
        Sweep::new("tilt", tilts, |own, value| own.tilt_deg = value),
        Sweep::new("motion", motions, |own, value| own.motion_cells = value),
        Sweep::new("noise", noises, |own, value| own.noise_levels = value),
        Sweep::new("tone_curve", &[0.45, 1.0], |own, value| {
            own.curve = if value < 1.0 {
                Curve::Srgb
            } else {
                Curve::Linear
            };
        }),
        Sweep::new("image_width", &[672.0, 1280.0], |own, value| {
            own.camera = if value < 1000.0 {
                Resolution::Vga
            } else {
                Resolution::Hd
            };
        }),
    ]
}
