use super::*;
use render::{Lens, Look, Picture, Random, View};

mod real;
mod render;

const GRID: Target = Target::AprilGrid {
    columns: 6,
    rows: 6,
    tag_m: 0.06,
    spacing: 0.3,
    first_id: 0,
};
const CHESS: Target = Target::Chessboard {
    columns: 9,
    rows: 6,
    square_m: 0.05,
};
const CHARUCO: Target = Target::Charuco {
    columns: 8,
    rows: 6,
    square_m: 0.06,
    marker_m: 0.045,
    dictionary: Dictionary::Aruco5x5 { count: 100 },
    first_id: 0,
};

/// Root mean square and largest error, mean error along x and y, pixels; and how many were found.
#[derive(Clone, Copy, Debug)]
struct Errors {
    rms: f64,
    largest: f64,
    bias: [f64; 2],
    found: usize,
}

/// Every corner found must be one of the board's and within a pixel of the truth: none may be wrong.
fn errors(found: &Detection, truth: &[(u32, [f64; 2])], what: &str) -> Errors {
    let mut sum = [0.0; 2];
    let (mut squares, mut largest) = (0.0, 0.0f64);
    for seen in &found.corners {
        let (_, at) = truth
            .iter()
            .find(|(id, _)| *id == seen.id)
            .expect("an id of the board");
        let error = [0, 1].map(|k| seen.pixel[k] - at[k]);
        let size = error[0].hypot(error[1]);
        assert!(size < 1.0, "{what}: corner {} is {size} px off", seen.id);
        largest = largest.max(size);
        squares += 0.5 * size * size;
        sum = [0, 1].map(|k| sum[k] + error[k]);
    }
    let count = found.corners.len().max(1) as f64;
    Errors {
        rms: (squares / count).sqrt(),
        largest,
        bias: sum.map(|s| s / count),
        found: found.corners.len(),
    }
}

fn see(target: &Target, view: View, look: &Look, what: &str) -> (Detection, Errors) {
    let picture = View::picture(&[(target, view)], look);
    let found = detect(&picture.view(), target, &Settings::default());
    let errors = errors(&found, &view.truth(target), what);
    (found, errors)
}

const VGA: [usize; 2] = [672, 376];

fn middling() -> View {
    View::new(VGA, 360.0, [0.01, -0.015, 0.55], [0.3, -0.4, 0.1])
}

#[test]
fn every_board_is_found_whole() {
    for target in [GRID, CHESS, CHARUCO] {
        let (found, errors) = see(&target, middling(), &Look::default(), "whole");
        println!("{errors:?} {:?} noise {:.2}", found.blur, found.noise_grey);
        assert_eq!(
            errors.found,
            target.corners().len(),
            "{target:?} {:?}",
            found.remark
        );
        assert!(errors.rms < 0.03, "{errors:?}");
    }
}
