//! Plain tables of placements, CSV or TOML.
//!
//! Contract: every number carries its unit in the name of its column or key, and every mistake is
//! an error with line and column. Decimals are written with a point; a comma is an error and never
//! a separator of thousands.
//!
//! A CSV table has a line of names, then a line per part. Separators are commas, semicolons or
//! tabs, as the first line has them; lines that begin with `#` are left out. Columns:
//!
//! | Columns | Meaning |
//! |---|---|
//! | `name` | the part; it may hold `/` |
//! | `parent` | the part it is placed in; optional, empty for the root |
//! | `x_m y_m z_m`, or `_mm`, or `_in` | the part's origin in the parent |
//! | `qw qx qy qz` | the rotation `parent_from_part` as a unit quaternion |
//! | `rx_deg ry_deg rz_deg`, or `_rad` | or as a rotation vector: axis times angle (OpenCV's Rodrigues) |
//! | `roll_deg pitch_deg yaw_deg`, or `_rad` | or as rotations about fixed x, then y, then z (URDF's rpy) |
//! | `r11 r12 … r33` | or as a matrix, rows first |
//!
//! A TOML table has entries `[[part]]` with `name`, `parent`, `translation_m` (or `_mm`, `_in`) and
//! one of `rotation_wxyz`, `rotation_rows`, `rotation_vector_deg`, `rotation_vector_rad`,
//! `rpy_deg`, `rpy_rad`.

use std::collections::BTreeMap;

use toml::de::{DeTable, DeValue};

use super::{Cad, Fault, Part};
use crate::cad::urdf::from_rpy;
use crate::rig::table::{Log, Table, not_toml, numbers, rows, text_of};
use crate::transform::{RigidTransform, TransformError};

/// Metres in an inch.
const INCH: f64 = 0.0254;
/// Radians in a degree.
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// A line of the table.
struct Row {
    name: String,
    parent: Option<String>,
    parent_from_part: RigidTransform,
    line: usize,
}

/// Parts of a CSV table.
///
/// # Errors
/// Everything that is wrong, with line and column.
pub(crate) fn parts_of_csv(text: &str) -> Result<Cad, Vec<Fault>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line))
        .filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
    let Some((first, header)) = lines.next() else {
        return Err(vec![Fault::at_line(1, "the table is empty")]);
    };
    let separator = ['\t', ';']
        .into_iter()
        .find(|s| header.contains(*s))
        .unwrap_or(',');
    let header = fields(header, separator).map_err(|m| vec![Fault::at_line(first, m)])?;
    let columns = Columns::of(&header, first)?;
    let (mut table, mut faults) = (Vec::new(), Vec::new());
    for (line, text) in lines {
        match fields(text, separator) {
            Err(message) => faults.push(Fault::at_line(line, message)),
            Ok(fields) if fields.len() != header.len() => {
                let (found, expected) = (fields.len(), header.len());
                let hint = if found > expected && separator == ',' {
                    " (decimal commas? write decimals with a point)"
                } else {
                    ""
                };
                let message = format!("{found} fields, the first line has {expected}{hint}");
                faults.push(Fault::at_line(line, message));
            }
            Ok(fields) => match columns.row(&header, &fields, line) {
                Ok(row) => table.push(row),
                Err(more) => faults.extend(more),
            },
        }
    }
    if table.is_empty() && faults.is_empty() {
        faults.push(Fault::at_line(first, "no part follows the line of names"));
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    placed(table)
}

/// The fields of a line, without the blanks around them. A field in double quotes may hold the
/// separator.
fn fields(line: &str, separator: char) -> Result<Vec<String>, String> {
    let mut fields = Vec::new();
    let mut rest = line;
    loop {
        let trimmed = rest.trim_start_matches(|c: char| c.is_whitespace() && c != separator);
        if let Some(quoted) = trimmed.strip_prefix('"') {
            let mut field = String::new();
            let mut chars = quoted.char_indices().peekable();
            let end = loop {
                match chars.next() {
                    None => return Err("a quote without end".to_owned()),
                    Some((_, '"')) if chars.peek().is_some_and(|(_, c)| *c == '"') => {
                        chars.next();
                        field.push('"');
                    }
                    Some((i, '"')) => break i + 1,
                    Some((_, c)) => field.push(c),
                }
            };
            fields.push(field);
            rest = quoted[end..].trim_start_matches(|c: char| c.is_whitespace() && c != separator);
            match rest.strip_prefix(separator) {
                Some(after) => rest = after,
                None if rest.is_empty() => return Ok(fields),
                None => return Err("something follows a closing quote".to_owned()),
            }
        } else {
            match rest.split_once(separator) {
                Some((field, after)) => {
                    fields.push(field.trim().to_owned());
                    rest = after;
                }
                None => {
                    fields.push(rest.trim().to_owned());
                    return Ok(fields);
                }
            }
        }
    }
}

