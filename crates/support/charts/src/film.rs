//! A film in a page: images at equal steps of time, beside a map with a marker where each was
//! taken.
//!
//! Contract: it plays without a network; where scripts are not allowed the first image and the map
//! are shown. With `prefers-reduced-motion` it does not start by itself.

use std::fmt::Write;

use crate::svg::escape;

const STYLE: &str = include_str!("film.css");
const SCRIPT: &str = include_str!("film.js");

/// Length of the marker's tip on the map, as part of the map's longer edge.
const MARKER: f64 = 0.03;

/// Images at equal steps of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Film {
    /// Time between images, s.
    pub step_s: f64,
    /// Size of the images, px.
    pub size: [u32; 2],
    /// The images.
    pub frames: Vec<FilmFrame>,
    /// Where they were taken.
    pub map: Option<FilmMap>,
}

/// An image of a film.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FilmFrame {
    /// JPEG file in base64.
    pub jpeg_base64: String,
    /// Position on the map, px from the left and from the top.
    pub map_px: [f64; 2],
    /// Direction of view on the map: 0 to the right, counterclockwise, rad.
    pub heading_rad: f64,
    /// What happens, in a few words.
    pub caption: String,
}

/// A map from above.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FilmMap {
    /// PNG file in base64.
    pub png_base64: String,
    /// Its size, px.
    pub size: [u32; 2],
}

impl Film {
    /// The film as HTML; `name` is read out to people who cannot see it. Empty without images.
    ///
    /// ```
    /// use charts::{Film, FilmFrame, Page, inspect};
    ///
    /// let frame = FilmFrame { caption: "start".into(), ..FilmFrame::default() };
    /// let frames = vec![frame];
    /// let film = Film { step_s: 0.1, size: [320, 180], frames, map: None };
    /// let page = Page::new("A walk").embed(&film.to_html("an agent")).to_html();
    /// assert!(page.contains("start"));
    /// assert_eq!(inspect(&page), Ok(()));
    /// ```
    pub fn to_html(&self, name: &str) -> String {
        let Some(first) = self.frames.first() else {
            return String::new();
        };
        let mut out = format!(
            "<style>\n{}\n</style>\n<figure class=\"film\">\n<div class=\"film-views\">\n",
            STYLE.trim_end()
        );
        let _ = writeln!(
            out,
            "<img class=\"film-image\" width=\"{}\" height=\"{}\" src=\"data:image/jpeg;base64,{}\" alt=\"{}\">",
            self.size[0],
            self.size[1],
            escape(&first.jpeg_base64),
            escape(name)
        );
        if let Some(map) = &self.map {
            self.write_map(&mut out, map, first);
        }
        let last = self.frames.len() - 1;
        let _ = writeln!(
            out,
            "</div>\n<div class=\"film-bar\" hidden=\"\"><button type=\"button\">Play</button>\
             <input type=\"range\" min=\"0\" max=\"{last}\" step=\"1\" value=\"0\" aria-label=\"image\">\
             <output></output></div>\n<figcaption>{}</figcaption>",
            escape(&first.caption)
        );
        let _ = writeln!(
            out,
            "<script type=\"application/json\">{}</script>\n</figure>\n<script>\n{}\n</script>",
            self.data(),
            SCRIPT.trim_end()
        );
        out
    }

    fn write_map(&self, out: &mut String, map: &FilmMap, first: &FilmFrame) {
        let [width, height] = map.size;
        let path: Vec<String> = self
            .frames
            .iter()
            .map(|frame| format!("{:.1},{:.1}", frame.map_px[0], frame.map_px[1]))
            .collect();
        let length = MARKER * f64::from(width.max(height));
        let [x, y] = first.map_px;
        let degrees = -first.heading_rad.to_degrees();
        let _ = writeln!(
            out,
            "<svg class=\"film-map\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"map from above with the path\">\
             <image width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{}\"/>\
             <polyline points=\"{}\" fill=\"none\" stroke=\"#0072B2\" stroke-width=\"{:.2}\"/>\
             <path class=\"film-marker\" d=\"M{length:.1},0L{:.1},{:.1}L{:.1},{:.1}Z\" fill=\"#D55E00\" stroke=\"#ffffff\" stroke-width=\"{:.2}\" \
             transform=\"translate({x:.1},{y:.1}) rotate({degrees:.1})\"/></svg>",
            escape(&map.png_base64),
            path.join(" "),
            length / 6.0,
            -0.6 * length,
            0.6 * length,
            -0.6 * length,
            -0.6 * length,
            length / 12.0,
        );
    }

    /// Images, markers and captions as JSON.
    fn data(&self) -> String {
        let mut out = format!("{{\"step_s\":{},\"frames\":[", self.step_s);
        for (number, frame) in self.frames.iter().enumerate() {
            let comma = if number == 0 { "" } else { "," };
            let [x, y] = frame.map_px;
            let _ = write!(
                out,
                "{comma}[\"{}\",{x:.1},{y:.1},{:.1},\"{}\"]",
                json_text(&frame.jpeg_base64),
                -frame.heading_rad.to_degrees(),
                json_text(&frame.caption)
            );
        }
        out.push_str("]}");
        out
    }
}

/// Text within a string of JSON that lies in a script element.
fn json_text(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '"' | '\\' | '<' | '\u{0}'..='\u{1f}' => {
                let _ = write!(out, "\\u{:04x}", u32::from(c));
            }
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Page, inspect};

    fn film() -> Film {
        let frames = (0..3).map(|k| FilmFrame {
            jpeg_base64: format!("Zm{k}v"),
            map_px: [10.0 * f64::from(k), 20.0],
            heading_rad: std::f64::consts::FRAC_PI_2,
            caption: format!("a \"</script>\" {k}\n"),
        });
        Film {
            step_s: 0.25,
            size: [64, 48],
            frames: frames.collect(),
            map: Some(FilmMap {
                png_base64: "Zm9v".to_owned(),
                size: [100, 50],
            }),
        }
    }

    #[test]
    fn a_page_with_a_film_is_whole_and_fetches_nothing() {
        let page = Page::new("p").embed(&film().to_html("what <it> shows"));
        let page = page.to_html();
        assert_eq!(inspect(&page), Ok(()));
        for expected in [
            "what &lt;it&gt; shows",
            "a \\u0022\\u003c/script>\\u0022 2\\u000a",
            "points=\"0.0,20.0 10.0,20.0 20.0,20.0\"",
            // Up on the map is a rotation by -90 degrees in SVG.
            "translate(0.0,20.0) rotate(-90.0)",
            "max=\"2\"",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
    }

    #[test]
    fn without_images_there_is_nothing() {
        assert_eq!(Film::default().to_html("x"), "");
        let without_map = Film {
            map: None,
            ..film()
        };
        assert!(!without_map.to_html("x").contains("<svg"));
    }
}
