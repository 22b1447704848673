//! A simulated walk on one sheet: the camera images at a few instants, and below them a map of the
//! scene with the path and every footprint, the left ones blue.
//!
//! Contract: one row per instant, one column per camera, from the wearer's left to the right, each
//! the color image of the left eye. At each instant the exposure has converged. The same simulation
//! and the same instants give the same sheet.

use std::io;
use std::panic::resume_unwind;
use std::path::Path;
use std::sync::Arc;
use std::thread;

use raster::{Canvas, Color, Compression};

use crate::rig::SimCamera;
use crate::simulation::{Simulation, seconds};

pub mod film;
mod map;

/// Gap between images, px.
const GAP: usize = 4;
const PAPER: Color = [255, 255, 255];
const LABEL: Color = [255, 230, 0];
const SHADE: Color = [0, 0, 0];

/// `count` instants, ns, spread evenly over the walk.
pub fn instants(simulation: &Simulation, count: usize) -> Vec<i64> {
    let settings = simulation.settings();
    let last = settings.frame_count() as usize;
    let frame = |k: usize| settings.frame_ns(((2 * k + 1) * last / (2 * count)) as u64);
    (0..count).map(frame).collect()
}

/// Draws the sheet. `done` is called after each image, from any thread.
pub fn sheet(simulation: &Arc<Simulation>, instants: &[i64], done: &(dyn Fn() + Sync)) -> Canvas {
    let order = left_to_right(simulation);
    let columns = thread::scope(|scope| {
        let taken: Vec<_> = order
            .iter()
            .map(|&camera| scope.spawn(move || column(simulation, camera, instants, done)))
            .collect();
        let joined = taken.into_iter().map(|t| t.join());
        joined
            .map(|column| column.unwrap_or_else(|panic| resume_unwind(panic)))
            .collect::<Vec<_>>()
    });

    let settings = simulation.settings();
    let (width, height) = (settings.width as usize, settings.height as usize);
    let sheet_width = columns.len() * (width + GAP) - GAP;
    let rows_height = instants.len() * (height + GAP);
    let (map, _) = map::draw(simulation, sheet_width, instants);
    let mut sheet = Canvas::new(sheet_width, rows_height + map.height, PAPER);
    for (i, column) in columns.iter().enumerate() {
        for (j, image) in column.iter().enumerate() {
            sheet.paste([i * (width + GAP), j * (height + GAP)], width, image);
        }
    }
    for (j, &time_ns) in instants.iter().enumerate() {
        let (y, text) = (j * (height + GAP) + 6, format!("{:.1} s", seconds(time_ns)));
        sheet.text([7, y + 1], 3, &text, SHADE);
        sheet.text([6, y], 3, &text, LABEL);
    }
    sheet.paste([0, rows_height], sheet_width, &map.pixels);
    sheet
}

/// Writes a sheet as a PNG file.
///
/// # Errors
/// Any I/O error.
pub fn save(sheet: &Canvas, path: &Path) -> io::Result<()> {
    std::fs::write(path, sheet.png(Compression::Fast)?)
}

/// The cameras from the wearer's left to the right.
fn left_to_right(simulation: &Simulation) -> Vec<usize> {
    let mut order: Vec<usize> = (0..simulation.cameras().len()).collect();
    let left = |camera: &SimCamera| camera.rig_from_eye[0].translation().y;
    order.sort_by(|&a, &b| {
        let cameras = simulation.cameras();
        left(&cameras[b]).total_cmp(&left(&cameras[a]))
    });
    order
}

/// Left images of a camera at each instant.
fn column(
    simulation: &Arc<Simulation>,
    camera: usize,
    instants: &[i64],
    done: &(dyn Fn() + Sync),
) -> Vec<Vec<Color>> {
    let mut images = simulation.frames(camera);
    let mut take = |(number, &time_ns)| {
        images.settle(time_ns);
        let frame = images.expose(number, time_ns);
        done();
        frame.rgb(0)
    };
    (0..).zip(instants).map(&mut take).collect()
}
