//! The film of an agent in a scene, stored beside the outputs of a bundle, for its report.
//!
//! Contract: `film.jsonl` in the bundle's folder has a header and then a line for each image. It is
//! not part of the bundle: nothing depends on it, no hash covers it, and a bundle is valid without
//! it. It is replaced as a whole.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use charts::{Film, FilmFrame, FilmMap};
use serde::{Deserialize, Serialize};

use crate::layout;

/// Maximum size of the file, bytes.
const LIMIT: u64 = 32 << 20;

/// A film with what happens in it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneFilm {
    /// Outcome in one sentence.
    pub summary: String,
    /// Images and map.
    pub film: Film,
}

/// First line.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    summary: String,
    step_s: f64,
    size: [u32; 2],
    map_png_base64: Option<String>,
    map_size: Option<[u32; 2]>,
}

/// Line of an image.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    jpeg_base64: String,
    map_px: [f64; 2],
    heading_rad: f64,
    caption: String,
}

/// Writes the film of the bundle in `folder`, whole or not at all.
///
/// # Errors
/// The file cannot be written or would be longer than 32 MiB; the previous one is kept.
///
/// ```
/// use charts::{Film, FilmFrame};
/// use scene_bundle::film::{self, SceneFilm};
///
/// let folder = tempfile::tempdir()?;
/// let frame = FilmFrame { jpeg_base64: "/9g=".into(), ..FilmFrame::default() };
/// let film = Film { step_s: 0.1, size: [320, 180], frames: vec![frame], map: None };
/// let written = SceneFilm { summary: "stands still".into(), film };
/// film::write(folder.path(), &written)?;
/// assert_eq!(film::read(folder.path())?, Some(written));
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn write(folder: &Path, film: &SceneFilm) -> io::Result<()> {
    let header = Header {
        summary: film.summary.clone(),
        step_s: film.film.step_s,
        size: film.film.size,
        map_png_base64: film.film.map.as_ref().map(|map| map.png_base64.clone()),
        map_size: film.film.map.as_ref().map(|map| map.size),
    };
    let mut text = serde_json::to_string(&header)?;
    text.push('\n');
    for frame in &film.film.frames {
        let line = Line {
            jpeg_base64: frame.jpeg_base64.clone(),
            map_px: frame.map_px,
            heading_rad: frame.heading_rad,
            caption: frame.caption.clone(),
        };
        text.push_str(&serde_json::to_string(&line)?);
        text.push('\n');
    }
    if text.len() as u64 > LIMIT {
        let expected = "a film of more than 32 MiB, which would not be read: show fewer seconds";
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, expected));
    }
    let path = folder.join(layout::FILM);
    let beside = folder.join(layout::temporary(layout::FILM));
    // Remains of a stopped run.
    let _ = fs::remove_file(&beside);
    let written = fs::File::create_new(&beside)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .and_then(|()| fs::rename(&beside, &path));
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written
}

/// The film of a bundle; `None` if it has no such file.
///
/// # Errors
/// The file cannot be read, is not a regular file, exceeds 32 MiB, or is no film.
pub fn read(folder: &Path) -> io::Result<Option<SceneFilm>> {
    let bytes = plain_file::read_below(folder, Path::new(layout::FILM), LIMIT);
    let text = match bytes.and_then(plain_file::text) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    let mut lines = text.lines();
    let header: Header = serde_json::from_str(lines.next().unwrap_or_default())?;
    let map = header.map_png_base64.zip(header.map_size);
    let map = map.map(|(png_base64, size)| FilmMap { png_base64, size });
    let mut frames = Vec::new();
    for line in lines {
        let line: Line = serde_json::from_str(line)?;
        frames.push(FilmFrame {
            jpeg_base64: line.jpeg_base64,
            map_px: line.map_px,
            heading_rad: line.heading_rad,
            caption: line.caption,
        });
    }
    let is_size = |edge: &u32| (1..=16_384).contains(edge);
    let files = frames.iter().map(|frame| &frame.jpeg_base64);
    let mut files = files.chain(map.as_ref().map(|map| &map.png_base64));
    let sizes = header.size.iter().chain(map.iter().flat_map(|m| &m.size));
    let is_valid = header.step_s.is_finite() && header.step_s > 0.0;
    if !is_valid || !sizes.clone().all(is_size) || !files.all(|text| is_base64(text)) {
        let expected = "expected a positive time step, sizes up to 16384 px, images in base64";
        return Err(io::Error::new(io::ErrorKind::InvalidData, expected));
    }
    let film = Film {
        step_s: header.step_s,
        size: header.size,
        frames,
        map,
    };
    let summary = header.summary;
    Ok(Some(SceneFilm { summary, film }))
}

fn is_base64(text: &str) -> bool {
    let digit = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'+' | b'/' | b'=');
    text.bytes().all(digit)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film() -> SceneFilm {
        let frame = FilmFrame {
            jpeg_base64: "/9g=".to_owned(),
            map_px: [0.1, 1e-7],
            heading_rad: -1.5,
            caption: "a \"caption\"\n".to_owned(),
        };
        SceneFilm {
            summary: "walks".to_owned(),
            film: Film {
                step_s: 0.1,
                size: [32, 18],
                frames: vec![frame.clone(), frame],
                map: Some(FilmMap {
                    png_base64: "Zm9v".to_owned(),
                    size: [40, 30],
                }),
            },
        }
    }

    #[test]
    fn films_are_replaced_as_a_whole() {
        let folder = tempfile::tempdir().expect("a folder");
        assert_eq!(read(folder.path()).expect("no film"), None);
        let mut written = film();
        write(folder.path(), &written).expect("written");
        written.film.frames.pop();
        write(folder.path(), &written).expect("replaced");
        assert_eq!(read(folder.path()).expect("a film"), Some(written));
        let names = fs::read_dir(folder.path()).expect("the folder").count();
        assert_eq!(names, 1);
    }

    #[test]
    fn what_is_no_film_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(layout::FILM);
        write(folder.path(), &film()).expect("written");
        let text = fs::read_to_string(&path).expect("text");
        for (from, to) in [
            ("\"step_s\":0.1", "\"step_s\":0.0"),
            ("[32,18]", "[32,0]"),
            ("Zm9v", "\\\"onload"),
            ("\"/9g=\"", "\"<script>\""),
            ("\"caption\":", "\"title\":"),
        ] {
            assert!(text.contains(from), "{from}");
            fs::write(&path, text.replace(from, to)).expect("changed");
            let error = read(folder.path()).expect_err(to);
            assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{to}: {error}");
        }
        fs::write(&path, "").expect("emptied");
        read(folder.path()).expect_err("an empty file");
    }
}
