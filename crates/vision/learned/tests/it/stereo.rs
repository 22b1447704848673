//! Stereo networks with a known output.

use std::path::{Path, PathBuf};

use learned::{ImageView, LearnedError, Runtime, StereoNetwork};

use crate::library::runtime;
use crate::onnx::{Attribute, F32, Graph, U8};

const SHIFTS: usize = 16;

/// Block matching as a network: the mean absolute difference over 5x5 pixels for shifts of 0 to 15
/// px, and the shift with the minimum, negated to be a flow. Three channels of any size, like
/// RAFT-Stereo.
fn block_matching(folder: &Path) -> PathBuf {
    let mut graph = Graph::default()
        .input("left", F32, &[1, 3, -1, -1])
        .input("right", F32, &[1, 3, -1, -1])
        .output("flow", F32, &[1, 1, -1, -1])
        .numbers("from", &[0])
        .numbers("axis", &[3])
        .real("minus", -1.0);
    let costs: Vec<String> = (0..SHIFTS).map(|k| format!("cost{k}")).collect();
    for (k, cost) in costs.iter().enumerate() {
        let name = |what: &str| format!("{what}{k}");
        let shift = k as i64;
        let to = if k == 0 { i64::MAX } else { -shift };
        graph = graph
            .numbers(&name("pads"), &[0, 0, 0, shift, 0, 0, 0, 0])
            .numbers(&name("to"), &[to])
            .node(
                "Pad",
                &["right", &name("pads")],
                &name("wide"),
                &[Attribute::Text("mode", "edge")],
            )
            .node(
                "Slice",
                &[&name("wide"), "from", &name("to"), "axis"],
                &name("shifted"),
                &[],
            )
            .node("Sub", &["left", &name("shifted")], &name("difference"), &[])
            .node("Abs", &[&name("difference")], &name("absolute"), &[])
            .node(
                "ReduceMean",
                &[&name("absolute")],
                &name("grey"),
                &[Attribute::Values("axes", &[1])],
            )
            .node(
                "AveragePool",
                &[&name("grey")],
                cost,
                &[
                    Attribute::Values("kernel_shape", &[5, 5]),
                    Attribute::Values("pads", &[2, 2, 2, 2]),
                ],
            );
    }
    let costs: Vec<&str> = costs.iter().map(String::as_str).collect();
    graph
        .node("Concat", &costs, "costs", &[Attribute::Number("axis", 1)])
        .node(
            "ArgMin",
            &["costs"],
            "best",
            &[Attribute::Number("axis", 1)],
        )
        .node(
            "Cast",
            &["best"],
            "shift",
            &[Attribute::Number("to", F32 as i64)],
        )
        .node("Mul", &["shift", "minus"], "flow", &[])
        .write(folder, "block-matching.onnx")
}

/// `left - right` of one channel, as `[1, rows, columns]`.
fn difference(kind: u64, rows: i64, columns: i64) -> Graph {
    Graph::default()
        .input("second", kind, &[1, 1, rows, columns])
        .input("first", kind, &[1, 1, rows, columns])
        .output("out", F32, &[1, rows, columns])
        .numbers("axes", &[1])
        .node(
            "Cast",
            &["first"],
            "a",
            &[Attribute::Number("to", F32 as i64)],
        )
        .node(
            "Cast",
            &["second"],
            "b",
            &[Attribute::Number("to", F32 as i64)],
        )
        .node("Sub", &["a", "b"], "difference", &[])
        .node("Squeeze", &["difference", "axes"], "out", &[])
}

fn with_settings(network: &Path, settings: &str) {
    std::fs::write(network.with_extension("toml"), settings).unwrap();
}

fn noise(x: usize, y: usize) -> u8 {
    let mut h = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    h ^= h >> 29;
    h = h.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (h >> 56) as u8
}

const WIDTH: usize = 90;
const HEIGHT: usize = 50;

/// Whether a pixel of the left image is on the near wall.
fn near(x: usize, y: usize) -> bool {
    (50..80).contains(&x) && (12..38).contains(&y)
}

