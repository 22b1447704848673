//! What the file says of the cameras as devices.

use std::ops::Range;

use toml::de::DeValue;

use super::table::{Log, Table, integer, text_of};
use super::{CameraInfo, Edge};

/// Whether two serial numbers are of one device: they may be written with or without `SN` and
/// leading zeros, as in the names of factory files.
pub fn same_serial(a: &str, b: &str) -> bool {
    let plain = |serial: &str| {
        let serial = serial.trim();
        let digits = serial.strip_prefix("SN").unwrap_or(serial);
        digits.trim_start_matches('0').to_owned()
    };
    plain(a) == plain(b)
}

/// All entries that could be read.
pub(super) fn cameras(
    root: &Table<'_, '_>,
    edges: &[(Range<usize>, Edge)],
    log: &mut Log<'_>,
) -> Vec<(Range<usize>, CameraInfo)> {
    let mut cameras: Vec<(Range<usize>, CameraInfo)> = Vec::new();
    for table in root.optional_entries("camera", "[[camera]]", "entries [[camera]]", log) {
        table.refuse_unknown(&["name", "serial", "model"], log);
        let name = table.get("name", log, text_of, "the name of a camera");
        let has = |key: &str| table.table.contains_key(key);
        let expected = "a number or a text that is not empty";
        let serial = has("serial").then(|| table.get("serial", log, serial, expected));
        let expected = "a text that is not empty";
        let model = has("model").then(|| table.get("model", log, text_of, expected));
        let Some((at, name)) = name else { continue };
        let of_this =
            |frame: &crate::Frame| frame.camera().is_some_and(|(camera, _)| camera == name);
        if !edges
            .iter()
            .any(|(_, e)| of_this(&e.parent) || of_this(&e.child))
        {
            log.add(at, format!("camera {name} has no frame in this file"));
        } else if let Some((first_at, _)) = cameras.iter().find(|(_, c)| c.name == name) {
            let line = log.line(first_at);
            log.add(
                at,
                format!("camera {name} is described already on line {line}"),
            );
        }
        let info = CameraInfo {
            name,
            serial: serial.flatten().map(|(_, serial)| serial),
            model: model.flatten().map(|(_, model)| model),
        };
        let same = |(_, other): &&(Range<usize>, CameraInfo)| {
            let serials = other.serial.as_deref().zip(info.serial.as_deref());
            serials.is_some_and(|(a, b)| same_serial(a, b)) && other.name != info.name
        };
        if let Some((_, other)) = cameras.iter().find(same) {
            let message = format!("serial of {} is that of {} too", info.name, other.name);
            log.add(table.at.clone(), message);
        }
        cameras.push((table.at, info));
    }
    cameras
}

fn serial(value: &DeValue<'_>) -> Option<String> {
    text_of(value).or_else(|| {
        integer(value)
            .filter(|number| *number >= 0)
            .map(|number| number.to_string())
    })
}
