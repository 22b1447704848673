//! Simulated walks: some to fit the sigma model, held-out ones to test it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::Result;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};

use super::frames::{Frame, Walk};
use super::imperfect::{self, Imperfection};

/// A walk and the frames used of every camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) kind: Kind,
    pub(super) light: Lighting,
    pub(super) seed: u64,
    pub(super) size: [u32; 2],
    pub(super) numbers: &'static [u64],
}

/// Length of a walk, s; frames come at 15 Hz.
pub(super) const SECONDS: f64 = 20.0;
/// Size of most frames.
pub(super) const SIZE: [u32; 2] = [672, 376];
/// A larger one.
const LARGE: [u32; 2] = [1280, 720];

/// Walks that the sigma model was fitted on.
pub(super) fn to_fit() -> Vec<Place> {
    let kinds = [Kind::Pavement, Kind::Corridor, Kind::Trail];
    let lights = [Lighting::Day, Lighting::Night, Lighting::LowSun];
    of(&kinds, &lights, 3, SIZE, &[60, 150, 240])
}

/// Held-out walks: other scenes, other seeds, and some larger images.
pub(super) fn held_out(quick: bool) -> Vec<Place> {
    if quick {
        return of(
            &[Kind::Stairs],
            &[Lighting::Day, Lighting::Night],
            8,
            SIZE,
            &[90],
        );
    }
    let kinds = [Kind::Stairs, Kind::Plaza, Kind::Room];
    let lights = [Lighting::Day, Lighting::Night];
    let mut places = of(&kinds, &lights, 8, SIZE, &[90, 210]);
    places.extend(of(
        &[Kind::Stairs, Kind::Room],
        &[Lighting::LowSun, Lighting::Flicker],
        8,
        SIZE,
        &[150],
    ));
    places.extend(of(
        &[Kind::Stairs, Kind::Plaza],
        &[Lighting::Day],
        8,
        LARGE,
        &[150],
    ));
    places
}

fn of(
    kinds: &[Kind],
    lights: &[Lighting],
    seed: u64,
    size: [u32; 2],
    numbers: &'static [u64],
) -> Vec<Place> {
    let places = kinds
        .iter()
        .flat_map(|kind| lights.iter().map(move |light| (*kind, *light)));
    places
        .map(|(kind, light)| Place {
            kind,
            light,
            seed,
            size,
            numbers,
        })
        .collect()
}

impl Place {
    /// Scene, light and, where it is not the usual one, size.
    pub(super) fn name(&self) -> String {
        let size = match self.size {
            SIZE => String::new(),
            [width, height] => format!(" {width}x{height}"),
        };
        format!("{} {}{size}", self.kind.name(), self.light.name())
    }
}

/// A frame and the number of its walk, or of its imperfection.
pub(super) type PlaceFrame = (usize, Frame);

/// Renders all frames of all walks, in order, with one thread per processor.
///
/// # Errors
/// There is no such walk.
pub(super) fn render(places: &[Place]) -> Result<Vec<PlaceFrame>> {
    let walk = |number: usize| frames(&places[number], &imperfect::NONE);
    parallel(places.len(), &walk)
}

/// Frames of held-out walks with each of [`imperfect::FOR_TEST`], in order; a quick run has the
/// last of them only.
///
/// # Errors
/// There is no such walk.
pub(super) fn render_imperfect(quick: bool) -> Result<Vec<PlaceFrame>> {
    let places = match quick {
        true => of(&[Kind::Stairs], &[Lighting::Day], 8, SIZE, &[150]),
        false => {
            let kinds = [Kind::Stairs, Kind::Plaza, Kind::Room];
            let mut places = of(&kinds, &[Lighting::Day], 8, SIZE, &[150]);
            places.extend(of(&[Kind::Plaza], &[Lighting::Night], 8, SIZE, &[150]));
            places
        }
    };
    let first = if quick {
        imperfect::FOR_TEST.len() - 1
    } else {
        0
    };
    let imperfections = &imperfect::FOR_TEST[first..];
    let walk = |number: usize| {
        let imperfection = &imperfections[number / places.len()];
        frames(&places[number % places.len()], imperfection)
    };
    let found = parallel(imperfections.len() * places.len(), &walk)?.into_iter();
    Ok(found
        .map(|(number, frame)| (first + number / places.len(), frame))
        .collect())
}

/// The frames of all cameras of a walk.
fn frames(place: &Place, imperfection: &Imperfection) -> Result<Vec<Frame>> {
    let walk = Walk::new(
        place.kind,
        place.light,
        place.seed,
        SECONDS,
        place.size,
        Quality::ACCURATE,
        imperfection,
    )?;
    let mut frames = Vec::new();
    for camera in 0..walk.cameras() {
        frames.extend(walk.frames(camera, place.numbers)?);
    }
    Ok(frames)
}

/// Renders a number of walks, with one thread per processor; their frames in order.
fn parallel(
    walks: usize,
    frames: &(dyn Fn(usize) -> Result<Vec<Frame>> + Sync),
) -> Result<Vec<PlaceFrame>> {
    let next = AtomicUsize::new(0);
    let found: Mutex<Vec<(usize, Result<Vec<Frame>>)>> = Mutex::new(Vec::new());
    let work = || {
        loop {
            let walk = next.fetch_add(1, Ordering::Relaxed);
            if walk >= walks {
                return;
            }
            let frames = frames(walk);
            let mut found = found.lock().expect("nobody panics with the list");
            found.push((walk, frames));
        }
    };
    let threads = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(work);
        }
    });
    let mut found = found.into_inner().expect("nobody panics with the list");
    found.sort_by_key(|(walk, _)| *walk);
    let mut frames = Vec::new();
    for (walk, of_walk) in found {
        frames.extend(of_walk?.into_iter().map(|frame| (walk, frame)));
    }
    Ok(frames)
}
