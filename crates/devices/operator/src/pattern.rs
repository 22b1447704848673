//! How each signal blinks and beeps. Pure.
//!
//! A light of one colour distinguishes signals by rhythm alone; a coloured light has the same
//! rhythm, and a colour in addition. The idea is that of Meta's Aria Gen 2 glasses (device manual,
//! table of light states): recording is a blink and then steady white, orange is battery, heat or
//! storage, red is an error. Ours adds that a warning still says whether it records: while
//! recording the light is on and goes out briefly, while not recording it is off and flashes. The
//! four warnings are rhythms of short and long:
//!
//! | `· ·` | `· · ·` | `· – ·` | `– ·` |
//! |---|---|---|---|
//! | storage | battery | heat | stream |
//!
//! Contract, held by tests that compare every rhythm with every other at every phase: in one
//! colour, what is seen within 1 s differs between any two [meanings](crate::signal::Meaning) for
//! at least [`APART_MS`]; what is seen within 2 s differs so between any two signals. Answers last
//! 1 s and are seen from their start. A steady light has no next change.

use crate::NS_PER_MS;
use crate::signal::{Once, Phase, Signal, Warning};

/// For how long at least two different patterns differ.
pub const APART_MS: u32 = 100;

/// A colour that three lines, each on or off, can make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Colour {
    /// No light.
    Off,
    /// All is well, recording.
    White,
    /// Ready.
    Green,
    /// A warning. Red and green: amber where the light is that of three lines.
    Orange,
    /// A fault.
    Red,
    /// Wait.
    Blue,
    /// Marked.
    Cyan,
    /// A question about discarding.
    Magenta,
}

impl Colour {
    /// Red, green, blue, each 0 to 255.
    pub fn rgb(self) -> [u8; 3] {
        match self {
            Self::Off => [0, 0, 0],
            Self::White => [255, 255, 255],
            Self::Green => [0, 255, 0],
            Self::Orange => [255, 110, 0],
            Self::Red => [255, 0, 0],
            Self::Blue => [0, 0, 255],
            Self::Cyan => [0, 255, 255],
            Self::Magenta => [255, 0, 255],
        }
    }

    /// Red, green, blue for lines that are on or off.
    pub fn lines(self) -> [bool; 3] {
        self.rgb().map(|level| level > 100)
    }
}

/// What a light shows at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LightState {
    /// For a light of one colour.
    pub lit: bool,
    /// For a light of many colours.
    pub colour: Colour,
}

impl LightState {
    /// No light.
    pub const DARK: Self = Self {
        lit: false,
        colour: Colour::Off,
    };
}

/// A light pattern: steps, repeated or once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// What is shown, and for how many milliseconds.
    pub steps: Vec<(LightState, u32)>,
    /// Again from the start after the last step.
    pub repeats: bool,
}

/// A sound: tones and rests, once, or again after a while.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sound {
    /// Pitch in hertz, or none for a rest, and for how many milliseconds.
    pub steps: Vec<(Option<u16>, u32)>,
    /// Period after which it restarts, ms.
    pub again_ms: Option<u32>,
}

/// Where in a sequence a time falls: what is on, and when the next step begins.
type Now<T> = (Option<T>, Option<i64>);

/// The step of a sequence `since_ns` after its start.
fn step_at<T: Copy>(steps: &[(T, u32)], period_ms: Option<u32>, since_ns: i64) -> Now<T> {
    let since = since_ns.max(0);
    let round = period_ms.map(|ms| i64::from(ms.max(1)) * NS_PER_MS);
    let begun = round.map_or(0, |round| since - since % round);
    let mut end = begun;
    for (value, ms) in steps {
        end += i64::from(*ms) * NS_PER_MS;
        if since < end {
            return (Some(*value), Some(end));
        }
    }
    (None, round.map(|round| begun + round))
}

impl Pattern {
    fn steady(state: LightState) -> Self {
        let steps = vec![(state, 1000)];
        Self {
            steps,
            repeats: true,
        }
    }

    /// How long until it is over or restarts, milliseconds.
    pub(crate) fn length_ms(&self) -> u32 {
        self.steps.iter().map(|(_, ms)| ms).sum()
    }

    /// What is shown `since_ns` after its start (none once it is over), and when after its start
    /// that changes (none: never).
    pub fn at(&self, since_ns: i64) -> (Option<LightState>, Option<i64>) {
        if let ([(state, _)], true) = (&self.steps[..], self.repeats) {
            return (Some(*state), None);
        }
        step_at(
            &self.steps,
            self.repeats.then(|| self.length_ms()),
            since_ns,
        )
    }
}

