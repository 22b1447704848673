//! What the stage reports of feet.

use std::collections::BTreeMap;

use ::feet::checks::{slides, unseen_intervals};
use ::feet::swing::SoleEdges;
use ::feet::track::FootContacts;
use ::feet::{FootConfig, SlideConfig};
use cad_transforms::rig::Foot;
use scene_bundle::outputs::contacts::FootContact;
use scene_bundle::outputs::feet::FootStatus;

use crate::pipeline::Findings;

/// Notes how many contacts were found, and how poses are known, by the number of each status.
pub(super) fn report_poses(
    work: &Findings,
    contacts: &[FootContact],
    statuses: &BTreeMap<FootStatus, u64>,
) {
    let [left, right] =
        Foot::ALL.map(|foot| contacts.iter().filter(|own| own.foot == foot).count());
    let all: u64 = statuses.values().sum();
    let share = |counted: &[FootStatus]| {
        let count = counted.iter().filter_map(|own| statuses.get(own));
        100.0 * count.sum::<u64>() as f64 / all.max(1) as f64
    };
    work.note(format!(
        "{left} contacts of the left foot and {right} of the right one; poses: {:.0} % observed, \
         {:.0} % held or bridged, {:.0} % lost",
        share(&[FootStatus::Observed]),
        share(&[FootStatus::Held, FootStatus::Bridged]),
        share(&[FootStatus::Lost])
    ));
}

/// Share of the frames of a foot in which it is at rest, below which contacts are missing: on the
/// walks of `bench feet` it is flat in 0.50 (a jog) to 0.78 of those that show its tag.
const MIN_REST_SHARE: f64 = 0.25;
/// Number of frames of a foot that says something about that.
const MIN_REST_FRAMES: usize = 60;

/// Reports a foot that frames show well, and hardly ever at rest: poses of the rig that drift, or a
/// calibration or a size of tags with which feet seem to move.
pub(super) fn report_restless(work: &Findings, foot: Foot, known: &FootContacts<'_>) {
    let all = known.observations.len();
    let at_rest = known
        .contacts
        .iter()
        .map(|own| own.stance.observations.len());
    let share = at_rest.sum::<usize>() as f64 / all.max(1) as f64;
    if all >= MIN_REST_FRAMES && share < MIN_REST_SHARE {
        work.record_loss(format!(
            "{}: it is at rest in {:.0} % of {all} frames only, so contacts are missing: check the \
             poses of the rig, the calibration of the camera and size_m of [[shoe_tag]]",
            foot.as_str(),
            100.0 * share
        ));
    }
}

/// Reports feet that slide before they rest: their heel strikes are taken for later than they are,
/// and ground on which some steps slide may be slippery for all.
pub(super) fn report_slides(work: &Findings, known: &[FootContacts<'_>; 2]) {
    let config = SlideConfig::default();
    let of_feet = known.iter().flat_map(|foot| slides(foot, &config));
    let lengths_m: Vec<f64> = of_feet.collect();
    let contacts: usize = known.iter().map(|foot| foot.contacts.len()).sum();
    if lengths_m.len() >= config.min_contacts.min(contacts).max(1) {
        let longest_m = lengths_m.iter().copied().fold(0.0, f64::max);
        work.record_loss(format!(
            "in {} of {contacts} contacts feet slide flat on the ground before they rest, by up to \
             {:.0} mm: heel strikes and times at which they are flat are those of the end of that",
            lengths_m.len(),
            1e3 * longest_m
        ));
    }
}

/// Reports an outline that is none of a shoe: times of strikes and lifts depend on its ends.
pub(super) fn report_sole(work: &Findings, foot: Foot, sole: &SoleEdges) {
    let [least, largest] = FootConfig::default().sole_length_m;
    let length = sole.heel_m + sole.toe_m;
    if !(least..=largest).contains(&length) {
        work.record_loss(format!(
            "{}: its sole is {length:.2} m long, and shoes of adults are {least} to {largest} m: \
             check outline_m of [[sole]] in the rig file; its events and swings depend on it",
            foot.as_str()
        ));
    }
}

/// Time without either foot in which a step is missing, s.
const MAX_UNSEEN_S: f64 = 0.8;

/// Reports times in which no frame shows a foot: no frames, or no poses of the rig for them.
pub(super) fn report_unseen(work: &Findings, known: &[FootContacts<'_>; 2]) {
    let observations = known.each_ref().map(|foot| foot.observations);
    let intervals = unseen_intervals(observations, MAX_UNSEEN_S);
    let gaps: Vec<(f64, f64)> = intervals.iter().map(|[a, b]| (*a, b - a)).collect();
    if let Some((at_s, longest_s)) = gaps.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)) {
        work.record_loss(format!(
            "intervals in which no frame shows a foot, or the pose of the rig is unknown: {}, {:.1} \
             s in total, the longest from {at_s:.3} s of the clock on for {longest_s:.1} s; contacts \
             in them are missing, and events beside them are uncertain",
            gaps.len(),
            gaps.iter().map(|own| own.1).sum::<f64>()
        ));
    }
}
