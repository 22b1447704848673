//! Times of contacts: heel strike, foot flat, heel off, toe off.
//!
//! Contract: each event has a standard deviation and says whether images show it or it follows from
//! the gait. Heel strikes come from the approach of the heel to where it then rests and from the
//! pitch of the foot, see `events/strike.rs`; one that no frame shows from the rhythm of the steps
//! around it, see `events/rhythm.rs`, and from the lift of the other foot. Toe offs
//! come from the toe where frames show it leave, and from the strike of the other foot, see
//! `events/lift.rs`. What is typical of the wearer's steps is learned from those that are seen
//! well, and then used for the others. So is how the trunk moves around a strike, see
//! `events/trunk.rs`. A strike after which the foot may have slid is less certain, see
//! `events/slide.rs`. Where no frame shows either foot, see `events/unseen.rs`, neither does the
//! gait say anything: an event may have been at any time in it.

use crate::config::EventConfig;
use crate::contact::seconds;
pub use crate::contact::{Contact, Event, FootStances};
use crate::stance::Stance;

mod distance;
mod lift;
mod rhythm;
mod slide;
mod strike;
mod times;
mod trunk;
mod unseen;

use self::lift::{Lift, LiftHabit, Strikes, bearing_share, lift};
use self::rhythm::{Step, rhythm};
use self::slide::{slides_since_s, with_slide};
use self::strike::{Strike, StrikeHabit, strike};
pub use self::trunk::RigHeights;
use self::trunk::TrunkHabit;
use self::unseen::UnseenIntervals;

/// The contacts of both feet, left and right, from their stances and the heights of the rig.
pub fn contacts(
    feet: [FootStances<'_>; 2],
    heights: &RigHeights,
    config: &EventConfig,
) -> [Vec<Contact>; 2] {
    let unseen = UnseenIntervals::of(&feet);
    let strikes_of = |habit: &StrikeHabit| feet.map(|foot| strikes(&foot, &unseen, habit, config));
    let generic = strikes_of(&StrikeHabit::generic(config));
    let habit = StrikeHabit::learned(generic.iter().flatten(), config);
    let shown = strikes_of(&habit);
    let sure = [0, 1].into_iter().flat_map(|side: usize| {
        let own = shown[side].iter().map(|own| own.heel_strike).enumerate();
        let of_level = own.filter(move |(k, _)| is_level(&feet[side], *k));
        of_level.filter(|(_, own)| own.is_seen && own.sigma_s < SURE_S)
    });
    let trunk = TrunkHabit::learned(heights, sure.map(|(_, own)| own.time_s));
    let by_trunk = |foot: &FootStances<'_>, k: usize, expected_s: f64| {
        let trunk = trunk.as_ref().filter(|_| is_level(foot, k));
        trunk?.strike(expected_s)
    };
    let generic = LiftHabit::generic(config);
    let lifts = |strikes: &[Vec<Strike>; 2], habit: &LiftHabit| {
        [0, 1].map(|side| {
            let foot = &feet[side];
            let strikes = Strikes::new(&strikes[side], &strikes[1 - side]);
            let lift = |k: usize| {
                let unseen = unseen.after(foot, k);
                lift(foot, k, strikes, unseen, habit, config)
            };
            (0..foot.stances.len()).map(lift).collect::<Vec<_>>()
        })
    };
    let shown_lifts = lifts(&shown, &generic);
    let by_rhythm = rhythm(&[0, 1].map(|side| steps(&feet[side], &unseen, &shown[side], side)));
    let strikes = [0, 1].map(|side| -> Vec<Strike> {
        let (foot, own) = (&feet[side], &shown[side]);
        let again = |k: usize| {
            let shown = own[k].heel_strike;
            if shown.is_seen {
                let prior = by_trunk(foot, k, shown.time_s);
                return strike(foot, k, (prior, None), &habit, config);
            }
            if unseen.before(foot, k).is_some() {
                return own[k].clone();
            }
            let by_lift = before_lift(foot, k, &shown_lifts[1 - side]);
            let prior = product(by_rhythm[side][k], by_lift);
            let expected = strike(foot, k, (prior, None), &habit, config);
            let prior = product(prior, by_trunk(foot, k, expected.heel_strike.time_s));
            strike(foot, k, (prior, None), &habit, config)
        };
        (0..own.len()).map(again).collect()
    });
    let habit = generic.learned(lifts(&strikes, &generic).iter().flatten(), config);
    let lifts = lifts(&strikes, &habit);
    [0, 1].map(|side| {
        let foot = &feet[side];
        let contact = |(k, stance): (usize, &Stance)| {
            let (strike, lift) = (&strikes[side][k], &lifts[side][k]);
            let slides_since_s = slides_since_s(foot, k, config);
            Contact {
                stance: stance.clone(),
                heel_strike: with_slide(strike.heel_strike, slides_since_s),
                foot_flat: with_slide(strike.foot_flat, slides_since_s),
                heel_off: lift.heel_off,
                toe_off: lift.toe_off,
            }
        };
        foot.stances.iter().enumerate().map(contact).collect()
    })
}

