//! Unsuitable networks and settings are rejected with an error that states what was found and
//! expected.

use std::error::Error;
use std::path::Path;

use learned::{ImageView, LearnedError, SegmentationNetwork, StereoNetwork};

use crate::library::runtime;
use crate::onnx::{Attribute, F32, Graph, I64};

/// A graph with these inputs that outputs the first one.
fn inputs(kinds: &[(u64, &[i64])]) -> Graph {
    let names = ["a", "b", "c"];
    let graph = names
        .iter()
        .zip(kinds)
        .fold(Graph::default(), |g, (name, (kind, shape))| {
            g.input(name, *kind, shape)
        });
    graph.node("Identity", &["a"], "out", &[])
}

const IMAGE: (u64, &[i64]) = (F32, &[1, 1, -1, -1]);

fn check(error: &LearnedError, parts: &[&str], file: &Path) {
    let text = error.to_string();
    let missing = parts.iter().find(|part| !text.contains(**part));
    assert!(missing.is_none(), "no {missing:?} in {text}");
    assert!(text.ends_with(&file.display().to_string()), "{text}");
}

#[test]
fn unsuitable_inputs_and_outputs_are_rejected() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let image = |graph: Graph| graph.output("out", F32, IMAGE.1);
    let cases: [(Graph, &[&str]); 10] = [
        (
            image(inputs(&[IMAGE])),
            &["number of inputs", "1 (`a`)", "expected 2"],
        ),
        (
            image(inputs(&[IMAGE; 3])),
            &["3 (`a`, `b`, `c`)", "expected 2"],
        ),
        (
            image(inputs(&[IMAGE, (I64, IMAGE.1)])),
            &["input `b`", "i64 of [1, 1, ?, ?]", "f32 or u8"],
        ),
        (
            image(inputs(&[IMAGE, (F32, &[1, 1, 1, -1, 64])])),
            &[
                "input `b`",
                "f32 of [1, 1, 1, ?, 64]",
                "[1, 1 or 3 channels, rows, columns]",
            ],
        ),
        (
            image(inputs(&[IMAGE, (F32, &[1, 2, -1, -1])])),
            &["input `b`", "[1, 2, ?, ?]"],
        ),
        (
            image(inputs(&[IMAGE, (F32, &[4, 1, -1, -1])])),
            &["input `b`", "[4, 1, ?, ?]"],
        ),
        (
            image(inputs(&[IMAGE, (F32, &[1, 1, 64, 64])])),
            &["two sizes, of `a` and `b`"],
        ),
        (
            image(inputs(&[IMAGE; 2]))
                .node("Abs", &["b"], "more", &[])
                .output("more", F32, IMAGE.1),
            &[
                "list of outputs",
                "`out`, `more`",
                "name of one in the settings",
            ],
        ),
        (
            inputs(&[IMAGE; 2])
                .node(
                    "Cast",
                    &["out"],
                    "whole",
                    &[Attribute::Number("to", I64 as i64)],
                )
                .output("whole", I64, IMAGE.1),
            &[
                "output `whole`",
                "i64 of [1, 1, ?, ?]",
                "f32 of [1, 1, rows, columns]",
            ],
        ),
        (
            inputs(&[IMAGE; 2])
                .node(
                    "Concat",
                    &["a", "b"],
                    "two",
                    &[Attribute::Number("axis", 1)],
                )
                .output("two", F32, &[1, 2, -1, -1]),
            &["output `two`", "f32 of [1, 2, ?, ?]"],
        ),
    ];
    for (place, (graph, parts)) in cases.into_iter().enumerate() {
        let file = graph.write(folder.path(), &format!("{place}.onnx"));
        let error = StereoNetwork::open(&runtime, &file).unwrap_err();
        assert!(
            matches!(error, LearnedError::Tensor { .. }),
            "{place}: {error}"
        );
        check(&error, parts, &file);
    }
}

