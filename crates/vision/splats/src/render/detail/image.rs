//! From the pixels of regions to an image: background, exposure, depths.

use std::cell::RefCell;

use rayon::prelude::*;

use super::camera::Rectangle;
use super::region::{Contents, Region, Scratch, split};
use crate::lanes::LANES;
use crate::render::finish::{Band, SkyView};
use crate::render::forward::Renderer;
use crate::render::image::Image;
use crate::render::view::View;
use crate::scene::{Exposure, Scene};

thread_local! {
    /// Memory of a thread for the regions that it renders: nothing is allocated per image but the
    /// image itself.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Renders an image of a pinhole camera that does not move, rows of regions in parallel.
pub(super) fn render(
    renderer: &Renderer,
    contents: Contents<'_>,
    scene: &Scene,
    view: &View,
    exposure: &Exposure,
) -> Image {
    let mut image = Image::zeros(view.width, view.height);
    let rows = split(view.height);
    let columns = split(view.width);
    let height = rows.first().map_or(1, |(_, height)| *height);
    let bands: Vec<Band<'_>> = Band::of(&mut image, height).collect();
    let render_row = |mut band: Band<'_>, (top, height): (usize, usize)| {
        for (left, width) in &columns {
            let rectangle = Rectangle {
                origin: [*left, top],
                size: [*width, height],
            };
            SCRATCH.with_borrow_mut(|scratch| {
                renderer.level.run(Region {
                    contents,
                    view,
                    rectangle,
                    config: &renderer.config,
                    scratch,
                });
                finish(
                    scene, scratch, view, rectangle, exposure, renderer, &mut band,
                );
            });
        }
    };
    match rows.len() {
        // Without tasks, which a batch has for its images.
        1 => bands
            .into_iter()
            .zip(rows)
            .for_each(|(band, row)| render_row(band, row)),
        _ => bands
            .into_par_iter()
            .zip(rows)
            .for_each(|(band, row)| render_row(band, row)),
    }
    image
}

fn finish(
    scene: &Scene,
    scratch: &Scratch,
    view: &View,
    rectangle: Rectangle,
    exposure: &Exposure,
    renderer: &Renderer,
    band: &mut Band<'_>,
) {
    let [left, top] = rectangle.origin;
    let config = &renderer.config;
    let sky = SkyView::new(scene, view);
    let is_changed = *exposure != Exposure::NONE;
    let [width, height] = rectangle.size;
    for row in 0..height {
        for first in (0..width).step_by(LANES) {
            let cell = scratch.pixels.cell(row, first / LANES);
            for lane in 0..LANES.min(width - first) {
                let column = left + first + lane;
                let pixel = row * view.width + column;
                let transmittance = cell.transmittance[lane];
                let mut color = [0, 1, 2].map(|c: usize| cell.rgb[c][lane]);
                let mut alpha = 1.0 - transmittance.abs();
                let depth = match alpha >= config.min_depth_alpha {
                    true => cell.depth[lane] / alpha,
                    false => f32::NAN,
                };
                if transmittance > 0.0 {
                    let behind = sky.color(column, top + row, transmittance, config);
                    for (value, behind) in color.iter_mut().zip(behind) {
                        *value += behind * transmittance;
                    }
                } else {
                    // What is hidden is taken to look like what hides it.
                    color = color.map(|value| value / alpha);
                    alpha = 1.0;
                }
                if is_changed {
                    color = exposure.apply(color);
                }
                for (plane, value) in band.rgb.iter_mut().zip(color) {
                    plane[pixel] = value;
                }
                band.expected[pixel] = depth;
                let median = cell.median[lane];
                band.median[pixel] = if median > 0.0 { median } else { f32::NAN };
                band.alpha[pixel] = alpha;
            }
        }
    }
}
