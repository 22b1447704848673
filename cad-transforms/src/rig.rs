//! The rig: its coordinate frames and their poses on the plate.
//!
//! Contract: a [`Rig`] that exists is a tree that connects every frame to `rig`, each transform a
//! proper rotation, each camera with its left frame. Reading reports everything that is wrong with
//! a file together, each with its line; a rig is never built from the part that was right. The
//! transforms are fixed for one revision of the plate. Where the rig is in the world changes with
//! time and is no part of the file.
//!
//! The file is TOML:
//!
//! ```toml
//! format = 1
//! name = "chest plate"
//! revision = "B"
//!
//! [provenance]
//! kind = "cad"             # nominal, cad, measured or calibrated
//! note = "assembly drawing 12, cameras in their mounts"
//! cad_file = "plate.step"  # optional: the file the numbers were taken from
//! cad_blake3 = "…"         # optional: its BLAKE3 hash, 64 hexadecimal digits
//!
//! [[camera]]               # optional: what is known of the device
//! name = "feet"
//! serial = "12345678"
//! model = "ZED Mini"
//!
//! [[parent_from_child]]    # takes coordinates in child to coordinates in parent
//! parent = "rig"
//! child = "feet/left"
//! rotation_wxyz = [0.5, -0.5, 0.5, -0.5]   # or rotation_rows = [[…], […], […]]
//! translation_m = [0.05, 0.03, -0.10]      # origin of child, in parent
//! sigma_translation_m = 0.0002             # optional tolerance of the joint: one number or three; or _mm
//! sigma_rotation_rad = 0.002               # one number or three; or _deg
//! # covariance = [[…], …]                  # or all of it: 6 rows of 6, m and rad
//!
//! [[closes_loop]]          # optional: a second way to the same place, as a check
//! parent = "left_shoulder/left"
//! child = "feet/left"
//! rotation_wxyz = [1, 0, 0, 0]
//! translation_m = [0.1, 0.2, 0.0]
//! within_m = 0.001         # or within_mm
//! within_rad = 0.005       # or within_deg
//!
//! [[shoe_tag]]             # any number, or none
//! family = "36h11"
//! id = 0
//! foot = "left_foot"       # or right_foot
//! size_m = 0.06            # side of the black square
//! rotation_wxyz = [0, 0.707106781186548, -0.707106781186548, 0]   # foot_from_tag
//! translation_m = [0.08, 0.0, 0.075]       # middle of the tag, in the foot
//! sigma_size_m = 0.0003                    # optional tolerance of the size; or _mm
//! sigma_translation_m = 0.003              # optional tolerance of the placement, as of a joint
//! sigma_rotation_rad = 0.03
//!
//! [[sole]]                 # one for each foot, or none
//! foot = "left_foot"
//! outline_m = [[0.15, 0.0], [0.1, 0.045], [-0.13, 0.04], [-0.13, -0.04], [0.1, -0.045]]
//! sigma_m = 0.003          # optional tolerance of a vertex; or _mm
//! ```
//!
//! A tolerance is a standard deviation, or the covariance, of a small motion of the child in the
//! child's axes, translation before rotation: see [`crate::covariance`]. It is above 0: what is not
//! known is left out. The optional keys may be absent.
//!
//! The frame of a foot has its origin in the middle of the shoe's sole, x to the toe, y to the
//! left, z up from the sole. That of a tag has its origin in its middle, x to the right, y down and
//! z into the tag, for a reader who sees it upright. Feet move, and are no frames of the tree. The
//! outline of a sole goes counter-clockwise around its middle, seen from above.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use crate::covariance::Covariance;
use crate::frame::{Frame, FramePart};
use crate::transform::RigidTransform;

mod change;
pub mod check;
mod devices;
pub mod diff;
pub(crate) mod file;
mod loops;
mod shoes;
pub(crate) mod table;
pub(crate) mod tolerance;
mod tree;
pub(crate) mod write;

