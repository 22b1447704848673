use super::*;
use crate::settings::Preset;
use crate::twin::Random;

const WIDTH: usize = 240;
const HEIGHT: usize = 96;

/// A scene at a disparity.
fn pair(moved: usize) -> [Vec<u8>; 2] {
    Random(71).pair(WIDTH, HEIGHT, moved)
}

fn run(banded: &mut Banded, eyes: &[Vec<u8>; 2]) -> (DisparityMap, Spared) {
    let pictures = [0, 1].map(|eye| Picture::new(WIDTH, HEIGHT, &eyes[eye]).unwrap());
    let (map, spared) = banded.run(&pictures[0], &pictures[1], None).unwrap();
    (map.clone(), spared)
}

fn share_at(map: &DisparityMap, columns: std::ops::Range<usize>, disparity: f32) -> f64 {
    let rows = map.disparity.chunks_exact(WIDTH);
    let pixels = rows.flat_map(|row| &row[columns.clone()]);
    let right = pixels.filter(|d| (**d - disparity).abs() < 1.0).count();
    right as f64 / (columns.len() * HEIGHT) as f64
}

fn banded() -> Banded {
    let settings = Settings::preset(Preset::Balanced);
    Banded::new(settings, WIDTH, Band::full(0, 128, HEIGHT).unwrap()).unwrap()
}

#[test]
fn little_is_looked_for_where_there_is_little() {
    let mut banded = banded();
    let (map, spared) = run(&mut banded, &pair(20));
    assert!(spared.share < 0.4 && spared.runs_again == 0, "{spared:?}");
    assert!(share_at(&map, 60..220, 20.0) > 0.98);
}

/// A jump of everything is seen by the coarse look, whatever was there before.
#[test]
fn what_moves_far_is_found() {
    let mut banded = banded();
    for moved in [20, 90, 5, 60] {
        let (map, _) = run(&mut banded, &pair(moved));
        assert!(share_at(&map, 100..220, moved as f32) > 0.98, "{moved}");
    }
}

/// A band that is too narrow is noticed by the pixels that pile up at its end.
#[test]
fn a_band_that_cuts_is_widened() {
    let mut banded = banded();
    // A plan that misses by a few pixels, as if the coarse look had been wrong.
    let eyes = pair(40);
    let pictures = [0, 1].map(|eye| Picture::new(WIDTH, HEIGHT, &eyes[eye]).unwrap());
    let narrow = Band::rows(&[[20, 40]; HEIGHT]).unwrap();
    banded
        .matcher
        .run(&pictures[0], &pictures[1], &narrow)
        .unwrap();
    assert!(banded.is_cut(&narrow, WIDTH));
    let wider = banded.wider(&narrow, WIDTH).unwrap();
    assert_eq!([0, 50, 95].map(|y| wider.row(y)), [[20, 56]; 3]);
    banded
        .matcher
        .run(&pictures[0], &pictures[1], &wider)
        .unwrap();
    assert!(!banded.is_cut(&wider, WIDTH));
}

/// The loop does so by itself; a block in which few pixels pile up stays as it was.
#[test]
fn a_pair_is_matched_again_where_its_band_cut() {
    let mut banded = banded();
    for (moved, again) in [(30, 0), (44, 1)] {
        let eyes = pair(moved);
        let pictures = [0, 1].map(|eye| Picture::new(WIDTH, HEIGHT, &eyes[eye]).unwrap());
        let narrow = Band::rows(&[[20, 40]; HEIGHT]).unwrap();
        let (map, spared) = banded.run_from(narrow, &pictures[0], &pictures[1]).unwrap();
        let map = map.clone();
        assert!(spared.runs_again >= again, "{moved}: {spared:?}");
        assert!(share_at(&map, 110..220, moved as f32) > 0.9, "{moved}");
    }
}

#[test]
fn the_ends_of_all_are_no_cut() {
    let banded = {
        let mut banded = banded();
        let eyes = pair(0);
        let pictures = [0, 1].map(|eye| Picture::new(WIDTH, HEIGHT, &eyes[eye]).unwrap());
        let band = Band::rows(&[[0, 30]; HEIGHT]).unwrap();
        banded
            .matcher
            .run(&pictures[0], &pictures[1], &band)
            .unwrap();
        assert!(!banded.is_cut(&band, WIDTH));
        banded
    };
    assert!(
        banded
            .matcher
            .seen()
            .at_end
            .iter()
            .any(|ends| ends[0] > 100)
    );
}
