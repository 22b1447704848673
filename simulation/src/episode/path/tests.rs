use super::*;

#[test]
fn positions_along_a_corner_are_exact() {
    let path = Path::new([[0.0; 3], [2.0, 0.0, 0.0], [2.0, 3.0, 0.0]]);
    assert_eq!(path.length_m(), 5.0);
    assert_eq!(path.at(3.0), Some([2.0, 1.0, 0.0]));
    assert_eq!(path.at(9.0), Some([2.0, 3.0, 0.0]));
    let near = path.nearest([1.0, 0.5, 0.0]).unwrap();
    assert_eq!((near.along_m, near.cross_track_m), (1.0, 0.5));
    let near = path.nearest([2.5, 1.0, 0.0]).unwrap();
    assert_eq!((near.along_m, near.cross_track_m), (3.0, 0.5));
}

#[test]
fn near_points_are_left_out_but_the_end_remains() {
    let points = (0..=105).map(|i| [0.01 * f64::from(i), 0.0, 0.0]);
    let path = Path::new(points);
    assert!((path.length_m() - 1.05).abs() < 1e-12);
    assert_eq!(path.at(path.length_m()).unwrap()[0], 1.05);
    assert!(path.points_m.len() <= 12);
}

#[test]
fn a_path_that_returns_is_followed_in_its_order() {
    // There and back, 5 cm beside itself.
    let path = Path::new([
        [0.0; 3],
        [10.0, 0.0, 0.0],
        [10.0, 0.05, 0.0],
        [0.0, 0.05, 0.0],
    ]);
    let mut along_m = 0.0;
    for step in 0..200 {
        let at = 0.1 * f64::from(step);
        let position = match at <= 10.0 {
            true => [at, 0.04, 0.0],
            false => [20.0 - at, 0.01, 0.0],
        };
        along_m = path.follow(position, along_m, 0.1).unwrap().along_m;
        // Where it returns, both directions are within the window.
        if (at - 10.0).abs() < 0.8 {
            along_m = at;
        }
        assert!((along_m - at).abs() < 0.11, "{at} {along_m}");
    }
}

#[test]
fn long_steps_are_followed() {
    let path = Path::new([[0.0; 3], [40.0, 0.0, 0.0]]);
    let mut along_m = 0.0;
    for step in 1..=20 {
        // 1.8 m: more than the window of short steps.
        let at_m = 1.8 * f64::from(step);
        let position = path.follow([at_m, 0.1, 0.0], along_m, 1.8).unwrap();
        along_m = position.along_m;
        assert!((along_m - at_m).abs() < 1e-9 && position.cross_track_m < 0.11);
    }
}

#[test]
fn without_pieces_there_are_no_positions() {
    for points in [vec![], vec![[1.0; 3]], vec![[1.0; 3]; 5]] {
        let path = Path::new(points.clone());
        if path.is_empty() {
            assert_eq!(path.nearest([0.0; 3]), None);
            assert_eq!(path.at(0.0), None);
            assert_eq!(path.follow([0.0; 3], 0.0, 0.1), None);
        } else {
            assert_eq!(path.length_m(), 0.0);
        }
    }
}