/// Which column means what.
struct Columns {
    name: usize,
    parent: Option<usize>,
    /// Column and metres in its unit.
    translation: [(usize, f64); 3],
    rotation: Rotation,
}

enum Rotation {
    Wxyz([usize; 4]),
    /// With radians in the unit.
    Vector([usize; 3], f64),
    Rpy([usize; 3], f64),
    Rows([usize; 9]),
}

const EXPECTED_ROTATION: &str =
    "one of qw qx qy qz; rx_deg ry_deg rz_deg; roll_deg pitch_deg yaw_deg (or _rad); r11 … r33";

impl Columns {
    fn of(header: &[String], line: usize) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let mut used = vec![false; header.len()];
        for (i, name) in header.iter().enumerate() {
            if header[..i].contains(name) {
                faults.push(Fault::at_line(
                    line,
                    format!("column {name:?} is there twice"),
                ));
            }
        }
        let mut find = |name: &str| {
            let at = header.iter().position(|n| n == name)?;
            used[at] = true;
            Some(at)
        };
        let name = find("name");
        if name.is_none() {
            faults.push(Fault::at_line(line, "no column name"));
        }
        let parent = find("parent");
        let mut translation = [(0, 0.0); 3];
        for (axis, slot) in ["x", "y", "z"].into_iter().zip(&mut translation) {
            let units = [("m", 1.0), ("mm", 1e-3), ("in", INCH)];
            let found: Vec<(usize, f64)> = units
                .iter()
                .filter_map(|(unit, metres)| Some((find(&format!("{axis}_{unit}"))?, *metres)))
                .collect();
            match found.as_slice() {
                [one] => *slot = *one,
                [] if header.iter().any(|n| n == axis) => faults.push(Fault::at_line(
                    line,
                    format!(
                        "column {axis:?} has no unit, expected {axis}_m, {axis}_mm or {axis}_in"
                    ),
                )),
                [] => faults.push(Fault::at_line(
                    line,
                    format!("no column {axis}_m, {axis}_mm or {axis}_in"),
                )),
                _ => faults.push(Fault::at_line(
                    line,
                    format!("{axis} is there in several units"),
                )),
            }
        }
        let mut rotations = Vec::new();
        if let [Some(w), Some(x), Some(y), Some(z)] = ["qw", "qx", "qy", "qz"].map(&mut find) {
            rotations.push(Rotation::Wxyz([w, x, y, z]));
        }
        for (unit, radians) in [("deg", DEGREE), ("rad", 1.0)] {
            let mut three = |names: [&str; 3]| match names.map(|n| find(&format!("{n}_{unit}"))) {
                [Some(x), Some(y), Some(z)] => Some([x, y, z]),
                _ => None,
            };
            let vector = three(["rx", "ry", "rz"]).map(|at| Rotation::Vector(at, radians));
            let rpy = three(["roll", "pitch", "yaw"]).map(|at| Rotation::Rpy(at, radians));
            rotations.extend(vector.into_iter().chain(rpy));
        }
        let mut matrix = Vec::new();
        for row in 1..=3 {
            matrix.extend((1..=3).filter_map(|column| find(&format!("r{row}{column}"))));
        }
        if let Ok(matrix) = matrix.try_into() {
            rotations.push(Rotation::Rows(matrix));
        }
        if rotations.len() != 1 {
            let found = rotations.len();
            let message =
                format!("{found} rotations among the columns, expected {EXPECTED_ROTATION}");
            faults.push(Fault::at_line(line, message));
        }
        for (name, used) in header.iter().zip(&used) {
            if !used && !["x", "y", "z"].contains(&name.as_str()) {
                faults.push(Fault::at_line(line, format!("unknown column {name:?}")));
            }
        }
        match (name, rotations.pop()) {
            (Some(name), Some(rotation)) if faults.is_empty() => Ok(Self {
                name,
                parent,
                translation,
                rotation,
            }),
            _ => Err(faults),
        }
    }

    fn row(&self, header: &[String], fields: &[String], line: usize) -> Result<Row, Vec<Fault>> {
        let mut faults = Vec::new();
        let mut number = |at: usize| {
            let text = &fields[at];
            match text.parse::<f64>() {
                Ok(number) if number.is_finite() => number,
                _ => {
                    let hint = if text.contains(',') {
                        "; decimals are written with a point"
                    } else {
                        ""
                    };
                    let message = format!("{text:?} is not a finite number{hint}");
                    faults.push(Fault::new(
                        format!("line {line}, column {}", header[at]),
                        message,
                    ));
                    f64::NAN
                }
            }
        };
        let translation = self.translation.map(|(at, metres)| number(at) * metres);
        let transform = match &self.rotation {
            Rotation::Wxyz(at) => RigidTransform::from_wxyz(at.map(&mut number), translation),
            Rotation::Vector(at, radians) => {
                let vector = at.map(|at| number(at) * radians);
                RigidTransform::from_rotation_vector(vector, translation)
            }
            Rotation::Rpy(at, radians) => from_rpy(at.map(|at| number(at) * radians), translation),
            Rotation::Rows(at) => {
                RigidTransform::from_rotation_rows(at.map(&mut number), translation)
            }
        };
        if !faults.is_empty() {
            return Err(faults);
        }
        let at_line = |message: String| vec![Fault::at_line(line, message)];
        let parent_from_part = transform.map_err(|error| at_line(error.to_string()))?;
        let name = fields[self.name].clone();
        if name.is_empty() {
            return Err(vec![Fault::new(
                format!("line {line}, column name"),
                "is empty",
            )]);
        }
        let parent = self
            .parent
            .map(|at| fields[at].clone())
            .filter(|p| !p.is_empty());
        Ok(Row {
            name,
            parent,
            parent_from_part,
            line,
        })
    }
}

