//! Threads for steps and images, and how a signal ends the wait for them.
//!
//! The threads start with the first work. A child process that was forked has none of them: work
//! there starts its own. A world or camera that has worked before the fork may have been copied
//! in the middle of its work, so that its owner refuses it in the child: see [`Owner`].

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::StateError;

/// Number of threads, 0 for one per core.
static THREADS: AtomicUsize = AtomicUsize::new(0);
/// The threads, with the process and the number for which they were started.
static POOL: Mutex<Option<(u32, usize, Arc<ThreadPool>)>> = Mutex::new(None);

/// Time between two looks for a signal. A signal is answered within 100 ms.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(30);

pub(crate) fn set_threads(threads: usize) {
    THREADS.store(threads, Ordering::Relaxed);
}

/// The threads of this process.
fn pool() -> PyResult<Arc<ThreadPool>> {
    let process = std::process::id();
    let threads = THREADS.load(Ordering::Relaxed);
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    match &*pool {
        Some((of, count, threads_here)) if *of == process && *count == threads => {
            Ok(threads_here.clone())
        }
        _ => {
            let name = |number| format!("paws-sim {number}");
            let builder = ThreadPoolBuilder::new()
                .num_threads(threads)
                .thread_name(name);
            let started = builder.build().map_err(|error| {
                PyRuntimeError::new_err(format!("threads could not be started: {error}"))
            })?;
            let started = Arc::new(started);
            let before = pool.replace((process, threads, started.clone()));
            if let Some((of, _, inherited)) = before
                && of != process
            {
                // Its threads do not exist here, so that dropping it would wait forever.
                std::mem::forget(inherited);
            }
            Ok(started)
        }
    }
}

/// Runs work of at most a few milliseconds on the threads, without Python's lock.
pub(crate) fn run<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let pool = pool()?;
    Ok(py.detach(|| pool.install(work)))
}

/// Runs work of any duration. A signal, such as Ctrl-C, ends the wait for it and sets the flag
/// that the work receives. Work that does not look at the flag is finished in the background, and
/// the next call that needs its results waits for it.
///
/// # Errors
/// The exception of the signal.
pub(crate) fn run_long<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> T + Send + 'static,
) -> PyResult<T> {
    let pool = pool()?;
    run_apart(py, move |is_cancelled| pool.install(|| work(is_cancelled)))
}

/// The same on a thread that ends with the work, for what comes before the first reset or image.
///
/// # Errors
/// The exception of the signal.
pub(crate) fn run_apart<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> T + Send + 'static,
) -> PyResult<T> {
    let is_cancelled = Arc::new(AtomicBool::new(false));
    let flag = is_cancelled.clone();
    let (to, from) = sync_channel(1);
    let from = Mutex::new(from);
    let worker = std::thread::Builder::new().name("paws-sim work".to_owned());
    let worker = worker.spawn(move || {
        // Nobody waits any longer after a signal.
        let _ = to.send(work(&flag));
    })?;
    loop {
        let wait = || {
            let from = from.lock().unwrap_or_else(PoisonError::into_inner);
            from.recv_timeout(SIGNAL_INTERVAL)
        };
        match py.detach(wait) {
            Ok(result) => {
                // Its end is near; afterwards no thread is left. It sent a result, so that it did
                // not panic.
                let _ = py.detach(|| worker.join());
                return Ok(result);
            }
            Err(RecvTimeoutError::Timeout) => py
                .check_signals()
                .inspect_err(|_| is_cancelled.store(true, Ordering::Relaxed))?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(PyRuntimeError::new_err(
                    "a thread of the simulator ended before its work was done",
                ));
            }
        }
    }
}

/// The process in which something worked first; none before.
#[derive(Debug, Default)]
pub(crate) struct Owner(AtomicU32);

impl Owner {
    /// Takes this process as the owner, if there is none.
    ///
    /// # Errors
    /// [`StateError`] in a child process of the owner.
    pub(crate) fn check(&self, what: &str) -> PyResult<()> {
        let process = std::process::id();
        let before = self
            .0
            .compare_exchange(0, process, Ordering::Relaxed, Ordering::Relaxed);
        match before {
            Ok(_) => Ok(()),
            Err(owner) if owner == process => Ok(()),
            Err(owner) => Err(StateError::new_err(format!(
                "{what} worked in process {owner} before this one, {process}, was forked from it; \
                 make another one here, or start processes by spawn"
            ))),
        }
    }
}
