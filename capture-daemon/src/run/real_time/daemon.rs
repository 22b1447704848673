//! The daemon: armed, answering on the control socket, reporting to systemd.

use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use session_archive::time::NS_PER_S;

use super::recorder_thread::send_request;
use super::running::{Running, spawn};
use super::shared::ToRecorder;
use super::waiting::span;
use crate::announce::{self, FirstFrames};
use crate::clock::Clock as _;
use crate::config::{Config, DEFAULT_SOCKET};
use crate::control;
use crate::hub::Outgoing;
use crate::notify::Notify;
use crate::realtime_priority;
use crate::recorder::RECOVERY;
use crate::run::build::build;
use crate::run::operator::Operator;
use crate::run::outcome::{Outcome, StopFlag};
use crate::run::{crash_recovery, page};
use crate::status::{Progress, Request, State};

/// Runs the daemon until `stop` is set: armed, answering on the control socket, reporting to
/// systemd.
///
/// # Errors
/// The configuration cannot be applied, or a thread is stuck.
pub fn daemon(config: &Config, stop: &StopFlag) -> anyhow::Result<()> {
    let out =
        config.session.out.clone().ok_or_else(|| {
            anyhow!("the configuration has no [session] out: where do sessions go?")
        })?;
    std::fs::create_dir_all(&out)
        .with_context(|| format!("creating the folder for sessions {}", out.display()))?;
    let out_folder = out.clone();
    // Before the first press could begin a new one.
    let cut_off = crash_recovery::find(&out);
    let running = Running::start(
        |start| build(config, start),
        out,
        None,
        Box::new(log_progress),
        Outcome::default(),
    )?;
    let of_control = running.shared.clone();
    let server = control::serve(&config.control.socket, move |request| {
        send_request(&of_control, request, "control")
    })
    .with_context(|| {
        format!(
            "opening the control socket {}",
            config.control.socket.display()
        )
    })?;
    let shared = running.shared.clone();
    let report = move |text: String| {
        let alarm = Outgoing::Alarm {
            at: shared.clock.now(),
            text,
            stream: RECOVERY.to_owned(),
            active: true,
        };
        let _ = shared.outbox.push_reserved(ToRecorder::Item(alarm), 0);
    };
    crash_recovery::close(out_folder.clone(), cut_off, report)
        .context("looking after earlier recordings")?;
    let operator = Operator::start(&config.operator, &running.shared)?;
    let mut page = page::PageSupervisor::new(config.page.as_ref(), &out_folder);
    page.supervise(&running);
    realtime_priority::lock_memory();
    let notify = Notify::from_env();
    notify.ready();
    let shared = running.shared.clone();
    let mut first_frames = FirstFrames::wait(running.names());
    let mut is_armed = false;
    // Twice as often as required, because the loop sleeps between its iterations.
    let watchdog_ns = notify
        .watchdog_interval()
        .map_or(NS_PER_S, |interval| interval.as_nanos() as i64 / 2)
        .min(NS_PER_S);
    let mut next_status = shared.clock.now();
    let mut next_watchdog = next_status;
    let result = loop {
        if stop.is_set() {
            break Ok(());
        }
        if let Err(stalled_thread) = running.check() {
            break Err(stalled_thread);
        }
        let now = shared.clock.now();
        let seen = shared.latest();
        if let Some(status) = &seen {
            first_frames.update(status);
            if status.state == State::Armed && !is_armed {
                is_armed = true;
                announce::step(armed(config));
            }
        }
        operator.show();
        page.supervise(&running);
        if now >= next_status {
            next_status = now + NS_PER_S;
            if let Some(status) = &seen {
                notify.status(&format!("{}, {:.0} s", status.state, status.seconds));
            }
        }
        if now >= next_watchdog {
            next_watchdog = now + watchdog_ns;
            notify.watchdog();
        }
        // It is published five times a second while the recorder runs, so the end is detected soon.
        let due = next_status.min(next_watchdog);
        shared.wait_for_status(seen.as_ref(), span(now, due));
    };
    notify.stopping();
    drop(page);
    drop(operator);
    drop(server);
    if result.is_ok() {
        stop_under_watchdog(running, &notify, Duration::from_nanos(watchdog_ns as u64))?;
    }
    result
}

/// Logs what happens to recordings.
fn log_progress(progress: Progress) {
    match progress {
        Progress::Started { session, notes, .. } => {
            log::info!("recording {}", session.display());
            notes.iter().for_each(|note| log::warn!("{note}"));
        }
        Progress::Finished {
            session,
            reason,
            seconds,
            stored,
            missing,
            streams,
            ..
        } => {
            log::info!(
                "closed {} ({reason}): {seconds:.1} s, {stored} samples, {missing} missing",
                session.display()
            );
            for stream in streams.iter().filter(|s| s.missing > 0) {
                log::warn!("{stream}");
            }
        }
        Progress::Durable { .. } | Progress::Alarm { .. } => {}
    }
}

/// Closes the open recording and ends all threads, and notifies the watchdog meanwhile.
fn stop_under_watchdog(
    running: Running,
    notify: &Notify,
    interval: Duration,
) -> anyhow::Result<()> {
    let (done, is_done) = sync_channel::<()>(0);
    let stopping = spawn("stop", move || {
        running.request(Request::Stop, "signal");
        running.end();
        drop(done);
    })?;
    while is_done.recv_timeout(interval) == Err(RecvTimeoutError::Timeout) {
        notify.watchdog();
    }
    let _ = stopping.join();
    Ok(())
}

/// Instruction for the operator once all cameras and IMUs deliver.
fn armed(config: &Config) -> String {
    let button = match config.operator.buttons.is_empty() {
        true => "",
        false => "the button or ",
    };
    let socket = match &config.control.socket {
        usual if usual == Path::new(DEFAULT_SOCKET) => String::new(),
        other => format!(" --socket {}", other.display()),
    };
    format!("armed: everything delivers; start with {button}`pawsd start{socket}`")
}
