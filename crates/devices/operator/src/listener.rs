//! A button on a thread: commands are reported as they are made.
//!
//! Contract: each command is reported once, in order, from the listener's own thread, which waits
//! for the callback; be quick. A button that goes, or is not there, is reported once
//! ([`ButtonEvent::Disconnected`]), and so is its return ([`ButtonEvent::Reconnected`]). While it
//! is away the thread waits for device nodes to appear or to change their permissions, and tries at
//! least every 10 s for devices that show no such change. Without presses the thread never wakes.
//! Dropping the listener ends it; a stop that waits for a second press at that moment is not
//! reported.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::button::{Button, Next, Port};
use crate::button_commands::{Gesture, Settings, TimedCommand};
use crate::wait::Waker;
use crate::{Clock, DeviceError};

/// The longest wait between two tries to open a button that is away.
const RETRY: Duration = Duration::from_secs(10);

/// Event of the button thread.
#[derive(Debug)]
pub enum ButtonEvent {
    /// A command of the operator.
    Command(TimedCommand),
    /// The button is disconnected, and why.
    Disconnected(DeviceError),
    /// The button is connected, for the first time or again: which device it is.
    Reconnected(String),
}

/// A running listener.
#[derive(Debug)]
pub struct Listener {
    stop: Arc<AtomicBool>,
    waker: Waker,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    /// Listens to the button of `port`. `recording` says whether it records now; `tell` is called
    /// on the listener's thread.
    ///
    /// # Errors
    /// The system has no thread or file descriptor left.
    pub fn start(
        port: Box<dyn Port>,
        settings: Settings,
        clock: Clock,
        recording: impl Fn() -> bool + Send + 'static,
        tell: impl FnMut(ButtonEvent) + Send + 'static,
    ) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let waker = Waker::new()?;
        let button_thread = ButtonThread {
            gesture: Gesture::new(settings),
            settings,
            clock,
            recording,
            tell,
            waker: waker.clone(),
            stop: stop.clone(),
        };
        let thread = std::thread::Builder::new()
            .name("button".into())
            .spawn(move || button_thread.run(port))?;
        Ok(Self {
            stop,
            waker,
            thread: Some(thread),
        })
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        self.waker.call();
        // Not joined when dropped by the callback, on that very thread.
        if let Some(thread) = self.thread.take()
            && thread.thread().id() != std::thread::current().id()
        {
            let _ = thread.join();
        }
    }
}

/// What runs on the thread.
struct ButtonThread<R, T> {
    gesture: Gesture,
    settings: Settings,
    clock: Clock,
    recording: R,
    tell: T,
    waker: Waker,
    stop: Arc<AtomicBool>,
}

impl<R: Fn() -> bool, T: FnMut(ButtonEvent)> ButtonThread<R, T> {
    fn run(mut self, mut port: Box<dyn Port>) {
        // What was reported last, so that it is reported once. Nothing at first.
        let mut told_gone = false;
        while !self.is_stopped() {
            let error = match port.open() {
                Ok(button) => {
                    told_gone = false;
                    let Some(error) = self.listen(button) else {
                        return;
                    };
                    error
                }
                Err(error) => error,
            };
            if told_gone {
                log::debug!("still without the button: {error}");
            } else {
                told_gone = true;
                (self.tell)(ButtonEvent::Disconnected(error));
            }
            self.wait_for_return(&mut *port);
        }
    }

    /// Until the button is disconnected (why), or the listener is to end (none).
    fn listen(&mut self, mut button: Box<dyn Button>) -> Option<DeviceError> {
        let debounce_ns = if button.is_debounced() {
            0
        } else {
            self.settings.debounce_ns
        };
        self.gesture.opened(debounce_ns);
        (self.tell)(ButtonEvent::Reconnected(button.describe().to_owned()));
        loop {
            let heard = button.next(self.until_deadline(), &self.waker);
            if self.is_stopped() {
                return None;
            }
            match heard {
                Ok(Next::Edge(edge)) => {
                    let commands = self.gesture.edge(edge, (self.recording)());
                    self.say(commands);
                }
                Ok(Next::Time | Next::Called) => self.look(),
                Err(error) => {
                    let commands = self.gesture.gone((self.clock)());
                    self.say(commands);
                    return Some(error);
                }
            }
        }
    }

