//! The wearer's shoes: AprilTags on them, and the outlines of their soles.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use toml::de::DeValue;

use super::file::transform;
use super::table::{Log, Table, integer, numbers, positive, text_of};
use super::tolerance::{self, Units, in_units};
use crate::covariance::Covariance;
use crate::transform::RigidTransform;

const SIZE_SIGMA: Units = [("sigma_size_m", 1.0), ("sigma_size_mm", 1e-3)];

/// Minimum and maximum distance of a vertex from the middle of the sole, m.
const VERTEX_RANGE_M: std::ops::RangeInclusive<f64> = 0.01..=0.3;
const VERTEX_SIGMA: Units = [("sigma_m", 1.0), ("sigma_mm", 1e-3)];

/// An AprilTag on a shoe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShoeTag {
    /// What it is drawn from.
    pub family: TagFamily,
    /// Number in the family.
    pub id: u32,
    /// The shoe it is on.
    pub foot: Foot,
    /// Side of the black square, m.
    pub size_m: f64,
    /// Takes coordinates in the tag's frame to the foot's; see [`super`].
    pub foot_from_tag: RigidTransform,
    /// Standard deviation of the size, m.
    pub size_sigma_m: Option<f64>,
    /// Covariance of the placement: of a small motion of the tag in its own axes. `None` where the
    /// file says nothing, which is not the same as exact.
    pub covariance: Option<Covariance>,
}

/// A family of AprilTags.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TagFamily {
    /// 36 bits, 11 of which differ between any two tags.
    #[serde(rename = "36h11")]
    Tag36h11,
}

/// A foot of the wearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Foot {
    /// The wearer's left.
    #[serde(rename = "left_foot")]
    Left,
    /// The wearer's right.
    #[serde(rename = "right_foot")]
    Right,
}

impl TagFamily {
    /// All families.
    pub const ALL: [Self; 1] = [Self::Tag36h11];

    /// As written in the file.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Tag36h11 => "36h11",
        }
    }

    /// How many tags it has.
    pub fn count(self) -> u32 {
        match self {
            Self::Tag36h11 => 587,
        }
    }
}

impl Foot {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Left, Self::Right];

    /// Name of its frame, as written in the file.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Left => "left_foot",
            Self::Right => "right_foot",
        }
    }
}

/// All entries that could be read.
pub(super) fn shoe_tags(root: &Table<'_, '_>, log: &mut Log<'_>) -> Vec<ShoeTag> {
    let mut tags: Vec<(Range<usize>, ShoeTag)> = Vec::new();
    for table in root.optional_entries("shoe_tag", "[[shoe_tag]]", "entries [[shoe_tag]]", log) {
        let Some(tag) = shoe_tag(&table, log) else {
            continue;
        };
        let same = |(_, other): &&(_, ShoeTag)| (other.family, other.id) == (tag.family, tag.id);
        if let Some((first_at, _)) = tags.iter().find(same) {
            let line = log.line(first_at);
            let message = format!("tag {} is on a shoe already, on line {line}", tag.id);
            log.add(table.at, message);
            continue;
        }
        tags.push((table.at, tag));
    }
    tags.into_iter().map(|(_, tag)| tag).collect()
}

