//! Values as text of OpenUSD.

use std::fmt::{Display, Write};

/// Three numbers.
pub(super) fn tuple(v: &[f32; 3]) -> String {
    format!("({}, {}, {})", v[0], v[1], v[2])
}

/// An attribute with its values and what follows them.
pub(super) fn array<T: Display>(
    text: &mut String,
    name: &str,
    values: impl Iterator<Item = T>,
    end: &str,
) {
    // Writing to a string does not fail.
    let _ = write!(text, "        {name} = [");
    for (number, value) in values.enumerate() {
        let comma = if number == 0 { "" } else { ", " };
        let _ = write!(text, "{comma}{value}");
    }
    let _ = writeln!(text, "]{end}");
}
