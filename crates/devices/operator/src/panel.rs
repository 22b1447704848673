//! Shows the status on every light and beeper.
//!
//! Contract: [`Indicator`] is pure: it takes states and events with times, and returns what to show
//! at a time and when that changes next. A [`Panel`] runs one on a thread. [`Panel::set`] and
//! [`Panel::play`] never wait for a device. Only the latest status and the latest answer are kept,
//! so nothing queues up and nothing newer is lost behind something older. The thread wakes at a new
//! state and when a pattern steps: never while the light is steady and the beeper silent, nor where
//! there is neither. A light or beeper that fails is logged once, tried again at every change, and
//! logged once more when it works; the others go on. Dropping the panel leaves it dark and silent.

use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::Clock;
use crate::beeper::Beeper;
use crate::light::Light;
use crate::pattern::{self, LightState, Pattern, Sound};
use crate::signal::{Once, Phase, Signal, Status};

/// What shows at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndicatorOutput {
    /// On every light.
    pub state: LightState,
    /// On every beeper; none is silence.
    pub tone_hz: Option<u16>,
    /// When that changes by itself; none: never.
    pub next_ns: Option<i64>,
}

/// A signal that is being shown.
#[derive(Debug)]
struct Running {
    signal: Signal,
    since_ns: i64,
    light: Pattern,
    sound: Option<Sound>,
}

impl Running {
    fn new(signal: Signal, since_ns: i64) -> Self {
        Self {
            signal,
            since_ns,
            light: pattern::light(signal),
            sound: pattern::sound(signal),
        }
    }

    /// None once it is over.
    fn at(&self, now_ns: i64) -> Option<IndicatorOutput> {
        let since = now_ns.saturating_sub(self.since_ns);
        let (state, step) = self.light.at(since);
        let (tone_hz, beep) = self.sound.as_ref().map_or((None, None), |s| s.at(since));
        let next = step.into_iter().chain(beep).min();
        Some(IndicatorOutput {
            state: state?,
            tone_hz,
            next_ns: next.map(|next| self.since_ns.saturating_add(next)),
        })
    }
}

/// What the panel shows as time passes.
#[derive(Debug)]
pub struct Indicator {
    phase: Phase,
    lasting: Running,
    once: Option<Running>,
}

impl Indicator {
    /// A panel that is switched on.
    pub fn new(now_ns: i64) -> Self {
        let status = Status::default();
        Self {
            phase: status.phase,
            lasting: Running::new(status.signal(), now_ns),
            once: None,
        }
    }

    /// Sets the status. An unchanged state keeps its rhythm. A recording that begins is reported by
    /// [`Once::Started`].
    pub fn set(&mut self, status: &Status, now_ns: i64) {
        let signal = status.signal();
        if signal != self.lasting.signal {
            self.lasting = Running::new(signal, now_ns);
        }
        let before = std::mem::replace(&mut self.phase, status.phase);
        if status.phase == Phase::Recording && before != Phase::Recording {
            self.play(Once::Started, now_ns);
        }
    }

    /// Answers. A new answer takes the place of the last.
    pub fn play(&mut self, once: Once, now_ns: i64) {
        self.once = Some(Running::new(Signal::Once(once), now_ns));
    }

    /// What shows now.
    pub fn at(&mut self, now_ns: i64) -> IndicatorOutput {
        match self.once.as_ref().and_then(|once| once.at(now_ns)) {
            Some(showing) => return showing,
            None => self.once = None,
        }
        // Patterns that last never end.
        self.lasting.at(now_ns).unwrap_or(IndicatorOutput {
            state: LightState::DARK,
            tone_hz: None,
            next_ns: None,
        })
    }
}

/// A running panel.
#[derive(Debug)]
pub struct Panel {
    mailbox: Arc<Mailbox>,
    thread: Option<JoinHandle<()>>,
}

