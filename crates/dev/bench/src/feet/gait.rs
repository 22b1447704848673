//! Contacts and swings of one walk against the truth: places, times, what is missed or invented.
//!
//! Poses of the rig are the true ones, so errors of places are those in the camera.

use cad_transforms::{Covariance, RigidTransform};
use feet::events::{Contact, FootStances, RigHeights, contacts};
use feet::observation::{TagPose, foot_candidates, foot_observations};
use feet::shoe::Side;
use feet::stance::{FootObservation, Stance, stances};
use feet::swing::SoleEdges;
use feet::swing_habit::SwingHabit;
use feet::track::{FootContacts, FootPose, FootStatus, foot_poses};
use feet::{FootConfig, GaitConfig};
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use super::recording::{FrameTruth, Recording, TRUTH_STEP_S, TrueContact, TruePose};
use super::statistics::{percentile, rms};

/// Edges of the sole of the simulated wearer.
const SOLE: SoleEdges = SoleEdges {
    heel_m: 0.13,
    toe_m: 0.15,
};
/// Time at the ends of a recording in which footfalls do not count, s.
const END_S: f64 = 0.5;

/// Errors of the contacts and swings of a walk.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Row {
    /// Whole footfalls, those found, those whose tag no frame shows while the foot is flat, and
    /// contacts that are none.
    pub(super) footfalls: usize,
    pub(super) found: usize,
    pub(super) hidden: usize,
    pub(super) invented: usize,
    /// Error of the middle of the sole at rest: 50th and 95th percentile, RMS, mm; mean squared
    /// error in sigmas, per dimension of the pose.
    pub(super) contact_mm: [f64; 3],
    pub(super) contact_nees: f64,
    /// Errors of times: 50th and 95th percentile, RMS, ms, and mean squared error in sigmas; of
    /// strikes that frames show alone, the 95th percentile and their number.
    pub(super) strike_ms: [f64; 3],
    pub(super) strike_nees: f64,
    pub(super) strike_seen_p95_ms: f64,
    pub(super) strikes_seen: usize,
    pub(super) toe_off_ms: [f64; 3],
    pub(super) toe_off_nees: f64,
    /// Hidden poses between contacts: their number, error of the middle of the sole, 50th and
    /// 95th percentile, RMS, mm, and the share within two stated sigmas along each axis.
    pub(super) bridged: usize,
    pub(super) bridged_mm: [f64; 3],
    pub(super) bridged_within: f64,
    /// The same at frames between contacts that were hidden from the estimator, bridged ones, and
    /// how many of the frames had no pose.
    pub(super) dropped: usize,
    pub(super) dropped_mm: [f64; 3],
    pub(super) dropped_within: f64,
    pub(super) dropped_lost: usize,
    /// Share of times at which a foot is lost.
    pub(super) lost: f64,
}

/// Errors of both feet, and each single one for sums over walks.
pub(super) fn row(recording: &Recording) -> (Row, Errors) {
    let observed = [0, 1].map(|foot| observations(recording, foot));
    let heights = heights(recording);
    let found = estimate(&observed, &heights);
    let count = recording.feet[0].len();
    let times: Vec<i64> = (0..count).map(|n| time_ns(recording, n)).collect();
    let poses = poses(recording, &observed, &found, [times.as_slice(); 2]);
    let mut row = Row::default();
    let mut errors = Errors::default();
    let end_s = recording.begin_s + TRUTH_STEP_S * (recording.feet[0].len() - 1) as f64;
    for foot in 0..2 {
        let counts = |own: &TrueContact| {
            own.strike_s > recording.begin_s + END_S && own.toe_off_s < end_s - END_S
        };
        let truth = &recording.contacts[foot];
        row.footfalls += truth.iter().filter(|own| counts(own)).count();
        row.hidden += truth
            .iter()
            .filter(|own| counts(own) && is_hidden(recording, foot, own))
            .count();
        let mut taken = vec![false; truth.len()];
        for contact in &found[foot] {
            let middle_s = 0.5
                * contact
                    .stance
                    .times_ns
                    .map(|ns| 1e-9 * ns as f64)
                    .iter()
                    .sum::<f64>();
            let own = |own: &TrueContact| (own.strike_s..own.toe_off_s).contains(&middle_s);
            let Some(at) = truth.iter().position(own).filter(|at| !taken[*at]) else {
                row.invented += 1;
                continue;
            };
            taken[at] = true;
            if counts(&truth[at]) {
                row.found += 1;
                errors.contact(contact, &truth[at]);
            }
        }
        for (pose, truth) in poses[foot].iter().zip(&recording.feet[foot]) {
            match pose.status {
                FootStatus::Lost => row.lost += 0.5 / count as f64,
                FootStatus::Bridged if !truth.is_flat => errors.bridged.add(truth, pose),
                _ => {}
            }
        }
    }
    drop_swings(
        (recording, &heights),
        &observed,
        &found,
        &mut errors.dropped,
    );
    (errors.complete(row), errors)
}

