//! A simulated walk as a film: camera images side by side, above the map with the wearer's
//! position.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;

use raster::{Canvas, Color};
use video::mp4::write_mp4;
use video::raw_image::rgb_to_i420;
use video::{AccessUnit, RawImage, RawImageError};

use super::{GAP, LABEL, PAPER, SHADE, left_to_right, map};
use crate::film::{Film, FilmError};
use crate::simulation::{Simulation, seconds};

const WEARER_COLOR: Color = [255, 140, 0];
/// Maximum number of queued images of a camera.
const MAX_QUEUED_IMAGES: usize = 4;

/// Writes the whole walk as an MP4 file. `done` is called after each image of each camera, from any
/// thread.
///
/// # Errors
/// [`FilmError`]; no file is left behind.
pub fn film(
    simulation: &Arc<Simulation>,
    path: &Path,
    done: &(dyn Fn() + Sync),
) -> Result<(), FilmError> {
    let settings = simulation.settings();
    let (width, height) = (settings.width as usize, settings.height as usize);
    let order = left_to_right(simulation);
    let sheet_width = order.len() * (width + GAP) - GAP;
    let (map, place) = map::draw(simulation, sheet_width, &[]);
    let mut sheet = Canvas::new(sheet_width, height + GAP + map.height, PAPER);
    let size = [sheet.width & !1, sheet.height & !1].map(|v| v as u32);
    let mut encoder = Film::new(size, settings.rate_hz, settings.rate_hz.ceil() as u32)?;
    let codec = encoder.codec();
    thread::scope(|scope| {
        let cameras: Vec<_> = order
            .iter()
            .map(|&camera| {
                let (sender, receiver) = sync_channel(MAX_QUEUED_IMAGES);
                scope.spawn(move || {
                    for frame in simulation.frames(camera) {
                        done();
                        // The receiver is dropped if the film has failed.
                        if sender.send(frame.rgb(0)).is_err() {
                            return;
                        }
                    }
                });
                receiver
            })
            .collect();
        let mut failed = None;
        let mut image = |number: u64| -> Result<AccessUnit, FilmError> {
            let time_ns = settings.frame_ns(number);
            for (i, camera) in cameras.iter().enumerate() {
                let pixels = camera.recv();
                let gone = |_| FilmError::Encoder("the thread of a camera ended".to_owned());
                sheet.paste([i * (width + GAP), 0], width, &pixels.map_err(gone)?);
            }
            let text = format!("{:.1} s", seconds(time_ns));
            sheet.text([7, 7], 3, &text, SHADE);
            sheet.text([6, 6], 3, &text, LABEL);
            sheet.paste([0, height + GAP], sheet_width, &map.pixels);
            let [x, y] = place.px(&simulation.world_from_rig(time_ns).0);
            sheet.disc([x, y + (height + GAP) as f64], 7.0, WEARER_COLOR);
            encoder.encode(time_ns, &i420(&sheet)?, number == 0)
        };
        let units = (0..settings.frame_count())
            .map_while(|number| image(number).map_err(|error| failed = Some(error)).ok());
        let written = write_mp4(path, codec, size[0], size[1], units);
        match failed {
            Some(error) => {
                // An incomplete film is removed.
                let _ = std::fs::remove_file(path);
                Err(error)
            }
            None => written.map(|_| ()).map_err(|source| FilmError::Write {
                path: path.to_owned(),
                source,
            }),
        }
    })
}

/// I420 image for the encoder; an odd last row or column is cropped.
fn i420(canvas: &Canvas) -> Result<RawImage, RawImageError> {
    let (width, height) = (canvas.width & !1, canvas.height & !1);
    let rows = canvas.pixels.chunks_exact(canvas.width).take(height);
    let rgb: Vec<u8> = rows
        .flat_map(|row| &row[..width])
        .flatten()
        .copied()
        .collect();
    rgb_to_i420(width as u32, height as u32, &rgb)
}
