//! A device with a script, in virtual time: waiting moves the clock.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Duration;

use super::link::{Link, LinkError, OpenError, Port};
use crate::report::REPORT_BYTES;

const S: i64 = 1_000_000_000;
/// Without a ping for so long the stream ends, ns.
const KEEP_ALIVE: i64 = 6 * S;

/// What goes wrong from a time to a time, ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fault {
    /// Samples are made and not sent.
    Silent(i64, i64),
    /// The stream has stopped by itself and a start is needed.
    Stopped(i64),
    /// The device is not on the bus, and restarts afterwards.
    Gone(i64, i64),
    /// Number of start commands, from a time on, that have no effect.
    Deaf(i64, u32),
    /// Only opening the device again helps.
    Stuck(i64),
    /// Pings are refused.
    Refusing(i64, i64),
    /// A read brings something else.
    Garbage(i64),
}

#[derive(Debug)]
pub(super) struct World {
    pub(super) now: Cell<i64>,
    pub(super) state: RefCell<State>,
}

#[derive(Debug)]
pub(super) struct State {
    pub(super) faults: Vec<Fault>,
    pub(super) period: i64,
    streaming: bool,
    pinged: i64,
    /// When the next sample is measured.
    next: i64,
    /// When it was switched on.
    on: i64,
    /// Counts openings: a link of an earlier one is dead.
    opening: u32,
    /// What was sent before the stream was stopped, and not yet read.
    waiting: std::collections::VecDeque<i64>,
    /// Samples sent.
    pub(super) sent: u64,
    pub(super) commands: Vec<(i64, Vec<u8>)>,
}

#[derive(Clone, Debug)]
pub(super) struct FakePort(pub(super) Rc<World>);

#[derive(Debug)]
pub(super) struct FakeLink {
    world: Rc<World>,
    opening: u32,
    /// When the device was switched on that was opened.
    on: i64,
}

pub(super) fn world(rate_hz: i64, faults: &[Fault]) -> Rc<World> {
    Rc::new(World {
        now: Cell::new(100 * S),
        state: RefCell::new(State {
            faults: faults.to_vec(),
            period: S / rate_hz,
            streaming: false,
            pinged: 0,
            next: 0,
            on: 0,
            opening: 0,
            waiting: Default::default(),
            sent: 0,
            commands: Vec::new(),
        }),
    })
}

impl World {
    pub(super) fn is_gone(&self) -> bool {
        let now = self.now.get();
        let gone = |f: &Fault| matches!(*f, Fault::Gone(from, to) if (from..to).contains(&now));
        self.state.borrow().faults.iter().any(gone)
    }
}

impl State {
    /// Brings the state up to `now`.
    fn settle(&mut self, now: i64) {
        for fault in self.faults.clone() {
            match fault {
                Fault::Stopped(at) if at <= now => {
                    self.streaming = false;
                    self.faults.retain(|f| *f != fault);
                }
                Fault::Gone(_, to) if to <= now => {
                    (self.streaming, self.on) = (false, to);
                    self.faults.retain(|f| *f != fault);
                }
                _ => {}
            }
        }
        self.streaming &= now - self.pinged < KEEP_ALIVE;
    }

    fn is_silent(&self, at: i64) -> bool {
        self.faults.iter().any(|f| match *f {
            Fault::Silent(from, to) => (from..to).contains(&at),
            Fault::Stuck(from) => from <= at,
            _ => false,
        })
    }

    fn report(&self, at: i64) -> [u8; REPORT_BYTES] {
        let ticks = ((at - self.on) as i128 * 2 / 78_125) as u64;
        let mut report = [0; REPORT_BYTES];
        report[2..10].copy_from_slice(&ticks.to_le_bytes());
        report
    }
}

impl Port for FakePort {
    type Link = FakeLink;

    fn open(&mut self) -> Result<FakeLink, OpenError> {
        let now = self.0.now.get();
        if self.0.is_gone() {
            return Err(OpenError::NotFound {
                wanted: "a fake".into(),
                found: "none".into(),
            });
        }
        let mut state = self.0.state.borrow_mut();
        state.settle(now);
        state
            .faults
            .retain(|f| !matches!(*f, Fault::Stuck(from) if from <= now));
        state.opening += 1;
        Ok(FakeLink {
            world: self.0.clone(),
            opening: state.opening,
            on: state.on,
        })
    }
}

impl FakeLink {
    fn alive(&self) -> Result<(), LinkError> {
        let gone = self.world.is_gone();
        let mut state = self.world.state.borrow_mut();
        state.settle(self.world.now.get());
        if gone || (state.opening, state.on) != (self.opening, self.on) {
            return Err(LinkError {
                doing: "talking to a fake".into(),
                reason: "no such device".into(),
            });
        }
        Ok(())
    }
}

impl Link for FakeLink {
    fn read(&mut self, report: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let until = self.world.now.get() + timeout.as_nanos() as i64;
        loop {
            let now = self.world.now.get();
            self.alive()?;
            let mut state = self.world.state.borrow_mut();
            state.settle(now);
            if let Some(k) = state
                .faults
                .iter()
                .position(|f| matches!(*f, Fault::Garbage(at) if at <= now))
            {
                state.faults.remove(k);
                report[..3].copy_from_slice(&[9, 9, 9]);
                return Ok(3);
            }
            if let Some(at) = state.waiting.pop_front() {
                let bytes = state.report(at);
                report[..REPORT_BYTES].copy_from_slice(&bytes);
                return Ok(REPORT_BYTES);
            }
            if state.streaming && state.next <= now {
                let at = state.next;
                state.next += state.period;
                if state.is_silent(at) {
                    continue;
                }
                state.sent += 1;
                let bytes = state.report(at);
                report[..REPORT_BYTES].copy_from_slice(&bytes);
                return Ok(REPORT_BYTES);
            }
            if now >= until {
                return Ok(0);
            }
            // One step is short, so that nothing that begins meanwhile is passed over.
            let step = if state.streaming {
                state.next
            } else {
                now + 1_000_000
            };
            drop(state);
            self.world.now.set(step.clamp(now + 1, until));
        }
    }

    fn set_feature(&mut self, report: &[u8]) -> Result<(), LinkError> {
        self.alive()?;
        let now = self.world.now.get();
        let mut state = self.world.state.borrow_mut();
        state.settle(now);
        state.commands.push((now, report.to_vec()));
        match report {
            [0x32, 1] => {
                let deaf = state.faults.iter_mut().find_map(|f| match f {
                    Fault::Deaf(from, left) if *from <= now && *left > 0 => Some(left),
                    _ => None,
                });
                match deaf {
                    Some(left) => *left -= 1,
                    None => (state.streaming, state.pinged, state.next) = (true, now, now),
                }
            }
            [0x32, 0] => {
                while state.streaming && state.next <= now {
                    let at = state.next;
                    state.waiting.push_back(at);
                    state.next += state.period;
                    state.sent += 1;
                }
                state.streaming = false;
            }
            [0x21, 0xf2] => {
                let refuses = |f: &Fault| matches!(*f, Fault::Refusing(from, to) if (from..to).contains(&now));
                if state.faults.iter().any(refuses) {
                    return Err(LinkError {
                        doing: "talking to a fake".into(),
                        reason: "it refuses".into(),
                    });
                }
                state.pinged = now;
            }
            _ => {}
        }
        Ok(())
    }

    fn get_feature(&mut self, report: &mut [u8]) -> Result<usize, LinkError> {
        self.alive()?;
        let mut state = self.world.state.borrow_mut();
        state.settle(self.world.now.get());
        report[1] = u8::from(state.streaming);
        Ok(2)
    }
}
