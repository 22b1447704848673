//! Output `masks`: `CAMERA/left.png` and `CAMERA/right.png`, 8-bit grey of the size of the recorded picture, 255 where a
//! pixel can be used and 0 where it shows the wearer.
//!
//! Contract: a camera or eye without a file has no mask; all its pixels can be used.

use calib::Eye;

use super::picture::{Grey, decode, encode8};
use super::refused;
use crate::draft::Draft;
use crate::error::BundleError;
use crate::scene::OutputReader;

/// Which pixels can be used.
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

/// Writes the mask of one eye of a camera.
///
/// # Errors
/// [`BundleError::Refused`] for values other than 0 and 255 or a wrong number of pixels, [`BundleError::Io`].
pub fn write(draft: &Draft, camera: &str, eye: Eye, mask: &Mask) -> Result<(), BundleError> {
    let path = path(camera, eye);
    let expected = u64::from(mask.width) * u64::from(mask.height);
    if mask.pixels.len() as u64 != expected || expected == 0 {
        let found = format!("{} pixels", mask.pixels.len());
        return Err(refused(
            draft,
            &path,
            found,
            &format!("{}x{}", mask.width, mask.height),
        ));
    }
    if let Some(other) = mask.pixels.iter().find(|p| ![0, 255].contains(*p)) {
        return Err(refused(
            draft,
            &path,
            format!("a pixel of {other}"),
            "0 or 255",
        ));
    }
    draft.write(&path, &encode8(mask.width, mask.height, &mask.pixels))
}

/// Reads the mask of one eye of a camera, where there is one.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader, camera: &str, eye: Eye) -> Result<Option<Mask>, BundleError> {
    let path = path(camera, eye);
    if !reader.paths().any(|p| p == path) {
        return Ok(None);
    }
    let place = reader.place(&path);
    match decode(&reader.read(&path)?, &place)? {
        (width, height, Grey::Bits8(pixels)) => Ok(Some(Mask {
            width,
            height,
            pixels,
        })),
        _ => Err(BundleError::Malformed {
            path: place,
            place: "picture".to_owned(),
            found: "16 bits".to_owned(),
            expected: "8".to_owned(),
        }),
    }
}