impl Sound {
    /// The pitch `since_ns` after its start, and when after its start that changes (none: never).
    pub fn at(&self, since_ns: i64) -> (Option<u16>, Option<i64>) {
        let (tone, next) = step_at(&self.steps, self.again_ms, since_ns);
        (tone.flatten(), next)
    }
}

const DIT: u32 = 100;
const DAH: u32 = 260;
const GAP: u32 = 120;
const PAUSE: u32 = 560;

/// The rhythm of a warning.
fn code(warning: Warning) -> &'static [u32] {
    match warning {
        Warning::Storage => &[DIT, DIT],
        Warning::Battery => &[DIT, DIT, DIT],
        Warning::Heat => &[DIT, DAH, DIT],
        Warning::Stream => &[DAH, DIT],
    }
}

/// The light pattern of a signal.
pub fn light(signal: Signal) -> Pattern {
    use Colour::{Blue, Cyan, Green, Magenta, Off, Orange, Red, White};
    let on = |colour, ms| (LightState { lit: true, colour }, ms);
    let off = |ms| {
        let colour = Off;
        (LightState { lit: false, colour }, ms)
    };
    // Dark in one colour, of another colour in many.
    let other = |colour, ms| (LightState { lit: false, colour }, ms);
    let repeats = !matches!(signal, Signal::Once(_));
    let steps = match signal {
        Signal::Phase(Phase::Recording) => return Pattern::steady(on(White, 0).0),
        Signal::Phase(Phase::Starting) => vec![on(Blue, 320), off(320)],
        Signal::Phase(Phase::Saving) => vec![on(Blue, 200), off(200)],
        Signal::Phase(Phase::Ready) => vec![on(Green, 80), off(820)],
        Signal::Warning { what, recording } => {
            let marks = code(what);
            let last = marks.len() - 1;
            let mut steps = Vec::new();
            for (i, &ms) in marks.iter().enumerate() {
                let rest = if i == last { PAUSE } else { GAP };
                if recording {
                    steps.extend([other(Orange, ms), on(White, rest)]);
                } else {
                    steps.extend([on(Orange, ms), off(rest)]);
                }
            }
            steps
        }
        Signal::Fault => vec![on(Red, 80), off(80)],
        Signal::Question => vec![on(Magenta, 120), off(60), on(Magenta, 120), off(240)],
        Signal::Once(Once::Started) => vec![on(White, 200), off(200), on(White, 600)],
        Signal::Once(Once::Marked) => {
            let mut steps = [other(Cyan, 60), on(White, 60)].repeat(3);
            steps.push(on(White, 640));
            steps
        }
        Signal::Once(Once::Discarded) => vec![
            on(Magenta, 400),
            off(100),
            on(Magenta, 200),
            off(100),
            on(Magenta, 100),
            off(100),
        ],
        Signal::Once(Once::Refused) => {
            let mut steps = [on(Red, 60), off(60)].repeat(4);
            steps.push(off(520));
            steps
        }
    };
    Pattern { steps, repeats }
}

/// The sound of a signal: at its start, and again for what must not be forgotten. None for silence.
pub fn sound(signal: Signal) -> Option<Sound> {
    const SHORT: u32 = 80;
    const LONG: u32 = 300;
    let (beeps, again_ms): (&[(u16, u32)], _) = match signal {
        Signal::Phase(Phase::Starting | Phase::Recording) => return None,
        Signal::Once(Once::Started) => (&[(1320, LONG)], None),
        Signal::Phase(Phase::Ready) => (&[(880, SHORT)], None),
        Signal::Phase(Phase::Saving) => (&[(880, LONG), (660, LONG)], None),
        Signal::Once(Once::Marked) => (&[(1760, SHORT), (1760, SHORT)], None),
        Signal::Warning { .. } => (&[(1320, SHORT); 3], Some(30_000)),
        Signal::Fault => (&[(440, LONG); 4], Some(10_000)),
        Signal::Question => (&[(880, LONG), (1320, SHORT)], Some(1_000)),
        Signal::Once(Once::Discarded) => (&[(1320, SHORT), (880, LONG)], None),
        Signal::Once(Once::Refused) => (&[(440, SHORT); 5], None),
    };
    let tones = beeps.iter().map(|&(hz, ms)| (Some(hz), ms));
    let steps = tones.flat_map(|tone| [tone, (None, 100)]).collect();
    Some(Sound { steps, again_ms })
}

#[cfg(test)]
mod tests;