/// Mailbox of the panel's thread: holds what the thread has not taken yet.
#[derive(Debug, Default)]
struct Mailbox {
    slot: Mutex<Slot>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Slot {
    status: Option<Status>,
    once: Option<Once>,
    end: bool,
}

impl Slot {
    fn is_empty(&self) -> bool {
        self.status.is_none() && self.once.is_none() && !self.end
    }
}

impl Mailbox {
    fn post(&self, change: impl FnOnce(&mut Slot)) {
        change(&mut self.lock());
        self.changed.notify_one();
    }

    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the next state, at most for `timeout`, without limit if none; takes it.
    fn take(&self, timeout: Option<Duration>) -> Slot {
        let slot = self.lock();
        let mut slot = match timeout {
            None => self.changed.wait_while(slot, |slot| slot.is_empty()),
            Some(timeout) => {
                let waited = self
                    .changed
                    .wait_timeout_while(slot, timeout, |s| s.is_empty());
                waited.map(|(slot, _)| slot).map_err(|e| {
                    let (slot, _) = e.into_inner();
                    PoisonError::new(slot)
                })
            }
        }
        .unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut slot)
    }
}

impl Panel {
    /// Shows [`Phase::Starting`] and then the states that it receives.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start(
        clock: Clock,
        lights: Vec<Box<dyn Light>>,
        beepers: Vec<Box<dyn Beeper>>,
    ) -> io::Result<Self> {
        let mailbox = Arc::new(Mailbox::default());
        let thread = std::thread::Builder::new().name("panel".into()).spawn({
            let mailbox = mailbox.clone();
            move || run(&mailbox, &clock, lights, beepers)
        })?;
        Ok(Self {
            mailbox,
            thread: Some(thread),
        })
    }

    /// Sets the status.
    pub fn set(&self, status: Status) {
        self.mailbox.post(|slot| slot.status = Some(status));
    }

    /// Answers a press.
    pub fn play(&self, once: Once) {
        self.mailbox.post(|slot| slot.once = Some(once));
    }
}

impl Drop for Panel {
    fn drop(&mut self) {
        self.mailbox.post(|slot| slot.end = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A device and the last state that it was set to.
struct Output<D: ?Sized, T> {
    device: Box<D>,
    /// None when that failed.
    shown: Option<T>,
    failing: bool,
}

impl<D: ?Sized, T: Copy + PartialEq> Output<D, T> {
    fn new(device: Box<D>) -> Self {
        Self {
            device,
            shown: None,
            failing: false,
        }
    }

    fn show(
        &mut self,
        value: T,
        show: impl FnOnce(&mut D, T) -> io::Result<()>,
        name: impl FnOnce(&D) -> &str,
    ) {
        if self.shown == Some(value) {
            return;
        }
        match show(&mut self.device, value) {
            Ok(()) => {
                self.shown = Some(value);
                if std::mem::take(&mut self.failing) {
                    log::info!("{} works again", name(&self.device));
                }
            }
            Err(error) => {
                self.shown = None;
                if !std::mem::replace(&mut self.failing, true) {
                    log::warn!("{} fails: {error}", name(&self.device));
                }
            }
        }
    }
}

fn run(
    mailbox: &Mailbox,
    clock: &Clock,
    lights: Vec<Box<dyn Light>>,
    beepers: Vec<Box<dyn Beeper>>,
) {
    let mut lights: Vec<_> = lights.into_iter().map(Output::new).collect();
    let mut beepers: Vec<_> = beepers.into_iter().map(Output::new).collect();
    let has_some = !(lights.is_empty() && beepers.is_empty());
    let mut show = |state: LightState, tone: Option<u16>| {
        for light in &mut lights {
            light.show(state, |l, state| l.show(state), |l| l.describe());
        }
        for beeper in &mut beepers {
            beeper.show(tone, |b, tone| b.sound(tone), |b| b.describe());
        }
    };
    let mut now = clock();
    let mut indicator = Indicator::new(now);
    loop {
        let showing = indicator.at(now);
        show(showing.state, showing.tone_hz);
        let timeout = showing.next_ns.filter(|_| has_some).map(|next| {
            let left = next.saturating_sub(clock()).max(0);
            Duration::from_nanos(left.unsigned_abs())
        });
        let news = mailbox.take(timeout);
        now = clock();
        if news.end {
            show(LightState::DARK, None);
            return;
        }
        if let Some(status) = news.status {
            indicator.set(&status, now);
        }
        if let Some(once) = news.once {
            indicator.play(once, now);
        }
    }
}

#[cfg(test)]
mod tests;
