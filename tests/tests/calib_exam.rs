//! Our calibration of real stereo pairs of a chessboard compared with OpenCV's, in one run.
//!
//! OpenCV detects its own corners and calibrates in its usual way. Both results are evaluated
//! equally: intrinsics and stereo extrinsics are fixed, the board's pose is estimated for every
//! pair of images, and the remaining residual is the RMS.

use std::path::{Path, PathBuf};
use std::process::Command;

use boards::Target;
use cad_transforms::RigidTransform;
use calib::adjust::{self, LensBlock, Point, PoseBlock, PosePrior, Problem, View};
use calib::cameras::{self, Calibration, Camera, Eye, Input, TargetDetection};
use calib::epipolar::Epipolar;
use calib::pnp;
use calib::target::{self, DetectedCorner, ImageView};
use camera_models::{CameraModel, Distortion, Provenance, StereoCalibration};
use serde_json::Value;

const COLUMNS: u32 = 9;
const ROWS: u32 = 6;
/// The side of a square is not known; only the baseline depends on it.
const SQUARE_M: f64 = 0.05;
const PAIRS: usize = 12;

fn board() -> Target {
    Target::Chessboard {
        columns: COLUMNS,
        rows: ROWS,
        square_m: SQUARE_M,
    }
}

/// Corners of every pair and eye, by id.
type Corners = Vec<[Vec<[f64; 2]>; 2]>;

fn our_corners(folder: &Path) -> Corners {
    let eye = |side: &str, number: usize| {
        let path = folder.join(format!("{side}{:02}.jpg", number + 1));
        let bytes = std::fs::read(&path).expect("an image");
        let options = zune_jpeg::zune_core::options::DecoderOptions::default()
            .jpeg_set_out_colorspace(zune_jpeg::zune_core::colorspace::ColorSpace::Luma);
        let mut decoder =
            zune_jpeg::JpegDecoder::new_with_options(std::io::Cursor::new(bytes), options);
        let pixels = decoder.decode().expect("a JPEG file");
        let info = decoder.info().expect("a size");
        let (width, height) = (usize::from(info.width), usize::from(info.height));
        let view = ImageView::new(width, height, width, &pixels).expect("a complete image");
        let found = target::detect(&view, &board(), &target::Config::default());
        assert_eq!(
            found.corners.len(),
            (COLUMNS * ROWS) as usize,
            "{}",
            path.display()
        );
        found.corners.iter().map(|c| c.pixel).collect()
    };
    (0..PAIRS)
        .map(|n| [eye("left", n), eye("right", n)])
        .collect()
}

/// OpenCV counts from either end of the board; ours from the upper left in the image.
fn in_our_order(theirs: &Value, ours: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut corners: Vec<[f64; 2]> = serde_json::from_value(theirs.clone()).expect("corners");
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    if apart(corners[0], ours[0]) > apart(corners[corners.len() - 1], ours[0]) {
        corners.reverse();
    }
    assert!(
        apart(corners[0], ours[0]) < 2.0,
        "{:?} {:?}",
        corners[0],
        ours[0]
    );
    corners
}

fn input(corners: &Corners, pairs: &[usize]) -> Input {
    let eyes = ["left", "right"].map(|name| Eye {
        name: name.to_owned(),
        size: (640, 512),
        factory: None,
    });
    let mut detections = Vec::new();
    for (instant, &pair) in pairs.iter().enumerate() {
        for (eye, seen) in corners[pair].iter().enumerate() {
            let corners = seen.iter().zip(0..);
            let corners = corners.map(|(pixel, id)| DetectedCorner {
                id,
                pixel: *pixel,
                sigma_px: 0.05,
            });
            detections.push(TargetDetection {
                instant,
                eye,
                target: 0,
                corners: corners.collect(),
            });
        }
    }
    Input {
        eyes: eyes.to_vec(),
        cameras: vec![Camera {
            name: "pair".to_owned(),
            left: 0,
            right: Some(1),
            left_from_right: None,
            rig_from_left: None,
        }],
        targets: vec![board()],
        times_ns: (0..pairs.len() as i64).map(|i| i * 1_000_000_000).collect(),
        detections,
    }
}

/// Intrinsics and `left_from_right`.
type Stereo = ([CameraModel; 2], RigidTransform);

fn ours(corners: &Corners, pairs: &[usize]) -> (Stereo, Calibration) {
    let config = cameras::Config::default();
    let found =
        cameras::calibrate(input(corners, pairs), &config, &mut |_, _| {}).expect("a result");
    let pair = found.pose(found.poses.pairs[0].expect("a pair")).0;
    (([*found.lens(0), *found.lens(1)], pair), found)
}

fn theirs(found: &Value) -> Stereo {
    let numbers =
        |key: &str| -> Vec<f64> { serde_json::from_value(found[key].clone()).expect(key) };
    let lens = |key: &str| {
        let p = numbers(key);
        CameraModel {
            width: 640,
            height: 512,
            fx: p[0],
            fy: p[1],
            cx: p[2],
            cy: p[3],
            distortion: Distortion::RadTan5 {
                k1: p[4],
                k2: p[5],
                p1: p[6],
                p2: p[7],
                k3: p[8],
            },
        }
    };
    let rows = numbers("rotation_rows").try_into().expect("nine");
    let at = numbers("translation_m").try_into().expect("three");
    let right_from_left = RigidTransform::from_rotation_rows(rows, at).expect("a rotation");
    ([lens("left"), lens("right")], right_from_left.inverse())
}

