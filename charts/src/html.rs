//! Self-contained HTML pages: text, tables, verdicts and pictures in one file that opens offline and
//! prints well. Light only: the pictures in it are drawn on white.
//!
//! Every text is escaped; pictures are put in as they are.

use crate::svg::escape;
use std::fmt::{self, Display, Write as _};

/// The outcome of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As it should be.
    Pass,
    /// Usable, with something to look at.
    Warn,
    /// Not usable as it is.
    Fail,
}

impl Verdict {
    fn badge(self) -> String {
        format!(
            "<span class=\"badge {}\">{self}</span>",
            self.to_string().to_lowercase()
        )
    }
}

impl Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pass => "PASS",
            Self::Warn => "WARN",
            Self::Fail => "FAIL",
        })
    }
}

/// One cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Words, aligned left.
    Text(String),
    /// A number, aligned right.
    Number(String),
    /// A badge.
    Verdict(Verdict),
}

impl Cell {
    /// A number in the caller's words; for example `Cell::number(format!("{rate:.2}"))`.
    pub fn number(value: impl Display) -> Self {
        Self::Number(value.to_string())
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<Verdict> for Cell {
    fn from(verdict: Verdict) -> Self {
        Self::Verdict(verdict)
    }
}

/// A table with a heading row.
#[derive(Clone, Debug)]
pub struct Table {
    heads: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    /// A table without rows; no heads at all leave the heading row out.
    pub fn new<T: Into<String>>(heads: impl IntoIterator<Item = T>) -> Self {
        Self {
            heads: heads.into_iter().map(Into::into).collect(),
            rows: Vec::new(),
        }
    }

    /// Adds a row.
    pub fn row(mut self, cells: impl IntoIterator<Item = Cell>) -> Self {
        self.rows.push(cells.into_iter().collect());
        self
    }

    fn write(&self, out: &mut String) {
        out.push_str("<div class=\"wide\"><table>\n");
        if !self.heads.is_empty() {
            out.push_str("<thead><tr>");
            for (i, head) in self.heads.iter().enumerate() {
                let numeric = self
                    .rows
                    .iter()
                    .any(|row| matches!(row.get(i), Some(Cell::Number(_))));
                let class = if numeric { " class=\"n\"" } else { "" };
                let _ = write!(out, "<th{class}>{}</th>", escape(head));
            }
            out.push_str("</tr></thead>\n");
        }
        out.push_str("<tbody>\n");
        for row in &self.rows {
            out.push_str("<tr>");
            for cell in row {
                let _ = match cell {
                    Cell::Text(text) => write!(out, "<td>{}</td>", escape(text)),
                    Cell::Number(text) => write!(out, "<td class=\"n\">{}</td>", escape(text)),
                    Cell::Verdict(verdict) => write!(out, "<td>{}</td>", verdict.badge()),
                };
            }
            out.push_str("</tr>\n");
        }
        out.push_str("</tbody></table></div>\n");
    }
}

/// A page, written from top to bottom.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    verdict: Option<Verdict>,
    body: String,
}

impl Page {
    /// A page with only a title.
    pub fn new(title: &str) -> Self {
        Self {
            title: title.into(),
            verdict: None,
            body: String::new(),
        }
    }

    /// The verdict of the whole, beside the title.
    pub fn verdict(mut self, verdict: Verdict) -> Self {
        self.verdict = Some(verdict);
        self
    }

    /// Starts a section.
    pub fn section(mut self, heading: &str) -> Self {
        let _ = writeln!(self.body, "<h2>{}</h2>", escape(heading));
        self
    }

    /// A paragraph.
    pub fn text(mut self, text: &str) -> Self {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
        self
    }

    /// A paragraph behind a badge.
    pub fn finding(mut self, verdict: Verdict, text: &str) -> Self {
        let _ = writeln!(self.body, "<p>{} {}</p>", verdict.badge(), escape(text));
        self
    }

    /// A table.
    pub fn table(mut self, table: &Table) -> Self {
        table.write(&mut self.body);
        self
    }

    /// A picture of this crate, put in without escaping, and a caption (left out when empty).
    pub fn figure(mut self, svg: &str, caption: &str) -> Self {
        let _ = writeln!(self.body, "<figure>{}", svg.trim_end());
        if !caption.is_empty() {
            let _ = writeln!(self.body, "<figcaption>{}</figcaption>", escape(caption));
        }
        self.body.push_str("</figure>\n");
        self
    }

    /// A picture of pixels: a PNG file, put in whole. `name` is read out to who cannot see it.
    pub fn picture(mut self, png: &[u8], name: &str, caption: &str) -> Self {
        let _ = writeln!(
            self.body,
            "<figure><img src=\"data:image/png;base64,{}\" alt=\"{}\">",
            base64(png),
            escape(name)
        );
        if !caption.is_empty() {
            let _ = writeln!(self.body, "<figcaption>{}</figcaption>", escape(caption));
        }
        self.body.push_str("</figure>\n");
        self
    }

    /// The whole file.
    pub fn to_html(&self) -> String {
        let title = escape(&self.title);
        let badge = self
            .verdict
            .map(|v| format!(" {}", v.badge()))
            .unwrap_or_default();
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}{badge}</h1>\n{}</body>\n</html>\n",
            self.body
        )
    }
}

/// RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits = (0..3).fold(0, |bits, k| {
            bits << 8 | u32::from(*three.get(k).unwrap_or(&0))
        });
        for digit in 0..4 {
            let place = (bits >> (18 - 6 * digit)) as usize % 64;
            text.push(if digit <= three.len() {
                DIGITS[place] as char
            } else {
                '='
            });
        }
    }
    text
}

const STYLE: &str = "\
:root { color-scheme: light }
body { font: 15px/1.5 \"DejaVu Sans\", system-ui, sans-serif; color: #222; background: #fff;
  max-width: 860px; margin: 24px auto; padding: 0 16px; overflow-wrap: anywhere }
h1 { font-size: 22px; margin: 0 0 12px } h2 { font-size: 17px; margin: 32px 0 8px; border-bottom: 1px solid #ccc }
p { margin: 8px 0 }
.wide { overflow-x: auto; margin: 12px 0 } table { border-collapse: collapse; font-size: 13px }
th, td { text-align: left; padding: 4px 20px 4px 0; border-bottom: 1px solid #ddd; vertical-align: top }
th { border-bottom-color: #888; overflow-wrap: normal } .n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
figure { margin: 16px 0 } figure svg, figure img { max-width: 100%; height: auto; display: block }
figcaption { font-size: 13px; color: #595959 }
.badge { display: inline-block; padding: 0 8px; border-radius: 4px; font-size: 12px; line-height: 20px; font-weight: bold;
  vertical-align: middle; -webkit-print-color-adjust: exact; print-color-adjust: exact }
.pass { background: #00734f; color: #fff } .warn { background: #E69F00; color: #000 } .fail { background: #a83c00; color: #fff }
@media print { body { margin: 0; max-width: none } figure, tr { break-inside: avoid } h2 { break-after: avoid } }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_put_in_whole() {
        // The vectors of RFC 4648.
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
        let page = Page::new("p").picture(b"foo", "a < b", "below").to_html();
        assert!(
            page.contains("data:image/png;base64,Zm9v\" alt=\"a &lt; b\""),
            "{page}"
        );
    }
}
