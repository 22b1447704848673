//! A rig file with places that were found: a new revision of the one that was told, its tolerances those of the
//! estimation.

use anyhow::{Context, Result, ensure};
use cad_transforms::rig::{Provenance, ProvenanceKind};
use cad_transforms::{Frame, Rig, RigidTransform};
use nalgebra::Matrix6;
use session_archive::manifest::Manifest;

use super::told::in_child;

/// A place that was found.
pub(super) struct Joint {
    pub(super) parent: Frame,
    pub(super) child: Frame,
    pub(super) parent_from_child: RigidTransform,
    /// Of `[v, ω]` in the parent's axes, m and rad: the translation moves by `v`, the rotation by `Exp(ω)` from the left.
    pub(super) covariance: Matrix6<f64>,
}

/// The rig with these joints, its revision that of `rig` and `ending`.
///
/// # Errors
/// A joint is none of the rig's own, its covariance is none, or a loop of the rig does not close any more.
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
        let covariance = in_child(&joint.covariance, &joint.parent_from_child);
        let covariance = covariance.with_context(|| {
            format!("writing the calibrated rig: the covariance of {child} in {parent} is none")
        })?;
        let direct = new.edges().iter().any(|e| {
            (&e.parent, &e.child) == (parent, child) || (&e.parent, &e.child) == (child, parent)
        });
        ensure!(
            direct,
            "writing the calibrated rig: {child} is not placed in {parent} directly, as it must be for this"
        );
        new = new.with_edge(parent, child, joint.parent_from_child, Some(covariance))?;
    }
    let note = format!(
        "by `paws calib {verb}` of {} from session {} of {}, starting from revision {:?}",
        crate::SOFTWARE,
        manifest.session_id,
        manifest.started_civil,
        rig.revision()
    );
    let provenance = Provenance {
        kind: ProvenanceKind::Calibrated,
        note,
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
    // What is written must read back.
    Rig::parse(&new.to_toml()).context("checking the calibrated rig")
}