/// A wall with random texture at 4 px, and a near one in front of it at 11 px.
fn walls() -> [Vec<u8>; 2] {
    let pixels = || (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    let at = |x: usize, y, near| noise(x + if near { 1000 } else { 0 }, y);
    let left = pixels().map(|(x, y)| at(x, y, near(x, y)));
    let right = pixels().map(|(x, y)| {
        if near(x + 11, y) {
            at(x + 11, y, true)
        } else {
            at(x + 4, y, false)
        }
    });
    [left.collect(), right.collect()]
}

fn run(network: &mut StereoNetwork, pair: &[Vec<u8>; 2]) -> depth::DisparityMap {
    let [left, right] = pair
        .each_ref()
        .map(|p| ImageView::from(depth::ImageView::packed(WIDTH, HEIGHT, p).unwrap()));
    network.run(&left, &right).unwrap()
}

fn matcher(runtime: &Runtime, folder: &Path, settings: &str) -> StereoNetwork {
    let network = block_matching(folder);
    with_settings(&network, settings);
    StereoNetwork::open(runtime, &network).unwrap()
}

/// Disparity of a pixel whose 5x5 window is on one wall; `None` near the edges.
fn inside(x: usize, y: usize) -> Option<f32> {
    let all = |f: &dyn Fn(usize, usize) -> bool| {
        (y.saturating_sub(2)..=y + 2).all(|y| (x.saturating_sub(2)..=x + 2).all(|x| f(x, y)))
    };
    if all(&near) {
        return Some(11.0);
    }
    // Visible in the right camera too, and not occluded by the near wall there.
    let seen = |x: usize, y: usize| (4..WIDTH).contains(&x) && !near(x, y) && !near(x + 7, y);
    all(&seen).then_some(4.0)
}

#[test]
fn known_shift_is_found() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let mut network = matcher(
        &runtime,
        folder.path(),
        "[stereo]\nboth_ways = false\nsigma_px = 0.7",
    );
    let map = run(&mut network, &walls());
    assert_eq!((map.width, map.height), (WIDTH, HEIGHT));
    let mut compared = 0;
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let at = y * WIDTH + x;
            let found = map.disparity[at];
            if let Some(expected) = inside(x, y) {
                assert_eq!((found, map.sigma[at]), (expected, 0.7), "{x} {y}");
                compared += 1;
            }
            assert!(
                found.is_nan() || found <= x as f32,
                "{x} {y}: outside the right image"
            );
        }
    }
    assert!(compared > WIDTH * HEIGHT / 2, "{compared}");
}

#[test]
fn left_right_check_removes_occluded_pixels() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let mut network = matcher(&runtime, folder.path(), "[stereo]\nsigma_px = 0.25");
    let map = run(&mut network, &walls());
    let (mut right, mut compared) = (0, 0);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let (found, sigma) = (map.disparity[y * WIDTH + x], map.sigma[y * WIDTH + x]);
            assert_eq!(found.is_nan(), sigma.is_nan());
            if let Some(expected) = inside(x, y) {
                compared += 1;
                right += usize::from(found == expected);
                assert!(found.is_nan() || found == expected, "{x} {y}: {found}");
                // Both directions are exact here, so that little is added to the configured sigma.
                assert!(
                    found.is_nan() || (0.25..0.45).contains(&sigma),
                    "{x} {y}: {sigma}"
                );
            }
        }
    }
    assert!(right * 100 > compared * 98, "{right} of {compared}");
    // The strip left of the near wall is hidden from the right camera.
    let hidden = (14..36).flat_map(|y| (43..50).map(move |x| (x, y)));
    let invented = hidden
        .filter(|(x, y)| !map.disparity[y * WIDTH + x].is_nan())
        .count();
    assert!(invented * 10 < 22 * 7, "{invented} of {}", 22 * 7);
}

#[test]
fn same_images_give_the_same_bytes() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let mut first = matcher(&runtime, folder.path(), "");
    let mut second = matcher(&runtime, folder.path(), "");
    assert_eq!(first.hash(), second.hash());
    let bits = |network: &mut StereoNetwork| -> Vec<u32> {
        let map = run(network, &walls());
        map.disparity
            .iter()
            .chain(&map.sigma)
            .map(|v| v.to_bits())
            .collect()
    };
    let once = bits(&mut first);
    assert_eq!(once, bits(&mut first));
    assert_eq!(once, bits(&mut second));
    let other = matcher(&runtime, folder.path(), "[stereo]\nsigma_px = 0.4");
    assert_ne!(first.hash(), other.hash(), "settings are part of what runs");
}

