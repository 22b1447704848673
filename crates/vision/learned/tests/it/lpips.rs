//! An LPIPS network with a known output: the mean squared difference of two images.

use std::path::Path;

use learned::{ImageView, LearnedError, LpipsNetwork};

use crate::library::runtime;
use crate::onnx::{Attribute, F32, Graph};

const COLOR: [i64; 4] = [1, 3, -1, -1];

/// `(first - 2 second)²`, its mean over the axes; not symmetric, so that exchanged inputs show.
fn squares(folder: &Path, axes: &[i64]) -> std::path::PathBuf {
    let left = axes.iter().fold(COLOR, |mut shape, axis| {
        shape[*axis as usize] = 1;
        shape
    });
    Graph::default()
        .input("first", F32, &COLOR)
        .input("second", F32, &COLOR)
        .output("out", F32, &left)
        .real("two", 2.0)
        .node("Mul", &["second", "two"], "double", &[])
        .node("Sub", &["first", "double"], "difference", &[])
        .node("Mul", &["difference", "difference"], "square", &[])
        .node(
            "ReduceMean",
            &["square"],
            "out",
            &[Attribute::Values("axes", axes)],
        )
        .write(folder, "squares.onnx")
}

#[test]
fn distance_is_that_of_colors_from_minus_1_to_1() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let file = squares(folder.path(), &[1, 2, 3]);
    // 255 is 1, 0 is -1: no pixel is added by padding, whose mean would be another one.
    let (white, black) = ([255; 3 * 5 * 3], [0; 3 * 5 * 3]);
    let [white, black] = [&white, &black].map(|image| ImageView::rgb(5, 3, image).unwrap());
    let mut network = LpipsNetwork::open(&runtime, &file).unwrap();
    assert!((network.run(&white, &black).unwrap() - 9.0).abs() < 1e-5);
    assert!((network.run(&white, &white).unwrap() - 1.0).abs() < 1e-5);
    let half = [[255; 3], [0; 3], [0; 3], [0; 3]].concat();
    let half = ImageView::rgb(4, 1, &half).unwrap();
    assert!((network.run(&half, &half).unwrap() - 1.0).abs() < 1e-5);
    let hash = network.hash().to_owned();

    std::fs::write(
        file.with_extension("toml"),
        "input = { white = 1.0, mean = [] }\nlpips = { recorded = 'second' }",
    )
    .unwrap();
    let mut network = LpipsNetwork::open(&runtime, &file).unwrap();
    assert_ne!(network.hash(), hash);
    // (0 - 2)²
    assert!((network.run(&white, &black).unwrap() - 4.0).abs() < 1e-5);
}

#[test]
fn what_is_not_one_distance_is_an_error() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let file = squares(folder.path(), &[1]);
    let mut network = LpipsNetwork::open(&runtime, &file).unwrap();
    let image = [7; 2 * 2 * 3];
    let image = ImageView::rgb(2, 2, &image).unwrap();
    let error = network.run(&image, &image).unwrap_err().to_string();
    let expected = "output `out` is [1, 1, 2, 2], expected one f32";
    assert!(error.contains(expected), "{error}");
    let small = ImageView::rgb(1, 1, &[1, 2, 3]).unwrap();
    let error = network.run(&image, &small).unwrap_err();
    assert!(matches!(error, LearnedError::Image { .. }), "{error}");

    let fixed = Graph::default()
        .input("first", F32, &COLOR)
        .input("second", F32, &COLOR)
        .output("out", F32, &[1, 3, 1, 1])
        .node("GlobalAveragePool", &["first"], "out", &[])
        .write(folder.path(), "fixed.onnx");
    let error = LpipsNetwork::open(&runtime, &fixed)
        .unwrap_err()
        .to_string();
    assert!(error.contains("f32 of [1, 3, 1, 1]"), "{error}");

    let infinite = Graph::default()
        .input("first", F32, &COLOR)
        .input("second", F32, &COLOR)
        .output("out", F32, &[1, 1, 1, 1])
        .real("zero", 0.0)
        .node("GlobalAveragePool", &["first"], "mean", &[])
        .node(
            "ReduceMean",
            &["mean"],
            "one",
            &[Attribute::Values("axes", &[1])],
        )
        .node("Div", &["one", "zero"], "out", &[])
        .write(folder.path(), "infinite.onnx");
    let mut network = LpipsNetwork::open(&runtime, &infinite).unwrap();
    let error = network.run(&image, &image).unwrap_err().to_string();
    assert!(error.contains("-inf, expected one f32"), "{error}");
}
