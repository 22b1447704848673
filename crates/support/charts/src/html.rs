//! Self-contained HTML pages: text, tables, verdicts, charts and images in one file that opens
//! offline and prints well, on screens from 360 pixels wide, light or dark.
//!
//! Contract: on a narrow screen charts are those drawn for it, rows of tables with a heading stack,
//! and what can do neither scrolls in a box of its own; the page itself never scrolls sideways.
//! Every text is escaped; charts and what [`Page::embed`] takes are put in as they are. The same
//! calls give the same bytes.

use crate::chart::Chart;
use crate::svg::escape;
use crate::theme::{COLOURS, STYLE, dark_rules};
use crate::timeline::Timeline;
use std::fmt::{self, Display, Write as _};

/// Width of a chart on a broad screen, pixels; the page is a little wider.
const BROAD: u32 = 820;
/// And on a phone of 360 pixels.
const NARROW: u32 = 336;

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
        let class = match self.heads.is_empty() {
            true => "facts",
            false => "heads",
        };
        let _ = writeln!(out, "<div class=\"wide\"><table class=\"{class}\">");
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
            for (i, cell) in row.iter().enumerate() {
                // What stands before the value where rows are stacked.
                let head = self.heads.get(i).filter(|head| !head.is_empty());
                let head = head.map_or(String::new(), |head| {
                    format!(" data-head=\"{}\"", escape(head))
                });
                let _ = match cell {
                    Cell::Text(text) => write!(out, "<td{head}>{}</td>", escape(text)),
                    Cell::Number(text) => {
                        write!(out, "<td class=\"n\"{head}>{}</td>", escape(text))
                    }
                    Cell::Verdict(verdict) => write!(out, "<td{head}>{}</td>", verdict.badge()),
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
    style: String,
    body: String,
}

impl Page {
    /// A page with only a title.
    pub fn new(title: &str) -> Self {
        Self {
            title: title.into(),
            verdict: None,
            style: String::new(),
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

    /// An SVG of one size, put in without escaping, and a caption (left out when empty). On a
    /// narrow screen it scrolls; [`Page::chart`] and [`Page::drawing`] fit.
    pub fn figure(self, svg: &str, caption: &str) -> Self {
        let body = format!("<div class=\"scroll\">{}</div>", svg.trim_end());
        self.captioned(&body, caption)
    }

    /// A chart, so high on a broad screen and at least 200 pixels on a narrow one.
    pub fn chart(self, chart: &Chart, height: u32, caption: &str) -> Self {
        self.drawing(
            |width| match width {
                BROAD => chart.to_svg(width, height),
                _ => chart.to_svg(width, height.max(200)),
            },
            caption,
        )
    }

    /// A timeline.
    pub fn timeline(self, timeline: &Timeline, caption: &str) -> Self {
        self.drawing(|width| timeline.to_svg(width), caption)
    }

    /// An SVG that `draw` makes for a width in pixels, put in without escaping: one for broad
    /// screens and one for narrow ones, of which one is shown.
    pub fn drawing(self, draw: impl Fn(u32) -> String, caption: &str) -> Self {
        let body = format!(
            "<div class=\"broad\">{}</div>\n<div class=\"narrow\">{}</div>",
            draw(BROAD).trim_end(),
            draw(NARROW).trim_end()
        );
        self.captioned(&body, caption)
    }

    fn captioned(mut self, body: &str, caption: &str) -> Self {
        let _ = writeln!(self.body, "<figure>{body}");
        if !caption.is_empty() {
            let _ = writeln!(self.body, "<figcaption>{}</figcaption>", escape(caption));
        }
        self.body.push_str("</figure>\n");
        self
    }

    /// An image as wide as the page.
    pub fn image(mut self, image: &Image) -> Self {
        image.write(&mut self.body);
        self
    }

    /// Small images side by side, two on a narrow screen and four on a broad one.
    pub fn images(mut self, images: &[Image]) -> Self {
        self.body.push_str("<div class=\"images\">\n");
        images.iter().for_each(|image| image.write(&mut self.body));
        self.body.push_str("</div>\n");
        self
    }

    /// A heading within a section.
    pub fn heading(mut self, text: &str) -> Self {
        let _ = writeln!(self.body, "<h3>{}</h3>", escape(text));
        self
    }

    /// HTML of the caller's own, put in as it is. What it shows has to be escaped already.
    pub fn embed(mut self, html: &str) -> Self {
        self.body.push_str(html);
        self
    }

    /// Colours of the caller's own SVGs, each with the one in its place on a dark screen, as in
    /// `("#1b4f8a", "#5aa0eb")`.
    pub fn dark<'a>(mut self, colours: impl IntoIterator<Item = (&'a str, &'a str)>) -> Self {
        self.style.push_str(&dark_rules(colours));
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
             <title>{title}</title>\n<style>\n{STYLE}{}{}</style>\n</head>\n<body>\n<h1>{title}{badge}</h1>\n{}</body>\n</html>\n",
            dark_rules(COLOURS),
            self.style,
            self.body
        )
    }
}

/// Pixels in a page: a file put in whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    media: &'static str,
    base64: String,
    name: String,
    caption: String,
}

