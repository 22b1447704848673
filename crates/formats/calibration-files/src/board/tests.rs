use super::*;
use crate::test_data::Folder;

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

#[test]
fn files_round_trip() {
    let folder = Folder::new();
    for (i, target) in [GRID, CHESS, CHARUCO].iter().enumerate() {
        let path = folder.file(&format!("{i}.toml"), &to_toml(target));
        assert_eq!(&read(&path).unwrap(), target);
    }
    let grid = Target::AprilGrid {
        columns: 6,
        rows: 5,
        tag_m: 0.088,
        spacing: 0.3,
        first_id: 0,
    };
    for target in [CHESS, grid] {
        let path = folder.file("kalibr.yaml", &to_kalibr(&target).unwrap());
        assert_eq!(read(&path).unwrap(), target);
    }
    assert_eq!((to_kalibr(&GRID), to_kalibr(&CHARUCO)), (None, None));
}

#[test]
fn wrong_files_are_named_with_line_and_key() {
    let folder = Folder::new();
    let april = "kind = \"aprilgrid\"\ncolumns = 6\nrows = 6\ntag_m = 0.088\nspacing = 0.3\n";
    let charuco = to_toml(&CHARUCO);
    let kalibr = "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n";
    let checker = to_kalibr(&CHESS).unwrap();
    for (name, text, expected) in [
        (
            "a.toml",
            april.replace("0.088", "88.0"),
            "line 4: found \"tag_m = 88\", expected 88, expected metres",
        ),
        ("a.toml", april.replace("0.088", "0,088"), "line 4"),
        (
            "a.toml",
            april.replace("0.088", "nan"),
            "line 4: found \"tag_m = nan\", expected tag_m as a finite number",
        ),
        (
            "a.toml",
            april.replace("columns = 6", "columns = 6.5"),
            "line 2: found \"columns = 6.5\"",
        ),
        (
            "a.toml",
            april.replace("columns = 6", "columns = -6"),
            "line 2: found \"columns = -6\"",
        ),
        (
            "a.toml",
            april.replace("columns = 6", "columns = 99"),
            "but 36H11 has 587",
        ),
        (
            "a.toml",
            april.replace("rows = 6\n", ""),
            "rows is missing, found",
        ),
        (
            "a.toml",
            april.replace("spacing", "tag_spacing"),
            "line 5: found \"tag_spacing\", expected only the keys",
        ),
        (
            "a.toml",
            april.replace("aprilgrid", "apriltag"),
            "line 1: found \"apriltag\"",
        ),
        ("a.toml", String::new(), "kind is missing, found no key"),
        (
            "a.toml",
            charuco.replace("4X4_50", "4X4_60"),
            "expected dictionary, one of 4X4_50",
        ),
        ("a.toml", charuco.replace("0.03", "0.05"), "marker_m"),
        (
            "a.yaml",
            kalibr.replace("0.088", "88"),
            "line 4: found \"tagSize: 88\"",
        ),
        (
            "a.yaml",
            kalibr.replace("0.088", "0,088"),
            "line 4: found \"0,088\", expected tagSize as a decimal point",
        ),
        (
            "a.yaml",
            kalibr.replace("tagCols: 6", "tagCols: six"),
            "line 2: found \"six\", expected tagCols",
        ),
        (
            "a.yaml",
            kalibr.replace("tagSpacing: 0.3\n", ""),
            "tagSpacing is missing",
        ),
        (
            "a.yaml",
            kalibr.replace("aprilgrid", "circlegrid"),
            "line 1: found \"circlegrid\"",
        ),
        (
            "a.yaml",
            checker.replace("colSpacingMeters: 0.03", "colSpacingMeters: 0.04"),
            "expected squares: both alike",
        ),
    ] {
        let path = folder.file(name, &text);
        let error = read(&path).expect_err(&text).to_string();
        assert!(
            error.contains(expected) && error.contains(name),
            "found {error:?}, expected {expected:?}"
        );
    }
}
