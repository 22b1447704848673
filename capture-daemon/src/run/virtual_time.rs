//! Virtual time: one loop, as fast as the machine can.
//!
//! Samples are taken in the order of their arrival times, the clock is set to each, and each frame is
//! encoded before the next sample is taken. Nothing is dropped, and the same input gives the
//! same bytes.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{anyhow, bail};
use session_archive::time::{CivilTime, HostTime, NS_PER_S};

use super::build::Built;
use super::store::FolderStore;
use super::{Finished, RecordOptions, StopFlag};
use crate::clock::VirtualClock;
use crate::hub::{Hub, Out, Outgoing, TICK_NS};
use crate::recorder::{OnProgress, Recorder};
use crate::sources::Sample;
use crate::status::Progress;

/// Virtual time begins here: late enough for a pre-roll before it.
const START: HostTime = HostTime(1000 * NS_PER_S);
/// And is called 2026-01-01T00:00:00Z, whenever it is.
const CIVIL: CivilTime = CivilTime(1_767_225_600 * NS_PER_S);

pub(super) fn record(
    build: impl FnOnce(HostTime) -> anyhow::Result<Built>,
    options: &RecordOptions,
    stop: &StopFlag,
    mut on_progress: OnProgress,
) -> anyhow::Result<Finished> {
    let Built {
        mut sources,
        cameras,
        setup,
    } = build(START)?;
    let clock = Arc::new(VirtualClock::new(START, CIVIL));
    let finished: Arc<Mutex<Option<Finished>>> = Arc::default();
    let seen = finished.clone();
    let watch: OnProgress = Box::new(move |progress| {
        if let Progress::Finished {
            session,
            stored,
            missing,
            error,
            ..
        } = &progress
        {
            let (session, error) = (session.clone(), error.clone());
            *lock(&seen) = Some(Finished {
                session,
                stored: *stored,
                missing: *missing,
                error,
            });
        }
        on_progress(progress);
    });
    let store = FolderStore::reproducible(options.out.clone());
    let chunk_ns = setup.chunk_ns;
    let recorder = Recorder::new(setup, clock.clone(), Box::new(store), Box::new(|| 0), watch);
    let recorder = Arc::new(Mutex::new(recorder));
    let out: Out = {
        let recorder = recorder.clone();
        Arc::new(move |item: Outgoing| lock(&recorder).handle(item))
    };
    let mut hub = Hub::new(cameras, chunk_ns, true, &out);
    lock(&recorder)
        .start(&options.name, "control")
        .map_err(|e| anyhow!(e))?;

    let end = START + (options.seconds * NS_PER_S as f64) as i64;
    let mut next_tick = START + TICK_NS;
    let mut waiting: Vec<Option<Sample>> = Vec::new();
    for source in &mut sources {
        if !source.is_scheduled() {
            bail!("{} cannot run in virtual time", source.info().description);
        }
        waiting.push(source.next_sample()?);
    }
    while !stop.is_set() && lock(&finished).is_none() {
        let first = waiting
            .iter()
            .enumerate()
            .filter_map(|(i, s)| s.as_ref().map(|s| (s.host_time(), i)))
            .min();
        let Some((time, i)) = first.filter(|(time, _)| *time < end) else {
            break;
        };
        while next_tick <= time {
            clock.advance_to(next_tick);
            hub.tick(next_tick);
            lock(&recorder).tick();
            next_tick = next_tick + TICK_NS;
        }
        clock.advance_to(time);
        let following = sources[i].next_sample()?;
        if let Some(sample) = std::mem::replace(&mut waiting[i], following) {
            hub.sample(i, sample, time);
        }
    }
    if waiting.iter().any(Option::is_some) && !stop.is_set() {
        clock.advance_to(end);
    }
    hub.finish(end);
    lock(&recorder).close_now(if stop.is_set() { "signal" } else { "duration" });
    let finished = lock(&finished).take();
    finished.ok_or_else(|| anyhow!("the recording ended without a session"))
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
