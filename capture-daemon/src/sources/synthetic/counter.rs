//! A frame's number encoded in the image, to be read back after compression.
//!
//! Layout: at the top left of each eye's image, two rows of 16 cells, black for 0 and white for 1,
//! the upper row first and the left bit highest. The upper 28 bits are the number modulo
//! [`COUNTER_MODULUS`], the lower 4 a check. A cell is at least 4 x 4 pixels; columns beyond 16
//! cells are not changed.

use video::RawImage;

/// Modulus of the numbers in the image: 51 days at 60 Hz.
pub const COUNTER_MODULUS: u64 = 1 << 28;

const COLUMNS: usize = 16;
const ROWS: usize = 2;
const BLACK: u8 = 16;
const WHITE: u8 = 235;

/// The number in the left half of a stereo frame. `None` if there is no bar, or it cannot be read
/// unambiguously.
pub fn read_counter(image: &RawImage) -> Option<u64> {
    read(image, image.width / 2)
}

/// The number in the image of one eye.
pub fn read_eye_counter(image: &RawImage) -> Option<u64> {
    read(image, image.width)
}

/// Width and height of a cell; `None` if an eye is too small for the bar.
pub(super) fn cell(eye_width: u32, height: u32) -> Option<(usize, usize)> {
    if eye_width < 64 || height < 32 {
        return None;
    }
    let cell_width = (eye_width as usize / COLUMNS) & !3;
    let cell_height = (height as usize / 24).clamp(4, 16) & !1;
    Some((cell_width, cell_height))
}

/// Draws the bar into both eyes of a `width` x `height` I420 stereo frame.
pub(super) fn draw(data: &mut [u8], width: u32, height: u32, number: u64) {
    let Some((cell_width, cell_height)) = cell(width / 2, height) else {
        return;
    };
    let word = encode(number);
    let (width, height) = (width as usize, height as usize);
    for y in 0..ROWS * cell_height {
        for eye in [0, width / 2] {
            let row = &mut data[y * width + eye..][..COLUMNS * cell_width];
            for (column, cell) in row.chunks_exact_mut(cell_width).enumerate() {
                let bit = word >> (31 - (y / cell_height * COLUMNS + column)) & 1;
                cell.fill(if bit == 1 { WHITE } else { BLACK });
            }
        }
    }
    let chroma = &mut data[width * height..];
    let plane = width * height / 4;
    for start in [0, plane] {
        for y in 0..ROWS * cell_height / 2 {
            for eye in [0, width / 4] {
                chroma[start + y * (width / 2) + eye..][..COLUMNS * cell_width / 2].fill(128);
            }
        }
    }
}

fn read(image: &RawImage, eye_width: u32) -> Option<u64> {
    let (cell_width, cell_height) = cell(eye_width, image.height)?;
    let luma = image.luma().ok()?;
    let mut word = 0;
    for index in 0..ROWS * COLUMNS {
        let (left, top) = (index % COLUMNS * cell_width, index / COLUMNS * cell_height);
        // The outermost pixels take color from their neighbors when compressed.
        let rows = (top + 1..top + cell_height - 1)
            .map(|y| &luma[y * image.width as usize + left + 1..][..cell_width - 2]);
        let sum: usize = rows.flatten().map(|&value| usize::from(value)).sum();
        let bit = match sum / ((cell_width - 2) * (cell_height - 2)) {
            0..=95 => 0,
            160.. => 1,
            _ => return None,
        };
        word = word << 1 | bit;
    }
    let number = u64::from(word >> 4);
    (encode(number) == word).then_some(number)
}

/// Number and check: the bitwise sum of the number's seven half bytes, inverted in part so that an
/// all black and an all white bar are no numbers.
fn encode(number: u64) -> u32 {
    let number = (number % COUNTER_MODULUS) as u32;
    let check = (0..7).fold(0b1010, |check, i| check ^ (number >> (4 * i) & 0xf));
    number << 4 | check
}

#[cfg(test)]
mod tests {
    use video::PixelFormat;

    use super::*;

    fn image(width: u32, height: u32, fill: u8) -> Vec<u8> {
        vec![fill; PixelFormat::I420.bytes(width, height).unwrap()]
    }

    fn read_bytes(width: u32, height: u32, data: Vec<u8>) -> Option<u64> {
        read_counter(&RawImage::new(width, height, PixelFormat::I420, data).unwrap())
    }

    #[test]
    fn any_number_in_any_size() {
        for (width, height) in [(128, 32), (132, 34), (640, 240), (2560, 720)] {
            for number in [
                0,
                1,
                2,
                255,
                65_535,
                65_536,
                123_456_789,
                COUNTER_MODULUS - 1,
            ] {
                let mut data = image(width, height, 90);
                draw(&mut data, width, height, number);
                assert_eq!(
                    read_bytes(width, height, data),
                    Some(number),
                    "{width}x{height}"
                );
            }
        }
        let mut data = image(640, 240, 90);
        draw(&mut data, 640, 240, COUNTER_MODULUS + 5);
        assert_eq!(read_bytes(640, 240, data), Some(5));
    }

    #[test]
    fn image_without_a_bar_has_no_number() {
        for fill in [0, 100, 128, 255] {
            assert_eq!(read_bytes(640, 240, image(640, 240, fill)), None, "{fill}");
        }
        assert_eq!(read_bytes(120, 32, image(120, 32, 0)), None);
        // One inverted cell.
        let mut data = image(128, 32, 90);
        draw(&mut data, 128, 32, 77);
        for y in 0..4 {
            for value in &mut data[y * 128 + 20..][..4] {
                *value = 251 - *value;
            }
        }
        assert_eq!(read_bytes(128, 32, data), None);
    }
}