fn time_ns(recording: &Recording, n: usize) -> i64 {
    ((recording.begin_s + n as f64 * TRUTH_STEP_S) * 1e9).round() as i64
}

/// Whether no frame shows the whole tag in both eyes while the foot is flat.
fn is_hidden(recording: &Recording, foot: usize, contact: &TrueContact) -> bool {
    let (from, to) = (contact.flat_s, contact.heel_off_s);
    let mut frames = recording.frames.iter();
    !frames.any(|frame| {
        let time_s = 1e-9 * frame.time_ns as f64;
        (from..to).contains(&time_s) && frame.visible[foot] == [1.0; 2]
    })
}

fn observations(recording: &Recording, foot: usize) -> Vec<FootObservation> {
    let own = recording.sightings.iter().filter(|own| own.foot == foot);
    let config = FootConfig::default();
    let candidates = own.filter_map(|own| {
        let frame = &recording.frames[own.frame];
        let tag = TagPose {
            rig_from_tag: own.rig_from_tag,
            covariance: own.covariance,
            visible_share: own.visible_share[0].max(own.visible_share[1]),
            second: own.second,
        };
        let foot_from_tag = &recording.foot_from_tag[foot];
        let rig = &frame.world_from_rig;
        foot_candidates(frame.time_ns, rig, &tag, foot_from_tag, &config).ok()
    });
    foot_observations(candidates, &config)
}

/// Heights of the rig at the times of frames.
fn heights(recording: &Recording) -> RigHeights {
    let of_frame = |frame: &FrameTruth| {
        let time_s = 1e-9 * frame.time_ns as f64;
        [time_s, frame.world_from_rig.translation_m()[2]]
    };
    RigHeights::new(recording.frames.iter().map(of_frame).collect())
}

fn estimate(observed: &[Vec<FootObservation>; 2], heights: &RigHeights) -> [Vec<Contact>; 2] {
    let config = GaitConfig::default();
    let at_rest: [Vec<Stance>; 2] = observed.each_ref().map(|own| stances(own, &config.stance));
    let seen = [0, 1].map(|k: usize| FootStances {
        observations: &observed[k],
        stances: &at_rest[k],
        sole: SOLE,
    });
    contacts(seen, heights, &config.events)
}

/// Poses of both feet at times.
fn poses(
    recording: &Recording,
    observed: &[Vec<FootObservation>; 2],
    contacts: &[Vec<Contact>; 2],
    times_ns: [&[i64]; 2],
) -> [Vec<FootPose>; 2] {
    let config = GaitConfig::default();
    let feet = [0, 1].map(|k: usize| FootContacts {
        side: [Side::Left, Side::Right][k],
        observations: &observed[k],
        contacts: &contacts[k],
        sole: SOLE,
        ground: &recording.ground,
    });
    let habit = SwingHabit::learned(&feet, &config.swing);
    [0, 1].map(|k: usize| foot_poses(&feet[k], &habit, times_ns[k], &config.swing))
}

/// Hides all frames between two contacts, of every other swing at a time, and compares the poses
/// there with the truth.
fn drop_swings(
    (recording, heights): (&Recording, &RigHeights),
    observed: &[Vec<FootObservation>; 2],
    found: &[Vec<Contact>; 2],
    errors: &mut SwingErrors,
) {
    for parity in 0..2 {
        let mut hidden = [Vec::new(), Vec::new()];
        let kept = [0, 1].map(|foot: usize| {
            let swings = found[foot].windows(2).enumerate();
            let swings = swings.filter(|(k, _)| k % 2 == parity);
            let spans = swings.map(|(_, of)| [of[0].stance.times_ns[1], of[1].stance.times_ns[0]]);
            let spans: Vec<[i64; 2]> = spans.collect();
            let is_hidden = |own: &FootObservation| {
                let mut spans = spans.iter();
                spans.any(|[from, to]| *from < own.time_ns && own.time_ns < *to)
            };
            let (out, kept): (Vec<_>, Vec<_>) = observed[foot].iter().copied().partition(is_hidden);
            hidden[foot] = out;
            kept
        });
        let again = estimate(&kept, heights);
        let times = hidden
            .each_ref()
            .map(|hidden| -> Vec<i64> { hidden.iter().map(|own| own.time_ns).collect() });
        let poses = poses(
            recording,
            &kept,
            &again,
            times.each_ref().map(Vec::as_slice),
        );
        for (foot, poses) in poses.iter().enumerate() {
            let known = poses
                .iter()
                .filter(|pose| pose.status == FootStatus::Bridged);
            errors.lost += poses
                .iter()
                .filter(|pose| pose.status == FootStatus::Lost)
                .count();
            for pose in known {
                let frame = recording.frames.iter().find(|f| f.time_ns == pose.time_ns);
                if let Some(frame) = frame.filter(|frame| !frame.feet[foot].is_flat) {
                    errors.add(&frame.feet[foot], pose);
                }
            }
        }
    }
}

