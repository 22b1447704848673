use super::*;
use crate::camera::Camera;
use crate::reference::tests::camera;
use camera_models::Distortion;

/// SSIM as the definition says, in f64, and the loss from it.
fn slow(
    image: &[Vec<f64>; 3],
    view: &TrainingView,
    config: &LossConfig,
    size: (usize, usize),
) -> f64 {
    let (width, height) = size;
    let valid = |pixel: usize| view.mask.get(pixel).copied().unwrap_or(true);
    let weight = |a: i64| (-(a * a) as f64 / 4.5).exp();
    let total: f64 = (-5..=5).map(weight).sum();
    let (mut l1, mut similarity) = (0.0, 0.0);
    for c in 0..3 {
        let y = |pixel: usize| match valid(pixel) {
            true => f64::from(view.rgb[3 * pixel + c]) / 255.0,
            // Detached: the color at which the gradient is taken.
            false => 0.25,
        };
        for row in 0..height as i64 {
            for column in 0..width as i64 {
                let at = row as usize * width + column as usize;
                if !valid(at) {
                    continue;
                }
                l1 += (image[c][at] - y(at)).abs();
                let mut sums = [0.0; 5];
                for dy in -5..=5 {
                    for dx in -5..=5 {
                        let (r, q) = (row + dy, column + dx);
                        if r < 0 || q < 0 || r >= height as i64 || q >= width as i64 {
                            continue;
                        }
                        let pixel = r as usize * width + q as usize;
                        let (a, b) = (image[c][pixel], y(pixel));
                        let w = weight(dx) * weight(dy) / (total * total);
                        for (sum, value) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                            *sum += w * value;
                        }
                    }
                }
                let [mx, my, xx, yy, xy] = sums;
                let over = (2.0 * mx * my + 1e-4) * (2.0 * (xy - mx * my) + 9e-4);
                let under = (mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4);
                similarity += over / under;
            }
        }
    }
    let count = 3.0 * view.valid_pixels() as f64;
    let w = f64::from(config.ssim_weight);
    (1.0 - w) * l1 / count + w * (1.0 - similarity / count)
}

fn case(mask: bool) -> (Image, TrainingView) {
    let camera: Camera = camera((45, 38), Distortion::None);
    let pixels = camera.pixels();
    let value = |k: u64, i: usize| counter_random::uniform(3, k, i as u64);
    let rgb = (0..3 * pixels)
        .map(|i| (value(0, i) * 255.0) as u8)
        .collect();
    let mut view = TrainingView::new(camera, rgb, 0);
    let mut image = Image {
        width: 45,
        height: 38,
        ..Image::default()
    };
    // Similar to the target, so that structures matter.
    for c in 0..3 {
        image.rgb[c] = (0..pixels)
            .map(|i| {
                f32::from(view.rgb[3 * i + c]) / 255.0 * 0.7 + 0.3 * value(1 + c as u64, i) as f32
            })
            .collect();
    }
    image.alpha = vec![1.0; pixels];
    image.expected_depth_m = (0..pixels).map(|i| 1.0 + value(9, i) as f32).collect();
    if mask {
        view.mask = (0..pixels)
            .map(|i| value(7, i) > 0.2 && i % 45 < 40)
            .collect();
        for plane in &mut image.rgb {
            for (value, valid) in plane.iter_mut().zip(&view.mask) {
                if !valid {
                    *value = 0.25;
                }
            }
        }
    }
    (image, view)
}

#[test]
fn loss_and_gradient_equal_the_definition() {
    for with_mask in [false, true] {
        let (image, view) = case(with_mask);
        let config = LossConfig::default();
        let found = loss(&image, &view, &config, 0.0, Level::best());
        let wide: [Vec<f64>; 3] =
            std::array::from_fn(|c| image.rgb[c].iter().map(|v| f64::from(*v)).collect());
        let expected = slow(&wide, &view, &config, (45, 38));
        assert!(
            (found.total - expected).abs() < 1e-5,
            "{} {expected}",
            found.total
        );
        for i in 0..60_u64 {
            let pixel = (counter_random::bits(1, 0, i) % wide[0].len() as u64) as usize;
            let c = i as usize % 3;
            let gradient = f64::from(found.gradient.rgb[c][pixel]);
            if with_mask && !view.mask[pixel] {
                assert_eq!(gradient, 0.0);
                continue;
            }
            let at = |h: f64| {
                let mut moved = wide.clone();
                moved[c][pixel] += h;
                slow(&moved, &view, &config, (45, 38))
            };
            let expected = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!(
                (gradient - expected).abs() < 1e-3 * expected.abs() + 1e-7,
                "{gradient} {expected}"
            );
        }
        for level in Level::all() {
            let other = loss(&image, &view, &config, 0.0, level);
            assert!(
                other.gradient == found.gradient && other.total == found.total,
                "{level:?}"
            );
        }
    }
}

