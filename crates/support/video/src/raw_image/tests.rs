//! Every fast kernel against a slow reference implementation, and the refusals.

use super::psnr::squared_difference;
use super::*;

/// Deterministic noise.
fn noise(length: usize, seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..length)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u8
        })
        .collect()
}

fn i420(width: u32, height: u32, seed: u64) -> RawImage {
    let length = PixelFormat::I420.bytes(width, height).unwrap();
    RawImage::new(width, height, PixelFormat::I420, noise(length, seed)).unwrap()
}

/// One sample, the slow way: plane 0 is luma.
fn at(image: &RawImage, plane: usize, x: usize, y: usize) -> u8 {
    let (width, height) = (image.width as usize, image.height as usize);
    match plane {
        0 => image.data[y * width + x],
        _ => {
            let [columns, rows] = chroma_size(image.width, image.height);
            image.data[width * height + (plane - 1) * columns * rows + y * columns + x]
        }
    }
}

#[test]
fn halves_come_back() {
    for (width, height) in [(2, 2), (6, 4), (34, 18)] {
        let (left, right) = (i420(width, height, 1), i420(width, height, 2));
        let both = side_by_side(&left, &right).unwrap();
        assert_eq!((both.width, both.height), (2 * width, height));
        for plane in 0..3 {
            let shift = usize::from(plane > 0);
            for y in 0..height as usize >> shift {
                for x in 0..width as usize >> shift {
                    let half = width as usize >> shift;
                    assert_eq!(at(&both, plane, x, y), at(&left, plane, x, y));
                    assert_eq!(at(&both, plane, x + half, y), at(&right, plane, x, y));
                }
            }
        }
        assert_eq!(split(&both).unwrap(), (left, right));
    }
    let left = RawImage::new(3, 5, PixelFormat::Grey8, noise(15, 3)).unwrap();
    let right = RawImage::new(3, 5, PixelFormat::Grey8, noise(15, 4)).unwrap();
    assert_eq!(
        split(&side_by_side(&left, &right).unwrap()).unwrap(),
        (left, right)
    );
}

#[test]
fn eyes_of_odd_size_come_back() {
    for (width, height) in [(3, 2), (5, 3), (1, 1), (4, 3)] {
        let (left, right) = (i420(width, height, 1), i420(width, height, 2));
        let both = side_by_side(&left, &right).unwrap();
        assert_eq!((both.width, both.height), (2 * width, height));
        let (first, second) = split(&both).unwrap();
        assert_eq!(first.luma(), left.luma());
        assert_eq!(second.luma(), right.luma());
        let columns = width as usize;
        for plane in 1..3 {
            for y in 0..height.div_ceil(2) as usize {
                for x in 0..columns {
                    // Each chroma sample is the mean of its two pixels.
                    let pixel = |x: usize| match x < columns {
                        true => u16::from(at(&left, plane, x / 2, y)),
                        false => u16::from(at(&right, plane, (x - columns) / 2, y)),
                    };
                    let expected = (pixel(2 * x) + pixel(2 * x + 1)).div_ceil(2);
                    assert_eq!(
                        u16::from(at(&both, plane, x, y)),
                        expected,
                        "{plane} {x} {y}"
                    );
                }
            }
        }
    }
    // Gray images have neutral chroma, which no interpolation changes.
    let gray = |seed| RawImage::new(5, 3, PixelFormat::Grey8, noise(15, seed)).unwrap();
    let eyes = [1, 2].map(|seed| grey_to_i420(&gray(seed)).unwrap());
    let both = side_by_side(&eyes[0], &eyes[1]).unwrap();
    assert_eq!(split(&both).unwrap(), (eyes[0].clone(), eyes[1].clone()));
}

#[test]
fn padding_is_removed() {
    let coded = i420(6, 4, 3);
    for (width, height) in [(5, 4), (6, 3), (5, 3)] {
        let image = without_padding(&coded, width, height).unwrap();
        assert_eq!((image.width, image.height), (width, height));
        for (plane, (columns, rows)) in [(0, (width, height)), (1, (3, 2)), (2, (3, 2))] {
            for y in 0..rows as usize {
                for x in 0..columns as usize {
                    assert_eq!(at(&image, plane, x, y), at(&coded, plane, x, y));
                }
            }
        }
    }
    assert_eq!(without_padding(&coded, 6, 4), Some(coded.clone()));
    for (width, height) in [(4, 4), (6, 5), (7, 4), (6, 2)] {
        assert_eq!(without_padding(&coded, width, height), None);
    }
}