/// Errors of poses between contacts.
#[derive(Clone, Debug, Default)]
pub(super) struct SwingErrors {
    mm: Vec<f64>,
    /// Components in stated sigmas.
    sigmas: Vec<f64>,
    /// Poses without estimate.
    lost: usize,
}

impl SwingErrors {
    fn add(&mut self, truth: &TruePose, pose: &FootPose) {
        let error = motion(&truth.world_from_foot, &pose.world_from_foot);
        self.mm.push(1e3 * error.fixed_rows::<3>(0).norm());
        let sigmas = pose.covariance.as_ref().map(Covariance::sigmas);
        let by_axis = (0..3).map(|k| sigmas.map_or(f64::INFINITY, |own| error[k] / own[k]));
        self.sigmas.extend(by_axis);
    }

    fn summary(&self) -> (usize, [f64; 3], f64) {
        let within = self.sigmas.iter().filter(|own| own.abs() < 2.0).count();
        let share = within as f64 / self.sigmas.len().max(1) as f64;
        (self.mm.len(), summary(&self.mm), share)
    }
}

/// Errors of one or more walks.
#[derive(Clone, Debug, Default)]
pub(super) struct Errors {
    contacts_mm: Vec<f64>,
    contact_squares: Vec<f64>,
    /// Time error, ms, in sigmas, and whether frames show it.
    strikes: Vec<(f64, f64, bool)>,
    toe_offs: Vec<(f64, f64)>,
    bridged: SwingErrors,
    dropped: SwingErrors,
}

impl Errors {
    fn contact(&mut self, contact: &Contact, truth: &TrueContact) {
        let stance = &contact.stance;
        let error = motion(&truth.world_from_foot, &stance.world_from_foot);
        self.contacts_mm.push(1e3 * error.fixed_rows::<3>(0).norm());
        if let Some(inverse) = stance.covariance.matrix().try_inverse() {
            self.contact_squares
                .push(error.dot(&(inverse * error)) / 6.0);
        }
        let event = contact.heel_strike;
        let strike = event.time_s - truth.strike_s;
        self.strikes
            .push((1e3 * strike, strike / event.sigma_s, event.is_seen));
        let toe_off = contact.toe_off.time_s - truth.toe_off_s;
        self.toe_offs
            .push((1e3 * toe_off, toe_off / contact.toe_off.sigma_s));
    }

    /// Adds those of another walk.
    pub(super) fn extend(&mut self, other: &Self) {
        self.contacts_mm.extend(&other.contacts_mm);
        self.contact_squares.extend(&other.contact_squares);
        self.strikes.extend(&other.strikes);
        self.toe_offs.extend(&other.toe_offs);
        for (own, other) in [
            (&mut self.bridged, &other.bridged),
            (&mut self.dropped, &other.dropped),
        ] {
            own.mm.extend(&other.mm);
            own.sigmas.extend(&other.sigmas);
            own.lost += other.lost;
        }
    }

    /// A row with these errors.
    pub(super) fn complete(&self, row: Row) -> Row {
        let squares = |all: &mut dyn Iterator<Item = f64>| {
            let (sum, count) = all.fold((0.0, 0.0), |(sum, count), own| (sum + own, count + 1.0));
            sum / f64::max(count, 1.0)
        };
        let strikes: Vec<f64> = self.strikes.iter().map(|own| own.0.abs()).collect();
        let seen: Vec<f64> = self
            .strikes
            .iter()
            .filter(|s| s.2)
            .map(|s| s.0.abs())
            .collect();
        let toe_offs: Vec<f64> = self.toe_offs.iter().map(|own| own.0.abs()).collect();
        let (bridged, bridged_mm, bridged_within) = self.bridged.summary();
        let (dropped, dropped_mm, dropped_within) = self.dropped.summary();
        Row {
            contact_mm: summary(&self.contacts_mm),
            contact_nees: squares(&mut self.contact_squares.iter().copied()),
            strike_ms: summary(&strikes),
            strike_nees: squares(&mut self.strikes.iter().map(|own| own.1 * own.1)),
            strikes_seen: seen.len(),
            strike_seen_p95_ms: percentile(seen, 0.95),
            toe_off_ms: summary(&toe_offs),
            toe_off_nees: squares(&mut self.toe_offs.iter().map(|own| own.1 * own.1)),
            bridged,
            bridged_mm,
            bridged_within,
            dropped,
            dropped_mm,
            dropped_within,
            dropped_lost: self.dropped.lost,
            ..row
        }
    }
}

/// 50th and 95th percentile, RMS.
fn summary(values: &[f64]) -> [f64; 3] {
    let at = |share: f64| percentile(values.to_vec(), share);
    [at(0.5), at(0.95), rms(values)]
}

/// Motion from a pose to another in the axes of the first: translation, rotation.
fn motion(from: &RigidTransform, to: &RigidTransform) -> Vector6<f64> {
    let motion = from.inverse() * *to;
    let ([x, y, z], [a, b, c]) = (motion.translation_m(), motion.rotation_vector());
    Vector6::new(x, y, z, a, b, c)
}