/// RMS over pairs that may be held out from the calibration, px.
fn left_over((lenses, left_from_right): &Stereo, corners: &Corners, pairs: &[usize]) -> f64 {
    let known = board().corners();
    let mut problem = Problem {
        lenses: lenses.iter().map(|m| LensBlock::fixed("", *m)).collect(),
        poses: vec![PoseBlock {
            name: String::new(),
            parent_from_child: *left_from_right,
            prior: PosePrior::Fixed,
        }],
        ..Problem::default()
    };
    for (instant, &pair) in pairs.iter().enumerate() {
        for (eye, seen) in corners[pair].iter().enumerate() {
            let points: Vec<Point> = seen
                .iter()
                .zip(&known)
                .map(|(pixel, corner)| Point {
                    x_in_target: [corner.at_m[0], corner.at_m[1], 0.0],
                    pixel: *pixel,
                    sigma_px: 0.1,
                })
                .collect();
            if eye == 0 {
                let placed =
                    pnp::planar(&lenses[0], &points, &pnp::Config::default()).expect("a pose");
                problem.instants.push(placed.eye_from_target);
            }
            problem.views.push(View {
                instant,
                lens: eye,
                path: if eye == 0 { Vec::new() } else { vec![0] },
                target: None,
                points,
            });
        }
    }
    // No robust loss, as in OpenCV.
    let mut config = adjust::Config::default();
    config.huber_sigma = 1e9;
    config.covariance = false;
    adjust::solve(&problem, &config)
        .expect("poses")
        .rms_px(|_| true)
}

/// Mean and 95th percentile of the row differences of corners, px.
fn row_differences(
    lenses: &[CameraModel; 2],
    left_from_right: &RigidTransform,
    corners: &Corners,
) -> (f64, f64) {
    let stereo = StereoCalibration {
        left: lenses[1],
        right: lenses[0],
        right_from_left: *left_from_right,
        imu: None,
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    };
    let epipolar = Epipolar::new(&stereo).expect("a pair side by side");
    let rows = corners
        .iter()
        .flat_map(|[left, right]| left.iter().zip(right));
    let rows = rows.filter_map(|(l, r)| epipolar.row_difference(*r, *l));
    let mut rows: Vec<f64> = rows.map(f64::abs).collect();
    rows.sort_by(f64::total_cmp);
    let mean = rows.iter().sum::<f64>() / rows.len() as f64;
    (mean, rows[rows.len() * 95 / 100])
}

#[test]
fn real_chessboard_pairs_agree_with_opencv() {
    let Some(python) = std::env::var_os("PAWS_PYTHON").map(PathBuf::from) else {
        eprintln!("skipped: PAWS_PYTHON names no interpreter with OpenCV");
        return;
    };
    let folder = harness::data::folder().map(|f| f.join("06_calibration/stereo_chessboard_rigB"));
    let Some(folder) = folder.filter(|f| f.is_dir()) else {
        eprintln!("skipped: no real data with 06_calibration/stereo_chessboard_rigB");
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/calib_exam.py");
    let output = Command::new(python)
        .args([&script, &folder])
        .args([COLUMNS.to_string(), ROWS.to_string(), SQUARE_M.to_string()])
        .output()
        .expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "the reference script failed: {errors}"
    );
    let opencv: Value = serde_json::from_slice(&output.stdout).expect("JSON");

    let corners = our_corners(&folder);
    let their_corners: Corners = (0..PAIRS)
        .map(|n| [0, 1].map(|eye| in_our_order(&opencv["corners"][n][eye], &corners[n][eye])))
        .collect();
    let all: Vec<usize> = (0..PAIRS).collect();
    let (even, odd): (Vec<usize>, Vec<usize>) = all.iter().partition(|n| **n % 2 == 0);

    // All pairs: each method evaluated with its own corners, and ours with OpenCV's corners.
    let (stereo, found) = ours(&corners, &all);
    let our_rms = found.solution.rms_px(|_| true);
    let their_rms = opencv["all"]["rms_px"].as_f64().expect("a number");
    println!("stereo RMS: ours {our_rms:.4} px, OpenCV {their_rms:.4} px");
    assert!(our_rms <= their_rms, "{our_rms} {their_rms}");
    let judged = left_over(&theirs(&opencv["all"]), &their_corners, &all);
    assert!(
        (judged - their_rms).abs() < 0.02 * their_rms,
        "{judged} {their_rms}"
    );

    // Corners of a pair share a row after rectification. The files name the eyes in reverse.
    let (lenses, left_from_right) = stereo;
    let (by_rows, p95) = row_differences(&lenses, &left_from_right, &corners);
    println!("row difference after rectification: mean {by_rows:.4} px, 95 % below {p95:.4} px");
    assert!(by_rows <= 0.12, "{by_rows}");

    // Halves, evaluated on the other half.
    for (name, train, test) in [("even", &even, &odd), ("odd", &odd, &even)] {
        let (own, _) = ours(&corners, train);
        let other = theirs(&opencv[name]);
        for (whose, judge) in [("our", &corners), ("OpenCV's", &their_corners)] {
            let (a, b) = (left_over(&own, judge, test), left_over(&other, judge, test));
            println!(
                "from the {name} half, the other half by {whose} corners: ours {a:.4} px, OpenCV {b:.4} px"
            );
            assert!(a < b, "{a} {b}");
        }
    }
}