fn shoe_tag(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<ShoeTag> {
    table.refuse_unknown(
        &[
            "family",
            "id",
            "foot",
            "size_m",
            "rotation_wxyz",
            "rotation_rows",
            "translation_m",
            "sigma_size_m",
            "sigma_size_mm",
            "sigma_translation_m",
            "sigma_translation_mm",
            "sigma_rotation_rad",
            "sigma_rotation_deg",
            "covariance",
        ],
        log,
    );
    let family = one_of(
        table,
        "family",
        &TagFamily::ALL.map(|f| (f.as_str(), f)),
        log,
    );
    let foot = one_of(table, "foot", &Foot::ALL.map(|f| (f.as_str(), f)), log);
    let size_m = table.get("size_m", log, positive, "a number above 0");
    let foot_from_tag = transform(table, log);
    let covariance = tolerance::covariance(table, log);
    let size_sigma_m = sigma(table, &SIZE_SIGMA, log);
    let id = table.get("id", log, integer, "an integer");
    let (family, (at, id)) = (family?, id?);
    let last = family.count() - 1;
    let Some(id) = u32::try_from(id).ok().filter(|id| *id <= last) else {
        let family = family.as_str();
        log.add(at, format!("id is {id}, family {family} has 0 to {last}"));
        return None;
    };
    Some(ShoeTag {
        family,
        id,
        foot: foot?,
        size_m: size_m?.1,
        foot_from_tag: foot_from_tag?,
        size_sigma_m,
        covariance,
    })
}

/// A tolerance in one of two units, where there is one.
fn sigma(table: &Table<'_, '_>, units: &Units, log: &mut Log<'_>) -> Option<f64> {
    let is_stated = units.iter().any(|(key, _)| table.table.contains_key(*key));
    let read = |log| in_units(table, units, log, positive, "a number above 0", None);
    is_stated
        .then(|| read(log))
        .flatten()
        .map(|(_, sigma)| sigma)
}

/// The value whose name stands under `key`.
fn one_of<T: Copy>(
    table: &Table<'_, '_>,
    key: &'static str,
    known: &[(&'static str, T)],
    log: &mut Log<'_>,
) -> Option<T> {
    let (at, found) = table.get(key, log, text_of, "a text that is not empty")?;
    if let Some((_, value)) = known.iter().find(|(name, _)| *name == found) {
        return Some(*value);
    }
    let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
    let names = names.join(", ");
    log.add(at, format!("{key} is {found:?}, expected one of {names}"));
    None
}

/// The sole of a shoe.
#[derive(Clone, Debug, PartialEq)]
pub struct Sole {
    /// Which shoe.
    pub foot: Foot,
    /// Vertices of a polygon around the middle of the sole, counter-clockwise seen from above: x to
    /// the toe and y to the left in the foot's frame, m.
    pub outline_m: Vec<[f64; 2]>,
    /// Standard deviation of a vertex along both axes, m.
    pub sigma_m: Option<f64>,
}

/// All entries that could be read.
pub(super) fn soles(root: &Table<'_, '_>, log: &mut Log<'_>) -> Vec<Sole> {
    let mut soles: Vec<(Range<usize>, Sole)> = Vec::new();
    for table in root.optional_entries("sole", "[[sole]]", "entries [[sole]]", log) {
        let Some(sole) = sole(&table, log) else {
            continue;
        };
        if let Some((first_at, _)) = soles.iter().find(|(_, other)| other.foot == sole.foot) {
            let (foot, line) = (sole.foot.as_str(), log.line(first_at));
            log.add(
                table.at,
                format!("{foot} has a sole already, on line {line}"),
            );
            continue;
        }
        soles.push((table.at, sole));
    }
    soles.into_iter().map(|(_, sole)| sole).collect()
}

fn sole(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Sole> {
    table.refuse_unknown(&["foot", "outline_m", "sigma_m", "sigma_mm"], log);
    let foot = one_of(table, "foot", &Foot::ALL.map(|f| (f.as_str(), f)), log);
    let expected = "three or more pairs of numbers";
    let outline = table.get("outline_m", log, outline, expected);
    let sigma_m = sigma(table, &VERTEX_SIGMA, log);
    let (foot, (at, outline_m)) = (foot?, outline?);
    if let Some(message) = objection(&outline_m) {
        log.add(at, message);
        return None;
    }
    Some(Sole {
        foot,
        outline_m,
        sigma_m,
    })
}

fn outline(value: &DeValue<'_>) -> Option<Vec<[f64; 2]>> {
    let pairs = value.as_array()?.iter();
    let outline: Option<Vec<[f64; 2]>> = pairs.map(|pair| numbers::<2>(pair.get_ref())).collect();
    outline.filter(|outline| outline.len() >= 3)
}

/// Why the vertices are not an outline around the middle of a sole.
fn objection(outline_m: &[[f64; 2]]) -> Option<String> {
    let mut turned = 0.0;
    for (k, a) in outline_m.iter().enumerate() {
        let b = outline_m[(k + 1) % outline_m.len()];
        let distance = a[0].hypot(a[1]);
        if !VERTEX_RANGE_M.contains(&distance) {
            return Some(format!(
                "vertex {k} of outline_m in [[sole]] is {distance} m from the middle of the sole, \
                 expected {} to {}",
                VERTEX_RANGE_M.start(),
                VERTEX_RANGE_M.end()
            ));
        }
        let (cross, dot) = (a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]);
        if cross <= 0.0 {
            return Some(format!(
                "outline_m in [[sole]] does not go counter-clockwise around the middle of the sole \
                 after vertex {k}, expected x to the toe, y to the left, and every vertex to be seen \
                 from the middle"
            ));
        }
        turned += cross.atan2(dot);
    }
    let once = 2.0 * std::f64::consts::PI;
    ((turned - once).abs() > 1e-6).then(|| {
        "outline_m in [[sole]] goes around the middle of the sole more than once".to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::objection;

    #[test]
    fn outlines_go_once_around_the_middle() {
        let sole = [
            [0.15, 0.0],
            [0.1, 0.045],
            [-0.13, 0.04],
            [-0.13, -0.04],
            [0.1, -0.045],
        ];
        assert_eq!(objection(&sole), None);
        let mut clockwise = sole;
        clockwise.reverse();
        assert!(objection(&clockwise).unwrap().contains("counter-clockwise"));
        let beside = sole.map(|[x, y]| [x, y + 0.1]);
        assert!(objection(&beside).unwrap().contains("counter-clockwise"));
        let twice = [sole, sole].concat();
        assert!(objection(&twice).unwrap().contains("more than once"));
        let inches = sole.map(|at| at.map(|v| v / 0.0254));
        assert!(objection(&inches).unwrap().contains("vertex 0"));
    }
}