pub use self::change::RigParts;
pub use self::devices::same_serial;
pub use self::loops::Closure;
pub use self::shoes::{Foot, ShoeTag, Sole, TagFamily};

/// The version of the file this crate reads.
pub(crate) const RIG_FORMAT: i64 = 1;

/// Transforms that differ by less are the same, m and rad.
const SAME: f64 = 1e-9;

/// Fixed transforms of one revision of the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    name: String,
    revision: String,
    provenance: Provenance,
    cameras: Vec<CameraInfo>,
    edges: Vec<Edge>,
    closures: Vec<Closure>,
    /// For every frame but `rig`: its neighbour on the path to `rig`.
    towards_rig: BTreeMap<Frame, Step>,
    shoe_tags: Vec<ShoeTag>,
    soles: Vec<Sole>,
}

/// One entry of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Frame the transform leads to.
    pub parent: Frame,
    /// Frame the transform starts from.
    pub child: Frame,
    /// Takes coordinates in `child` to coordinates in `parent`.
    pub parent_from_child: RigidTransform,
    /// Covariance of the joint: of a small motion of `child` in its own axes. `None` where the file
    /// says nothing, which is not the same as exact.
    pub covariance: Option<Covariance>,
}

/// What the file says of a camera as a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraInfo {
    /// Name in the rig, the first part of its frames.
    pub name: String,
    /// Serial number, as printed on the device.
    pub serial: Option<String>,
    /// Maker's name of the model.
    pub model: Option<String>,
}

/// Where the numbers come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Kind of the source.
    pub kind: ProvenanceKind,
    /// In words: drawing, method, instrument.
    pub note: String,
    /// The file that the numbers were taken from.
    pub cad: Option<CadSource>,
}

/// The file a rig was made from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CadSource {
    /// Name of the file, without its folder.
    pub file: String,
    /// BLAKE3 hash of its bytes: 64 hexadecimal digits, lower case.
    pub blake3: String,
}

/// How the numbers of a rig came about, from least to most trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ProvenanceKind {
    /// Written down as intended; nothing was drawn or measured.
    Nominal,
    /// Taken from the CAD model.
    Cad,
    /// Measured on the built plate.
    Measured,
    /// Estimated from recordings.
    Calibrated,
}

/// What is wrong with a rig file or with a question to a rig.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading a rig file: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not a rig: correct everything listed.
    #[error("checking a rig file: {problems}{}", in_file(path.as_deref()))]
    Invalid {
        /// Everything that is wrong, in the order of the file.
        problems: Problems,
        /// The file, where the text came from one.
        path: Option<PathBuf>,
    },
    /// The rig has no such frame: use one of those it has, or add it to the file.
    #[error("looking up frame {frame} in rig {rig:?}: not there, expected one of {known}")]
    UnknownFrame {
        /// The requested frame.
        frame: Frame,
        /// Name of the rig.
        rig: String,
        /// The frames it has.
        known: String,
    },
    /// The rig has no such entry: the two frames are not neighbours.
    #[error(
        "changing rig {rig:?}: no entry connects {parent} and {child}, expected one of {known}"
    )]
    UnknownEdge {
        /// One frame.
        parent: Frame,
        /// The other.
        child: Frame,
        /// Name of the rig.
        rig: String,
        /// The entries it has.
        known: String,
    },
    /// The rig file could not be written; an existing file is unchanged.
    #[error(transparent)]
    Write(#[from] crate::output::WriteError),
}

/// A list of problems, shown one per line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>);

/// One thing that is wrong with a rig file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line in the file, from 1; 0 where there is no file.
    pub line: usize,
    /// What was found and what was expected.
    pub message: String,
}

