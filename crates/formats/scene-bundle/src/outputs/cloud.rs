//! Output `cloud`: `cloud.ply`, points of the world, binary PLY 1.0 (Turk 1994).
//!
//! Contract: the properties of a vertex are x y z (f32, metres, world), red green blue (u8) and
//! sigma (f32, metres, one standard deviation along the direction it is largest in; NaN where not
//! known), little-endian, in this order, 19 bytes. Only this layout is read.

use std::io::Write;

use super::refused;
use crate::draft::Draft;
use crate::error::{BundleError, doing};
use crate::scene::OutputReader;

const FILE: &str = "cloud.ply";
const BYTES: usize = 19;
const PROPERTIES: &str = "property float x\nproperty float y\nproperty float z\nproperty uchar red\n\
                          property uchar green\nproperty uchar blue\nproperty float sigma\nend_header\n";

/// A point of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// Position in the world, metres.
    pub x_in_world: [f32; 3],
    /// Red, green, blue.
    pub color: [u8; 3],
    /// One standard deviation, metres; NaN where not known.
    pub sigma_m: f32,
}

fn start(count: usize) -> String {
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres, world with z up\nelement vertex {count}\n{PROPERTIES}"
    )
}

/// Writes points in their order.
///
/// # Errors
/// [`BundleError::Refused`] for a position that is not finite, [`BundleError::Io`].
///
/// ```
/// use scene_bundle::outputs::{self, cloud};
/// # use scene_bundle::Bundle;
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
///
/// let point = cloud::CloudPoint {
///     x_in_world: [1.5, -2.0, 0.25],
///     color: [200, 180, 160],
///     sigma_m: 0.004,
/// };
/// let draft = bundle.begin(outputs::CLOUD)?;
/// cloud::write(&draft, &[point, point])?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::CLOUD)?;
/// assert_eq!(cloud::read(&reader)?[1].x_in_world, [1.5, -2.0, 0.25]);
/// assert!(cloud::read_file(&reader)?.starts_with(b"ply\nformat binary_little_endian 1.0\n"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(draft: &Draft, points: &[CloudPoint]) -> Result<(), BundleError> {
    let off = |p: &CloudPoint| p.x_in_world.iter().any(|v| !v.is_finite());
    if let Some(number) = points.iter().position(off) {
        let found = format!("point {number} at {:?}", points[number].x_in_world);
        return Err(refused(draft, FILE, found, "finite numbers"));
    }
    let mut file = draft.create(FILE)?;
    let mut put = |bytes: &[u8]| {
        let place = draft.file_path(FILE);
        file.write_all(bytes)
            .map_err(doing("writing a cloud of points", place))
    };
    put(start(points.len()).as_bytes())?;
    for point in points {
        put(&vertex(point))?;
    }
    file.finish()
}

fn vertex(point: &CloudPoint) -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    for (place, value) in bytes.chunks_exact_mut(4).zip(point.x_in_world) {
        place.copy_from_slice(&value.to_le_bytes());
    }
    bytes[12..15].copy_from_slice(&point.color);
    bytes[15..].copy_from_slice(&point.sigma_m.to_le_bytes());
    bytes
}

/// Reads all points.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Vec<CloudPoint>, BundleError> {
    let bytes = reader.read(FILE)?;
    let wrong = |place: &str, found: String, expected: String| BundleError::Malformed {
        path: reader.file_path(FILE),
        place: place.to_owned(),
        found,
        expected,
    };
    let end = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .map_or(0, |at| at + 11);
    let (head, data) = bytes.split_at(end);
    let head = String::from_utf8_lossy(head);
    let count = head
        .lines()
        .find_map(|line| line.strip_prefix("element vertex "))
        .and_then(|count| count.parse::<usize>().ok())
        .filter(|count| head == start(*count))
        .ok_or_else(|| {
            wrong(
                "header",
                format!("{head:?}"),
                "the header of a cloud.ply".to_owned(),
            )
        })?;
    if count.checked_mul(BYTES) != Some(data.len()) {
        let found = format!("{} bytes of points", data.len());
        return Err(wrong("points", found, format!("{count} of {BYTES} bytes")));
    }
    let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let points = data.chunks_exact(BYTES).map(|bytes| CloudPoint {
        x_in_world: [number(bytes), number(&bytes[4..]), number(&bytes[8..])],
        color: [bytes[12], bytes[13], bytes[14]],
        sigma_m: number(&bytes[15..]),
    });
    Ok(points.collect())
}

/// The file as stored, checked against its hash: any program that reads PLY can use it.
///
/// # Errors
/// As [`OutputReader::read`].
pub fn read_file(reader: &OutputReader) -> Result<Vec<u8>, BundleError> {
    reader.read(FILE)
}
