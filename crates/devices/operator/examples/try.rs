//! Button, lights and beepers on the bench, without a recorder: what is pressed is printed and
//! shown as if it recorded.
//!
//! ```text
//! cargo run -p operator --example try -- button=gpio:record-button light=sysfs:status beeper=gpio:beeper for=30
//! ```
//!
//! `for=SECONDS` ends it; otherwise it runs until it is interrupted. What can be written after each
//! word: `operator::spec`. Without any word it lists what this machine has.

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use operator::Clock;
use operator::button::DevPort;
use operator::button_commands::{Command, Settings};
use operator::listener::{ButtonEvent, Listener};
use operator::panel::Panel;
use operator::signal::{Once, Phase, Status, Warning};
use operator::{beeper, light};

#[expect(
    clippy::disallowed_methods,
    reason = "this program is where its clock is read"
)]
fn clock() -> Clock {
    Arc::new(|| {
        let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        t.tv_sec * 1_000_000_000 + t.tv_nsec
    })
}

/// What a recorder would do with a command: the status that follows, and the answer.
fn obey(command: Command, status: &mut Status) -> Option<Once> {
    status.question = matches!(command, Command::Ask(_));
    match command {
        Command::Start => status.phase = Phase::Recording,
        Command::Stop => status.phase = Phase::Ready,
        Command::Mark => return Some(Once::Marked),
        Command::Discard(_) => {
            status.phase = Phase::Ready;
            return Some(Once::Discarded);
        }
        Command::Ask(_) | Command::Cancelled | Command::Stuck | Command::Freed => {}
    }
    None
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut button = None;
    let (mut lights, mut beepers) = (Vec::new(), Vec::new());
    let mut seconds = None;
    for word in std::env::args().skip(1) {
        match word.split_once('=') {
            Some(("button", spec)) => button = Some(spec.parse()?),
            Some(("light", spec)) => lights.push(light::open(&spec.parse()?)?),
            Some(("beeper", spec)) => beepers.push(beeper::open(&spec.parse()?)?),
            Some(("for", text)) => seconds = Some(text.parse()?),
            _ => {
                return Err(format!(
                    "reading the command line: found {word:?}, expected button=SPEC, light=SPEC, \
                     beeper=SPEC or for=SECONDS"
                )
                .into());
            }
        }
    }
    if std::env::args().len() == 1 {
        for device in operator::inventory::all() {
            let problem = device.problem.map_or(String::new(), |p| format!(": {p}"));
            println!(
                "{:?} {} {}{problem}",
                device.as_what, device.spec, device.name
            );
        }
        return Ok(());
    }
    let button = button.ok_or("reading the command line: found no button=SPEC")?;

    let clock = clock();
    let begun = clock();
    let panel = Panel::start(clock.clone(), lights, beepers)?;
    let mut status = Status {
        phase: Phase::Ready,
        ..Status::default()
    };
    panel.set(status.clone());

    let recording = Arc::new(AtomicBool::new(false));
    let (end, ended) = sync_channel::<()>(0);
    let listener = Listener::start(
        Box::new(DevPort::new(button, clock.clone())?),
        Settings::default(),
        clock.clone(),
        {
            let recording = recording.clone();
            move || recording.load(Ordering::SeqCst)
        },
        move |heard| {
            let now = clock();
            let since = |at_ns: i64| (at_ns - begun) as f64 / 1e9;
            match heard {
                ButtonEvent::Reconnected(what) => {
                    println!("{:8.3} hears {what}", since(now));
                    status.warnings.remove(&Warning::Stream);
                }
                ButtonEvent::Disconnected(error) => {
                    println!("{:8.3} deaf: {error}", since(now));
                    status.warnings.insert(Warning::Stream);
                }
                ButtonEvent::Command(timed) => {
                    let late = (now - timed.at_ns) / 1_000_000;
                    println!(
                        "{:8.3} {:?}, known {late} ms after, at_ns {}",
                        since(timed.at_ns),
                        timed.command,
                        timed.at_ns
                    );
                    if let Some(once) = obey(timed.command, &mut status) {
                        panel.play(once);
                    }
                }
            }
            recording.store(status.phase == Phase::Recording, Ordering::SeqCst);
            panel.set(status.clone());
        },
    )?;
    let over = match seconds {
        Some(seconds) => ended.recv_timeout(Duration::from_secs(seconds)),
        None => ended.recv().map_err(|_| RecvTimeoutError::Disconnected),
    };
    drop((over, end, listener));
    Ok(())
}
