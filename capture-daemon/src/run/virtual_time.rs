//! Virtual time: one loop, as fast as the machine can.
//!
//! Samples are taken in the order of their arrival times, the clock is set to each, and each frame
//! is encoded before the next sample is taken. Nothing is dropped, and the same input gives the
//! same bytes. When a source fails, the recording continues without it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{anyhow, bail};
use session_archive::time::{CivilTime, HostTime, NS_PER_S};

use super::build::RunParts;
use super::identity;
use super::outcome::{Outcome, RecordOptions, RecordingSummary, StopFlag, stop_reason};
use super::store::FolderStore;
use crate::clock::VirtualClock;
use crate::encode::RemainingFrames;
use crate::encoding::Encoding;
use crate::hub::{Hub, Out, Outgoing, TICK_NS};
use crate::recorder::{OnProgress, Queues, Recorder};
use crate::sources::{AnySource, Sample, Source};

/// Start of virtual time: late enough for a pre-roll before it.
const START: HostTime = HostTime(1000 * NS_PER_S);
/// Civil time of the start, always 2026-01-01T00:00:00Z.
const CIVIL: CivilTime = CivilTime(1_767_225_600 * NS_PER_S);

pub(super) fn record(
    build: impl FnOnce(HostTime) -> anyhow::Result<RunParts>,
    options: &RecordOptions,
    stop: &StopFlag,
    on_progress: OnProgress,
) -> anyhow::Result<RecordingSummary> {
    let mut built = build(START)?;
    built.begin_at(START)?;
    let identity = identity::of(&built, options);
    let RunParts {
        sources,
        cameras,
        setup,
    } = built;
    let clock = Arc::new(VirtualClock::new(START, CIVIL));
    let mut scheduled = Vec::new();
    for source in sources {
        match source {
            AnySource::Scheduled(source) => scheduled.push(source),
            AnySource::Live(source) => {
                bail!("{} cannot run in virtual time", source.info().description)
            }
        }
    }
    let mut sources = scheduled;
    let outcome = Outcome::default();
    let watch = outcome.watch(on_progress);
    let store = FolderStore::reproducible(options.out.clone(), identity);
    let chunk_ns = setup.chunk_ns;
    let encoding = Encoding::new(cameras.len());
    let queues = Queues {
        bytes: Box::new(|| 0),
        encoding: encoding.clone(),
    };
    let recorder = Recorder::new(setup, clock.clone(), Box::new(store), queues, watch);
    let recorder = Arc::new(Mutex::new(recorder));
    let out: Out = {
        let recorder = recorder.clone();
        Arc::new(move |item: Outgoing| lock(&recorder).handle(item))
    };
    let mut hub = Hub::new(cameras, chunk_ns, true, &encoding, &out);
    lock(&recorder)
        .start(&options.name, "control")
        .map_err(|e| anyhow!(e))?;

    let end = START + (options.seconds * NS_PER_S as f64) as i64;
    let mut next_tick = START + TICK_NS;
    let next = |i: usize, source: &mut dyn Source, hub: &Hub, now| {
        source.next_sample().unwrap_or_else(|e| {
            hub.source_failed(i, &e.to_string(), now);
            outcome.source_failed(e.to_string());
            None
        })
    };
    let mut waiting: Vec<Option<Sample>> = Vec::new();
    for (i, source) in sources.iter_mut().enumerate() {
        waiting.push(next(i, &mut **source, &hub, START));
    }
    while !stop.is_set() && !outcome.is_finished() {
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
        let following = next(i, &mut *sources[i], &hub, time);
        if let Some(sample) = std::mem::replace(&mut waiting[i], following) {
            hub.sample(i, sample, time);
        }
    }
    let all_ended = waiting.iter().all(Option::is_none);
    if !all_ended && !stop.is_set() {
        clock.advance_to(end);
    }
    hub.finish(RemainingFrames::Encode, end);
    lock(&recorder).close_now(stop_reason(stop, all_ended));
    outcome.take()
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
