//! Keyframes of a walk as a session has them: both images, stereo depth, masks of people.
//!
//! They are kept in `bench-splats` in the target folder. The first keyframe of a walk is rendered
//! in every run; if it is not the stored one, the simulator has changed, and all are rendered
//! again.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use camera_models::Eye;
use camera_models::rectify::{Rectification, Remap, View};
use depth::{Band, BandedMatcher, Config, Geometry};
use rayon::prelude::*;
use rig_sim::camera::sensor::Exposure;
use rig_sim::scene::surface::Class;
use rig_sim::simulation::{FrameRenderer, GroundTruth, StereoFrame};
use scene_bundle::outputs::depth::DepthImage;

use crate::meter;
use crate::terrain::keyframes::{
    MASK_MARGIN, MAX_DISPARITIES, MAX_RELATIVE_SIGMA, MIN_DISTANCE_M, dilated,
};
use crate::terrain::walks::{KeyframeId, WalkInputs};

/// A stereo keyframe; rows first.
pub(crate) struct KeyframeImages {
    pub(crate) id: KeyframeId,
    pub(crate) exposure: Exposure,
    /// Red, green and blue of both images.
    pub(crate) rgb: [Vec<u8>; 2],
    /// Whether a pixel of an image shows a person or the wearer, with a margin.
    pub(crate) is_person: [Vec<bool>; 2],
    /// Stereo depth of the rectified left image, as the stage `depth` stores it.
    pub(crate) depth: DepthImage,
}

/// All keyframes of a walk, rendered or read. `variant` names what differs from the usual walk of
/// this name.
///
/// # Errors
/// A pair that cannot be rectified, or an I/O error.
pub(crate) fn recorded(
    prepared: &WalkInputs,
    ids: &[KeyframeId],
    variant: &str,
) -> Result<Vec<KeyframeImages>> {
    let count = prepared.simulation.cameras().len();
    // The path depends on the length of the walk.
    let end_s = prepared.walk.span_s[1];
    let folder = folder(&format!("{}-{end_s}s{variant}", prepared.walk.name()))?;
    let path = |id: &KeyframeId| folder.join(format!("{}-{}.bin", id.camera, id.frame));
    if let Some(first) = ids.first() {
        let fresh = Renderer::new(prepared, first)?.render(first)?;
        if fs::read(path(first)).is_ok_and(|stored| stored != fresh) {
            fs::remove_dir_all(&folder)?;
            fs::create_dir_all(&folder)?;
        }
    }
    (0..count).into_par_iter().try_for_each(|camera| {
        let own: Vec<&KeyframeId> = ids.iter().filter(|id| id.camera == camera).collect();
        let missing = own.iter().any(|id| !path(id).exists());
        let Some(first) = own.first().filter(|_| missing) else {
            return Ok(());
        };
        // Automatic exposure continues from one keyframe to the next.
        let mut renderer = Renderer::new(prepared, first)?;
        own.iter().try_for_each(|id| {
            // Another run reads whole files only.
            let path = path(id);
            let partial = path.with_extension(format!("{}.tmp", std::process::id()));
            let bytes = renderer.render(id)?;
            fs::write(&partial, bytes)
                .and_then(|()| fs::rename(&partial, &path))
                .with_context(|| format!("writing {}", path.display()))
        })
    })?;
    let size = prepared.walk.size.map(|edge| edge as usize);
    ids.par_iter()
        .map(|id| {
            let path = path(id);
            let bytes = fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
            parse(id, size, &bytes).with_context(|| format!("reading {}", path.display()))
        })
        .collect()
}

/// Renders the keyframes of a camera in order.
struct Renderer<'a> {
    images: FrameRenderer,
    truth: GroundTruth<'a>,
    remaps: [Remap; 2],
    geometry: Geometry,
    size: [usize; 2],
}

impl<'a> Renderer<'a> {
    /// With the exposure of the first frame.
    fn new(prepared: &'a WalkInputs, first: &KeyframeId) -> Result<Self> {
        let calibration = prepared.simulation.calibration(first.camera);
        let rectification = Rectification::new(&calibration, View::Filled)?;
        let [width, height] = prepared.walk.size;
        let maps = [Eye::Left, Eye::Right].map(|eye| rectification.map(eye));
        let mut images = prepared.simulation.frames(first.camera);
        images.settle(first.time_ns);
        let model = rectification.camera;
        Ok(Self {
            images,
            truth: prepared.simulation.ground_truth(first.camera),
            remaps: maps.map(|map| Remap::new(&map, width, height)),
            geometry: Geometry {
                focal_px: model.fx,
                center: [model.cx, model.cy],
                baseline_m: rectification.baseline_m,
                offset_px: 0.0,
            },
            size: [width as usize, height as usize],
        })
    }

