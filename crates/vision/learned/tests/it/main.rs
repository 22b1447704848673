//! Networks that the tests generate, run in the real ONNX Runtime.
//!
//! The library is that of `ORT_DYLIB_PATH`, or else the one inside the Python package `onnxruntime`
//! of the interpreter that `PAWS_PYTHON` names (`cargo xtask test` creates one); without either
//! these tests are skipped.

mod library;
mod lpips;
mod onnx;
mod rejections;
mod segmentation;
mod stereo;
