//! `splats.json`: sectors, views and the training of a scene of Gaussians.

use std::collections::BTreeSet;

use cad_transforms::RigidTransform;
use camera_models::Eye;
use serde::{Deserialize, Serialize};

use super::super::Fault;
use crate::layout;

/// The file of the record.
pub(super) const FILE: &str = "splats.json";

/// A scene of Gaussians without the Gaussians themselves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatScene {
    /// Degree of the spherical harmonics, 0 to 3.
    pub degree: usize,
    /// Whether opacities are compensated for the dilation in the image (Mip-Splatting).
    pub compensated: bool,
    /// What is behind the Gaussians.
    pub background: SplatBackground,
    /// Parts of the scene. None where nothing could be trained.
    pub sectors: Vec<SplatSector>,
    /// Images of the training and held-out ones, as they were used.
    pub views: Vec<SplatView>,
    /// How it was trained.
    pub training: SplatTraining,
    /// Layout of what the views of the training saw; `None` where that is not known.
    #[serde(default)]
    pub coverage: Option<SplatCoverage>,
}

/// What is behind the Gaussians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum SplatBackground {
    /// One color, 0 to 1.
    Constant([f32; 3]),
    /// A map of colors by direction in `sky.npy`.
    Sky {
        /// Texels along an edge.
        size: usize,
    },
}

/// A part of the scene: the Gaussians whose means are in a box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatSector {
    /// Lowest corner of the box in the world, m.
    pub min_m: [f64; 3],
    /// Highest corner, m.
    pub max_m: [f64; 3],
    /// Number of Gaussians.
    pub count: usize,
    /// Their file in the output's folder.
    pub file: String,
    /// BLAKE3 of the file, hex.
    pub blake3: String,
    /// Indices of the views that it was trained with.
    pub views: Vec<usize>,
    /// Sectors beside it.
    pub neighbors: Vec<SplatNeighbor>,
}

/// A sector beside another one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatNeighbor {
    /// Its index.
    pub sector: usize,
    /// Takes points of the sector to the frame of its neighbor; the identity where both are in the
    /// world of the bundle.
    pub neighbor_from_sector: RigidTransform,
}

/// An image that the training used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatView {
    /// Name of the camera.
    pub camera: String,
    /// Which image of the stereo frame.
    #[serde(with = "eye")]
    pub eye: Eye,
    /// Number of the frame among those of its camera.
    pub frame: u64,
    /// Number of the frame set.
    pub set: u64,
    /// Time of the frame, ns.
    pub time_ns: i64,
    /// Pose of the optical frame at the exposure of the middle row.
    pub world_from_camera: RigidTransform,
    /// Motion of a rolling shutter; `None` for a global one.
    pub shutter: Option<SplatShutter>,
    /// Factor by which the recorded image was reduced.
    pub reduction: u32,
    /// Colors of the image from those of the scene: rows of a map of red, green, blue and 1.
    pub exposure: [[f32; 4]; 3],
    /// Result in this image if it was held out; `None` if the scene was trained with it.
    pub held_out: Option<HeldOut>,
}

/// Motion of a camera while its rows are exposed, along its own axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatShutter {
    /// Readout line time, s.
    pub line_s: f64,
    /// Velocity, m/s.
    pub velocity_m_s: [f64; 3],
    /// Angular rate, rad/s.
    pub rate_rad_s: [f64; 3],
}

/// Quality of the scene in an image that it was not trained with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOut {
    /// PSNR over usable pixels, dB.
    pub psnr_db: f64,
    /// Mean structural similarity over usable pixels.
    pub ssim: f64,
    /// LPIPS (Zhang et al. 2018), 0 for equal images, by the user's network; `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// How a scene was trained.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatTraining {
    /// Name of the settings.
    pub preset: String,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Number of steps of each sector, one image each.
    pub steps: usize,
    /// Number of Gaussians at the start of all trainings.
    pub start_count: usize,
    /// How the exposures of the images were known.
    pub exposure_model: String,
    /// Median relative error of depth in the held-out images; of several sectors the mean of
    /// theirs, weighted by images.
    pub depth_error: Option<f64>,
    /// Comparisons of two numbers of Gaussians by held-out PSNR, in order: the curve.
    pub checks: Vec<SplatCheck>,
}

/// A comparison of a scene with a larger one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatCheck {
    /// Step at which the two parted.
    pub step: usize,
    /// Gaussians of both.
    pub counts: [usize; 2],
    /// Mean PSNR of the held-out images in both, dB.
    pub psnr_db: [f64; 2],
    /// Gain of a tenth more Gaussians, dB.
    pub gain_db: f64,
    /// The gain plus two standard errors, dB.
    pub upper_gain_db: f64,
    /// Whether the larger one was kept.
    pub continues: bool,
}

/// An eye as `left` or `right`.
mod eye {
    use camera_models::Eye;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Name {
        Left,
        Right,
    }

    pub(super) fn serialize<S: Serializer>(eye: &Eye, to: S) -> Result<S::Ok, S::Error> {
        match eye {
            Eye::Left => Name::Left,
            Eye::Right => Name::Right,
        }
        .serialize(to)
    }

    pub(super) fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Eye, D::Error> {
        Ok(match Name::deserialize(from)? {
            Name::Left => Eye::Left,
            Name::Right => Eye::Right,
        })
    }
}