#[test]
fn color_of_odd_size_follows_the_formula_of_the_padded_one() {
    let (width, height) = (5_usize, 3_usize);
    let rgb = noise(3 * width * height, 9);
    let mut padded = Vec::new();
    for y in 0..4_usize {
        for x in 0..6_usize {
            let pixel = 3 * (y.min(2) * width + x.min(4));
            padded.extend_from_slice(&rgb[pixel..pixel + 3]);
        }
    }
    let padded = rgb_to_i420(6, 4, &padded).unwrap();
    let image = rgb_to_i420(5, 3, &rgb).unwrap();
    assert_eq!(without_padding(&padded, 5, 3), Some(image.clone()));
    let back = i420_to_rgb(&image).unwrap();
    let expected = i420_to_rgb(&padded).unwrap();
    for y in 0..height {
        let row = &expected[3 * 6 * y..3 * 6 * y + 3 * width];
        assert_eq!(&back[3 * width * y..3 * width * (y + 1)], row);
    }
    let mut nv12 = image.luma().unwrap().to_vec();
    for y in 0..2 {
        for x in 0..3 {
            nv12.extend([at(&image, 1, x, y), at(&image, 2, x, y)]);
        }
    }
    assert_eq!(nv12_to_i420(5, 3, &nv12), Ok(image));
}

#[test]
fn grey_goes_there_and_back() {
    let grey = RawImage::new(6, 4, PixelFormat::Grey8, noise(24, 5)).unwrap();
    let image = grey_to_i420(&grey).unwrap();
    assert!(image.data[24..].iter().all(|&chroma| chroma == 128));
    assert_eq!(i420_to_grey(&image).unwrap(), grey);
    assert!(
        i420_to_rgb(&image)
            .unwrap()
            .chunks(3)
            .zip(&grey.data)
            .all(|(rgb, &y)| rgb == [y; 3])
    );
}

#[test]
fn sizes_that_cannot_be_are_refused() {
    let odd = |width, height| Err(RawImageError::OddSize { width, height });
    assert_eq!(yuyv_to_i420(3, 2, &[0; 12]).map(|_| 0), odd(3, 2));
    assert_eq!(split(&i420(5, 2, 1)).map(|_| 0), odd(5, 2));
    assert!(matches!(
        PixelFormat::Grey8.bytes(0, 7),
        Err(RawImageError::Empty { .. })
    ));
    assert!(matches!(
        PixelFormat::Grey8.bytes(u32::MAX, u32::MAX),
        Err(RawImageError::TooLarge { .. })
    ));
    let short = RawImage {
        width: 4,
        height: 4,
        format: PixelFormat::I420,
        data: Bytes::new(),
    };
    let wrong = RawImageError::WrongLength {
        found: 0,
        expected: 24,
    };
    assert_eq!(short.check(), Err(wrong.clone()));
    assert_eq!(split(&short), Err(wrong.clone()));
    assert_eq!(i420_to_grey(&short), Err(wrong.clone()));
    assert_eq!(side_by_side(&short, &short), Err(wrong));
    assert!(matches!(
        side_by_side(&i420(4, 4, 1), &i420(4, 2, 1)),
        Err(RawImageError::Unequal { .. })
    ));
    assert!(matches!(
        grey_to_i420(&i420(4, 4, 1)),
        Err(RawImageError::WrongFormat { .. })
    ));
}

#[test]
fn rgb_follows_the_formula() {
    let (width, height) = (18, 10);
    let mut rgb = noise(3 * width * height, 7);
    // The corners of the colour cube, where clamping matters, in one block each.
    for corner in 0..8usize {
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            for channel in 0..3 {
                rgb[3 * (y * width + 2 * corner + x) + channel] =
                    if corner & (1 << channel) == 0 { 0 } else { 255 };
            }
        }
    }
    let image = rgb_to_i420(width as u32, height as u32, &rgb).unwrap();
    let pixel = |x: usize, y: usize| -> [f64; 3] {
        std::array::from_fn(|channel| f64::from(rgb[3 * (y * width + x) + channel]))
    };
    // The fixed-point coefficients have an error of at most 2^-17 each: three of them times 255 may
    // move a value by 0.006 over a rounding border, never further.
    let close = |found: u8, exact: f64| (f64::from(found) - exact.clamp(0.0, 255.0)).abs() <= 0.506;
    for y in 0..height {
        for x in 0..width {
            let [r, g, b] = pixel(x, y);
            assert!(close(
                at(&image, 0, x, y),
                0.299 * r + 0.587 * g + 0.114 * b
            ));
        }
    }
    for y in 0..height / 2 {
        for x in 0..width / 2 {
            let mut mean = [0.0; 3];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                for (mean, value) in mean.iter_mut().zip(pixel(2 * x + dx, 2 * y + dy)) {
                    *mean += value / 4.0;
                }
            }
            let [r, g, b] = mean;
            assert!(close(
                at(&image, 1, x, y),
                -0.168736 * r - 0.331264 * g + 0.5 * b + 128.0
            ));
            assert!(close(
                at(&image, 2, x, y),
                0.5 * r - 0.418688 * g - 0.081312 * b + 128.0
            ));
        }
    }
    let back = i420_to_rgb(&image).unwrap();
    for y in 0..height {
        for x in 0..width {
            let luma = f64::from(at(&image, 0, x, y));
            let cb = f64::from(at(&image, 1, x / 2, y / 2)) - 128.0;
            let cr = f64::from(at(&image, 2, x / 2, y / 2)) - 128.0;
            let exact = [
                luma + 1.402 * cr,
                luma - 0.344136 * cb - 0.714136 * cr,
                luma + 1.772 * cb,
            ];
            for (&found, exact) in back[3 * (y * width + x)..].iter().zip(exact) {
                assert!(close(found, exact), "at {x},{y}: {found} for {exact}");
            }
        }
    }
}

