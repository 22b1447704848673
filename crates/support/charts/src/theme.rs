//! Colours by day and by night.
//!
//! Charts are drawn for white paper and carry their colours as attributes, so that a file of its
//! own looks the same everywhere. A page replaces them by rules of its style sheet, which are
//! stronger than attributes, where the reader prefers a dark screen. Every colour that this crate
//! draws with is in [`COLOURS`].

use std::fmt::Write as _;

/// A colour on white, and the one in its place on a dark screen.
pub(crate) const COLOURS: [(&str, &str); 15] = [
    // Paper, ink, secondary text, lines.
    ("#fff", "#16191d"),
    ("#222", "#e6e8ea"),
    ("#595959", "#aab2ba"),
    ("#767676", "#98a1aa"),
    ("#444", "#bcc4cb"),
    ("#8a8a8a", "#7f8892"),
    ("#e2e2e2", "#31373e"),
    // Series.
    ("#0072B2", "#4b9fe3"),
    ("#D55E00", "#ff8b3e"),
    ("#009E73", "#2fc79a"),
    ("#CC79A7", "#e59bc6"),
    ("#E69F00", "#f2bb3f"),
    ("#56B4E9", "#a3dbff"),
    ("#000000", "#f4f4f4"),
    // What was recorded, in a timeline.
    ("#9CCBE8", "#3a76a3"),
];

/// Rules that replace each first colour by its second one in every SVG of a page on a dark screen.
/// Names of colours are put in as they stand.
pub(crate) fn dark_rules<'a>(colours: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let mut css = String::from("@media screen and (prefers-color-scheme: dark) {\n");
    for (light, dark) in colours {
        let _ = writeln!(
            css,
            "svg[fill=\"{light}\"], svg [fill=\"{light}\"] {{ fill: {dark} }} svg [stroke=\"{light}\"] {{ stroke: {dark} }}"
        );
    }
    css.push_str("}\n");
    css
}

/// The style sheet of every page.
pub(crate) const STYLE: &str = "\
:root { color-scheme: light dark; --paper: #fff; --ink: #222; --muted: #595959; --line: #ddd; --strong: #888; --panel: #f3f4f5 }
@media screen and (prefers-color-scheme: dark) {
  :root { --paper: #16191d; --ink: #e6e8ea; --muted: #aab2ba; --line: #31373e; --strong: #7f8892; --panel: #20252b } }
* { box-sizing: border-box }
body { font: 15px/1.5 \"DejaVu Sans\", system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 860px; margin: 24px auto; padding: 0 16px; overflow-wrap: anywhere }
h1 { font-size: 22px; margin: 0 0 12px } h2 { font-size: 17px; margin: 32px 0 8px; border-bottom: 1px solid var(--line) }
h3 { font-size: 15px; margin: 20px 0 4px } p { margin: 8px 0 }
.wide { overflow-x: auto; margin: 12px 0 } table { border-collapse: collapse; font-size: 13px }
th, td { text-align: left; padding: 4px 20px 4px 0; border-bottom: 1px solid var(--line); vertical-align: top }
.heads { overflow-wrap: break-word }
th { border-bottom-color: var(--strong) } .n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
figure { margin: 16px 0 } figure svg, figure img { max-width: 100%; height: auto; display: block }
figcaption { font-size: 13px; color: var(--muted) }
.narrow { display: none } .scroll { overflow-x: auto }
.images { display: grid; grid-template-columns: repeat(auto-fill, minmax(190px, 1fr)); gap: 12px; margin: 8px 0 16px }
.images figure { margin: 0 } .images img { width: 100% } .images figcaption { font-size: 12px }
.badge { display: inline-block; padding: 0 8px; border-radius: 4px; font-size: 12px; line-height: 20px; font-weight: bold;
  vertical-align: middle; -webkit-print-color-adjust: exact; print-color-adjust: exact }
.pass { background: #00734f; color: #fff } .warn { background: #E69F00; color: #000 } .fail { background: #a83c00; color: #fff }
@media screen and (max-width: 560px) {
  body { margin: 12px auto; padding: 0 12px }
  .broad { display: none } .narrow { display: block } .narrow svg { width: 100% } .scroll svg { max-width: none }
  .heads thead { display: none } .heads, .heads tbody, .heads tr, .heads td { display: block; width: 100% }
  .heads tr { border-bottom: 1px solid var(--strong); padding: 6px 0 }
  .heads td { display: flex; gap: 10px; border: 0; padding: 1px 0; text-align: left; white-space: normal; overflow-wrap: anywhere }
  .heads td::before { content: attr(data-head); color: var(--muted); flex: 0 0 40% }
  .heads td:first-child { font-weight: bold } .heads td:first-child::before, .heads td:not([data-head])::before { content: none }
  .heads td:empty { display: none }
  .facts, .facts tbody, .facts tr, .facts td { display: block } .facts tr { border-bottom: 1px solid var(--line); padding: 4px 0 }
  .facts td { border: 0; padding: 0; text-align: left; white-space: normal } .facts td:first-child { color: var(--muted) }
  .images { grid-template-columns: repeat(2, 1fr) }
  td { padding-right: 12px } }
@media print { body { margin: 0; max-width: none } figure, tr { break-inside: avoid } h2 { break-after: avoid } }
";

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance by WCAG 2.1.
    fn luminance(colour: &str) -> f64 {
        let digits = colour.trim_start_matches('#');
        let wide: String = match digits.len() {
            3 => digits.chars().flat_map(|c| [c, c]).collect(),
            _ => digits.to_owned(),
        };
        let part = |k: usize| {
            let value = u8::from_str_radix(&wide[2 * k..2 * k + 2], 16).unwrap();
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

    #[test]
    fn everything_can_be_read_on_a_dark_screen() {
        let (_, paper) = COLOURS[0];
        for (light, dark) in &COLOURS[1..] {
            // Text, by WCAG 2.1 AA; what is drawn; the grid, which is to stay in the background.
            let least = match *light {
                "#222" | "#595959" | "#767676" | "#444" => 4.5,
                "#e2e2e2" => 1.3,
                _ => 3.0,
            };
            let found = contrast(dark, paper);
            assert!(found >= least, "{light} as {dark}: {found:.2}");
        }
    }

    #[test]
    fn no_two_series_become_one() {
        let all: std::collections::BTreeSet<&str> = COLOURS.iter().map(|c| c.1).collect();
        assert_eq!(all.len(), COLOURS.len());
        let rules = dark_rules(COLOURS);
        assert!(
            rules.contains("svg [stroke=\"#0072B2\"] { stroke: #4b9fe3 }"),
            "{rules}"
        );
    }
}
