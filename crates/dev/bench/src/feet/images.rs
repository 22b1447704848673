//! Images of the feet camera of a walk.
//!
//! Contract: rendering takes most of the time of the benchmark, so that a run can keep what it has
//! rendered in a folder: a file of gray levels, left and right image of each frame, and one with
//! what goes with them. A later run with the same rig, walk and seed reads them if both are there,
//! whatever has changed since in the simulator: remove the folder then.

use std::fs::{self, File};
use std::io::{BufReader, BufWriter, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result};
use imaging::ImageView;
use rig_sim::simulation::{FrameSource as _, GroundTruth, Simulation};
use serde::{Deserialize, Serialize};

use super::walks::{FeetRig, Walk};

/// A stereo frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Image {
    /// Middle of the exposure of the middle row, ns.
    pub(super) time_ns: i64,
    pub(super) exposure_s: f64,
    /// Visible share of the tag of each foot by eye.
    pub(super) visible: [[f64; 2]; 2],
    /// Gray levels of both eyes.
    #[serde(skip)]
    grays: [Vec<u8>; 2],
}

impl Image {
    /// The images of both eyes.
    pub(super) fn views(&self, size: [u32; 2]) -> Result<[ImageView<'_>; 2]> {
        let [width, height] = size.map(|size| size as usize);
        let view = |eye: usize| ImageView::packed(width, height, &self.grays[eye]);
        Ok([view(0)?, view(1)?])
    }
}

/// Calls `each` with all frames of a walk, which are kept in a folder if there is one.
pub(super) fn for_each(
    rig: &FeetRig,
    walk: &Walk,
    simulation: &Arc<Simulation>,
    camera: usize,
    kept: Option<&Path>,
    each: impl FnMut(&Image) -> Result<()>,
) -> Result<()> {
    let Some(folder) = kept else {
        return render(walk, simulation, camera, each);
    };
    let paths = paths(folder, rig, walk);
    if !are_kept(folder, rig, walk) {
        fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
        keep(walk, simulation, camera, &paths)?;
    }
    read(rig.size, &paths, each)
}

/// Whether the images of a walk are in a folder.
pub(super) fn are_kept(folder: &Path, rig: &FeetRig, walk: &Walk) -> bool {
    paths(folder, rig, walk).iter().all(|path| path.exists())
}

/// Files of the frames of a walk and of their gray levels.
fn paths(folder: &Path, rig: &FeetRig, walk: &Walk) -> [PathBuf; 2] {
    let name = walk.name.replace([' ', ','], "_");
    let stem = format!("{}-{name}-{}", rig.name, walk.seed);
    ["json", "gray"].map(|end| folder.join(format!("{stem}.{end}")))
}

/// Renders all frames into files.
fn keep(
    walk: &Walk,
    simulation: &Arc<Simulation>,
    camera: usize,
    [frames, grays]: &[PathBuf; 2],
) -> Result<()> {
    let mut images = Vec::new();
    let file = File::create(grays).with_context(|| format!("creating {}", grays.display()))?;
    let mut file = BufWriter::new(file);
    render(walk, simulation, camera, |image| {
        for gray in &image.grays {
            file.write_all(gray)
                .with_context(|| format!("writing {}", grays.display()))?;
        }
        images.push(Image {
            grays: Default::default(),
            ..*image
        });
        Ok(())
    })?;
    file.flush()
        .with_context(|| format!("writing {}", grays.display()))?;
    // Last, so that a run that was interrupted does not leave both.
    fs::write(frames, serde_json::to_vec(&images)?)
        .with_context(|| format!("writing {}", frames.display()))
}

fn read(
    size: [u32; 2],
    [frames, grays]: &[PathBuf; 2],
    mut each: impl FnMut(&Image) -> Result<()>,
) -> Result<()> {
    let reading = |path: &Path| format!("reading {}", path.display());
    let text = fs::read(frames).with_context(|| reading(frames))?;
    let images: Vec<Image> = serde_json::from_slice(&text).with_context(|| reading(frames))?;
    let mut file = BufReader::new(File::open(grays).with_context(|| reading(grays))?);
    for mut image in images {
        for gray in &mut image.grays {
            gray.resize(size[0] as usize * size[1] as usize, 0);
            file.read_exact(gray).with_context(|| reading(grays))?;
        }
        each(&image)?;
    }
    Ok(())
}

fn render(
    walk: &Walk,
    simulation: &Arc<Simulation>,
    camera: usize,
    mut each: impl FnMut(&Image) -> Result<()>,
) -> Result<()> {
    let mut renderer = simulation.frames(camera);
    let mut ground_truth = simulation.ground_truth(camera);
    let settings = *simulation.settings();
    let first = (walk.begin_s * settings.rate_hz).round() as u64;
    renderer.settle(settings.frame_ns(first));
    for number in first..settings.frame_count() {
        let time_ns = settings.frame_ns(number);
        let image = renderer.render_frame(number, time_ns);
        each(&Image {
            time_ns,
            exposure_s: image.exposure.seconds,
            visible: visible(&mut ground_truth, time_ns),
            grays: [image.gray(0).to_vec(), image.gray(1).to_vec()],
        })?;
    }
    Ok(())
}

/// Visible share of the tag of each foot by eye.
fn visible(ground_truth: &mut GroundTruth<'_>, time_ns: i64) -> [[f64; 2]; 2] {
    let mut by_eye = [[0.0; 2]; 2];
    for (eye, shares) in by_eye.iter_mut().enumerate() {
        let truth = ground_truth.render(eye, time_ns);
        for tag in ground_truth.tags(eye, &truth) {
            shares[tag.id] = tag.visible_share;
        }
    }
    [0, 1].map(|foot| [0, 1].map(|eye: usize| by_eye[eye][foot]))
}