#[test]
fn saturated_values_bound_the_color_from_below() {
    let (mut image, mut view) = case(false);
    // Blocks of values of red that are exceeded, reached, and not reached.
    let block = |row: usize| (row * 45..row * 45 + 12).collect::<Vec<usize>>();
    for (row, value) in [(4, 1.3), (14, 1.01), (24, 0.6)] {
        for pixel in block(row) {
            view.rgb[3 * pixel] = 255;
            image.rgb[0][pixel] = value;
        }
    }
    let config = LossConfig::default();
    let at = |image: &Image, view: &TrainingView| loss(image, view, &config, 0.0, Level::best());
    let found = at(&image, &view);
    let red = |row: usize| block(row).into_iter().map(|p| found.gradient.rgb[0][p]);
    assert!(red(4).chain(red(14)).all(|gradient| gradient == 0.0));
    assert!(red(24).sum::<f32>() < 0.0);
    assert!(block(4).iter().all(|p| found.gradient.rgb[1][*p] != 0.0));
    // Elsewhere the gradient is that of a target that equals the rendered color.
    let wide: [Vec<f64>; 3] =
        std::array::from_fn(|c| image.rgb[c].iter().map(|v| f64::from(*v)).collect());
    let pixel = 6 * 45 + 5;
    let change = |h: f64| {
        let mut moved = image.clone();
        moved.rgb[0][pixel] = (wide[0][pixel] + h) as f32;
        at(&moved, &view).total
    };
    let expected = (change(1e-3) - change(-1e-3)) / 2e-3;
    let gradient = f64::from(found.gradient.rgb[0][pixel]);
    assert!(
        (gradient - expected).abs() < 0.02 * expected.abs(),
        "{gradient} {expected}"
    );
}

#[test]
fn equal_images_have_no_loss_and_no_gradient() {
    let (mut image, view) = case(false);
    for c in 0..3 {
        image.rgb[c] = (0..view.camera.pixels())
            .map(|i| f32::from(view.rgb[3 * i + c]) / 255.0)
            .collect();
    }
    let found = loss(&image, &view, &LossConfig::default(), 0.0, Level::best());
    assert!(
        found.total.abs() < 1e-6 && (found.ssim - 1.0).abs() < 1e-5,
        "{found:?}"
    );
    let largest = found
        .gradient
        .rgb
        .iter()
        .flatten()
        .fold(0.0_f32, |a, b| a.max(b.abs()));
    assert!(largest < 1e-7, "{largest}");
    assert!(found.gradient.error.iter().all(|error| *error == 0.0));
}

#[test]
fn depth_counts_by_its_sigma_where_it_is_known() {
    let (mut image, mut view) = case(false);
    let pixels = view.camera.pixels();
    view.depth_m = vec![f32::NAN; pixels];
    view.depth_sigma_m = vec![0.1; pixels];
    view.depth_m[5] = 1.5;
    view.depth_m[6] = 1.5;
    view.depth_sigma_m[6] = 0.2;
    image.expected_depth_m[5] = 1.6;
    image.expected_depth_m[6] = 1.6;
    view.depth_m[7] = 1.5;
    image.alpha[7] = 0.4;
    let config = LossConfig::default();
    let at = |image: &Image| loss(image, &view, &config, 1.0, Level::best());
    let found = at(&image);
    let slopes = &found.gradient.expected_depth;
    assert!(
        slopes
            .iter()
            .enumerate()
            .all(|(i, slope)| (*slope != 0.0) == (i == 5 || i == 6))
    );
    assert!(slopes[5] > 3.0 * slopes[6], "{} {}", slopes[5], slopes[6]);
    let mut moved = image.clone();
    moved.expected_depth_m[5] += 1e-3;
    let expected = (at(&moved).depth - found.depth) / 1e-3;
    assert!(
        (f64::from(slopes[5]) - expected).abs() < 0.02 * expected,
        "{} {expected}",
        slopes[5]
    );
}
