//! The operator's buttons, lights and beepers, connected to the recorder.
//!
//! Contract: a command is executed as soon as it is given; its result is shown immediately. Lasting
//! states are shown whenever [`Operator::show`] is called. A failing light or a disconnected button
//! is logged and waited for; neither stops a recording.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context as _;
use operator::button::DevPort;
use operator::button_commands::{Command, Settings, Target, TimedCommand};
use operator::listener::{ButtonEvent, Listener};
use operator::panel::Panel;
use operator::signal::{Once, Phase, Status as Shown, Warning};
use operator::{Clock, beeper, light};
use session_archive::time::HostTime;

use super::real_time::{Shared, send_request};
use crate::config;
use crate::error_chain::with_causes;
use crate::status::{Concern, Request, Response, State, Status};

/// Source of its requests, in sessions.
const SOURCE: &str = "button";

/// All devices of the operator.
pub(super) struct Operator {
    actions: Arc<OperatorActions>,
    /// Button threads; they run until they are dropped.
    _listeners: Vec<Listener>,
}

/// State shared by the buttons' threads.
struct OperatorActions {
    shared: Arc<Shared>,
    panel: Panel,
    /// The operator was prompted whether to discard.
    question: AtomicBool,
    shown: Mutex<Option<Shown>>,
}

impl Operator {
    /// Opens lights and beepers, and starts listening to the buttons.
    ///
    /// # Errors
    /// The system provides no thread.
    pub(super) fn start(config: &config::Operator, shared: &Arc<Shared>) -> anyhow::Result<Self> {
        let clock: Clock = {
            let shared = shared.clone();
            Arc::new(move || shared.now().0)
        };
        let lights = config.lights.iter().filter_map(|spec| {
            let opened = light::open(spec);
            opened
                .inspect_err(|error| log::error!("the light {spec}: {}", with_causes(error)))
                .ok()
        });
        let beepers = config.beepers.iter().filter_map(|spec| {
            let opened = beeper::open(spec);
            opened
                .inspect_err(|error| log::error!("the beeper {spec}: {}", with_causes(error)))
                .ok()
        });
        let panel = Panel::start(clock.clone(), lights.collect(), beepers.collect())
            .context("starting the lights")?;
        let actions = Arc::new(OperatorActions {
            shared: shared.clone(),
            panel,
            question: AtomicBool::new(false),
            shown: Mutex::default(),
        });
        let mut listeners = Vec::new();
        for spec in &config.buttons {
            let port = DevPort::new(spec.clone(), clock.clone())
                .with_context(|| format!("watching for the button {spec}"))?;
            let (of_state, of_actions, name) = (shared.clone(), actions.clone(), spec.to_string());
            let listener = Listener::start(
                Box::new(port),
                Settings::default(),
                clock.clone(),
                move || of_state.is_recording(),
                move |event| of_actions.handle(&name, event),
            );
            listeners.push(listener.with_context(|| format!("listening to the button {spec}"))?);
        }
        Ok(Self {
            actions,
            _listeners: listeners,
        })
    }

    /// Shows the present state of the recorder.
    pub(super) fn show(&self) {
        self.actions.show();
    }
}

impl OperatorActions {
    fn handle(&self, button: &str, event: ButtonEvent) {
        match event {
            ButtonEvent::Command(command) => self.execute(command),
            ButtonEvent::Disconnected(error) => {
                log::warn!(
                    "the button {button} is disconnected: {}",
                    with_causes(&error)
                );
            }
            ButtonEvent::Reconnected(device) => log::info!("the button {button} is {device}"),
        }
        self.show();
    }

    fn execute(&self, command: TimedCommand) {
        let at = HostTime(command.at_ns);
        self.question
            .store(matches!(command.command, Command::Ask(_)), Ordering::SeqCst);
        let (request, done) = match command.command {
            // The start is shown by the state.
            Command::Start => (
                Request::Start {
                    name: String::new(),
                },
                None,
            ),
            Command::Stop => (Request::Stop, None),
            Command::Mark => (
                Request::Mark {
                    text: String::new(),
                    at: Some(at),
                },
                Some(Once::Marked),
            ),
            Command::Discard(Target::This) => (Request::Discard, Some(Once::Discarded)),
            Command::Discard(Target::Last) => (Request::DiscardLast, Some(Once::Discarded)),
            Command::Ask(_) | Command::Cancelled | Command::Freed => return,
            Command::Stuck => return log::warn!("the button is held down, or stuck"),
        };
        match send_request(&self.shared, request, SOURCE) {
            Response::Ok { .. } => {
                if let Some(done) = done {
                    self.panel.play(done);
                }
            }
            Response::Error { message } => {
                log::warn!("a press of the button was rejected: {message}");
                self.panel.play(Once::Refused);
            }
        }
    }

    fn show(&self) {
        let Some(status) = self.shared.latest() else {
            return;
        };
        let shown = shown(&status, self.question.load(Ordering::SeqCst));
        let mut last = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        if last.as_ref() != Some(&shown) {
            self.panel.set(shown.clone());
            *last = Some(shown);
        }
    }
}

/// Indication of a recorder in this state.
fn shown(status: &Status, question: bool) -> Shown {
    let warnings: BTreeSet<Warning> = status.concerns.iter().map(warning).collect();
    let phase = match status.state {
        // A missing camera is a warning, not a slow start.
        State::Idle if !warnings.contains(&Warning::Stream) => Phase::Starting,
        State::Idle | State::Armed | State::Fault => Phase::Ready,
        State::Recording => Phase::Recording,
        State::Stopping => Phase::Saving,
    };
    Shown {
        phase,
        warnings,
        fault: status.state == State::Fault,
        question,
    }
}

fn warning(concern: &Concern) -> Warning {
    match concern {
        Concern::Stream => Warning::Stream,
        Concern::Storage => Warning::Storage,
        Concern::Battery => Warning::Battery,
        Concern::Heat => Warning::Heat,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_camera_is_a_warning_and_not_a_slow_start() {
        let status = |state, concerns: &[Concern]| Status {
            state,
            session: None,
            seconds: 0.0,
            durable_until: None,
            streams: Vec::new(),
            free_bytes: None,
            seconds_left: None,
            alarms: Vec::new(),
            notes: Vec::new(),
            concerns: concerns.iter().copied().collect(),
            encoders: Vec::new(),
            machine: crate::status::MachineStatus::default(),
            degradation: String::new(),
        };
        let phase = |state, concerns: &[Concern]| shown(&status(state, concerns), false).phase;
        assert_eq!(phase(State::Idle, &[]), Phase::Starting);
        assert_eq!(phase(State::Idle, &[Concern::Heat]), Phase::Starting);
        assert_eq!(phase(State::Idle, &[Concern::Stream]), Phase::Ready);
        assert_eq!(
            phase(State::Recording, &[Concern::Stream]),
            Phase::Recording
        );
        let shown = shown(&status(State::Fault, &[Concern::Storage]), true);
        assert!(shown.fault && shown.question);
        assert_eq!(shown.warnings, [Warning::Storage].into());
    }
}
