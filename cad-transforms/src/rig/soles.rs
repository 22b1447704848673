//! Outlines of the soles of the wearer's shoes.

use std::ops::Range;

use toml::de::DeValue;

use super::table::{Log, Table, list_of, numbers, positive};
use super::tags::{Foot, one_of};
use super::tolerance::{Units, in_units};

/// Minimum and maximum distance of a vertex from the middle of the sole, m.
const VERTEX_RANGE_M: std::ops::RangeInclusive<f64> = 0.01..=0.3;
const SIGMA: Units = [("sigma_m", 1.0), ("sigma_mm", 1e-3)];

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
    if !root.table.contains_key("sole") {
        return Vec::new();
    }
    let entries = root.get("sole", log, list_of, "entries [[sole]]");
    for entry in entries.map(|(_, entries)| entries).unwrap_or_default() {
        let Some(table) = entry.get_ref().as_table() else {
            let message = "sole holds something that is not a table";
            log.add(entry.span(), message.to_owned());
            continue;
        };
        let table = Table {
            table,
            at: entry.span(),
            name: "[[sole]]",
        };
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
    let has_sigma = SIGMA.iter().any(|(key, _)| table.table.contains_key(*key));
    let sigma = has_sigma.then(|| in_units(table, &SIGMA, log, positive, "a number above 0", None));
    let (foot, (at, outline_m)) = (foot?, outline?);
    if let Some(message) = objection(&outline_m) {
        log.add(at, message);
        return None;
    }
    let sigma_m = match sigma {
        None => None,
        Some(found) => Some(found?.1),
    };
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
