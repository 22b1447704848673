//! Rig files with estimated extrinsics: a new revision of the given one, or the first one of a rig.
//! Tolerances are the covariances of the estimate.

use anyhow::{Context, Result, ensure};
use cad_transforms::rig::{CameraInfo, Edge, Provenance, ProvenanceKind, RigParts};
use cad_transforms::{Covariance, Frame, Rig, RigidTransform};
use nalgebra::Matrix6;
use session_archive::manifest::Manifest;

use super::nominal_rig::in_child;

/// Sigmas of the origin's pose, m and rad. It is fixed by definition, but rig files allow no sigma
/// of 0, and no tolerance is as small as a micrometre.
const ORIGIN_SIGMA: f64 = 1e-6;

/// Estimated extrinsics.
pub(super) struct Joint {
    pub(super) parent: Frame,
    pub(super) child: Frame,
    pub(super) parent_from_child: RigidTransform,
    /// Covariance of `[v, ω]` in the parent's axes, m and rad: the translation changes by `v`, the
    /// rotation by `Exp(ω)` from the left; `None` if unknown.
    pub(super) covariance: Option<Matrix6<f64>>,
}

impl Joint {
    /// The tolerance as in rig files.
    fn tolerance(&self) -> Result<Option<Covariance>> {
        let Some(covariance) = &self.covariance else {
            return Ok(None);
        };
        if *covariance == Matrix6::zeros() {
            return Ok(Some(Covariance::from_sigmas(
                [ORIGIN_SIGMA; 3],
                [ORIGIN_SIGMA; 3],
            )?));
        }
        let covariance = in_child(covariance, &self.parent_from_child);
        let (parent, child) = (&self.parent, &self.child);
        let covariance = covariance.with_context(|| {
            format!("writing the calibrated rig: the covariance of {child} in {parent} is none")
        })?;
        Ok(Some(covariance))
    }
}

/// The rig with these joints; its revision is that of `rig` followed by `ending`. A child that the
/// rig does not have is added.
///
/// # Errors
/// A child has another parent than the joint, its covariance is invalid, or a loop of the rig no
/// longer closes.
pub(super) fn revised(
    rig: &Rig,
    joints: &[Joint],
    verb: &str,
    ending: &str,
    manifest: &Manifest,
) -> Result<Rig> {
    let mut new = rig.clone();
    for joint in joints {
        let (parent, child) = (&joint.parent, &joint.child);
        let covariance = joint.tolerance()?;
        if new.frames().all(|frame| frame != *child) {
            let mut parts = new.to_parts();
            parts.edges.push(Edge {
                parent: parent.clone(),
                child: child.clone(),
                parent_from_child: joint.parent_from_child,
                covariance,
            });
            new = Rig::from_parts(parts).context("adding the estimates to the rig")?;
            continue;
        }
        let direct = new.edges().iter().any(|e| {
            (&e.parent, &e.child) == (parent, child) || (&e.parent, &e.child) == (child, parent)
        });
        ensure!(
            direct,
            "writing the calibrated rig: {child} has another parent than {parent}"
        );
        new = new.with_edge(parent, child, joint.parent_from_child, covariance)?;
    }
    let start = format!("starting from revision {:?}", rig.revision());
    let provenance = Provenance {
        kind: ProvenanceKind::Calibrated,
        note: note(verb, manifest, &start),
        cad: rig.provenance().cad.clone(),
    };
    let revision = format!("{}-{ending}", rig.revision());
    let new = new.with_provenance(provenance).with_revision(revision);
    let open = new.open_loops();
    ensure!(
        open.is_empty(),
        "checking the calibrated rig: {}",
        open.join("; ")
    );
    // The written file must parse.
    Rig::parse(&new.to_toml()).context("checking the calibrated rig")
}

/// The first rig file of a rig: these joints and nothing else. `frame` describes the rig frame.
///
/// # Errors
/// The joints do not form a rig: a camera is not connected with the others.
pub(super) fn first(joints: &[Joint], verb: &str, frame: &str, manifest: &Manifest) -> Result<Rig> {
    let mut edges = Vec::new();
    for joint in joints {
        edges.push(Edge {
            parent: joint.parent.clone(),
            child: joint.child.clone(),
            parent_from_child: joint.parent_from_child,
            covariance: joint.tolerance()?,
        });
    }
    let camera = |name: &String| CameraInfo {
        name: name.clone(),
        serial: None,
        model: None,
    };
    let placed = |name: &&String| {
        let left = format!("{name}/left");
        edges.iter().any(|edge| edge.child.as_str() == left)
    };
    let names = manifest.cameras.iter().map(|camera| &camera.name);
    let cameras = names.filter(placed).map(camera).collect();
    let session = manifest.session_id.split('-').next().unwrap_or_default();
    let parts = RigParts {
        name: "calibrated rig".to_owned(),
        revision: format!("{}-{session}", day(manifest)),
        provenance: Provenance {
            kind: ProvenanceKind::Calibrated,
            note: note(verb, manifest, frame),
            cad: None,
        },
        cameras,
        edges,
        closures: Vec::new(),
        shoe_tags: Vec::new(),
        soles: Vec::new(),
    };
    Rig::from_parts(parts).context("making a rig file of the estimates")
}

fn note(verb: &str, manifest: &Manifest, more: &str) -> String {
    format!(
        "by `paws calib {verb}` of {} from session {} of {}, {more}",
        crate::software::SOFTWARE,
        manifest.session_id,
        manifest.started_civil
    )
}

/// The day of a recording, as in `2026-01-31`.
fn day(manifest: &Manifest) -> String {
    let civil = manifest.started_civil.to_string();
    civil.split('T').next().unwrap_or_default().to_owned()
}
