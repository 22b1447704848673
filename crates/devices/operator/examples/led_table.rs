//! Writes the table of lights into `docs/`: `cargo run -p operator --example led_table`.
//!
//! The PNG beside it is the SVG as Chromium draws it:
//! `chromium --headless --screenshot=docs/images/led-table.png --window-size=1123,794
//! --force-device-scale-factor=2 --hide-scrollbars docs/images/led-table.svg`

use std::fs;
use std::io;
use std::path::Path;

use operator::table;

fn main() -> io::Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs");
    fs::write(docs.join("images/led-table.svg"), table::svg())?;
    fs::write(docs.join("reference/led-table.md"), table::markdown())?;
    Ok(())
}
