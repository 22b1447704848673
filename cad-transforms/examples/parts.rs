//! Prints the parts of a CAD file: `cargo run -p cad-transforms --example parts -- plate.step`.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for path in std::env::args().skip(1) {
        let (cad, source) = cad_transforms::cad::read(Path::new(&path))?;
        println!("{}  blake3 {}", source.file, source.blake3);
        for part in &cad.parts {
            let [x, y, z] = part.root_from_part.translation_m().map(|v| 1e3 * v);
            let turn = part
                .root_from_part
                .rotation_rows()
                .map(|v| (v * 1e9).round() / 1e9 + 0.0);
            println!("{:40} {x:9.3} {y:9.3} {z:9.3} mm  {turn:?}", part.path);
        }
        for note in &cad.notes {
            println!("note: {note}");
        }
    }
    Ok(())
}
