//! MP4 files with the recorded access units, each at its time.

use std::path::Path;

use anyhow::{Context, Result};
use console_output::{Console, Outcome, text};
use session_access::read_or_build;
use session_archive::index::Access;
use session_archive::reader::SessionReader;
use video::mp4::write_mp4;
use video::raw_image::coded_size;
use video::{AccessUnit, Codec};

use super::common::{damage, file_name};

pub(super) fn export(
    reader: &SessionReader,
    out: &Path,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let index = read_or_build(reader, console)?;
    let access = Access::open(&**reader.storage(), &index).context("opening the segments")?;
    let mut outcome = Outcome::Fine;
    for (camera, frames) in reader.manifest().cameras.iter().zip(&index.cameras) {
        let path = out.join(format!("{}.mp4", file_name(&camera.name)));
        let codec = Codec::from_foxglove_format(&camera.codec).with_context(|| {
            format!("found the codec {:?}, expected h264 or h265", camera.codec)
        })?;
        if frames.frames.is_empty() {
            console.line(format!("{}: no frames", camera.name))?;
            outcome = Outcome::Loss;
            continue;
        }
        let bytes = frames.frames.iter().map(|f| u64::from(f.bytes)).sum();
        let progress = console.progress(&camera.name, bytes);
        // A unit that cannot be read ends the file; the error is reported afterwards.
        let mut failed = None;
        let units = frames.frames.iter().enumerate().map_while(|(i, frame)| {
            progress.add(u64::from(frame.bytes));
            match access.unit(frame) {
                Ok(data) => Some(AccessUnit {
                    pts_ns: frame.time_ns,
                    data,
                    key: frame.key as usize == i,
                }),
                Err(e) => {
                    failed = Some(e);
                    None
                }
            }
        });
        // Players show what is coded: an odd last row twice.
        let (width, height) = coded_size(camera.width, camera.height);
        let written = write_mp4(&path, codec, width, height, units);
        drop(progress);
        if let Some(e) = failed {
            // A truncated file must not be mistaken for a complete one.
            let _ = std::fs::remove_file(&path);
            return Err(e).with_context(|| format!("reading frames of {}", camera.name));
        }
        let written = written?;
        let mut line = format!(
            "{}: {}, 0 in the file is {} ns",
            path.display(),
            text::count(written.units, "frame"),
            written.origin_ns
        );
        if frames.undecodable > 0 {
            line.push_str(&format!(
                "; {} without key frame left out",
                frames.undecodable
            ));
            outcome = Outcome::Loss;
        }
        console.line(line)?;
    }
    Ok(outcome.max(damage(&index, console)?))
}
