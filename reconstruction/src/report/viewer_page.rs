//! The parts of a view in three dimensions put together: style, canvas, data and program.

use charts::base64;
use serde_json::Value;

/// Style of all views.
const STYLE: &str = include_str!("viewer.css");
/// Functions that all programs use.
const SHARED: &str = include_str!("webgl.js");

/// HTML and program of a view.
#[derive(Clone, Copy)]
pub(super) struct Template {
    /// With the markers `<!--STYLE-->`, `<!--DATA-->` and `<!--SCRIPT-->`.
    pub(super) html: &'static str,
    /// With the marker `/*SHARED*/`.
    pub(super) script: &'static str,
}

impl Template {
    /// The view with a JSON in the element `header_id` and each blob in base64 in the element of
    /// its name.
    pub(super) fn fill(
        &self,
        header_id: &str,
        header: &Value,
        blobs: &[(String, Vec<u8>)],
    ) -> String {
        // In a script element `<` could end it.
        let header = header.to_string().replace('<', "\\u003c");
        let mut data =
            format!("<script type=\"application/json\" id=\"{header_id}\">{header}</script>\n");
        for (name, bytes) in blobs {
            data.push_str(&format!(
                "<script type=\"application/octet-stream\" id=\"{name}\">{}</script>\n",
                base64(bytes)
            ));
        }
        let script = self.script.replace("/*SHARED*/", SHARED.trim_end());
        // The data holds no marker: it has no `<` but those of its own tags.
        self.html
            .replace("<!--STYLE-->", STYLE.trim_end())
            .replace("<!--SCRIPT-->", script.trim_end())
            .replace("<!--DATA-->", data.trim_end())
    }

    /// Lines of HTML, style and programs.
    #[cfg(test)]
    pub(super) fn lines(&self) -> impl Iterator<Item = &'static str> {
        [self.html, self.script, STYLE, SHARED]
            .into_iter()
            .flat_map(str::lines)
    }

    /// Bytes of HTML, style and programs.
    #[cfg(test)]
    pub(super) fn bytes(&self) -> usize {
        self.html.len() + self.script.len() + STYLE.len() + SHARED.len()
    }
}

/// Length of `bytes` bytes in base64.
pub(super) fn text_bytes(bytes: usize) -> usize {
    bytes.div_ceil(3) * 4
}