#[test]
fn invalid_network_file_is_rejected() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let file = folder.path().join("missing.onnx");
    let error = StereoNetwork::open(&runtime, &file).unwrap_err();
    assert!(matches!(error, LearnedError::Read { .. }), "{error}");
    check(&error, &["reading a network"], &file);
    let garbage: Vec<u8> = (0..4000_u32).map(|i| ((i * i) >> 3) as u8).collect();
    for bytes in [&garbage[..], b"", b"<html>not found</html>"] {
        std::fs::write(&file, bytes).unwrap();
        let error = StereoNetwork::open(&runtime, &file).unwrap_err();
        assert!(matches!(error, LearnedError::Model { .. }), "{error}");
        assert!(error.source().is_some());
        check(&error, &["expected an ONNX model"], &file);
    }
    let unknown = inputs(&[IMAGE; 2])
        .node("NoSuchOperator", &["a"], "x", &[])
        .output("x", F32, IMAGE.1);
    let file = unknown.write(folder.path(), "unknown.onnx");
    let error = StereoNetwork::open(&runtime, &file).unwrap_err();
    assert!(matches!(error, LearnedError::Model { .. }), "{error}");
}

#[test]
fn output_of_another_size_is_rejected() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let half = inputs(&[IMAGE; 2])
        .node(
            "AveragePool",
            &["a"],
            "half",
            &[
                Attribute::Values("kernel_shape", &[2, 2]),
                Attribute::Values("strides", &[2, 2]),
            ],
        )
        .output("half", F32, IMAGE.1);
    let file = half.write(folder.path(), "half.onnx");
    let mut network = StereoNetwork::open(&runtime, &file).unwrap();
    let values = [0; 40 * 30];
    let image = ImageView::gray(40, 30, &values).unwrap();
    let error = network.run(&image, &image).unwrap_err();
    check(
        &error,
        &[
            "output `half`",
            "[1, 1, 16, 32] for inputs of 32 rows and 64 columns",
        ],
        &file,
    );
}

#[test]
fn settings_that_contradict_the_network_are_rejected() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let file = inputs(&[IMAGE; 2])
        .output("out", F32, IMAGE.1)
        .write(folder.path(), "network.onnx");
    let settings = file.with_extension("toml");
    let cases: [(&str, &[&str]); 4] = [
        (
            "input = { mean = [0.1, 0.2, 0.3] }",
            &["mean = [0.1, 0.2, 0.3]", "each of 1 channels"],
        ),
        (
            "stereo = { left = 'a', right = 'a' }",
            &["one name for both"],
        ),
        ("stereo = { sigma_px = -1.0 }", &["sigma_px = -1"]),
        ("segmentation = { masked = { person = 1 } }", &[]),
    ];
    for (text, parts) in cases {
        std::fs::write(&settings, text).unwrap();
        check(
            &StereoNetwork::open(&runtime, &file).unwrap_err(),
            parts,
            &settings,
        );
    }
    for text in ["stereo = { left = 'z' }", "stereo = { output = 'z' }"] {
        std::fs::write(&settings, text).unwrap();
        check(
            &StereoNetwork::open(&runtime, &file).unwrap_err(),
            &["`z` among them"],
            &file,
        );
    }
}

#[test]
fn segmentation_without_classes_is_rejected() {
    let (Some(runtime), folder) = (runtime(), tempfile::tempdir().unwrap()) else {
        return;
    };
    let three: (u64, &[i64]) = (F32, &[1, 3, -1, -1]);
    let file = inputs(&[three])
        .output("out", F32, three.1)
        .write(folder.path(), "network.onnx");
    let settings = file.with_extension("toml");
    let error = SegmentationNetwork::open(&runtime, &file).unwrap_err();
    check(
        &error,
        &["no settings", "names the classes to mask"],
        &settings,
    );
    for (text, parts) in [
        ("segmentation = { masked = {} }", "no class under `masked`"),
        (
            "segmentation = { masked = { person = 3 } }",
            "person = 3, expected the number of one of 3 classes",
        ),
    ] {
        std::fs::write(&settings, text).unwrap();
        check(
            &SegmentationNetwork::open(&runtime, &file).unwrap_err(),
            &[parts],
            &settings,
        );
    }
    // Two image inputs, and an output with one class.
    for (graph, part) in [
        (
            inputs(&[three; 2]).output("out", F32, three.1),
            "expected 1",
        ),
        (
            inputs(&[IMAGE]).output("out", F32, IMAGE.1),
            "at least 2 classes",
        ),
    ] {
        std::fs::write(&settings, "segmentation = { masked = { person = 0 } }").unwrap();
        let file = graph.write(folder.path(), "network.onnx");
        check(
            &SegmentationNetwork::open(&runtime, &file).unwrap_err(),
            &[part],
            &file,
        );
    }
}