impl SplatScene {
    /// Number of Gaussians of all sectors.
    pub fn count(&self) -> usize {
        self.sectors
            .iter()
            .fold(0, |sum, sector| sum.saturating_add(sector.count))
    }

    /// Means over the held-out images, if there are any.
    pub fn held_out(&self) -> Option<HeldOut> {
        let all: Vec<HeldOut> = self.views.iter().filter_map(|view| view.held_out).collect();
        let mean = |of: fn(&HeldOut) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
        let lpips: Option<Vec<f64>> = all.iter().map(|view| view.lpips).collect();
        (!all.is_empty()).then(|| HeldOut {
            psnr_db: mean(|view| view.psnr_db),
            ssim: mean(|view| view.ssim),
            lpips: lpips.map(|of| of.iter().sum::<f64>() / of.len() as f64),
        })
    }

    pub(super) fn check(&self) -> Result<(), Fault> {
        if self.degree > gaussians::MAX_DEGREE {
            let found = format!("degree {}", self.degree);
            return Err(Fault::new("degree", found, "0 to 3"));
        }
        match self.background {
            SplatBackground::Sky { size } if !(2..=4096).contains(&size) => {
                let found = format!("{size} texels");
                return Err(Fault::new("background", found, "2 to 4096"));
            }
            SplatBackground::Constant(color) if !color.iter().all(|v| v.is_finite()) => {
                let found = format!("{color:?}");
                return Err(Fault::new("background", found, "finite numbers"));
            }
            _ => {}
        }
        let mut files = BTreeSet::new();
        for (number, sector) in self.sectors.iter().enumerate() {
            sector.check(&format!("sector {number}"), self)?;
            if !files.insert(&sector.file) {
                let (place, found) = (format!("sector {number}"), sector.file.clone());
                return Err(Fault::new(&place, found, "a file of its own"));
            }
        }
        for (number, view) in self.views.iter().enumerate() {
            view.check(&format!("view {number}"))?;
        }
        if let Some(coverage) = &self.coverage {
            coverage.check()?;
        }
        let finite = |check: &SplatCheck| {
            let gains = [check.gain_db, check.upper_gain_db];
            gains.iter().chain(&check.psnr_db).all(|v| v.is_finite())
        };
        match self.training.checks.iter().position(|check| !finite(check)) {
            Some(number) => {
                let (place, found) = (format!("check {number}"), "a number that is not finite");
                Err(Fault::new(&place, found.to_owned(), "finite numbers"))
            }
            None => Ok(()),
        }
    }
}

impl SplatSector {
    fn check(&self, place: &str, scene: &SplatScene) -> Result<(), Fault> {
        let both = self.min_m.iter().zip(&self.max_m);
        if !both
            .into_iter()
            .all(|(a, b)| a.is_finite() && b.is_finite() && a <= b)
        {
            let found = format!("a box from {:?} to {:?}", self.min_m, self.max_m);
            return Err(Fault::new(place, found, "finite corners in order"));
        }
        if !layout::is_file_path(&self.file) || !self.file.ends_with(".ply") {
            let found = format!("a file {:?}", self.file);
            return Err(Fault::new(place, found, "a .ply file of the output"));
        }
        if !layout::is_hash(&self.blake3) {
            let found = format!("a hash {:?}", self.blake3);
            return Err(Fault::new(place, found, "64 hexadecimal digits"));
        }
        if let Some(view) = self.views.iter().find(|view| **view >= scene.views.len()) {
            let found = format!("view {view} of {}", scene.views.len());
            return Err(Fault::new(place, found, "an index of a view"));
        }
        let (sectors, mut neighbors) = (scene.sectors.len(), self.neighbors.iter());
        match neighbors.find(|neighbor| neighbor.sector >= sectors) {
            Some(neighbor) => {
                let found = format!("neighbor {} of {sectors}", neighbor.sector);
                Err(Fault::new(place, found, "an index of a sector"))
            }
            None => Ok(()),
        }
    }
}

impl SplatView {
    fn check(&self, place: &str) -> Result<(), Fault> {
        let shutter = self.shutter.iter().flat_map(|shutter| {
            let motion = shutter.velocity_m_s.into_iter().chain(shutter.rate_rad_s);
            motion.chain([shutter.line_s])
        });
        let result = self.held_out.iter();
        let result = result.flat_map(|h| [h.psnr_db, h.ssim].into_iter().chain(h.lpips));
        let exposure = self.exposure.as_flattened().iter().map(|v| f64::from(*v));
        if !shutter.chain(result).chain(exposure).all(f64::is_finite) {
            let found = "a number that is not finite".to_owned();
            return Err(Fault::new(place, found, "finite numbers"));
        }
        if self.reduction == 0 {
            let found = "a reduction by 0".to_owned();
            return Err(Fault::new(place, found, "1 or more"));
        }
        Ok(())
    }
}

/// Layout of what was seen of space and sky.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplatCoverage {
    /// Edge of a voxel, m.
    pub voxel_m: f32,
    /// Distance from a camera at which space was not seen any more, m.
    pub range_m: f32,
    /// Texels along an edge of the map of the sky.
    pub sky_texels: usize,
}
