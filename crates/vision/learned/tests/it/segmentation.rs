//! Segmentation networks with a known output: the class of a pixel is its strongest color.

use std::path::{Path, PathBuf};

use learned::{ImageView, Runtime, SegmentationNetwork};

use crate::library::runtime;
use crate::onnx::{Attribute, F32, Graph, I64};

const WIDTH: usize = 45;
const HEIGHT: usize = 30;
/// Side length of an output cell, px.
const SIDE: usize = 4;

/// Mean of each color over cells of 4x4 pixels.
fn scores() -> Graph {
    Graph::default().input("image", F32, &[1, 3, -1, -1]).node(
        "AveragePool",
        &["image"],
        "scores",
        &[
            Attribute::Values("kernel_shape", &[4, 4]),
            Attribute::Values("strides", &[4, 4]),
        ],
    )
}

fn open(runtime: &Runtime, network: &Path, settings: &str) -> SegmentationNetwork {
    std::fs::write(network.with_extension("toml"), settings).unwrap();
    SegmentationNetwork::open(runtime, network).unwrap()
}

fn blue(x: usize, y: usize) -> bool {
    (8..24).contains(&x) && (12..HEIGHT).contains(&y)
}

/// Green, with blue in the middle.
fn image() -> Vec<u8> {
    let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    pixels
        .flat_map(|(x, y)| if blue(x, y) { [0, 0, 200] } else { [0, 200, 0] })
        .collect()
}

fn with_scores(folder: &Path) -> PathBuf {
    scores()
        .output("scores", F32, &[1, 3, -1, -1])
        .write(folder, "scores.onnx")
}

fn with_classes(folder: &Path) -> PathBuf {
    scores()
        .node(
            "ArgMax",
            &["scores"],
            "classes",
            &[
                Attribute::Number("axis", 1),
                Attribute::Number("keepdims", 0),
            ],
        )
        .output("classes", I64, &[1, -1, -1])
        .write(folder, "classes.onnx")
}

#[test]
fn masked_classes_are_found_at_their_pixels() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let values = image();
    let image = ImageView::rgb(WIDTH, HEIGHT, &values).unwrap();
    let networks = [
        (with_scores(folder.path()), "enlarge = 'nearest'"),
        (with_scores(folder.path()), "enlarge = 'bilinear'"),
        (with_classes(folder.path()), ""),
    ];
    for (file, enlarge) in networks {
        let settings = format!("[segmentation]\n{enlarge}\nmasked = {{ water = 2 }}");
        let mut network = open(&runtime, &file, &settings);
        let mask = network.run(&image).unwrap();
        assert_eq!((mask.width, mask.height), (WIDTH, HEIGHT));
        // The edges of the blue area coincide with cell borders, so that even the bilinear result
        // changes exactly there, except at two corners.
        for (at, found) in mask.movable.iter().enumerate() {
            let (x, y) = (at % WIDTH, at / WIDTH);
            let rounded = enlarge.contains("bilinear") && [(8, 12), (23, 12)].contains(&(x, y));
            assert_eq!(*found, blue(x, y) && !rounded, "{enlarge} {x} {y}");
        }
        let settings = format!("[segmentation]\n{enlarge}\nmasked = {{ grass = 1, fire = 0 }}");
        let mut other = open(&runtime, &file, &settings);
        let others = other.run(&image).unwrap();
        assert!(
            others
                .movable
                .iter()
                .zip(&mask.movable)
                .all(|(a, b)| a != b)
        );
    }
}

#[test]
fn bilinear_scores_move_an_edge_within_a_cell() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    // All rows are equal; the third cell is a quarter blue: blue minus green is -200, -200, -100,
    // 200, 200, ... from cell to cell.
    let row: Vec<u8> = (0..32)
        .flat_map(|x| if x >= 11 { [0, 0, 200] } else { [0, 200, 0] })
        .collect();
    let values = row.repeat(32);
    let image = ImageView::rgb(32, 32, &values).unwrap();
    let first = |enlarge: &str| {
        let settings = format!("[segmentation]\nenlarge = '{enlarge}'\nmasked = {{ water = 2 }}");
        let mut network = open(&runtime, &with_scores(folder.path()), &settings);
        network.run(&image).unwrap().movable[..32]
            .iter()
            .position(|m| *m)
    };
    assert_eq!(first("nearest"), Some(3 * SIDE));
    // The centers of the third and fourth cell are at 9.5 and 13.5; the difference is 0 at one
    // third between them, at 10.83.
    assert_eq!(first("bilinear"), Some(11));
}

#[test]
fn gray_image_fills_all_channels() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    // With the means subtracted, blue is the strongest channel of gray.
    let settings =
        "[input]\nwhite = 1.0\nmean = [0.3, 0.2, 0.1]\n[segmentation]\nmasked = { water = 2 }";
    let mut network = open(&runtime, &with_scores(folder.path()), settings);
    let values = [77; 20 * 10];
    let mask = network
        .run(&ImageView::gray(20, 10, &values).unwrap())
        .unwrap();
    assert!(mask.movable.iter().all(|m| *m));
}