/// Maximum difference of the heights of two contacts of a foot on level ground, m: on stairs the
/// trunk moves otherwise.
const MAX_RISE_M: f64 = 0.06;

/// Whether a foot comes to rest about as high as before.
fn is_level(foot: &FootStances<'_>, index: usize) -> bool {
    let height = |k: usize| Some(foot.stances.get(k)?.world_from_foot.translation().z);
    let before = index.checked_sub(1).and_then(height);
    let rise = before
        .zip(height(index))
        .map(|(before, after)| after - before);
    rise.is_some_and(|rise| rise.abs() < MAX_RISE_M)
}

fn strikes(
    foot: &FootStances<'_>,
    unseen: &UnseenIntervals,
    habit: &StrikeHabit,
    config: &EventConfig,
) -> Vec<Strike> {
    let stances = 0..foot.stances.len();
    stances
        .map(|k| strike(foot, k, (None, unseen.before(foot, k)), habit, config))
        .collect()
}

/// Standard deviation up to which a strike tells other ones, or how the trunk moves; of the other
/// foot one that no frame shows, s.
const SURE_S: f64 = 0.04;
/// Standard deviation of the time in which both feet bear, as a share of the stride, and the stride
/// where it is unknown, s.
const BOTH_SIGMA: f64 = 0.04;
const STRIDE_S: f64 = 1.1;

/// The strikes of a foot as each is known by itself.
fn steps(
    foot: &FootStances<'_>,
    unseen: &UnseenIntervals,
    strikes: &[Strike],
    side: usize,
) -> Vec<Step> {
    let both = foot.stances.iter().zip(strikes).enumerate();
    let step = |(index, (stance, strike)): (usize, (&Stance, &Strike))| {
        let [first_s, last_s] = stance.times_ns.map(seconds);
        let strike = strike.heel_strike;
        Step {
            side,
            index,
            stands_s: 0.5 * (first_s + last_s),
            place: *stance.world_from_foot.translation(),
            strike: [strike.time_s, strike.sigma_s],
            is_after_unseen: unseen.before(foot, index).is_some(),
        }
    };
    both.map(step).collect()
}

/// Mean and standard deviation of a strike by the lift of the other foot that frames show: both
/// feet bear for some time before.
fn before_lift(foot: &FootStances<'_>, index: usize, other: &[Lift]) -> Option<[f64; 2]> {
    let stance = &foot.stances[index];
    let [first_s, last_s] = stance.times_ns.map(seconds);
    let (from_s, to_s) = (first_s - 0.4, last_s.max(first_s + 0.2));
    let near = other.partition_point(|lift| lift.toe_off.time_s < from_s);
    let mut near = (other[near..].iter())
        .map(|lift| lift.toe_off)
        .take_while(|toe_off| toe_off.time_s < to_s);
    let toe_off = near.find(|toe_off| toe_off.is_seen && toe_off.sigma_s < SURE_S)?;
    let next = foot.stances.get(index + 1);
    let next = next.filter(|next| seconds(next.times_ns[0]) - first_s < 2.0);
    let (stride_s, speed) = next.map_or((STRIDE_S, 1.2), |next| {
        let stride_s = (seconds(next.times_ns[0]) - first_s).max(0.3);
        let step = next.world_from_foot.translation() - stance.world_from_foot.translation();
        (stride_s, step.norm() / stride_s)
    });
    let [share, run_sigma] = bearing_share(speed);
    Some([
        toe_off.time_s - (share - 0.5) * stride_s,
        toe_off
            .sigma_s
            .hypot(BOTH_SIGMA.hypot(run_sigma) * stride_s),
    ])
}

/// What two independent estimates say together.
fn product(a: Option<[f64; 2]>, b: Option<[f64; 2]>) -> Option<[f64; 2]> {
    let (Some(a), Some(b)) = (a, b) else {
        return a.or(b);
    };
    let [p, q] = [a, b].map(|own| own[1].powi(-2));
    Some([(a[0] * p + b[0] * q) / (p + q), 1.0 / (p + q).sqrt()])
}

#[cfg(test)]
mod tests;