#[test]
fn flat_colours_survive_rgb() {
    for (r, g, b) in [
        (0, 0, 0),
        (255, 255, 255),
        (200, 30, 60),
        (10, 120, 250),
        (77, 77, 77),
    ] {
        let rgb: Vec<u8> = [r, g, b].repeat(16);
        let back = i420_to_rgb(&rgb_to_i420(4, 4, &rgb).unwrap()).unwrap();
        // Intermediate rounding to 8 bits costs at most 1.402/2 + 1/2 resp. 1.772/2 + 1/2.
        assert!(
            back.iter()
                .zip(&rgb)
                .all(|(&back, &rgb)| back.abs_diff(rgb) <= 1)
        );
    }
}

#[test]
fn camera_layouts_are_taken_apart() {
    let (width, height) = (22usize, 8usize);
    let nv12 = noise(width * height * 3 / 2, 8);
    let image = nv12_to_i420(width as u32, height as u32, &nv12).unwrap();
    for y in 0..height {
        for x in 0..width {
            assert_eq!(at(&image, 0, x, y), nv12[y * width + x]);
            let chroma = width * height + y / 2 * width + x / 2 * 2;
            assert_eq!(at(&image, 1, x / 2, y / 2), nv12[chroma]);
            assert_eq!(at(&image, 2, x / 2, y / 2), nv12[chroma + 1]);
        }
    }
    let yuyv = noise(width * height * 2, 9);
    let image = yuyv_to_i420(width as u32, height as u32, &yuyv).unwrap();
    for y in 0..height {
        for x in 0..width {
            assert_eq!(at(&image, 0, x, y), yuyv[2 * (y * width + x)]);
            let chroma = |row: usize, which: usize| {
                f64::from(yuyv[2 * row * width + x / 2 * 4 + 1 + 2 * which])
            };
            for which in 0..2 {
                let mean = (chroma(y / 2 * 2, which) + chroma(y / 2 * 2 + 1, which)) / 2.0;
                assert_eq!(f64::from(at(&image, 1 + which, x / 2, y / 2)), mean.round());
            }
        }
    }
    assert!(matches!(
        yuyv_to_i420(22, 8, &yuyv[1..]),
        Err(RawImageError::WrongLength {
            found: 351,
            expected: 352
        })
    ));
}

#[test]
fn psnr_is_the_textbook_one() {
    let (a, b) = (i420(30, 20, 10), i420(30, 20, 11));
    let slow = |a: &[u8], b: &[u8]| {
        let sum: f64 = a
            .iter()
            .zip(b)
            .map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2))
            .sum();
        10.0 * (255.0f64.powi(2) / (sum / a.len() as f64)).log10()
    };
    assert!((psnr(&a, &b) - slow(&a.data[..600], &b.data[..600])).abs() < 1e-9);
    assert!((psnr_all(&a, &b) - slow(&a.data, &b.data)).abs() < 1e-9);
    assert_eq!(psnr(&a, &a), f64::INFINITY);
    assert_eq!(psnr(&a, &i420_to_grey(&a).unwrap()), f64::INFINITY);
    assert!(psnr_all(&a, &i420_to_grey(&a).unwrap()).is_nan());
    assert!(psnr(&a, &i420(20, 30, 10)).is_nan());
    // The largest difference over more than one block does not overflow.
    let length = 200_001;
    assert_eq!(
        squared_difference(&vec![0; length], &vec![255; length]),
        65025 * length as u64
    );
}
