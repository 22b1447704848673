//! Compiles the schemas of `crates/formats/session-archive/proto` into
//! `crates/formats/session-archive/src/record/generated`: Rust types by prost, and for each message
//! type the descriptor set that is embedded in the files. protox is a protobuf compiler in Rust, so
//! no system package is needed. `sources.txt` beside them holds the checksums of what they were
//! made of; a test of `session-archive` compares them, so that nobody forgets to run this.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use prost_build::Config;
use protox::prost::Message;
use protox::prost_reflect::prost_types::{DescriptorProto, FileDescriptorProto, FileDescriptorSet};

const FILES: [&str; 4] = [
    "foxglove/CompressedVideo.proto",
    "foxglove/CameraCalibration.proto",
    "foxglove/FrameTransforms.proto",
    "paws.proto",
];

fn main() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (proto, out) = (package.join("proto"), package.join("src/record/generated"));
    let set = protox::compile(FILES, [&proto]).unwrap_or_else(|e| panic!("proto: {e:?}"));
    for file in &set.file {
        if file.package() == "google.protobuf" {
            continue;
        }
        for message in &file.message_type {
            let name = format!("{}.{}", file.package(), message.name());
            let bytes = closure(&set.file, &name).encode_to_vec();
            fs::write(out.join(format!("{name}.desc")), bytes).expect("write descriptor set");
        }
    }
    Config::new()
        .bytes(["."])
        .out_dir(&out)
        .compile_fds(set)
        .expect("generate Rust types from the schemas");
    let mut sources = String::new();
    for file in FILES {
        let text = fs::read(proto.join(file)).expect("read a schema");
        let _ = writeln!(sources, "{:08x} {file}", crc32fast::hash(&text));
    }
    fs::write(out.join("sources.txt"), sources).expect("write the checksums");
}

/// A message type and everything it is made of, imports first, without comments: readers need the
/// fields and nothing else, and the bytes are repeated in every segment.
fn closure(files: &[FileDescriptorProto], root: &str) -> FileDescriptorSet {
    let mut wanted = BTreeSet::new();
    let mut queue = vec![format!(".{root}")];
    while let Some(name) = queue.pop() {
        for (full, message) in files.iter().flat_map(messages) {
            if is_within(&name, &full) && wanted.insert(full) {
                types(message, &mut queue);
            }
        }
        if files.iter().flat_map(enums).any(|full| full == name) {
            wanted.insert(name);
        }
    }
    let mut file: Vec<FileDescriptorProto> = Vec::new();
    for source in files {
        let mut part = FileDescriptorProto {
            source_code_info: None,
            ..source.clone()
        };
        let package = part.package().to_owned();
        let is_wanted = |name: &str| wanted.contains(&format!(".{package}.{name}"));
        part.message_type.retain(|m| is_wanted(m.name()));
        part.enum_type.retain(|e| is_wanted(e.name()));
        if part.message_type.is_empty() && part.enum_type.is_empty() {
            continue;
        }
        part.dependency
            .retain(|d| file.iter().any(|f| f.name() == d));
        file.push(part);
    }
    FileDescriptorSet { file }
}

fn messages(file: &FileDescriptorProto) -> impl Iterator<Item = (String, &DescriptorProto)> {
    let full = |name: &str| format!(".{}.{name}", file.package());
    file.message_type.iter().map(move |m| (full(m.name()), m))
}

fn enums(file: &FileDescriptorProto) -> impl Iterator<Item = String> {
    let full = |name: &str| format!(".{}.{name}", file.package());
    file.enum_type.iter().map(move |e| full(e.name()))
}

/// Whether a type is this one or declared inside it.
fn is_within(name: &str, outer: &str) -> bool {
    name.strip_prefix(outer)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// The names of the types of all fields, those of nested messages too.
fn types(message: &DescriptorProto, names: &mut Vec<String>) {
    let fields = message.field.iter().map(|f| f.type_name().to_owned());
    names.extend(fields.filter(|name| !name.is_empty()));
    for nested in &message.nested_type {
        types(nested, names);
    }
}