#[test]
fn inputs_are_normalized_as_configured() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let network = difference(F32, -1, -1).write(folder.path(), "difference.onnx");
    let settings = "input = { white = 1.0, mean = [0.5], std = [0.25], multiple = 8 }\n\
                    stereo = { left = 'first', factor = 0.5, both_ways = false }";
    with_settings(&network, settings);
    let mut network = StereoNetwork::open(&runtime, &network).unwrap();
    let left: Vec<u8> = (0..5 * 3).map(|i| 200 + i).collect();
    let right = [50; 5 * 3];
    let map = network
        .run(
            &ImageView::gray(5, 3, &left).unwrap(),
            &ImageView::gray(5, 3, &right).unwrap(),
        )
        .unwrap();
    for (i, found) in map.disparity.iter().enumerate() {
        let expected = 0.5 * (150.0 + i as f32) / 255.0 / 0.25;
        // Disparities below 0 or larger than the column map outside the right image.
        if (i % 5) as f32 >= expected {
            assert!(
                (found - expected).abs() < 1e-5,
                "{i}: {found}, expected {expected}"
            );
        } else {
            assert!(found.is_nan(), "{i}: {found}");
        }
    }
    assert_eq!(map.disparity.iter().filter(|d| !d.is_nan()).count(), 9);
}

#[test]
fn images_are_padded_by_repeating_the_border() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    // The mean over 5x5 pixels of the left image; the right one is black.
    let network = Graph::default()
        .input("left", F32, &[1, 1, -1, -1])
        .input("right", F32, &[1, 1, -1, -1])
        .output("out", F32, &[1, 1, -1, -1])
        .node("Sub", &["left", "right"], "difference", &[])
        .node(
            "AveragePool",
            &["difference"],
            "out",
            &[
                Attribute::Values("kernel_shape", &[5, 5]),
                Attribute::Values("pads", &[2, 2, 2, 2]),
            ],
        )
        .write(folder.path(), "mean.onnx");
    with_settings(
        &network,
        "input = { multiple = 8 }\nstereo = { factor = 0.5, both_ways = false }",
    );
    let mut network = StereoNetwork::open(&runtime, &network).unwrap();
    let left: Vec<u8> = (0..3).flat_map(|y| (0..9).map(move |x| x + y)).collect();
    let black = [0; 9 * 3];
    let [l, r] = [&left[..], &black[..]].map(|p| ImageView::gray(9, 3, p).unwrap());
    let map = network.run(&l, &r).unwrap();
    // Mean over the columns 6, 7, 8, 8, 8 and the rows 0, 1, 2, 2, 2.
    let corner = map.disparity[9 * 3 - 1];
    assert!((corner - 0.5 * (7.4 + 1.4)).abs() < 1e-5, "{corner}");
}

#[test]
fn network_of_a_fixed_size_takes_smaller_byte_images() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let network = difference(U8, 4, 6).write(folder.path(), "bytes.onnx");
    with_settings(
        &network,
        "stereo = { right = 'second', factor = 1.0, both_ways = false }",
    );
    let mut network = StereoNetwork::open(&runtime, &network).unwrap();
    // RGB (3, 3, 3) is also gray level 3, which the network takes.
    let left = [3; 5 * 3 * 3];
    let right: Vec<u8> = (0..5 * 3).map(|i| 3 - (i % 3) as u8).collect();
    let [l, r] = [
        ImageView::rgb(5, 3, &left).unwrap(),
        ImageView::gray(5, 3, &right).unwrap(),
    ];
    let map = network.run(&l, &r).unwrap();
    for (i, found) in map.disparity.iter().enumerate() {
        let expected = (i % 3) as f32;
        let there = (i % 5) as f32 >= expected;
        assert_eq!(found.is_nan(), !there, "{i}: {found}");
        assert!(!there || *found == expected, "{i}: {found}");
    }
    let large = [0; 7 * 3];
    let large = ImageView::gray(7, 3, &large).unwrap();
    let error = network.run(&large, &large).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("7 x 3 pixels, expected at most what the network takes, 6 x 4"),
        "{error}"
    );
    let error = network.run(&l, &large).unwrap_err();
    assert!(matches!(error, LearnedError::Image { .. }), "{error}");
}
