//! Load shedding: degradation steps taken when frames arrive faster than they are encoded.
//!
//! Contract: [`LoadShedder::update`] is deterministic and depends on its own state only. It takes
//! the fill of the fullest queue before an encoder, several times a second. *When the queue grows*
//! by [`GROWTH_THRESHOLD`] since the last step, or is fuller than [`FULL_THRESHOLD`], one more step
//! is taken, at most one per [`MIN_STEP_INTERVAL_NS`]: each step takes effect at the next key
//! frame. *When the queue remains empty* for a while, the last step is undone; each time that this
//! turns out to be too early, the next attempt waits twice as long. Frames are lost only if all
//! steps are taken and that is not enough.
//!
//! The order is from least to most harmful for reconstruction: x264's preset (larger files), the
//! quality (coarser images), every other frame of the least important camera (the last one of the
//! configuration), every other frame of all cameras.

use session_archive::time::{HostTime, NS_PER_S};

/// Growth of the queue that triggers the next step, as a fraction of its capacity.
const GROWTH_THRESHOLD: f64 = 0.1;
/// Fill above which the next step is taken whether the queue grows or not.
const FULL_THRESHOLD: f64 = 0.75;
/// Fill below which the queue counts as empty.
const EMPTY_THRESHOLD: f64 = 0.02;
/// Minimum time between two steps, ns.
const MIN_STEP_INTERVAL_NS: i64 = NS_PER_S;
/// Time for which the queue must be empty before a step is undone, ns: initial value and maximum.
const RECOVERY_DELAY_NS: i64 = 10 * NS_PER_S;
const MAX_RECOVERY_DELAY_NS: i64 = 16 * RECOVERY_DELAY_NS;

/// One degradation step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Step {
    /// Faster x264 preset: larger files of the same quality.
    Preset,
    /// Fewer bits, coarser images.
    Quality,
    /// Every other frame of the least important camera is dropped.
    OneRate,
    /// Every other frame of every camera is dropped.
    AllRates,
}

impl Step {
    /// Description of the step, for people.
    pub(super) fn text(self) -> &'static str {
        match self {
            Self::Preset => "faster preset",
            Self::Quality => "quality lowered",
            Self::OneRate => "half the frame rate of the last camera",
            Self::AllRates => "half the frame rate of all cameras",
        }
    }
}

/// State of the load shedding. See the module.
#[derive(Debug)]
pub(super) struct LoadShedder {
    /// All available steps, in order.
    steps: Vec<Step>,
    /// Number of steps taken.
    taken: usize,
    changed: HostTime,
    /// Minimum fill since the last step.
    lowest: f64,
    empty_since: Option<HostTime>,
    recovery_delay_ns: i64,
    /// Time at which a step was last undone.
    last_undone: Option<HostTime>,
}

impl LoadShedder {
    /// No step is taken. `has_preset`: the encoders run at a preset that can be made faster.
    pub(super) fn new(has_preset: bool, cameras: usize) -> Self {
        let mut steps = vec![Step::Quality, Step::AllRates];
        if has_preset {
            steps.insert(0, Step::Preset);
        }
        if cameras > 1 {
            steps.insert(steps.len() - 1, Step::OneRate);
        }
        Self {
            steps,
            taken: 0,
            changed: HostTime::MIN,
            lowest: 0.0,
            empty_since: None,
            recovery_delay_ns: RECOVERY_DELAY_NS,
            last_undone: None,
        }
    }

    /// Whether this step is taken.
    pub(super) fn has(&self, step: Step) -> bool {
        self.steps[..self.taken].contains(&step)
    }

    /// The last step taken.
    pub(super) fn last(&self) -> Option<Step> {
        self.taken.checked_sub(1).map(|last| self.steps[last])
    }

    /// Updates the state with the fill of the fullest queue, 0 to 1. Returns whether a step was
    /// taken or undone.
    pub(super) fn update(&mut self, now: HostTime, fill: f64) -> bool {
        self.lowest = self.lowest.min(fill);
        let settled = now.since(self.changed) >= MIN_STEP_INTERVAL_NS;
        if settled
            && (fill >= FULL_THRESHOLD || fill - self.lowest >= GROWTH_THRESHOLD)
            && self.taken < self.steps.len()
        {
            if self
                .last_undone
                .is_some_and(|at| now.since(at) < self.recovery_delay_ns)
            {
                self.recovery_delay_ns = (2 * self.recovery_delay_ns).min(MAX_RECOVERY_DELAY_NS);
            }
            self.taken += 1;
            self.change(now, fill);
            return true;
        }
        if fill > EMPTY_THRESHOLD {
            self.empty_since = None;
            return false;
        }
        let since = *self.empty_since.get_or_insert(now);
        if now.since(since) < self.recovery_delay_ns {
            return false;
        }
        if self.taken == 0 {
            self.recovery_delay_ns = RECOVERY_DELAY_NS;
            return false;
        }
        self.taken -= 1;
        self.last_undone = Some(now);
        self.change(now, fill);
        true
    }

