//! Rigs made by programs: from parts, or from another rig by an exchange.

use super::{
    CameraInfo, Closure, Edge, Problem, Problems, Provenance, Rig, RigError, ShoeTag, Sole, file,
    loops, tree,
};
use crate::covariance::Covariance;
use crate::frame::Frame;
use crate::transform::RigidTransform;

/// Everything a rig file holds, unchecked.
#[derive(Clone, Debug, PartialEq)]
pub struct RigParts {
    /// Name of the plate.
    pub name: String,
    /// Revision of the plate.
    pub revision: String,
    /// Where the numbers come from.
    pub provenance: Provenance,
    /// The cameras as devices.
    pub cameras: Vec<CameraInfo>,
    /// The entries.
    pub edges: Vec<Edge>,
    /// Loop closures: second paths to the same frame.
    pub closures: Vec<Closure>,
    /// Tags on the wearer's shoes.
    pub shoe_tags: Vec<ShoeTag>,
    /// Outlines of the soles of the wearer's shoes.
    pub soles: Vec<Sole>,
}

impl Rig {
    /// A rig of these parts, if they are one: the same checks as on reading a file.
    ///
    /// # Errors
    /// [`RigError::Invalid`] with everything that is wrong, without lines.
    pub fn from_parts(parts: RigParts) -> Result<Self, RigError> {
        // What can be written and read again is a rig, and nothing else is.
        let text = super::write::text(&parts);
        file::read(&text).into_rig().map_err(|problems| {
            let unplaced = |problem: Problem| Problem { line: 0, ..problem };
            RigError::Invalid {
                problems: Problems(problems.0.into_iter().map(unplaced).collect()),
                path: None,
            }
        })
    }

    /// Its parts, to change some and make another.
    pub fn to_parts(&self) -> RigParts {
        RigParts {
            name: self.name.clone(),
            revision: self.revision.clone(),
            provenance: self.provenance.clone(),
            cameras: self.cameras.clone(),
            edges: self.edges.clone(),
            closures: self.closures.clone(),
            shoe_tags: self.shoe_tags.clone(),
            soles: self.soles.clone(),
        }
    }

    /// This rig with another transform and tolerance between two neighbours. The entry keeps its
    /// place and its direction in the file; `parent` and `child` may be given either way round.
    ///
    /// Loops are not looked at, so that several entries can be exchanged one after the other;
    /// [`Rig::open_loops`] tells, and [`Rig::write`] refuses a rig with an open one.
    ///
    /// # Errors
    /// [`RigError::UnknownEdge`].
    ///
    /// ```
    /// use cad_transforms::{Covariance, RigidTransform, Rig};
    /// # let text = include_str!("../../rigs/example.toml");
    /// let rig = Rig::parse(text)?;
    /// let (left, right) = ("feet/left".parse()?, "feet/right".parse()?);
    /// let left_from_right = RigidTransform::from_translation_m([0.06287, 0.0, 0.0])?;
    /// let sigma = Covariance::from_sigmas([2e-5; 3], [1e-4; 3])?;
    /// let rig = rig.with_edge(&left, &right, left_from_right, Some(sigma))?;
    /// assert_eq!(rig.transform(&left, &right)?.distance_m(), 0.06287);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_edge(
        &self,
        parent: &Frame,
        child: &Frame,
        parent_from_child: RigidTransform,
        covariance: Option<Covariance>,
    ) -> Result<Self, RigError> {
        let mut rig = self.clone();
        let (mut same, mut reversed) = (None, None);
        for edge in &mut rig.edges {
            if (&edge.parent, &edge.child) == (parent, child) {
                same = Some(edge);
            } else if (&edge.parent, &edge.child) == (child, parent) {
                reversed = Some(edge);
            }
        }
        match (same, reversed) {
            (Some(edge), _) => {
                edge.parent_from_child = parent_from_child;
                edge.covariance = covariance;
            }
            (None, Some(edge)) => {
                edge.parent_from_child = parent_from_child.inverse();
                edge.covariance = covariance.map(|c| c.moved(&parent_from_child));
            }
            (None, None) => {
                let known: Vec<String> = self
                    .edges
                    .iter()
                    .map(|edge| format!("{} - {}", edge.parent, edge.child))
                    .collect();
                return Err(RigError::UnknownEdge {
                    parent: parent.clone(),
                    child: child.clone(),
                    rig: self.name.clone(),
                    known: known.join(", "),
                });
            }
        }
        rig.towards_rig = tree::towards_rig(&rig.edges);
        Ok(rig)
    }

    /// This rig with another provenance.
    #[must_use]
    pub fn with_provenance(mut self, provenance: Provenance) -> Self {
        self.provenance = provenance;
        self
    }

    /// This rig as another revision.
    #[must_use]
    pub fn with_revision(mut self, revision: impl Into<String>) -> Self {
        self.revision = revision.into();
        self
    }

    /// Errors of this rig that only an exchange can have brought in.
    pub(super) fn closed(&self) -> Result<(), RigError> {
        let problems = Problems(loops::problems(self));
        if problems.0.is_empty() {
            return Ok(());
        }
        Err(RigError::Invalid {
            problems,
            path: None,
        })
    }
}
