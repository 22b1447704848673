//! The film of an agent in the scene, as `paws-sim film` leaves it beside the bundle.

use std::path::Path;

use charts::{Image, Page};
use scene_bundle::film;
use scene_bundle::layout;

use super::error::ReportError;

/// Number of images in the strip below the film.
const STRIP: usize = 8;

/// Adds film and strip, if the bundle in `folder` has them.
pub(super) fn add(page: Page, folder: &Path) -> Result<Page, ReportError> {
    let found = film::read(folder).map_err(|source| ReportError::Film {
        path: folder.join(layout::FILM),
        source,
    })?;
    let Some(found) = found else {
        return Ok(page);
    };
    let frames = &found.film.frames;
    let last = frames.len().saturating_sub(1);
    let mut numbers: Vec<usize> = (0..STRIP).map(|k| k * last / (STRIP - 1)).collect();
    numbers.dedup();
    let of_frames = numbers.into_iter().filter_map(|number| {
        let frame = frames.get(number)?;
        let time_s = number as f64 * found.film.step_s;
        let name = format!("what the agent sees at {time_s:.1} s");
        let caption = format!("{time_s:.1} s: {}", frame.caption);
        Some(Image::jpeg_base64(&frame.jpeg_base64, &name, &caption))
    });
    let strip: Vec<Image> = of_frames.collect();
    Ok(page
        .section("An agent in the scene")
        .text(&found.summary)
        .embed(&found.film.to_html("what the agent sees"))
        .images(&strip))
}

#[cfg(test)]
mod tests {
    use charts::{Film, FilmFrame};
    use scene_bundle::film::SceneFilm;

    use super::*;

    #[test]
    fn film_and_strip_are_shown() {
        let folder = tempfile::tempdir().expect("a folder");
        let empty = add(Page::new("p"), folder.path()).expect("no film");
        assert!(!empty.to_html().contains("An agent in the scene"));
        let frames = (0..31).map(|k| FilmFrame {
            jpeg_base64: "/9g=".to_owned(),
            caption: format!("goal {k}"),
            ..FilmFrame::default()
        });
        let film = SceneFilm {
            summary: "An agent walks 12.3 m.".to_owned(),
            film: Film {
                step_s: 0.1,
                size: [32, 18],
                frames: frames.collect(),
                map: None,
            },
        };
        film::write(folder.path(), &film).expect("written");
        let page = add(Page::new("p"), folder.path())
            .expect("a film")
            .to_html();
        assert_eq!(charts::inspect(&page), Ok(()));
        for expected in ["An agent walks 12.3 m.", "3.0 s: goal 30", "0.0 s: goal 0"] {
            assert!(page.contains(expected), "{expected}");
        }
        assert_eq!(page.matches("<img ").count(), 1 + STRIP);
        std::fs::write(folder.path().join(layout::FILM), "{}").expect("changed");
        let error = add(Page::new("p"), folder.path()).expect_err("no film");
        assert!(error.to_string().contains("film.jsonl"), "{error}");
    }
}