    fn change(&mut self, now: HostTime, fill: f64) {
        self.changed = now;
        self.lowest = fill;
        self.empty_since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: i64 = NS_PER_S / 10;

    /// Encoders that process a fraction `speed(step)` of the frames, with a queue of `depth_s`.
    struct Machine {
        load_shedder: LoadShedder,
        now: HostTime,
        queued_s: f64,
        depth_s: f64,
        lost_s: f64,
        changes: Vec<(f64, Option<Step>)>,
    }

    impl Machine {
        fn new(depth_s: f64) -> Self {
            Self {
                load_shedder: LoadShedder::new(true, 3),
                now: HostTime(0),
                queued_s: 0.0,
                depth_s,
                lost_s: 0.0,
                changes: Vec::new(),
            }
        }

        /// Runs for `seconds`; without load shedding the encoders process `speed` times the frames
        /// of the cameras.
        fn run(&mut self, seconds: f64, speed: f64) {
            for _ in 0..(seconds * 10.0) as usize {
                self.now = self.now + TICK;
                let gain = match self.load_shedder.last() {
                    None => 1.0,
                    Some(Step::Preset) => 2.5,
                    Some(Step::Quality) => 3.0,
                    Some(Step::OneRate) => 3.6,
                    Some(Step::AllRates) => 6.0,
                };
                self.queued_s = (self.queued_s + 0.1 * (1.0 - speed * gain)).max(0.0);
                self.lost_s += (self.queued_s - self.depth_s).max(0.0);
                self.queued_s = self.queued_s.min(self.depth_s);
                if self
                    .load_shedder
                    .update(self.now, self.queued_s / self.depth_s)
                {
                    let at = self.now.0 as f64 / NS_PER_S as f64;
                    self.changes.push((at, self.load_shedder.last()));
                }
            }
        }
    }

    #[test]
    fn minimal_steps_are_taken_and_no_frame_is_lost() {
        for (speed, expected) in [
            (1.1, None),
            (0.6, Some(Step::Preset)),
            (0.36, Some(Step::Quality)),
            (0.3, Some(Step::OneRate)),
            (0.2, Some(Step::AllRates)),
        ] {
            let mut machine = Machine::new(5.0);
            machine.run(8.0, speed);
            assert_eq!(machine.load_shedder.last(), expected, "at {speed}");
            assert_eq!(machine.lost_s, 0.0, "at {speed}: {:?}", machine.changes);
        }
    }

    #[test]
    fn all_steps_are_undone_when_the_load_ends() {
        let mut machine = Machine::new(5.0);
        machine.run(10.0, 0.2);
        assert_eq!(machine.load_shedder.last(), Some(Step::AllRates));
        machine.run(60.0, 2.0);
        assert_eq!(machine.load_shedder.last(), None, "{:?}", machine.changes);
        assert_eq!(machine.lost_s, 0.0);
    }

    /// Under a lasting load, an undone step has to be taken again, with growing intervals.
    #[test]
    fn lasting_load_does_not_flap() {
        let mut machine = Machine::new(5.0);
        machine.run(600.0, 0.6);
        let changes = machine.changes.len();
        assert!(
            (3..=20).contains(&changes),
            "{changes}: {:?}",
            machine.changes
        );
        assert_eq!(machine.lost_s, 0.0);
    }

    #[test]
    fn short_stall_changes_nothing() {
        let mut machine = Machine::new(5.0);
        machine.run(10.0, 2.0);
        machine.run(0.4, 0.0);
        machine.run(10.0, 2.0);
        assert_eq!(machine.changes, []);
    }

    #[test]
    fn unavailable_steps_are_omitted() {
        assert_eq!(
            LoadShedder::new(false, 1).steps,
            [Step::Quality, Step::AllRates]
        );
        let all = LoadShedder::new(true, 2).steps;
        assert!(all.is_sorted() && all.len() == 4);
    }
}
