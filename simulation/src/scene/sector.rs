//! A sector: a part of a scene with its own coordinate frame, and its edges to others.

use std::fmt;
use std::sync::Arc;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Eye};
use scene_bundle::Trajectory;
use scene_bundle::outputs::contacts::FootContact;
use scene_bundle::outputs::feet::FootPose;
use scene_bundle::outputs::maps::MapLevel;

use super::gaussians::GaussianSource;
use super::similarity::Similarity;

/// A part of a scene. Its frame has z up along gravity, in m; all members are in it.
#[derive(Clone, Debug)]
pub struct Sector {
    /// Its name, which no other sector of the scene has.
    pub name: String,
    /// Walkable levels, from output `maps`.
    pub levels: Option<Arc<Vec<MapLevel>>>,
    /// Where it owns agents and cameras.
    pub area: Area,
    /// Poses from which the scene was recorded, `sector_from_camera`: views that support images
    /// in this sector, among them those of neighbors in the same recording.
    pub references: Arc<Vec<RigidTransform>>,
    /// Gaussians that show it.
    pub gaussians: Option<GaussianSource>,
    /// What was recorded of the walk. Sectors of a bundle share it.
    pub recording: Arc<Recording>,
    /// Edges to other sectors.
    pub edges: Vec<SectorEdge>,
}

/// What was recorded on a walk, in the frame of the sector.
#[derive(Clone, Default)]
pub struct Recording {
    /// Poses of the rig.
    pub trajectory: Option<Trajectory>,
    /// Cameras of the rig, each image of a stereo camera by itself.
    pub cameras: Vec<RecordingCamera>,
    /// Contacts of the wearer's feet with the ground, by time.
    pub contacts: Vec<FootContact>,
    /// Poses of the wearer's feet, by foot and time.
    pub feet: Vec<FootPose>,
    /// Images that the Gaussians were trained with or compared to.
    pub views: Vec<RecordedView>,
    /// The bundle, for reading the outputs `terrain` and `collision`; their files were checked.
    pub bundle: Option<scene_bundle::Scene>,
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let poses = self.trajectory.as_ref().map_or(0, Trajectory::len);
        let (cameras, views) = (self.cameras.len(), self.views.len());
        write!(
            f,
            "{poses} poses of the rig, {cameras} cameras, {views} views"
        )
    }
}

/// A camera that recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingCamera {
    /// Its name with the eye, such as `left_shoulder/left`.
    pub name: String,
    /// Which image of the stereo frame.
    pub eye: Eye,
    /// Lens and image size.
    pub model: CameraModel,
    /// Its optical frame in the rig.
    pub rig_from_camera: RigidTransform,
    /// Readout line time of the rolling shutter, s; 0 for a global one.
    pub line_s: f64,
}

/// An image of the training, or one that was held out.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedView {
    /// Name of its camera with the eye.
    pub camera: String,
    /// Time of the frame, ns.
    pub time_ns: i64,
    /// Pose of the optical frame at the middle row, `sector_from_camera`.
    pub world_from_camera: RigidTransform,
    /// PSNR of the rendered image where it was held out, dB.
    pub held_out_psnr_db: Option<f64>,
}

/// Where a sector owns what moves: a rectangle on the ground, and a range of heights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Least x and y, m.
    pub min_m: [f64; 2],
    /// Greatest x and y, m.
    pub max_m: [f64; 2],
    /// Least and greatest height, m; may be infinite.
    pub height_m: [f64; 2],
}

impl Area {
    /// All heights above a rectangle.
    pub fn new(min_m: [f64; 2], max_m: [f64; 2]) -> Self {
        Self {
            min_m,
            max_m,
            height_m: [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    /// Signed horizontal distance to the border, m: positive inside of the rectangle; outside minus
    /// the distance. Negative infinity outside of the heights.
    ///
    /// ```
    /// use simulation::Area;
    ///
    /// let area = Area::new([0.0, 0.0], [4.0, 2.0]);
    /// assert_eq!(area.depth_m([1.0, 1.5, 0.0]), 0.5);
    /// assert_eq!(area.depth_m([7.0, 6.0, 0.0]), -5.0);
    /// ```
    pub fn depth_m(&self, at_m: [f64; 3]) -> f64 {
        if !(self.height_m[0]..=self.height_m[1]).contains(&at_m[2]) {
            return f64::NEG_INFINITY;
        }
        let inside = [0, 1].map(|k| (at_m[k] - self.min_m[k]).min(self.max_m[k] - at_m[k]));
        match inside[0].min(inside[1]) {
            depth if depth >= 0.0 => depth,
            _ => -inside
                .map(|v| v.min(0.0).powi(2))
                .iter()
                .sum::<f64>()
                .sqrt(),
        }
    }

    /// Middle of the rectangle, x and y, m.
    pub fn center_m(&self) -> [f64; 2] {
        [0, 1].map(|k| 0.5 * (self.min_m[k] + self.max_m[k]))
    }
}

/// A directed edge to another sector.
#[derive(Clone, Debug, PartialEq)]
pub struct SectorEdge {
    /// Index of the sector that it leads to.
    pub to: usize,
    /// Takes points of this sector to the other one. The identity inside of a bundle.
    pub to_from_here: Similarity,
    /// Where both sectors show the scene, in the frame of this one.
    pub overlap: Area,
    /// Root mean square residual of the alignment, m; 0 inside of a bundle, `None` where an import
    /// does not state it.
    pub residual_m: Option<f64>,
    /// Whether the transform was estimated between recordings. Only then may it have a scale, and
    /// only there are images cross-faded: inside of a bundle both sectors show the same Gaussians.
    pub is_imported: bool,
}
