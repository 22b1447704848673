//! Cameras as mounted devices: the poses of the lenses relative to the mounting datum.
//!
//! Contract: the numbers are data (`devices/zed.toml`) with their source, and a map file may
//! override each of them. The datum is the maker's mounting point with the axes of the housing: x
//! forward, y left, z up. The optical axes are taken along the housing's x. No source states the
//! error of that, so the sigmas are nominal.
//!
//! A sigma is that of the lens pose relative to the datum over all cameras of the model; within one
//! camera the pose is fixed. The factory file of one ZED Mini has its two lenses rotated against
//! each other by 0.05, 0.40 and 0.03 degrees about x, y and z; if both are mounted alike, that is
//! some 0.3 degrees each for the worst axis, and the nominal 0.5 leaves room for the housing.

use toml::de::{DeTable, DeValue};

use crate::covariance::Covariance;
use crate::rig::table::{Log, Table, not_toml, numbers, positive, text_of};
use crate::rig::{Problem, tolerance};
use crate::transform::RigidTransform;

/// The devices that are known.
const DEVICES: &str = include_str!("../../devices/zed.toml");

/// A model of a stereo camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Device {
    /// As map files name it: `zed_x_mini`.
    pub name: String,
    /// As people name it.
    pub title: String,
    /// From the left optical centre to the right one, m.
    pub baseline_m: f64,
    /// The left optical centre in the datum, m.
    pub datum_from_left_m: [f64; 3],
    /// Where these numbers are from.
    pub source: String,
    /// Of the left optical frame in the datum; see [`crate::covariance`].
    pub covariance: Covariance,
    /// Of the baseline, m.
    pub sigma_baseline_m: f64,
    /// Horizontal and vertical field of view, degrees.
    pub field_of_view_deg: [f64; 2],
}

/// Takes an optical frame's axes (x right, y down, z forward) to a housing's (x forward, y left, z
/// up).
pub(crate) fn housing_from_optical() -> RigidTransform {
    RigidTransform::from_wxyz([0.5, -0.5, 0.5, -0.5], [0.0; 3]).expect("a unit quaternion")
}

impl Device {
    /// The devices that are known without a map file.
    pub fn known() -> Vec<Self> {
        parse(DEVICES).expect("the devices that come with this crate are valid")
    }

    /// A known device, by its name or by its title, for example `zed_mini` or `ZED Mini`.
    pub fn find(name: &str) -> Option<Self> {
        Self::known()
            .into_iter()
            .find(|device| device.name == name || device.title.eq_ignore_ascii_case(name))
    }

    /// Takes coordinates in the left optical frame to the mounting datum's.
    pub(crate) fn datum_from_left(&self) -> RigidTransform {
        let shift = RigidTransform::from_translation_m(self.datum_from_left_m);
        shift.expect("finite numbers") * housing_from_optical()
    }

    /// Takes coordinates in the right optical frame to the left one's.
    pub fn left_from_right(&self) -> RigidTransform {
        RigidTransform::from_translation_m([self.baseline_m, 0.0, 0.0]).expect("a finite number")
    }

    /// Covariance of [`Self::left_from_right`]: the baseline as stated, the rotation as that of the
    /// whole camera.
    pub(crate) fn covariance_of_right(&self) -> Covariance {
        let whole = self.covariance.rows();
        let mut rows = [[0.0; 6]; 6];
        for (i, row) in rows.iter_mut().enumerate() {
            row[i] = match i {
                0..3 => self.sigma_baseline_m * self.sigma_baseline_m,
                _ => whole[i][i],
            };
        }
        Covariance::from_rows(rows).expect("variances, as checked on reading")
    }
}

/// Reads entries `[[device]]`.
///
/// # Errors
/// Everything that is wrong, with lines.
pub fn parse(text: &str) -> Result<Vec<Device>, Vec<Problem>> {
    let document = DeTable::parse(text).map_err(|error| vec![not_toml(text, &error)])?;
    let mut log = Log {
        text,
        problems: Vec::new(),
    };
    let root = Table {
        table: document.get_ref(),
        at: 0..0,
        name: "the file of devices",
    };
    root.refuse_unknown(&["device"], &mut log);
    let devices = devices(&root, &mut log);
    if log.problems.is_empty() {
        Ok(devices)
    } else {
        Err(log.problems)
    }
}

