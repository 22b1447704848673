//! ONNX Runtime for the tests.

use std::path::PathBuf;
use std::process::Command;

use learned::{RUNTIME_PATH_VARIABLE, Runtime};

const FIND: &str = "import pathlib, onnxruntime; \
                    print(next(pathlib.Path(onnxruntime.__file__).parent.glob('capi/libonnxruntime.so*')))";

/// The library, if one is configured.
pub(crate) fn runtime() -> Option<Runtime> {
    if std::env::var_os(RUNTIME_PATH_VARIABLE).is_some_and(|v| !v.is_empty()) {
        return Some(Runtime::load(None).expect("the library of ORT_DYLIB_PATH"));
    }
    let Some(python) = std::env::var_os("PAWS_PYTHON") else {
        eprintln!(
            "skipped: neither {RUNTIME_PATH_VARIABLE} names an ONNX Runtime nor PAWS_PYTHON an interpreter that has one"
        );
        return None;
    };
    let output = Command::new(python)
        .args(["-c", FIND])
        .output()
        .expect("the interpreter of PAWS_PYTHON");
    if !output.status.success() {
        eprintln!(
            "skipped: the interpreter of PAWS_PYTHON has no package onnxruntime with a library"
        );
        return None;
    }
    let path = PathBuf::from(String::from_utf8(output.stdout).unwrap().trim_end());
    Some(Runtime::load(Some(&path)).expect("the library of the package onnxruntime"))
}

#[test]
fn process_loads_one_library_only() {
    let Some(runtime) = runtime() else {
        return;
    };
    let again = Runtime::load(Some(runtime.library())).unwrap();
    assert_eq!(again.library(), runtime.library());
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("libonnxruntime.so");
    std::fs::write(&other, b"").unwrap();
    let error = Runtime::load(Some(&other)).unwrap_err().to_string();
    assert!(error.contains("already loaded"), "{error}");
}
