use super::*;
use crate::test_images::Draw;

#[test]
fn touching_runs_are_one_region() {
    let mut pixels = vec![200_u8; 40 * 40];
    // A ring, and a bar that is too thin.
    for i in 10..30 {
        for j in 10..30 {
            let is_inside = (14..26).contains(&i) && (14..26).contains(&j);
            pixels[j * 40 + i] = if is_inside { 200 } else { 20 };
        }
    }
    for i in 2..38 {
        pixels[36 * 40 + i] = 20;
    }
    let image = ImageView::packed(40, 40, &pixels).expect("an image");
    let found = dark(&image, &RegionConfig::default());
    assert_eq!(found.len(), 1);
    let ring = &found[0];
    assert_eq!((ring.top, ring.left, ring.area), (10, 10, 400 - 144));
    assert_eq!(ring.rows.len(), 20);
    assert!(
        ring.rows
            .iter()
            .chain(&ring.columns)
            .all(|ends| *ends == [10, 29])
    );
}

/// Pixels below the threshold of their tile, one by one.
fn is_dark(image: &ImageView<'_>, [x, y]: [usize; 2], config: &RegionConfig) -> bool {
    let tile = config.tile_px;
    let near = |v: usize, size: usize| {
        let last = size.div_ceil(tile) - 1;
        let from = (v / tile).saturating_sub(1) * tile;
        from..(((v / tile + 1).min(last) + 1) * tile).min(size)
    };
    let columns = near(x, image.width());
    let around = near(y, image.height()).flat_map(|row| image.row(row)[columns.clone()].iter());
    let (low, high) = around.fold((u8::MAX, 0), |(low, high), &v| (low.min(v), high.max(v)));
    high - low >= config.min_contrast && image.row(y)[x] < low + (high - low) / 2
}

/// All regions, by flooding.
fn flooded(image: &ImageView<'_>, config: &RegionConfig) -> Vec<Region> {
    let [width, height] = [image.width(), image.height()];
    let mut dark: Vec<bool> = (0..width * height)
        .map(|i| is_dark(image, [i % width, i / width], config))
        .collect();
    let mut regions = Vec::new();
    for start in 0..width * height {
        let mut pending = vec![start];
        let mut pixels = Vec::new();
        while let Some(at) = pending.pop() {
            if !std::mem::take(&mut dark[at]) {
                continue;
            }
            let [x, y] = [at % width, at / width];
            pixels.push([x, y]);
            for row in y.saturating_sub(1)..(y + 2).min(height) {
                let columns = x.saturating_sub(1)..(x + 2).min(width);
                pending.extend(columns.map(|column| row * width + column));
            }
        }
        let ends = |of: &dyn Fn(&[usize; 2]) -> Option<usize>| {
            let values = pixels.iter().filter_map(of);
            values.fold([usize::MAX, 0], |[a, b], v| [a.min(v), b.max(v)])
        };
        let [[left, right], [top, bottom]] = [0, 1].map(|k: usize| ends(&|p| Some(p[k])));
        let extent = config.min_extent_px..=config.max_extent_px;
        let is_suitable = |from: usize, to: usize| from <= to && extent.contains(&(to + 1 - from));
        if is_suitable(left, right) && is_suitable(top, bottom) {
            let row = |row: usize| ends(&|p| (p[1] == row).then_some(p[0]));
            let column = |column: usize| ends(&|p| (p[0] == column).then_some(p[1]));
            regions.push(Region {
                top,
                rows: (top..=bottom).map(row).collect(),
                left,
                columns: (left..=right).map(column).collect(),
                area: pixels.len(),
            });
        }
    }
    regions
}

#[test]
fn regions_are_those_of_flooding() {
    let mut draw = Draw(5);
    let mut count = 0;
    // Widths on both sides of a block of pixels, and of tiles.
    for (width, height) in [(150, 61), (128, 64), (64, 40), (63, 33), (65, 50), (30, 30)] {
        for noise in [10.0, 60.0, 120.0] {
            let waves = [0, 1].map(|_| 0.15 + 0.3 * draw.next());
            let pixels: Vec<u8> = (0..width * height)
                .map(|i| {
                    let [x, y] = [i % width, i / width].map(|v| v as f64);
                    let wave = (waves[0] * x).sin() * (waves[1] * y).cos();
                    (128.0 + 60.0 * wave + noise * (draw.next() - 0.5)) as u8
                })
                .collect();
            let image = ImageView::packed(width, height, &pixels).expect("an image");
            let config = RegionConfig::default();
            let found = dark(&image, &config);
            count += found.len();
            assert_eq!(found, flooded(&image, &config), "{width} {height} {noise}");
        }
    }
    assert!(count > 40, "{count}");
}