/// Parts of a TOML table.
///
/// # Errors
/// Everything that is wrong, with line and key.
pub(crate) fn parts_of_toml(text: &str) -> Result<Cad, Vec<Fault>> {
    let document = DeTable::parse(text).map_err(|error| {
        let problem = not_toml(text, &error);
        vec![Fault::at_line(problem.line, problem.message)]
    })?;
    let mut log = Log {
        text,
        problems: Vec::new(),
    };
    let root = Table {
        table: document.get_ref(),
        at: 0..0,
        name: "the table",
    };
    root.refuse_unknown(&["part"], &mut log);
    let mut table = Vec::new();
    for part in root.entries("part", "[[part]]", "entries [[part]]", &mut log) {
        let known: Vec<&str> = ["name", "parent"]
            .into_iter()
            .chain(PLACEMENT_KEYS)
            .collect();
        part.refuse_unknown(&known, &mut log);
        let name = part.get("name", &mut log, text_of, "a text that is not empty");
        let parent = match part.table.contains_key("parent") {
            true => part.get("parent", &mut log, text_of, "a text that is not empty"),
            false => None,
        };
        if let (Some((_, name)), Some(parent_from_part)) = (name, placement(&part, &mut log)) {
            table.push(Row {
                name,
                parent: parent.map(|(_, parent)| parent),
                parent_from_part,
                line: log.line(&part.at),
            });
        }
    }
    if !log.problems.is_empty() {
        log.problems.sort_by_key(|problem| problem.line);
        let fault = |p: crate::rig::Problem| Fault::at_line(p.line, p.message);
        return Err(log.problems.into_iter().map(fault).collect());
    }
    placed(table)
}

/// Keys of a placement in TOML.
pub(crate) const PLACEMENT_KEYS: [&str; 9] = [
    "translation_m",
    "translation_mm",
    "translation_in",
    "rotation_wxyz",
    "rotation_rows",
    "rotation_vector_deg",
    "rotation_vector_rad",
    "rpy_deg",
    "rpy_rad",
];

