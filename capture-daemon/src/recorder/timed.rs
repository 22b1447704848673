//! Storage wrapper that measures the duration of writes and syncs.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use session_archive::storage::{ReadAt, Storage, WriteFile};

use crate::clock::Clock;

/// Maximum durations of a write and of a sync since they were last taken.
#[derive(Default)]
struct MaxDurations {
    write_ns: AtomicI64,
    sync_ns: AtomicI64,
}

/// Wraps a storage and measures it.
pub(super) struct TimedStorage {
    inner: Arc<dyn Storage>,
    clock: Arc<dyn Clock>,
    max_durations: Arc<MaxDurations>,
}

impl TimedStorage {
    pub(super) fn new(inner: Arc<dyn Storage>, clock: Arc<dyn Clock>) -> Self {
        Self {
            inner,
            clock,
            max_durations: Arc::default(),
        }
    }

    /// Maximum durations of a write and of a sync since the last call, ns.
    pub(super) fn take_max_durations(&self) -> (u64, u64) {
        let take = |a: &AtomicI64| a.swap(0, Ordering::Relaxed).max(0) as u64;
        (
            take(&self.max_durations.write_ns),
            take(&self.max_durations.sync_ns),
        )
    }
}

struct TimedFile {
    inner: Box<dyn WriteFile>,
    clock: Arc<dyn Clock>,
    max_durations: Arc<MaxDurations>,
}

impl TimedFile {
    fn measure(
        &mut self,
        which: fn(&MaxDurations) -> &AtomicI64,
        call: impl FnOnce(&mut dyn WriteFile) -> io::Result<()>,
    ) -> io::Result<()> {
        let before = self.clock.now();
        let result = call(&mut *self.inner);
        which(&self.max_durations).fetch_max(self.clock.now() - before, Ordering::Relaxed);
        result
    }
}

impl Storage for TimedStorage {
    fn create(&self, path: &str) -> io::Result<Box<dyn WriteFile>> {
        let inner = self.inner.create(path)?;
        let (clock, max_durations) = (self.clock.clone(), self.max_durations.clone());
        Ok(Box::new(TimedFile {
            inner,
            clock,
            max_durations,
        }))
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>> {
        self.inner.open(path)
    }

    fn list(&self, dir: &str) -> io::Result<Vec<String>> {
        self.inner.list(dir)
    }

    fn create_dir(&self, dir: &str) -> io::Result<()> {
        self.inner.create_dir(dir)
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        self.inner.rename(from, to)
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        self.inner.remove(path)
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        self.inner.sync_dir(dir)
    }
}

impl WriteFile for TimedFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.measure(|l| &l.write_ns, |file| file.append(bytes))
    }

    fn sync_data(&mut self) -> io::Result<()> {
        self.measure(|l| &l.sync_ns, |file| file.sync_data())
    }

    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.inner.truncate(len)
    }
}
