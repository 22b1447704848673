use super::*;

const GRID: Target = Target::AprilGrid {
    columns: 3,
    rows: 2,
    tag_m: 0.08,
    spacing: 0.25,
    first_id: 10,
};
const CHESS: Target = Target::Chessboard {
    columns: 9,
    rows: 6,
    square_m: 0.03,
};
const CHARUCO: Target = Target::Charuco {
    columns: 5,
    rows: 4,
    square_m: 0.04,
    marker_m: 0.03,
    dictionary: Dictionary::Aruco4x4 { count: 50 },
    first_id: 0,
};

fn is_black_at(target: &Target, at: [f64; 2]) -> bool {
    let inside = |r: &&Rectangle| (0..2).all(|i| r.min_m[i] < at[i] && at[i] < r.max_m[i]);
    target.black().iter().filter(inside).count() == 1
}

#[test]
fn black_rectangles_do_not_overlap_and_stay_on_the_sheet() {
    for target in [GRID, CHESS, CHARUCO] {
        let black = target.black();
        let sheet = target.sheet_m();
        for (i, a) in black.iter().enumerate() {
            assert!((0..2).all(|k| a.min_m[k] > -1e-12 && a.max_m[k] < sheet.max_m[k]));
            for b in &black[..i] {
                let overlap = |k: usize| a.max_m[k].min(b.max_m[k]) - a.min_m[k].max(b.min_m[k]);
                assert!(overlap(0) < 1e-12 || overlap(1) < 1e-12, "{a:?} {b:?}");
            }
        }
    }
}

#[test]
fn every_corner_is_a_crossing_of_black_and_white() {
    for target in [GRID, CHESS, CHARUCO] {
        let d = 0.001;
        for corner in target.corners() {
            let [x, y] = corner.at_m;
            let around = [[-d, -d], [d, -d], [d, d], [-d, d]]
                .map(|[u, v]| is_black_at(&target, [x + u, y + v]));
            assert!(
                around == [true, false, true, false] || around == [false, true, false, true],
                "{corner:?}"
            );
        }
    }
}

/// Kalibr: tag 0 bottom left, corners of a tag counter-clockwise from its bottom left (y up).
#[test]
fn aprilgrid_ids_are_kalibrs() {
    let corners = GRID.corners();
    assert_eq!(corners.len(), 24);
    let at = |id: u32| {
        corners
            .iter()
            .find(|c| c.id == id)
            .unwrap()
            .at_m
            .map(|v| (v * 1e4).round() / 10.0)
    };
    assert_eq!(
        [at(40), at(41), at(42), at(43)],
        [[20.0, 200.0], [100.0, 200.0], [100.0, 120.0], [20.0, 120.0]]
    );
    assert_eq!(at(44), [120.0, 200.0]);
    assert_eq!(at(4 * 13), [20.0, 100.0]);
    assert_eq!(
        GRID.sheet_m().size_m().map(|v| (v * 1e3).round()),
        [360.0, 260.0]
    );
    // Code 10 is 0x34fe91b86: its first row 001101 begins behind two cells of border.
    let row: Vec<bool> = (0..10)
        .map(|i| {
            is_black_at(
                &GRID,
                [0.02 + (f64::from(i) + 0.5) * 0.008, 0.12 + 2.5 * 0.008],
            )
        })
        .collect();
    assert_eq!(row, [1, 1, 1, 1, 0, 0, 1, 0, 1, 1].map(|v| v == 1));
}

#[test]
fn charuco_is_opencvs() {
    let markers = CHARUCO.markers();
    assert_eq!(markers.len(), 10);
    let near = |found: [f64; 2], expected: [f64; 2]| {
        assert!(
            (0..2).all(|i| (found[i] - expected[i]).abs() < 1e-12),
            "{found:?} {expected:?}"
        );
    };
    // cv2.aruco.CharucoBoard((5, 4), 0.04, 0.03).getObjPoints() of OpenCV 5.0
    for (id, place) in [
        (0, [0.045, 0.005]),
        (1, [0.125, 0.005]),
        (2, [0.005, 0.045]),
        (3, [0.085, 0.045]),
    ] {
        assert_eq!(markers[id].id, id as u32);
        near(markers[id].place.min_m, place);
    }
    let corners = CHARUCO.corners();
    assert_eq!(corners.len(), 12);
    near(corners[4].at_m, [0.04, 0.08]);
    assert!(is_black_at(&CHARUCO, [0.02, 0.02]));
}

#[test]
fn symmetry_under_half_a_turn_is_detected() {
    let symmetric = |columns, rows| {
        Target::Chessboard {
            columns,
            rows,
            square_m: 0.1,
        }
        .is_rotationally_symmetric()
    };
    assert!(!symmetric(9, 6) && symmetric(8, 6) && symmetric(7, 7));
    assert!(!GRID.is_rotationally_symmetric());
}
