//! Compiles the schemas: Rust types by prost, and for each schema the descriptor set that is
//! embedded in the files. protox is a protobuf compiler in Rust, so no system package is needed.

use std::collections::BTreeSet;
use std::path::PathBuf;

use prost_build::Config;
use protox::prost::Message;
use protox::prost_reflect::prost_types::{FileDescriptorProto, FileDescriptorSet};

const ROOTS: [&str; 4] = [
    "foxglove/CompressedVideo.proto",
    "foxglove/CameraCalibration.proto",
    "foxglove/FrameTransforms.proto",
    "paws.proto",
];

fn main() {
    println!("cargo:rerun-if-changed=proto");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let set = protox::compile(ROOTS, ["proto"]).unwrap_or_else(|e| panic!("proto: {e:?}"));
    for root in ROOTS {
        let stem = root
            .rsplit('/')
            .next()
            .unwrap_or(root)
            .trim_end_matches(".proto");
        let bytes = closure(&set.file, root).encode_to_vec();
        std::fs::write(out.join(format!("{stem}.desc")), bytes).expect("write descriptor set");
    }
    Config::new()
        .bytes(["."])
        .compile_fds(set)
        .expect("generate Rust types from the schemas");
}

/// The file and everything it imports, imports first, without comments: readers need the
/// fields, and the bytes are repeated in every segment.
fn closure(files: &[FileDescriptorProto], root: &str) -> FileDescriptorSet {
    let mut wanted = BTreeSet::from([root.to_owned()]);
    let mut queue = vec![root.to_owned()];
    while let Some(name) = queue.pop() {
        let file = files
            .iter()
            .find(|f| f.name() == name)
            .expect("imports are in the set");
        for import in &file.dependency {
            if wanted.insert(import.clone()) {
                queue.push(import.clone());
            }
        }
    }
    let file = files
        .iter()
        .filter(|f| wanted.contains(f.name()))
        .map(|f| FileDescriptorProto {
            source_code_info: None,
            ..f.clone()
        })
        .collect();
    FileDescriptorSet { file }
}
