use super::*;
use crate::config::Preset;
use crate::reference::Random;

const WIDTH: usize = 240;
const HEIGHT: usize = 96;

/// A fronto-parallel scene at one disparity.
fn pair(shift: usize) -> [Vec<u8>; 2] {
    Random(71).pair(WIDTH, HEIGHT, shift)
}

fn run(banded: &mut BandedMatcher, eyes: &[Vec<u8>; 2]) -> (DisparityMap, BandStats) {
    let images = [0, 1].map(|eye| ImageView::packed(WIDTH, HEIGHT, &eyes[eye]).unwrap());
    let (map, stats) = banded.run(&images[0], &images[1], None).unwrap();
    (map.clone(), stats)
}

fn ratio_at(map: &DisparityMap, columns: std::ops::Range<usize>, disparity: f32) -> f64 {
    let rows = map.disparity.chunks_exact(WIDTH);
    let pixels = rows.flat_map(|row| &row[columns.clone()]);
    let right = pixels.filter(|d| (**d - disparity).abs() < 1.0).count();
    right as f64 / (columns.len() * HEIGHT) as f64
}

fn banded() -> BandedMatcher {
    let config = Config::preset(Preset::Balanced);
    BandedMatcher::new(config, WIDTH, Band::full(0, 128, HEIGHT).unwrap()).unwrap()
}

#[test]
fn narrow_scene_searches_a_small_fraction_of_the_range() {
    let mut banded = banded();
    let (map, stats) = run(&mut banded, &pair(20));
    assert!(stats.searched_ratio < 0.4 && stats.reruns == 0, "{stats:?}");
    assert!(ratio_at(&map, 60..220, 20.0) > 0.98);
}

/// Coarse matching follows a jump of the whole scene, whatever the previous map was.
#[test]
fn large_disparity_jumps_are_found() {
    let mut banded = banded();
    for shift in [20, 90, 5, 60] {
        let (map, _) = run(&mut banded, &pair(shift));
        assert!(ratio_at(&map, 100..220, shift as f32) > 0.98, "{shift}");
    }
}

/// A band that is too narrow is detected by the pixels at its end.
#[test]
fn clipping_band_is_widened() {
    let mut banded = banded();
    // A plan that misses the disparity by a few pixels, as after wrong coarse matching.
    let eyes = pair(40);
    let images = [0, 1].map(|eye| ImageView::packed(WIDTH, HEIGHT, &eyes[eye]).unwrap());
    let narrow = Band::rows(&[[20, 40]; HEIGHT]).unwrap();
    banded.matcher.run(&images[0], &images[1], &narrow).unwrap();
    assert!(banded.is_clipped(&narrow, WIDTH));
    let wider = banded.widened(&narrow, WIDTH).unwrap();
    assert_eq!([0, 50, 95].map(|y| wider.row(y)), [[20, 56]; 3]);
    banded.matcher.run(&images[0], &images[1], &wider).unwrap();
    assert!(!banded.is_clipped(&wider, WIDTH));
}

/// `run_from` repeats the match; a block with few pixels at its end is not widened.
#[test]
fn clipped_pair_is_matched_again() {
    let mut banded = banded();
    for (shift, reruns) in [(30, 0), (44, 1)] {
        let eyes = pair(shift);
        let images = [0, 1].map(|eye| ImageView::packed(WIDTH, HEIGHT, &eyes[eye]).unwrap());
        let narrow = Band::rows(&[[20, 40]; HEIGHT]).unwrap();
        let (map, stats) = banded.run_from(narrow, &images[0], &images[1]).unwrap();
        let map = map.clone();
        assert!(stats.reruns >= reruns, "{shift}: {stats:?}");
        assert!(ratio_at(&map, 110..220, shift as f32) > 0.9, "{shift}");
    }
}

#[test]
fn ends_of_the_full_range_do_not_count_as_clipped() {
    let banded = {
        let mut banded = banded();
        let eyes = pair(0);
        let images = [0, 1].map(|eye| ImageView::packed(WIDTH, HEIGHT, &eyes[eye]).unwrap());
        let band = Band::rows(&[[0, 30]; HEIGHT]).unwrap();
        banded.matcher.run(&images[0], &images[1], &band).unwrap();
        assert!(!banded.is_clipped(&band, WIDTH));
        banded
    };
    assert!(
        banded
            .matcher
            .stats()
            .at_end
            .iter()
            .any(|ends| ends[0] > 100)
    );
}
