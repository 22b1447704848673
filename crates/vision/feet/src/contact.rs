//! Contacts of a foot with the ground, and what is known of a foot.

use crate::ground::GroundHeights;
use crate::shoe::Side;
use crate::stance::{FootObservation, Stance};

/// Edges of a sole, from its middle, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoleEdges {
    /// Distance of the rear edge.
    pub heel_m: f64,
    /// Distance of the front edge.
    pub toe_m: f64,
}

/// An instant of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Its time, s, from the same zero as that of observations.
    pub time_s: f64,
    /// Standard deviation of that, s.
    pub sigma_s: f64,
    /// Whether images show it.
    pub is_seen: bool,
}

/// A contact of a foot with the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// The foot at rest.
    pub stance: Stance,
    /// First contact, of the heel.
    pub heel_strike: Event,
    /// From here on the whole sole bears.
    pub foot_flat: Event,
    /// The heel lifts.
    pub heel_off: Event,
    /// Last contact, of the toe.
    pub toe_off: Event,
}

/// What is seen of one foot.
#[derive(Clone, Copy, Debug)]
pub struct FootStances<'a> {
    /// Its poses in frames, in order of time.
    pub observations: &'a [FootObservation],
    /// Its stances, see [`stances`](crate::stance::stances).
    pub stances: &'a [Stance],
    /// The edges of its sole.
    pub sole: SoleEdges,
}

/// Time between two stances of a foot in which it cannot swing, s.
const NO_SWING_S: f64 = 0.18;
/// Standard deviation of the times at which a foot lifts and strikes that is displaced without a
/// swing, s: it does neither.
pub(crate) const DISPLACED_SIGMA_S: f64 = 0.3;

impl FootStances<'_> {
    /// Whether a foot is displaced after a stance without a swing: it slides, or its tag slips.
    pub(crate) fn is_displaced_after(&self, index: usize) -> bool {
        let pair = self.stances.get(index..index + 2);
        pair.is_some_and(|pair| {
            seconds(pair[1].times_ns[0]) - seconds(pair[0].times_ns[1]) < NO_SWING_S
        })
    }
}

/// Longest distance from a place of a foot to its next one, m: people who run at 3.5 m/s step 2.5 m
/// far. A contact is missing in between where it is longer.
const MAX_STRIDE_M: f64 = 2.7;

/// Whether two stances can be consecutive ones of a foot by their distance.
pub(crate) fn is_one_stride(a: &Stance, b: &Stance) -> bool {
    let [from, to] = [a, b].map(|own| own.world_from_foot.translation());
    (to - from).norm() < MAX_STRIDE_M
}

/// What is known of one foot.
#[derive(Clone, Copy, Debug)]
pub struct FootContacts<'a> {
    /// Which foot.
    pub side: Side,
    /// Its poses in frames, in order of time.
    pub observations: &'a [FootObservation],
    /// Its contacts, in order of time.
    pub contacts: &'a [Contact],
    /// The edges of its sole.
    pub sole: SoleEdges,
    /// The ground between its contacts, where that is known.
    pub ground: &'a GroundHeights,
}

/// Seconds of a time in nanoseconds.
pub(crate) fn seconds(ns: i64) -> f64 {
    1e-9 * ns as f64
}

/// From when to when a foot is surely at rest, s: where the events are uncertain, while frames show
/// it.
pub(crate) fn rest_s(contact: &Contact) -> [f64; 2] {
    let [first_s, last_s] = contact.stance.times_ns.map(seconds);
    let (flat, lift) = (contact.foot_flat, contact.heel_off);
    [
        first_s
            .min(flat.time_s + 2.0 * flat.sigma_s)
            .max(flat.time_s),
        last_s
            .max(lift.time_s - 2.0 * lift.sigma_s)
            .min(lift.time_s),
    ]
}
