use super::*;
use imaging::ImageView;

/// The same numbers, one pixel at a time, from the definition.
fn slow_response(smooth: &Smooth, x: usize, y: usize) -> f32 {
    let v = |dx: isize, dy: isize| {
        f32::from(smooth.values[y.strict_add_signed(dy) * smooth.width + x.strict_add_signed(dx)])
    };
    let xx = v(-2, 0) + v(2, 0) - 2.0 * v(0, 0);
    let yy = v(0, -2) + v(0, 2) - 2.0 * v(0, 0);
    let xy = v(1, 1) - v(-1, 1) - v(1, -1) + v(-1, -1);
    xy * xy - xx * yy
}

/// Integers below 2^24 are exact in f32, so there is no tolerance.
#[test]
fn fast_response_agrees_with_the_reference() {
    for (width, height) in [(8, 8), (37, 21), (64, 9)] {
        let pixels: Vec<u8> = (0..width * height)
            .map(|i| (i * i * 37 / 5 % 256) as u8)
            .collect();
        let smooth = Smooth::of(&ImageView::new(width, height, width, &pixels).unwrap());
        let mut row = vec![0.0; width];
        for y in 2..height - 2 {
            response(&smooth, y, &mut row);
            for (x, value) in row.iter().enumerate().take(width - 2).skip(2) {
                assert_eq!(*value, slow_response(&smooth, x, y), "({x}, {y})");
            }
        }
    }
}

#[test]
fn the_circle_is_a_circle() {
    for (i, (cos, sin)) in circle().enumerate() {
        let angle = i as f32 * std::f32::consts::TAU / SAMPLES as f32;
        assert!(
            (cos - angle.cos()).abs() < 1e-6 && (sin - angle.sin()).abs() < 1e-6,
            "{i}"
        );
    }
}

/// A crossing at (20, 20) with dark where x and y have the same sign: rays along the axes.
#[test]
fn rays_begin_before_a_dark_sector() {
    let (width, height) = (41, 41);
    let dark = |x: usize, y: usize| (x > 20) == (y > 20);
    let pixels: Vec<u8> = (0..width * height)
        .map(|i| match (i % width, i / width) {
            (20, _) | (_, 20) => 100,
            (x, y) => {
                if dark(x, y) {
                    20
                } else {
                    180
                }
            }
        })
        .collect();
    let smooth = Smooth::of(&ImageView::new(width, height, width, &pixels).unwrap());
    let found = find(&smooth, &Config::default());
    assert_eq!(found.len(), 1);
    let quarter = std::f64::consts::FRAC_PI_2;
    for (ray, expected) in found[0]
        .rays
        .iter()
        .zip([0.0, quarter, 2.0 * quarter, 3.0 * quarter])
    {
        let off = (ray - expected).rem_euclid(std::f64::consts::TAU);
        assert!(
            off.min(std::f64::consts::TAU - off) < 0.02,
            "{:?}",
            found[0].rays
        );
    }
    assert!(
        found[0].at.iter().all(|v| (v - 20.0).abs() < 1e-3),
        "{:?}",
        found[0].at
    );
}