/// A translation and a rotation, each in one of its forms.
pub(crate) fn placement(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<RigidTransform> {
    let present = |keys: &[&'static str]| -> Vec<&'static str> {
        let has = |key: &&'static str| table.table.contains_key(*key);
        keys.iter().copied().filter(has).collect()
    };
    let mut one = |keys: &[&'static str]| match present(keys).as_slice() {
        [key] => Some(*key),
        found => {
            let message = format!(
                "{} of {} in {}, expected exactly one",
                if found.is_empty() {
                    "none".to_owned()
                } else {
                    found.join(" and ")
                },
                keys.join(", "),
                table.name
            );
            log.add(table.at.clone(), message);
            None
        }
    };
    let (length, rotation) = (one(&PLACEMENT_KEYS[..3]), one(&PLACEMENT_KEYS[3..]));
    let (length, rotation) = (length?, rotation?);
    let metres = match length {
        "translation_mm" => 1e-3,
        "translation_in" => INCH,
        _ => 1.0,
    };
    let three = "three finite numbers";
    let translation = table.get_list(length, log, numbers::<3>, three, 3);
    let translation = translation.map(|(_, t)| t.map(|v| v * metres));
    let t = translation.unwrap_or([0.0; 3]);
    let radians = if rotation.ends_with("_deg") {
        DEGREE
    } else {
        1.0
    };
    type ReadResult = Result<RigidTransform, TransformError>;
    let read = |value: &DeValue<'_>| -> Option<ReadResult> {
        let angles = || numbers::<3>(value).map(|v| v.map(|v| v * radians));
        Some(match rotation {
            "rotation_wxyz" => RigidTransform::from_wxyz(numbers::<4>(value)?, t),
            "rotation_rows" => RigidTransform::from_rotation_rows(rows(value)?, t),
            "rpy_deg" | "rpy_rad" => from_rpy(angles()?, t),
            _ => RigidTransform::from_rotation_vector(angles()?, t),
        })
    };
    let (expected, count) = match rotation {
        "rotation_wxyz" => ("four finite numbers, w first", 4),
        "rotation_rows" => ("three rows of three finite numbers", 3),
        _ => (three, 3),
    };
    let (at, found) = table.get_list(rotation, log, read, expected, count)?;
    let found = found.map_err(|error| log.add(at, error.to_string())).ok()?;
    translation.map(|_| found)
}

/// Puts rows together along their parents.
fn placed(table: Vec<Row>) -> Result<Cad, Vec<Fault>> {
    let mut faults = Vec::new();
    let mut by_name: BTreeMap<&str, &Row> = BTreeMap::new();
    for row in &table {
        if let Some(first) = by_name.insert(&row.name, row) {
            let message = format!(
                "part {:?} is there already, on line {}",
                row.name, first.line
            );
            faults.push(Fault::at_line(row.line, message));
        }
    }
    let mut parts = Vec::new();
    for row in &table {
        let mut root_from_part = row.parent_from_part;
        let mut path = row.name.clone();
        let (mut here, mut steps) = (row, 0);
        while let Some(parent) = &here.parent {
            let Some(next) = by_name.get(parent.as_str()) else {
                // Named where it is used first, not again for every part below.
                if steps == 0 {
                    let message = format!("parent {parent:?} is not in the table");
                    faults.push(Fault::at_line(row.line, message));
                }
                break;
            };
            steps += 1;
            if steps > table.len() {
                let message = format!("part {:?} is its own parent", row.name);
                faults.push(Fault::at_line(row.line, message));
                break;
            }
            root_from_part = next.parent_from_part * root_from_part;
            path = format!("{}/{path}", next.name);
            here = next;
        }
        parts.push(Part {
            name: row.name.clone(),
            path,
            root_from_part,
            place: format!("line {}", row.line),
        });
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    Ok(Cad {
        parts,
        notes: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cad::{Format, read_bytes};

    #[test]
    fn all_forms_of_a_rotation_agree() {
        // A rotation of 120° about (1, 1, 1): x to y, y to z, z to x.
        let third = "69.28203230275508";
        let tables = [
            "name,x_mm,y_mm,z_mm,qw,qx,qy,qz\na,20,140,100,0.5,0.5,0.5,0.5\n".to_owned(),
            format!("name;x_m;y_m;z_m;rx_deg;ry_deg;rz_deg\n\"a\"; 0.02;0.14;0.1;{third};{third};{third}\n"),
            "# datum plate\nname\tx_mm\ty_mm\tz_m\troll_deg\tpitch_deg\tyaw_deg\na\t20\t140\t0.1\t90\t0\t90\n".to_owned(),
            "x_mm,y_mm,z_mm,r11,r12,r13,r21,r22,r23,r31,r32,r33,name\n20,140,100,0,0,1,1,0,0,0,1,0,a\n".to_owned(),
        ];
        let expected = RigidTransform::from_wxyz([0.5; 4], [0.02, 0.14, 0.1]).unwrap();
        for text in &tables {
            let cad = parts_of_csv(text).unwrap();
            let off = cad.parts[0].root_from_part.inverse() * expected;
            assert!(
                off.angle_rad() < 1e-15 && off.distance_m() < 1e-15,
                "{text}: {cad:?}"
            );
        }
        let forms = [
            "translation_mm = [20, 140, 100]\nrotation_wxyz = [0.5, 0.5, 0.5, 0.5]".to_owned(),
            format!("translation_m = [0.02, 0.14, 0.1]\nrotation_vector_deg = [{third}, {third}, {third}]"),
            "translation_m = [0.02, 0.14, 0.1]\nrpy_rad = [1.5707963267948966, 0, 1.5707963267948966]".to_owned(),
            "translation_m = [0.02, 0.14, 0.1]\nrotation_rows = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]".to_owned(),
        ];
        for form in &forms {
            let cad = parts_of_toml(&format!("[[part]]\nname = \"a\"\n{form}\n")).unwrap();
            let off = cad.parts[0].root_from_part.inverse() * expected;
            assert!(
                off.angle_rad() < 1e-15 && off.distance_m() < 1e-15,
                "{form}: {cad:?}"
            );
        }
    }

    #[test]
    fn parents_are_followed() {
        let text = "name,parent,x_in,y_mm,z_mm,rx_rad,ry_rad,rz_rad\nlens,mount,0,10,0,0,0,0\n\
                    mount,,1,0,0,0,0,1.5707963267948966\n";
        let cad = parts_of_csv(text).unwrap();
        let lens = cad.find("mount/lens").unwrap();
        let found = lens.root_from_part.translation_m();
        assert!(
            (found[0] - 0.0154).abs() < 1e-15 && found[1].abs() < 1e-15,
            "{found:?}"
        );
    }

    #[test]
    fn mistakes_name_line_and_column() {
        let check = |text: &str, expected: &[&str]| {
            let error = read_bytes(text.as_bytes(), Format::Csv)
                .unwrap_err()
                .to_string();
            for expected in expected {
                assert!(
                    error.contains(expected),
                    "{text}: no {expected:?} in {error}"
                );
            }
        };
        const HEAD: &str = "name;x_mm;y_mm;z_mm;rx_deg;ry_deg;rz_deg\n";
        check(
            &format!("{HEAD}a;1,5;0;0;0;0;0\nb;0;0;nan;0;0;x\n"),
            &[
                "line 2, column x_mm: \"1,5\" is not a finite number; decimals are written with a point",
                "line 3, column z_mm: \"nan\" is not a finite number",
                "line 3, column rz_deg: \"x\"",
            ],
        );
        check(
            "name,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\na,1,5,0,0,0,0,0\n",
            &["line 2: 8 fields, the first line has 7 (decimal commas?"],
        );
        check(
            "name,x,y_mm,z_mm,angle\na,1,1,1,1\n",
            &[
                "column \"x\" has no unit",
                "unknown column \"angle\"",
                "0 rotations",
            ],
        );
        check(
            "name,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\na,20,140,100,0,0,0\n",
            &[
                "line 2: part \"a\" is 173.2 m from the root",
                "another unit",
            ],
        );
        check(
            "name,x_m,y_m,z_m,qw,qx,qy,qz\na,0,0,0,0.9,0,0,0\na,0,0,0,1,0,0,0\n",
            &["line 2: the quaternion's norm is 0.9"],
        );
        check(
            "name,x_m,y_m,z_m,qw,qx,qy,qz\na,0,0,0,1,0,0,0\na,0,0,0,1,0,0,0\n",
            &["line 3: part \"a\" is there already, on line 2"],
        );
        check(
            "name,parent,x_m,y_m,z_m,qw,qx,qy,qz\na,b,0,0,0,1,0,0,0\nb,a,0,0,0,1,0,0,0\nc,d,0,0,0,1,0,0,0\n",
            &[
                "part \"a\" is its own parent",
                "line 4: parent \"d\" is not in the table",
            ],
        );
        check("", &["the table is empty"]);
        check(HEAD, &["no part follows"]);
        let toml = "[[part]]\nname = \"a\"\ntranslation_m = [0, 0]\nrotation_wxyz = [1, 0, 0, 0]\nrpy_deg = [0, 0, 0]\n";
        let error = read_bytes(toml.as_bytes(), Format::Toml)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("line 1: rotation_wxyz and rpy_deg of rotation_wxyz"),
            "{error}"
        );
        let toml = "[[part]]\nname = \"a\"\ntranslation_m = [1,5, 0, 0]\nrpy_deg = [0, 0, 0]\n";
        let error = read_bytes(toml.as_bytes(), Format::Toml)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("line 3: translation_m in [[part]] is not three finite numbers"),
            "{error}"
        );
    }
}
