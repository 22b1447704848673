//! The generated code is that of the schemas beside it.

use std::fs;
use std::path::Path;

/// Checksums are of `proto/` as it was when `cargo xtask schemas` ran.
#[test]
fn generated_code_is_of_these_schemas() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sources = fs::read_to_string(package.join("src/record/generated/sources.txt"));
    let sources = sources.expect("the list of schemas");
    let mut checked = 0;
    for line in sources.lines() {
        let (checksum, name) = line.split_once(' ').expect("a checksum and a name");
        let text = fs::read(package.join("proto").join(name)).expect("a schema");
        assert_eq!(
            checksum,
            format!("{:08x}", crc32fast::hash(&text)),
            "{name} has changed since; `cargo xtask schemas` makes the code of it"
        );
        checked += 1;
    }
    assert_eq!(checked, 4, "schemas");
}