    /// Exposure, I420 of both eyes, stored depth and its sigma, and masks, a bit per pixel.
    fn render(&mut self, id: &KeyframeId) -> Result<Vec<u8>> {
        let [width, height] = self.size;
        let shot = self.images.expose(id.frame, id.time_ns);
        let eyes = [0, 1].map(|eye| self.remaps[eye].apply(&shot.gray(eye), 0));
        let mut bytes = Vec::new();
        bytes.extend(shot.exposure.seconds.to_le_bytes());
        bytes.extend(shot.exposure.gain.to_le_bytes());
        bytes.extend(&shot.i420);
        let nearest = self.geometry.focal_px * self.geometry.baseline_m / MIN_DISTANCE_M;
        let range = (nearest.ceil() as usize + 1).min(MAX_DISPARITIES);
        let band = Band::full(0, range, height)?;
        let mut matcher = BandedMatcher::new(Config::default(), width, band)?;
        let [left, right] = eyes
            .each_ref()
            .map(|eye| depth::ImageView::packed(width, height, eye));
        let (map, _) = matcher.run(&left?, &right?, None)?;
        let depth = self.geometry.depth(map, MAX_RELATIVE_SIGMA)?;
        let stored =
            DepthImage::from_metres(width as u32, height as u32, &depth.depth_m, &depth.sigma_m);
        bytes.extend(stored.depth.iter().flat_map(|units| units.to_le_bytes()));
        bytes.extend(stored.sigma.iter().flat_map(|units| units.to_le_bytes()));
        for eye in 0..2 {
            let seen = self.truth.render(eye, id.time_ns);
            let is_person: Vec<bool> = seen.class.iter().map(|c| *c == Class::Person).collect();
            let wide = dilated(&is_person, self.size, MASK_MARGIN * width / 640);
            let bits = |of: &[bool]| (0..of.len()).map(|k| u8::from(of[k]) << k).sum::<u8>();
            bytes.extend(wide.chunks(8).map(bits));
        }
        Ok(bytes)
    }
}

fn parse(id: &KeyframeId, [width, height]: [usize; 2], bytes: &[u8]) -> Result<KeyframeImages> {
    let pixels = width * height;
    let expected = 16 + 3 * pixels + 2 * 2 * pixels + 2 * pixels.div_ceil(8);
    ensure!(
        bytes.len() == expected,
        "found {} bytes of a keyframe, expected {expected}",
        bytes.len()
    );
    let mut rest = bytes;
    let mut take = |count: usize| {
        let (head, tail) = rest.split_at(count);
        rest = tail;
        head
    };
    let mut number = || {
        let (number, _) = take(8).as_chunks::<8>();
        f64::from_le_bytes(number[0])
    };
    let exposure = Exposure {
        seconds: number(),
        gain: number(),
    };
    let shot = StereoFrame {
        number: id.frame,
        time_ns: id.time_ns,
        exposure,
        width: 2 * width,
        height,
        i420: take(3 * pixels).to_vec(),
    };
    let rgb = [0, 1].map(|eye| shot.rgb(eye).into_flattened());
    let [depth, sigma] = [0, 1].map(|_| {
        let (units, _) = take(2 * pixels).as_chunks::<2>();
        units
            .iter()
            .map(|units| u16::from_le_bytes(*units))
            .collect()
    });
    let is_person = [0, 1].map(|_| {
        let bits = take(pixels.div_ceil(8));
        (0..pixels)
            .map(|k| bits[k / 8] >> (k % 8) & 1 == 1)
            .collect()
    });
    Ok(KeyframeImages {
        id: *id,
        exposure,
        rgb,
        is_person,
        depth: DepthImage {
            width: width as u32,
            height: height as u32,
            depth,
            sigma,
        },
    })
}

/// The folder of a walk's keyframes.
fn folder(name: &str) -> Result<PathBuf> {
    let release = meter::on_disk(None)?;
    let target = release.parent().unwrap_or(Path::new("."));
    let folder = target.join("bench-splats").join(name);
    fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    Ok(folder)
}
