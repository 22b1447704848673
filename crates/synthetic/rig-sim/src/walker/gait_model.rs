//! A gait of another form than the simulator's own, to examine estimators with.
//!
//! Contract: footfalls are planned as for the simulator's own wearers, so that soles rest on the
//! ground. Between the flat phases feet move as the model says; there it begins and ends in the
//! poses of the footfalls.

use std::fmt;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::gait::{Footfall, GroundFn};
use super::profile::GaitProfile;

/// A wearer whose feet move by other rules.
pub trait GaitModel: fmt::Debug + Send + Sync {
    /// The wearer, instead of the person that the seed draws.
    fn profile(&self, drawn: GaitProfile) -> GaitProfile;

    /// From the heel strike of a footfall until the whole sole is down, and from heel off until toe
    /// off, s; at most a quarter and 45 % of the footfall.
    fn rolls_s(&self, fall: &Footfall) -> [f64; 2];

    /// Motion from heel off of a footfall to foot flat of the next one of the same foot; `None` for
    /// the simulator's own.
    fn motion(
        &self,
        from: &Footfall,
        to: &Footfall,
        ground: &GroundFn<'_>,
    ) -> Option<Arc<dyn FootMotion>>;
}

/// Motion of a foot between two flat phases.
pub trait FootMotion: fmt::Debug + Send + Sync {
    /// Middle of the sole in the world, m, and the rotation from the foot frame, at a time, s.
    fn pose(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>);
}

/// The person that a seed draws, or that of a gait model.
pub(crate) fn profile(seed: u64, gait: Option<&dyn GaitModel>) -> GaitProfile {
    let drawn = GaitProfile::draw(seed);
    gait.map_or(drawn, |gait| gait.profile(drawn))
}
