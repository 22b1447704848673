//! The table in `docs/` is the one that the code makes.

use std::path::Path;

use operator::table;

fn check(file: &str, made: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../docs")
        .join(file);
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == made,
        "docs/{file} is not what the code makes: run `cargo run -p operator --example led_table`"
    );
}

#[test]
fn the_image_is_up_to_date() {
    check("images/led-table.svg", &table::svg());
}

#[test]
fn the_text_is_up_to_date() {
    check("reference/led-table.md", &table::markdown());
}