impl Rig {
    /// Reads and checks a rig file: a regular file of at most [`plain_file::TEXT_LIMIT`] bytes.
    ///
    /// # Errors
    /// [`RigError::Read`], or [`RigError::Invalid`] with everything that is wrong.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let text = plain_file::read_to_string(path, plain_file::TEXT_LIMIT).map_err(|source| {
            RigError::Read {
                path: path.to_owned(),
                source,
            }
        })?;
        Self::parse(&text).map_err(|error| match error {
            RigError::Invalid { problems, .. } => RigError::Invalid {
                problems,
                path: Some(path.to_owned()),
            },
            other => other,
        })
    }

    /// Reads and checks the text of a rig file.
    ///
    /// # Errors
    /// [`RigError::Invalid`] with everything that is wrong.
    pub fn parse(text: &str) -> Result<Self, RigError> {
        file::read(text)
            .into_rig()
            .map_err(|problems| RigError::Invalid {
                problems,
                path: None,
            })
    }

    /// `b_from_a`, composed along the tree.
    ///
    /// # Errors
    /// [`RigError::UnknownFrame`].
    pub fn transform(&self, b: &Frame, a: &Frame) -> Result<RigidTransform, RigError> {
        let to_rig_from_a = self.way_to_rig(a)?;
        let to_rig_from_b = self.way_to_rig(b)?;
        // Both paths end in `rig`; what they share at the end cancels and is left out, so that the
        // transform between neighbours is the stored one.
        let shared = to_rig_from_a
            .iter()
            .rev()
            .zip(to_rig_from_b.iter().rev())
            .take_while(|(x, y)| std::ptr::eq(**x, **y))
            .count();
        let meeting_from = |way: &[&Step]| {
            way[..way.len() - shared]
                .iter()
                .map(|step| step.next_from_this)
                .reduce(|next_from_start, after_from_next| after_from_next * next_from_start)
        };
        let (m_from_a, m_from_b) = (meeting_from(&to_rig_from_a), meeting_from(&to_rig_from_b));
        Ok(match (m_from_b, m_from_a) {
            (None, None) => RigidTransform::identity(),
            (None, Some(m_from_a)) => m_from_a,
            (Some(m_from_b), None) => m_from_b.inverse(),
            (Some(m_from_b), Some(m_from_a)) => m_from_b.inverse() * m_from_a,
        })
    }

    /// Name of the plate.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Revision of the plate.
    pub fn revision(&self) -> &str {
        &self.revision
    }

    /// Where the numbers come from.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The entries as written, in the order of the file.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The tags on the wearer's shoes, in the order of the file.
    pub fn shoe_tags(&self) -> &[ShoeTag] {
        &self.shoe_tags
    }

    /// Outlines of the soles of the wearer's shoes, in the order of the file.
    pub fn soles(&self) -> &[Sole] {
        &self.soles
    }

    /// What the file says of the cameras as devices, in the order of the file.
    pub fn camera_infos(&self) -> &[CameraInfo] {
        &self.cameras
    }

    /// Serial number of a camera, where the file has one.
    pub fn serial(&self, camera: &str) -> Option<&str> {
        let info = self.cameras.iter().find(|info| info.name == camera)?;
        info.serial.as_deref()
    }

    /// Loop closures: second paths to the same frame, which agree with the tree.
    pub fn closures(&self) -> &[Closure] {
        &self.closures
    }

    /// Covariance of [`Self::transform`]: of a small motion of `a`, in its own axes, with `b`
    /// fixed. The joints are taken as independent. `None` where an entry on the path has no
    /// tolerance.
    ///
    /// # Errors
    /// [`RigError::UnknownFrame`].
    pub fn covariance(&self, b: &Frame, a: &Frame) -> Result<Option<Covariance>, RigError> {
        let (from_a, from_b) = (self.way_to_rig(a)?, self.way_to_rig(b)?);
        let shared = |step: &&Step, other: &[&Step]| other.iter().any(|o| std::ptr::eq(*o, *step));
        let mut sum = Covariance::zero();
        for (way, other) in [(&from_a, &from_b), (&from_b, &from_a)] {
            for step in way.iter().filter(|step| !shared(step, other)) {
                let Some(in_this) = &step.covariance else {
                    return Ok(None);
                };
                sum = sum.plus(&in_this.moved(&self.transform(a, &step.this)?));
            }
        }
        Ok(Some(sum))
    }

    /// All frames, `rig` first, the others by name.
    pub fn frames(&self) -> impl Iterator<Item = Frame> + '_ {
        std::iter::once(Frame::rig()).chain(self.towards_rig.keys().cloned())
    }

    /// Names of the cameras, sorted. Each has at least its left frame.
    pub fn cameras(&self) -> Vec<&str> {
        self.towards_rig
            .keys()
            .filter_map(|frame| match frame.camera()? {
                (camera, FramePart::Left) => Some(camera),
                _ => None,
            })
            .collect()
    }

    /// The camera that is the origin of a rig calibrated from boards alone: `rig` is at its left
    /// lens, x along the view, y to the left, z up in its image. None where the frame of the rig is
    /// a datum of the plate, as in every rig whose numbers are not calibrated.
    pub fn origin_camera(&self) -> Option<&str> {
        if self.provenance.kind != ProvenanceKind::Calibrated {
            return None;
        }
        let body_from_optical = RigidTransform::body_from_optical();
        self.cameras().into_iter().find(|camera| {
            let left = Frame::of_camera(camera, FramePart::Left);
            let rig_from_left = left
                .ok()
                .and_then(|l| self.transform(&Frame::rig(), &l).ok());
            rig_from_left.is_some_and(|rig_from_left| {
                let off = body_from_optical.inverse() * rig_from_left;
                off.distance_m() < SAME && off.angle_rad() < SAME
            })
        })
    }

    /// Every frame but `rig`, its neighbour towards `rig`, and `neighbour_from_frame`; by name.
    pub(crate) fn steps(&self) -> impl Iterator<Item = (&Frame, &Frame, RigidTransform)> {
        let steps = self.towards_rig.iter();
        steps.map(|(frame, step)| (frame, &step.next, step.next_from_this))
    }

    /// The steps from a frame to `rig`.
    fn way_to_rig(&self, frame: &Frame) -> Result<Vec<&Step>, RigError> {
        let mut way = Vec::new();
        let mut here = frame;
        while let Some(step) = self.towards_rig.get(here) {
            way.push(step);
            here = &step.next;
        }
        if *here == Frame::rig() {
            return Ok(way);
        }
        let known: Vec<String> = self.frames().map(String::from).collect();
        Err(RigError::UnknownFrame {
            frame: frame.clone(),
            rig: self.name.clone(),
            known: known.join(", "),
        })
    }
}

/// One step on the path from a frame to `rig`.
#[derive(Clone, Debug, PartialEq)]
struct Step {
    this: Frame,
    next: Frame,
    next_from_this: RigidTransform,
    /// Of a small motion of `this` in its own axes.
    covariance: Option<Covariance>,
}

impl ProvenanceKind {
    /// All kinds, from least to most trusted.
    pub const ALL: [Self; 4] = [Self::Nominal, Self::Cad, Self::Measured, Self::Calibrated];

    /// As written in the file.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::Cad => "cad",
            Self::Measured => "measured",
            Self::Calibrated => "calibrated",
        }
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.as_slice() {
            [only] => write!(f, "{only}"),
            all => {
                write!(f, "{} problems", all.len())?;
                all.iter()
                    .try_for_each(|problem| write!(f, "\n  {problem}"))
            }
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => f.write_str(&self.message),
            line => write!(f, "line {line}: {}", self.message),
        }
    }
}

fn in_file(path: Option<&Path>) -> String {
    path.map(|path| format!("\nin {}", path.display()))
        .unwrap_or_default()
}

#[cfg(test)]
mod tests;
