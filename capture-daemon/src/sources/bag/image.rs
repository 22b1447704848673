//! Decoding of an image message to I420.

use std::path::Path;

use video::RawImage;
use video::raw_image::{side_by_side, yuyv_to_i420};

use super::messages::{self, Kind};
use crate::error_chain::with_causes;
use crate::sources::datasets::{DecodedPng, MAX_PIXELS, Samples, decode_png};
use crate::sources::jpeg;
use crate::sources::replay::stereo_image;

/// An image of a bag.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BagImage {
    /// Whether it has chroma.
    pub(super) colour: bool,
    /// As I420.
    pub(super) image: RawImage,
}

impl BagImage {
    /// Columns and rows.
    pub(super) fn size(&self) -> (u32, u32) {
        (self.image.width, self.image.height)
    }
}

/// Names of encodings with their layout: the bytes of a pixel, and where red, green and blue are in
/// it.
const LAYOUTS: [(&str, usize, Option<[usize; 3]>); 8] = [
    ("mono8", 1, None),
    ("8UC1", 1, None),
    ("rgb8", 3, Some([0, 1, 2])),
    ("bgr8", 3, Some([2, 1, 0])),
    ("8UC3", 3, Some([2, 1, 0])),
    ("rgba8", 4, Some([0, 1, 2])),
    ("bgra8", 4, Some([2, 1, 0])),
    ("8UC4", 4, Some([2, 1, 0])),
];

/// 4:2:2, bytes Y Cb Y Cr.
const YUYV: [&str; 2] = ["yuv422_yuy2", "yuyv"];

/// Decodes an image message.
///
/// # Errors
/// What was found and what was expected.
pub(super) fn decode(kind: Kind, message: &[u8]) -> Result<BagImage, String> {
    match kind {
        Kind::Image => plain(&messages::image(message).map_err(|e| e.to_string())?),
        Kind::CompressedImage => {
            let image = messages::compressed_image(message).map_err(|e| e.to_string())?;
            compressed(&image)
        }
        Kind::Imu => Err("an IMU sample, expected an image".to_owned()),
    }
}

/// Both eyes side by side.
///
/// # Errors
/// They do not match.
pub(super) fn join(left: &BagImage, right: &BagImage) -> Result<BagImage, String> {
    let (ours, other) = (left.size(), right.size());
    if ours != other {
        return Err(format!(
            "the left image is {}x{} and the right one {}x{}, expected the same",
            ours.0, ours.1, other.0, other.1
        ));
    }
    let image = side_by_side(&left.image, &right.image).map_err(|e| e.to_string())?;
    Ok(BagImage {
        colour: left.colour || right.colour,
        image,
    })
}

fn plain(image: &messages::Image<'_>) -> Result<BagImage, String> {
    let (width, height) = (image.width, image.height);
    if width == 0 || height == 0 || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(format!(
            "it is {width}x{height}, expected at most {MAX_PIXELS} pixels"
        ));
    }
    let is_yuyv = YUYV.contains(&image.encoding);
    let layout = LAYOUTS.iter().find(|(name, ..)| *name == image.encoding);
    let bytes = match layout {
        Some((_, bytes, _)) => *bytes,
        None if is_yuyv => 2,
        None => {
            let known: Vec<&str> = LAYOUTS.iter().map(|(name, ..)| *name).chain(YUYV).collect();
            return Err(format!(
                "its encoding is {:?}, expected one of {}; convert the topic (image_proc makes mono8 or rgb8 of raw sensor \
                 values)",
                image.encoding,
                known.join(", ")
            ));
        }
    };
    let row = width as usize * bytes;
    let step = image.step as usize;
    // The last row may end with its pixels.
    let needed = step
        .checked_mul(height as usize - 1)
        .and_then(|all| all.checked_add(row));
    if step < row || needed.is_none_or(|needed| needed > image.data.len()) {
        return Err(format!(
            "{} bytes in rows of {step} for {width}x{height} of {}, expected rows of {row} or more and all of them",
            image.data.len(),
            image.encoding
        ));
    }
    let rows = image
        .data
        .chunks(step)
        .take(height as usize)
        .map(|data| &data[..row]);
    let place = layout.and_then(|(_, _, place)| *place);
    let (samples, data) = match (is_yuyv, place) {
        (true, _) => {
            let packed: Vec<u8> = rows.flatten().copied().collect();
            let image = yuyv_to_i420(width, height, &packed).map_err(|e| e.to_string())?;
            return Ok(BagImage {
                colour: true,
                image,
            });
        }
        (false, None) => (Samples::Grey8, rows.flatten().copied().collect()),
        (false, Some(place)) => {
            let mut data = Vec::with_capacity(3 * width as usize * height as usize);
            for pixel in rows.flat_map(|row| row.chunks_exact(bytes)) {
                data.extend(place.map(|k| pixel[k]));
            }
            (Samples::Rgb8, data)
        }
    };
    of_samples(DecodedPng {
        width,
        height,
        samples,
        data,
    })
}

