//! AprilTags on the wearer's shoes.

use std::ops::Range;

use super::file::transform;
use super::table::{Log, Table, integer, list_of, positive, text_of};
use crate::transform::RigidTransform;

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
}

/// A family of AprilTags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TagFamily {
    /// 36 bits, 11 of which differ between any two tags.
    Tag36h11,
}

/// A foot of the wearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Foot {
    /// The wearer's left.
    Left,
    /// The wearer's right.
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
    if !root.table.contains_key("shoe_tag") {
        return Vec::new();
    }
    let entries = root.get("shoe_tag", log, list_of, "entries [[shoe_tag]]");
    for entry in entries.map(|(_, entries)| entries).unwrap_or_default() {
        let Some(table) = entry.get_ref().as_table() else {
            let message = "shoe_tag holds something that is not a table";
            log.add(entry.span(), message.to_owned());
            continue;
        };
        let table = Table {
            table,
            at: entry.span(),
            name: "[[shoe_tag]]",
        };
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
    })
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
