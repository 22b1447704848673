//! Output `masks`: `CAMERA/left.png` and `CAMERA/right.png`, 8-bit gray of the size of the recorded
//! image, 255 where a pixel may be used and 0 where it may show the wearer;
//! `CAMERA/left/000123.png`, the dynamic mask of one keyframe, 0 where the scene is dynamic (the
//! wearer or others).
//!
//! Contract: a camera side without a file has no mask; all its pixels may be used. A keyframe
//! without a file has no dynamic pixels. There are too many of those files for the manifest; the
//! listing has their hashes.

use camera_models::Eye;

use super::gray_png::{GraySamples, decode, encode8};
use super::refused;
use crate::draft::Draft;
use crate::error::BundleError;
use crate::scene::OutputReader;

/// Mask: pixels that may be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row by row from the top: 255 can be used, 0 cannot.
    pub pixels: Vec<u8>,
}

/// Path of a mask in the output's folder.
pub fn path(camera: &str, eye: Eye) -> String {
    match eye {
        Eye::Left => format!("{camera}/left.png"),
        Eye::Right => format!("{camera}/right.png"),
    }
}

/// Path of the dynamic mask of a keyframe's left image in the output's folder.
pub(crate) fn dynamic_path(camera: &str, frame: u64) -> String {
    format!("{camera}/left/{frame:06}.png")
}

/// Writes the wearer mask of one side of a camera.
///
/// # Errors
/// [`BundleError::Refused`] for values other than 0 and 255 or a wrong number of pixels,
/// [`BundleError::Io`].
///
/// ```
/// use camera_models::Eye;
/// use scene_bundle::outputs::masks::{self, Mask};
/// # use scene_bundle::{Bundle, outputs};
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
/// // The lower row shows the wearer.
/// let mask = Mask { width: 3, height: 2, pixels: vec![255, 255, 255, 0, 0, 0] };
/// let draft = bundle.begin(outputs::MASKS)?;
/// masks::write(&draft, "feet", Eye::Left, &mask)?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::MASKS)?;
/// assert_eq!(masks::read(&reader, "feet", Eye::Left)?, Some(mask));
/// // No file: every pixel may be used.
/// assert_eq!(masks::read(&reader, "feet", Eye::Right)?, None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(draft: &Draft, camera: &str, eye: Eye, mask: &Mask) -> Result<(), BundleError> {
    let path = path(camera, eye);
    let file = file(draft, &path, mask)?;
    draft.write(&path, &file)
}

/// Writes the dynamic mask of the left image of a keyframe.
///
/// # Errors
/// As [`write()`].
pub fn write_dynamic(
    draft: &Draft,
    camera: &str,
    frame: u64,
    mask: &Mask,
) -> Result<(), BundleError> {
    let path = dynamic_path(camera, frame);
    let file = file(draft, &path, mask)?;
    draft.write_listed(&path, &file)
}

fn file(draft: &Draft, path: &str, mask: &Mask) -> Result<Vec<u8>, BundleError> {
    let expected = u64::from(mask.width) * u64::from(mask.height);
    if mask.pixels.len() as u64 != expected || expected == 0 {
        let found = format!("{} pixels", mask.pixels.len());
        let expected = format!("{}x{}", mask.width, mask.height);
        return Err(refused(draft, path, found, &expected));
    }
    if let Some(other) = mask.pixels.iter().find(|p| ![0, 255].contains(*p)) {
        return Err(refused(
            draft,
            path,
            format!("a pixel of {other}"),
            "0 or 255",
        ));
    }
    Ok(encode8(mask.width, mask.height, &mask.pixels))
}

/// Reads the wearer mask of one side of a camera, if there is one.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader, camera: &str, eye: Eye) -> Result<Option<Mask>, BundleError> {
    read_at(reader, &path(camera, eye))
}

/// Reads the dynamic mask of the left image of a keyframe; `None` if it has no dynamic pixels.
///
/// # Errors
/// As [`read`].
pub fn read_dynamic(
    reader: &OutputReader,
    camera: &str,
    frame: u64,
) -> Result<Option<Mask>, BundleError> {
    read_at(reader, &dynamic_path(camera, frame))
}

fn read_at(reader: &OutputReader, path: &str) -> Result<Option<Mask>, BundleError> {
    if !reader.paths().any(|p| p == path) {
        return Ok(None);
    }
    let place = reader.file_path(path);
    match decode(&reader.read(path)?, &place)? {
        (width, height, GraySamples::Bits8(pixels)) => Ok(Some(Mask {
            width,
            height,
            pixels,
        })),
        _ => Err(BundleError::Malformed {
            path: place,
            place: "image".to_owned(),
            found: "16 bits".to_owned(),
            expected: "8".to_owned(),
        }),
    }
}
