//! SVG text: escaping, numbers with fixed decimals, the few elements that charts need, and how wide
//! a text will be. Widths are an estimate for DejaVu Sans, which is wider than most sans faces.

use std::fmt::Write as _;

/// Colour of text.
pub(crate) const INK: &str = "#222";
/// Colour of secondary text.
pub(crate) const MUTED: &str = "#595959";

/// Text that is safe inside XML or HTML, in elements and in attributes. Characters that XML
/// forbids, and those that change the direction of the text around them, become U+FFFD.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' | '\r' => out.push(c),
            '\0'..'\u{20}' | '\u{7f}'..='\u{9f}' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            '\u{61c}'
            | '\u{200e}'
            | '\u{200f}'
            | '\u{202a}'..='\u{202e}'
            | '\u{2066}'..='\u{2069}' => {
                out.push('\u{fffd}');
            }
            _ => out.push(c),
        }
    }
    out
}

/// A coordinate with at most one decimal.
pub(crate) fn num(v: f64) -> String {
    debug_assert!(v.is_finite());
    let text = format!("{v:.1}");
    match text.strip_suffix(".0").unwrap_or(&text) {
        "-0" => "0".into(),
        short => short.into(),
    }
}

/// Estimated width in pixels of `text` at font size `size`.
pub(crate) fn text_width(text: &str, size: f64) -> f64 {
    let ems = text.chars().map(|c| match c {
        'i' | 'j' | 'l' | 'I' | '.' | ',' | ':' | ';' | '\'' | '|' | '!' | ' ' => 0.34,
        'f' | 't' | 'r' | '(' | ')' | '[' | ']' | '/' | '-' | '"' => 0.41,
        'm' | 'w' | 'M' | 'W' | '@' | '%' | '—' | '→' => 0.98,
        'A'..='Z' | '+' | '=' | '<' | '>' | '~' | '±' | '×' => 0.76,
        '⁰'..='⁹' | '⁻' | '¹' | '²' | '³' => 0.42,
        '\0'..'\u{2e80}' => 0.63,
        _ => 1.0,
    });
    ems.sum::<f64>() * size
}

/// `text`, cut with an ellipsis where it is wider than `room` pixels.
pub(crate) fn shorten(text: &str, size: f64, room: f64) -> String {
    if text_width(text, size) <= room {
        return text.into();
    }
    let mut short = text.to_owned();
    while !short.is_empty() && text_width(&short, size) + size > room {
        short.pop();
    }
    format!("{}…", short.trim_end())
}

/// Lines of `text` that fit into `room` pixels, broken at spaces, or inside a word too long for a
/// line.
pub(crate) fn wrap(text: &str, size: f64, room: f64) -> Vec<String> {
    let mut lines = Vec::new();
    for paragraph in text.lines() {
        let mut line = String::new();
        for word in paragraph.split(' ') {
            let gap = if line.is_empty() { "" } else { " " };
            if text_width(&line, size) + text_width(gap, size) + text_width(word, size) <= room {
                line.push_str(gap);
                line.push_str(word);
                continue;
            }
            if !line.is_empty() {
                lines.push(std::mem::take(&mut line));
            }
            for c in word.chars() {
                if !line.is_empty() && text_width(&line, size) + size > room {
                    lines.push(std::mem::take(&mut line));
                }
                line.push(c);
            }
        }
        lines.push(line);
    }
    lines
}

/// Which point of a text stands at its coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// A growing SVG body.
#[derive(Debug, Default)]
pub(crate) struct Svg {
    body: String,
}

impl Svg {
    /// An element with attributes given as text.
    pub(crate) fn element(&mut self, name: &str, attributes: &str) {
        let _ = writeln!(self.body, "<{name} {attributes}/>");
    }

    /// A text; `attributes` are added as they stand.
    pub(crate) fn text(
        &mut self,
        x: f64,
        y: f64,
        size: f64,
        anchor: Anchor,
        attributes: &str,
        text: &str,
    ) {
        let anchor = match anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let (x, y, size, text) = (num(x), num(y), num(size), escape(text));
        let _ = writeln!(
            self.body,
            "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\"{anchor} {attributes}>{text}</text>"
        );
    }

    /// A text with a white rim, readable on top of lines.
    pub(crate) fn text_with_rim(&mut self, x: f64, y: f64, size: f64, anchor: Anchor, text: &str) {
        let rim = "fill=\"#fff\" stroke=\"#fff\" stroke-width=\"3\" stroke-linejoin=\"round\" stroke-opacity=\"0.85\"";
        self.text(x, y, size, anchor, rim, text);
        self.text(x, y, size, anchor, "", text);
    }

    /// A filled rectangle.
    pub(crate) fn rect(&mut self, x: f64, y: f64, width: f64, height: f64, attributes: &str) {
        let (x, y, w, h) = (num(x), num(y), num(width), num(height));
        self.element(
            "rect",
            &format!("x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" {attributes}"),
        );
    }

    /// A straight line.
    pub(crate) fn line(&mut self, from: (f64, f64), to: (f64, f64), attributes: &str) {
        let (x1, y1, x2, y2) = (num(from.0), num(from.1), num(to.0), num(to.1));
        self.element(
            "line",
            &format!("x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\" {attributes}"),
        );
    }

    /// A polyline or polygon, by element name.
    pub(crate) fn poly(&mut self, name: &str, points: &[(f64, f64)], attributes: &str) {
        let points: Vec<String> = points
            .iter()
            .map(|p| format!("{},{}", num(p.0), num(p.1)))
            .collect();
        self.element(
            name,
            &format!("points=\"{}\" {attributes}", points.join(" ")),
        );
    }

    /// The whole chart on a white sheet. `title` is for screen readers.
    pub(crate) fn finish(self, width: f64, height: f64, title: &str) -> String {
        let (w, h, title) = (num(width.ceil()), num(height.ceil()), escape(title));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             role=\"img\" font-family=\"DejaVu Sans, sans-serif\" fill=\"{INK}\">\n<title>{title}</title>\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>\n{}</svg>\n",
            self.body
        )
    }
}