impl Image {
    /// A JPEG file. `name` is read out to people who cannot see it; an empty caption is left out.
    pub fn jpeg(file: &[u8], name: &str, caption: &str) -> Self {
        Self::of("image/jpeg", base64(file), name, caption)
    }

    /// A PNG file.
    pub fn png(file: &[u8], name: &str, caption: &str) -> Self {
        Self::of("image/png", base64(file), name, caption)
    }

    /// A JPEG file that is in base64 already.
    pub fn jpeg_base64(text: &str, name: &str, caption: &str) -> Self {
        Self::of("image/jpeg", text.to_owned(), name, caption)
    }

    fn of(media: &'static str, base64: String, name: &str, caption: &str) -> Self {
        Self {
            media,
            base64,
            name: name.into(),
            caption: caption.into(),
        }
    }

    fn write(&self, out: &mut String) {
        let _ = writeln!(
            out,
            "<figure><img src=\"data:{};base64,{}\" alt=\"{}\">",
            self.media,
            escape(&self.base64),
            escape(&self.name)
        );
        if !self.caption.is_empty() {
            let _ = writeln!(out, "<figcaption>{}</figcaption>", escape(&self.caption));
        }
        out.push_str("</figure>\n");
    }
}

/// Bytes as text, by RFC 4648 with padding.
pub fn base64(bytes: &[u8]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect;

    #[test]
    fn images_are_put_in_whole() {
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
        let page = Page::new("p").image(&Image::png(b"foo", "a < b", "below"));
        let page = page.images(&[
            Image::jpeg(b"foob", "c", ""),
            Image::jpeg_base64("Zg==", "d", ""),
        ]);
        let page = page.to_html();
        for expected in [
            "data:image/png;base64,Zm9v\" alt=\"a &lt; b\"",
            "data:image/jpeg;base64,Zm9vYg==\" alt=\"c\"",
            "data:image/jpeg;base64,Zg==\" alt=\"d\"",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        assert_eq!(inspect(&page), Ok(()));
    }

    #[test]
    fn a_chart_is_there_for_broad_and_for_narrow_screens() {
        let chart = Chart::new("speed of everything that was looked at")
            .series(crate::Series::line("a", [(0.0, 1.0), (1.0, 2.0)]));
        let page = Page::new("p").chart(&chart, 180, "c").to_html();
        for (class, width, height) in [("broad", 820, 180), ("narrow", 336, 200)] {
            let start = format!(
                "<div class=\"{class}\"><svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\""
            );
            assert!(page.contains(&start), "{start}: {page}");
        }
        assert_eq!(inspect(&page), Ok(()));
    }

    #[test]
    fn stacked_rows_name_their_columns() {
        let table =
            Table::new(["Metric", "a < b", ""]).row(["x".into(), Cell::number(3), "y".into()]);
        let page = Page::new("p").table(&table).to_html();
        assert!(page.contains("<table class=\"heads\">"), "{page}");
        assert!(page.contains("<td data-head=\"Metric\">x</td><td class=\"n\" data-head=\"a &lt; b\">3</td><td>y</td>"), "{page}");
        let plain = Table::new::<&str>([]).row(["x".into()]);
        let page = Page::new("p").table(&plain).to_html();
        assert!(
            page.contains("<table class=\"facts\">") && page.contains("<td>x</td>"),
            "{page}"
        );
    }

    #[test]
    fn a_page_has_colours_for_the_dark() {
        let page = Page::new("p").dark([("#123456", "#abcdef")]).to_html();
        assert_eq!(
            page.matches("@media screen and (prefers-color-scheme: dark)")
                .count(),
            3
        );
        assert!(
            page.contains("svg [stroke=\"#123456\"] { stroke: #abcdef }"),
            "{page}"
        );
    }
}