fn compressed(image: &messages::CompressedImage<'_>) -> Result<BagImage, String> {
    // The format text is ambiguous; the bytes are decisive.
    if image.data.starts_with(&[0xff, 0xd8]) {
        let decoded = jpeg::decode(image.data).map_err(|e| e.to_string())?;
        return Ok(BagImage {
            colour: decoded.colour,
            image: decoded.image,
        });
    }
    if image.data.starts_with(b"\x89PNG") {
        let decoded = decode_png(Path::new("the message"), image.data);
        return of_samples(decoded.map_err(|e| with_causes(&e))?);
    }
    Err(format!(
        "its format is {:?}, expected JPEG or PNG in its bytes",
        image.format
    ))
}

fn of_samples(decoded: DecodedPng) -> Result<BagImage, String> {
    let colour = decoded.samples == Samples::Rgb8;
    let image = stereo_image::i420(decoded);
    Ok(BagImage {
        colour,
        image: image.map_err(|e| e.to_string())?,
    })
}

#[cfg(test)]
mod tests {
    use video::raw_image::rgb_to_i420;

    use super::*;

    fn of<'a>(encoding: &'a str, step: u32, data: &'a [u8]) -> messages::Image<'a> {
        messages::Image {
            height: 2,
            width: 2,
            encoding,
            step,
            data,
        }
    }

    /// One red and three black pixels.
    #[test]
    fn every_layout_decodes_to_the_same_image() {
        let red = rgb_to_i420(2, 2, &[200, 10, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0]).expect("an image");
        let rgb = [200, 10, 10, 0, 0, 0, 9, 9, 0, 0, 0, 0, 0, 0];
        let bgr = [10, 10, 200, 0, 0, 0, 9, 9, 0, 0, 0, 0, 0, 0];
        let bgra = [10, 10, 200, 255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0, 255];
        for (encoding, step, data) in [
            ("rgb8", 8, &rgb[..]),
            ("bgr8", 8, &bgr),
            ("8UC3", 8, &bgr),
            ("bgra8", 8, &bgra),
        ] {
            let image = plain(&of(encoding, step, data)).expect(encoding);
            assert_eq!(image.image, red, "{encoding}");
            assert!(image.colour);
        }
        let grey = plain(&of("mono8", 3, &[1, 2, 9, 3, 4])).expect("mono8");
        assert_eq!(&grey.image.data[..], [1, 2, 3, 4, 128, 128]);
        assert!(!grey.colour);
        let yuyv = plain(&of("yuv422_yuy2", 4, &[1, 100, 2, 200, 3, 100, 4, 200])).expect("yuyv");
        assert_eq!(&yuyv.image.data[..], [1, 2, 3, 4, 100, 200]);
    }

    #[test]
    fn unusable_image_reports_the_reason() {
        let error =
            |encoding, step, data: &[u8]| plain(&of(encoding, step, data)).expect_err("no image");
        let bayer = error("bayer_rggb8", 2, &[0; 4]);
        assert!(
            bayer.contains("\"bayer_rggb8\", expected one of mono8"),
            "{bayer}"
        );
        let short = error("mono8", 2, &[0; 3]);
        assert!(
            short.contains("3 bytes in rows of 2 for 2x2 of mono8"),
            "{short}"
        );
        let narrow = error("rgb8", 2, &[0; 40]);
        assert!(narrow.contains("expected rows of 6"), "{narrow}");
        let huge = messages::Image {
            height: u32::MAX,
            width: u32::MAX,
            ..of("mono8", u32::MAX, &[])
        };
        assert!(plain(&huge).is_err());
        let tiff = messages::CompressedImage {
            format: "tiff",
            data: b"II*\0",
        };
        let error = compressed(&tiff).expect_err("no image");
        assert!(error.contains("\"tiff\", expected JPEG or PNG"), "{error}");
    }
}