    /// Until it is worth trying again.
    fn wait_for_return(&mut self, port: &mut dyn Port) {
        // A stop may still be waiting for its second press.
        let timeout = self.until_deadline().map_or(RETRY, |t| t.min(RETRY));
        if let Err(error) = port.wait(timeout, &self.waker) {
            log::warn!("waiting for the button to return: {error}");
        }
        self.look();
    }

    fn look(&mut self) {
        // Not looked at without need: a clock may count its readers.
        if self.gesture.deadline().is_some() {
            let commands = self.gesture.look((self.clock)(), (self.recording)());
            self.say(commands);
        }
    }

    fn until_deadline(&self) -> Option<Duration> {
        let deadline = self.gesture.deadline()?;
        let left = deadline.saturating_sub((self.clock)()).max(0);
        Some(Duration::from_nanos(left.unsigned_abs()))
    }

    fn say(&mut self, commands: Vec<TimedCommand>) {
        for timed in commands {
            (self.tell)(ButtonEvent::Command(timed));
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, sync_channel};

    use super::*;
    use crate::button::Edge;
    use crate::button::fake::{ScriptedButton, Step, Time};
    use crate::button_commands::Command;

    const MS: i64 = crate::NS_PER_MS;

    fn hear(steps: impl IntoIterator<Item = Step>) -> (Listener, Receiver<String>) {
        let time = Time::default();
        let port = ScriptedButton::new(time.clone(), steps);
        let (sender, heard) = sync_channel(64);
        let on_event = move |heard| {
            let text = match heard {
                ButtonEvent::Command(w) => format!("{:?} {}", w.command, w.at_ns / MS),
                ButtonEvent::Disconnected(error) => format!("gone: {error}"),
                ButtonEvent::Reconnected(what) => format!("back: {what}"),
            };
            sender.send(text).unwrap();
        };
        let recording = || true;
        let listener = Listener::start(
            Box::new(port),
            Settings::default(),
            time.clock(),
            recording,
            on_event,
        );
        (listener.unwrap(), heard)
    }

    fn edge(ms: i64, pressed: bool) -> Step {
        Step::Edge(Edge {
            at_ns: ms * MS,
            pressed,
        })
    }

    #[test]
    fn presses_become_wishes_without_anybody_looking_at_a_clock() {
        let (_listener, heard) = hear([
            edge(100, true),
            edge(200, false),
            edge(3000, true),
            edge(3100, false),
            edge(3200, true),
            edge(3300, false),
        ]);
        assert_eq!(heard.recv().unwrap(), "back: scripted button");
        assert_eq!(heard.recv().unwrap(), format!("{:?} 100", Command::Stop));
        assert_eq!(heard.recv().unwrap(), format!("{:?} 3000", Command::Mark));
    }

    #[test]
    fn a_removed_button_is_reported_once_and_works_again_when_it_is_back() {
        let (_listener, heard) = hear([
            edge(100, true),
            edge(200, false),
            // Before the second press could come: the stop holds.
            Step::Gone { at_ns: 300 * MS },
            Step::Back { at_ns: 60_000 * MS },
            edge(60_100, true),
            edge(60_200, false),
        ]);
        assert_eq!(heard.recv().unwrap(), "back: scripted button");
        assert_eq!(
            heard.recv().unwrap(),
            "gone: scripted button is disconnected"
        );
        assert_eq!(heard.recv().unwrap(), format!("{:?} 100", Command::Stop));
        assert_eq!(heard.recv().unwrap(), "back: scripted button");
        assert_eq!(heard.recv().unwrap(), format!("{:?} 60100", Command::Stop));
    }
}
