//! Colors of rig drawings, on white paper and on a dark screen.
//!
//! Contract: a separate SVG and the PNG are on white. A page that shows the SVG replaces all of its
//! colors, that of the paper too, by those of [`DARK`] if the reader prefers a dark screen
//! (`charts::Page::dark`).

use raster::Color;

pub(crate) const PAPER: Color = [255, 255, 255];
pub(crate) const INK: Color = [34, 34, 34];
pub(crate) const MUTED: Color = [110, 110, 110];
pub(crate) const GRID: Color = [222, 222, 222];
pub(crate) const BODY: Color = [238, 232, 224];
pub(crate) const GROUND: Color = [140, 120, 90];
pub(crate) const SHOE: Color = [90, 80, 70];
/// One per camera, by name; distinguishable with color vision deficiency.
pub(crate) const PALETTE: [Color; 6] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 140, 100],
    [170, 70, 140],
    [120, 100, 0],
    [60, 60, 60],
];
/// x, y, z.
pub(crate) const AXES: [Color; 3] = [[200, 30, 30], [20, 140, 20], [30, 60, 210]];

/// Each color of the SVG, and its replacement on a dark screen.
pub const DARK: [(&str, &str); 16] = [
    // Paper, ink, secondary text, lines.
    ("#ffffff", "#16191d"),
    ("#222222", "#e6e8ea"),
    ("#6e6e6e", "#98a1aa"),
    ("#dedede", "#31373e"),
    // The wearer, the ground, the shoes.
    ("#eee8e0", "#332d27"),
    ("#8c785a", "#b39c78"),
    ("#5a5046", "#94867a"),
    // Cameras.
    ("#0072b2", "#4b9fe3"),
    ("#d55e00", "#ff8b3e"),
    ("#008c64", "#2fc79a"),
    ("#aa468c", "#e08cc4"),
    ("#786400", "#c9ae3a"),
    ("#3c3c3c", "#bcc4cb"),
    // Axes.
    ("#c81e1e", "#ff7b72"),
    ("#148c14", "#56d364"),
    ("#1e3cd2", "#8f9dff"),
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::sheet::hex;

    /// Relative luminance by WCAG 2.1.
    fn luminance(color: &str) -> f64 {
        let part = |k: usize| {
            let value = u8::from_str_radix(&color[2 * k + 1..2 * k + 3], 16).unwrap();
            let share = f64::from(value) / 255.0;
            match share <= 0.03928 {
                true => share / 12.92,
                false => ((share + 0.055) / 1.055).powf(2.4),
            }
        };
        0.2126 * part(0) + 0.7152 * part(1) + 0.0722 * part(2)
    }

    fn contrast(a: &str, b: &str) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    fn dark(color: Color) -> &'static str {
        let color = hex(color);
        let mut all = DARK.into_iter();
        let known = all.find(|(light, _)| *light == color);
        let known = known.map(|(_, dark)| dark);
        known.unwrap_or_else(|| panic!("{color} has no colour for the dark"))
    }

    #[test]
    fn every_color_has_contrast_on_a_dark_screen() {
        let paper = dark(PAPER);
        // Lines between panels and the wearer remain in the background.
        for color in [GRID, BODY] {
            let found = contrast(dark(color), paper);
            assert!((1.2..2.0).contains(&found), "{color:?}: {found:.2}");
        }
        // All others are also used for text (WCAG 2.1 AA), and drawn in front of the wearer.
        let inks = [INK, MUTED, GROUND, SHOE].into_iter();
        for color in inks.chain(PALETTE).chain(AXES) {
            let found = contrast(dark(color), paper);
            assert!(found >= 4.5, "{color:?}: {found:.2}");
            let found = contrast(dark(color), dark(BODY));
            assert!(found >= 3.0, "{color:?} before the wearer: {found:.2}");
        }
        let all: BTreeSet<&str> = DARK.iter().map(|(_, dark)| *dark).collect();
        assert_eq!(all.len(), DARK.len(), "two became one");
    }
}