/// All entries `[[device]]` that could be read.
pub(super) fn devices(root: &Table<'_, '_>, log: &mut Log<'_>) -> Vec<Device> {
    let entries = root.optional_entries("device", "[[device]]", "entries [[device]]", log);
    (entries.iter())
        .filter_map(|table| device(table, log))
        .collect()
}

fn device(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Device> {
    table.refuse_unknown(
        &[
            "name",
            "title",
            "baseline_m",
            "datum_from_left_m",
            "source",
            "sigma_translation_m",
            "sigma_translation_mm",
            "sigma_rotation_rad",
            "sigma_rotation_deg",
            "covariance",
            "sigma_baseline_m",
            "field_of_view_deg",
        ],
        log,
    );
    let text = "a text that is not empty";
    let above = "a number above 0";
    // Its square has to be a variance.
    let metres = |value: &DeValue<'_>| positive(value).filter(|s| *s < 1.0 && s * s > 0.0);
    let name = table.get("name", log, text_of, text);
    let title = table.get("title", log, text_of, text);
    let source = table.get("source", log, text_of, text);
    let baseline = table.get("baseline_m", log, positive, above);
    let three = "three finite numbers";
    let offset = table.get_list("datum_from_left_m", log, numbers::<3>, three, 3);
    let below = "a number above 0 and below 1";
    let sigma_baseline = table.get("sigma_baseline_m", log, metres, below);
    let covariance = tolerance::covariance(table, log);
    if covariance.is_none() {
        let message =
            "sigma_translation_m and sigma_rotation_deg (or covariance) are needed in [[device]]";
        log.add(table.at.clone(), message.to_owned());
    }
    let angles = |value: &DeValue<'_>| {
        numbers::<2>(value).filter(|all| all.iter().all(|v| *v > 0.0 && *v < 180.0))
    };
    let expected = "two angles between 0 and 180, horizontal and vertical";
    let view = table.get_list("field_of_view_deg", log, angles, expected, 2);
    Some(Device {
        name: name?.1,
        title: title?.1,
        baseline_m: baseline?.1,
        datum_from_left_m: offset?.1,
        source: source?.1,
        covariance: covariance?,
        sigma_baseline_m: sigma_baseline?.1,
        field_of_view_deg: view?.1,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lenses_are_where_the_makers_file_has_them() {
        let mini = Device::find("zed_mini").unwrap();
        assert_eq!(Device::find("ZED X Mini").unwrap().baseline_m, 0.05);
        assert_eq!(Device::find("zed"), None);
        let datum_from_left = mini.datum_from_left();
        assert_eq!(datum_from_left.apply([0.0; 3]), [0.0, 0.0315, 0.01325]);
        // Looks forward, and right in the image is right of the housing.
        assert_eq!(datum_from_left.rotate([0.0, 0.0, 1.0]), [1.0, 0.0, 0.0]);
        assert_eq!(datum_from_left.rotate([1.0, 0.0, 0.0]), [0.0, -1.0, 0.0]);
        // The two lenses mirror each other about the middle.
        let right = (datum_from_left * mini.left_from_right()).apply([0.0; 3]);
        assert!((right[1] + 0.0315).abs() < 1e-15, "{right:?}");
    }

    #[test]
    fn mistakes_are_reported() {
        let text = DEVICES
            .replace("baseline_m = 0.063", "baseline_m = -0.063")
            .replace("85, 54", "85, 540");
        let problems = parse(&text).unwrap_err();
        let all: Vec<String> = problems.iter().map(Problem::to_string).collect();
        assert_eq!(all.len(), 2, "{all:?}");
        assert!(
            all[0].contains("baseline_m in [[device]] is not a number above 0 (found -0.063)"),
            "{all:?}"
        );
        for sigma in ["1e160", "0", "1e-170"] {
            let text = DEVICES.replacen(
                "sigma_baseline_m = 0.0005",
                &format!("sigma_baseline_m = {sigma}"),
                1,
            );
            let problems = parse(&text).unwrap_err();
            let expected = format!(
                "sigma_baseline_m in [[device]] is not a number above 0 and below 1 (found {sigma})"
            );
            assert_eq!(problems.len(), 1, "{problems:?}");
            assert!(problems[0].message == expected, "{problems:?}");
        }
        for device in Device::known() {
            assert_eq!(device.covariance_of_right().sigmas()[1], 0.0005);
        }
    }
}
