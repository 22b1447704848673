//! The disk: what is free, for how long it lasts, and whether it is still there.
//!
//! Contract: [`reading`] asks the file system afresh; on a disk that does not answer it blocks too.
//! [`DiskWatch::judge`] is pure. The rate is what the free space has fallen by in the last
//! [`WINDOW_NS`], by any writer; what is freed meanwhile neither hides it nor makes it negative.
//! Until it has been watched for [`MIN_RATE_WINDOW_NS`] there is no rate and no time left, rather
//! than a guess. Free space is what an ordinary user may still write, without the blocks that are
//! held back for root. The writer measures how long writes take.

use std::collections::VecDeque;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use rustix::fs::StatVfsMountFlags;
use serde::Serialize;

use crate::NS_PER_S;

/// How far back the rate looks. Long enough for writes that come in bursts.
pub const WINDOW_NS: i64 = 30 * NS_PER_S;
/// How long must be watched before there is a rate.
pub const MIN_RATE_WINDOW_NS: i64 = 5 * NS_PER_S;
/// With fewer inodes left there may be none for the next session's files.
const LOW_INODES: u64 = 1000;

/// A slower loss of free space is a log file, not a recording, bytes per second.
const LEAST_RATE: f64 = 1000.0;

/// Report of a file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Space {
    /// Free for an ordinary user, bytes.
    pub free_bytes: u64,
    /// Size, bytes.
    pub size_bytes: u64,
    /// Files and folders that can still be made; `None` where there is no such limit.
    pub free_inodes: Option<u64>,
    /// Mounted read-only: also after the kernel has found damage.
    pub read_only: bool,
    /// Which file system this is.
    pub device: u64,
}

/// The file system could not be read.
#[derive(Debug, thiserror::Error)]
pub enum DiskError {
    /// Make the folder, or mount what should be there.
    #[error("looking at the disk: there is no such folder: {}", path.display())]
    Absent {
        /// The folder.
        path: PathBuf,
    },
    /// The disk is defective or disconnected; see `dmesg`.
    #[error("looking at the disk: {}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// What is wrong with the disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DiskFault {
    /// It has become read-only.
    ReadOnly,
    /// Another file system is in its place.
    MountLost,
    /// It does not answer; the error.
    Unreachable(String),
}

/// State of the disk.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DiskState {
    /// Free, bytes; `None` where the file system does not report it.
    pub free_bytes: Option<u64>,
    /// Free above the reserve, bytes.
    pub usable_bytes: Option<u64>,
    /// How fast free space falls, bytes per second; `None` before that is known.
    pub bytes_per_s: Option<f64>,
    /// Until only the reserve is left, at this rate; `None` before it is known and while nothing is
    /// written.
    pub seconds_left: Option<f64>,
    /// Whether there are too few inodes for another session.
    pub low_inodes: bool,
    /// What is wrong.
    pub fault: Option<DiskFault>,
}

/// Asks the file system that holds the folder `path`.
///
/// # Errors
/// The folder is not there, or the file system reports an I/O error.
pub fn reading(path: &Path) -> Result<Space, DiskError> {
    let failed = |source: io::Error| {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound => DiskError::Absent { path },
            _ => DiskError::Io { path, source },
        }
    };
    let stat = rustix::fs::statvfs(path).map_err(|error| failed(error.into()))?;
    let metadata = std::fs::metadata(path).map_err(failed)?;
    Ok(Space {
        free_bytes: stat.f_bavail.saturating_mul(stat.f_frsize),
        size_bytes: stat.f_blocks.saturating_mul(stat.f_frsize),
        // btrfs and some others have no limit and say 0 of 0.
        free_inodes: (stat.f_files > 0).then_some(stat.f_favail),
        read_only: stat.f_flag.contains(StatVfsMountFlags::RDONLY),
        device: metadata.dev(),
    })
}

/// Watches one folder's disk.
#[derive(Clone, Debug)]
pub struct DiskWatch {
    reserve_bytes: u64,
    /// The file system that was there at the first look.
    device: Option<u64>,
    /// When and what was free, oldest first.
    window: VecDeque<(i64, u64)>,
}

impl DiskWatch {
    /// Watches a disk of which `reserve_bytes` stay free.
    pub fn new(reserve_bytes: u64) -> Self {
        Self {
            reserve_bytes,
            device: None,
            window: VecDeque::new(),
        }
    }

    /// A recording begins: what was written before says nothing about it.
    pub fn begin_recording(&mut self) {
        self.window.clear();
    }

    /// State of the disk from a reading at `at_ns`.
    pub fn judge(&mut self, at_ns: i64, reading: &Result<Space, DiskError>) -> DiskState {
        let space = match reading {
            Ok(space) => space,
            Err(error) => {
                let source = std::error::Error::source(error);
                let said = source.map_or_else(|| error.to_string(), ToString::to_string);
                return DiskState {
                    fault: Some(DiskFault::Unreachable(said)),
                    ..DiskState::default()
                };
            }
        };
        if *self.device.get_or_insert(space.device) != space.device {
            self.window.clear();
            return DiskState {
                fault: Some(DiskFault::MountLost),
                ..DiskState::default()
            };
        }
        self.note(at_ns, space.free_bytes);
        let bytes_per_s = self.bytes_per_s();
        let usable = space.free_bytes.saturating_sub(self.reserve_bytes);
        DiskState {
            free_bytes: Some(space.free_bytes),
            usable_bytes: Some(usable),
            bytes_per_s,
            seconds_left: bytes_per_s
                .filter(|rate| *rate >= LEAST_RATE)
                .map(|rate| usable as f64 / rate),
            low_inodes: space.free_inodes.is_some_and(|free| free < LOW_INODES),
            fault: space.read_only.then_some(DiskFault::ReadOnly),
        }
    }

    fn note(&mut self, at_ns: i64, free_bytes: u64) {
        // A time that does not go on would count its bytes in no time.
        if self.window.back().is_some_and(|(last, _)| *last >= at_ns) {
            return;
        }
        self.window.push_back((at_ns, free_bytes));
        // The last one outside is kept: the span from it covers the window.
        while self.window.len() > 2 && at_ns - self.window[1].0 >= WINDOW_NS {
            self.window.pop_front();
        }
    }

    /// What was lost in the spans in which nothing was freed, by their length.
    fn bytes_per_s(&self) -> Option<f64> {
        let mut span_ns = 0;
        let mut lost = 0;
        for ((t0, free0), (t1, free1)) in self.window.iter().zip(self.window.iter().skip(1)) {
            if let Some(fallen) = free0.checked_sub(*free1) {
                span_ns += t1 - t0;
                lost += fallen;
            }
        }
        (span_ns >= MIN_RATE_WINDOW_NS).then(|| lost as f64 * NS_PER_S as f64 / span_ns as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MB: u64 = 1_000_000;

    fn space(free_bytes: u64) -> Result<Space, DiskError> {
        Ok(Space {
            free_bytes,
            size_bytes: 1000 * MB,
            free_inodes: Some(50_000),
            read_only: false,
            device: 7,
        })
    }

    /// Looks once a second at these free spaces, MB; the last meaning.
    fn watch(free_mb: impl IntoIterator<Item = u64>) -> DiskState {
        let mut watch = DiskWatch::new(100 * MB);
        let readings = free_mb.into_iter().enumerate();
        let states = readings.map(|(s, mb)| watch.judge(s as i64 * NS_PER_S, &space(mb * MB)));
        states.last().unwrap()
    }

    #[test]
    fn time_left_is_what_is_above_the_reserve_at_the_present_rate() {
        let state = watch((0..=10).map(|s| 700 - 6 * s));
        assert_eq!(state.bytes_per_s, Some(6e6));
        assert_eq!(state.usable_bytes, Some(540 * MB));
        assert_eq!(state.seconds_left, Some(90.0));
        assert_eq!(watch([700, 50]).usable_bytes, Some(0));
    }

    #[test]
    fn no_rate_is_reported_before_it_is_known() {
        assert_eq!(watch((0..5).map(|s| 700 - 6 * s)).bytes_per_s, None);
        assert_eq!(watch((0..6).map(|s| 700 - 6 * s)).bytes_per_s, Some(6e6));
        // Nothing is written: there is a rate and no end.
        let idle = watch([700; 20]);
        assert_eq!((idle.bytes_per_s, idle.seconds_left), (Some(0.0), None));
    }

    #[test]
    fn what_is_freed_does_not_hide_the_rate() {
        // 6 MB/s are written, and 200 MB freed in the middle.
        let state = watch((0..=20).map(|s| 500 - 6 * s + 200 * u64::from(s > 10)));
        assert_eq!(state.bytes_per_s, Some(6e6));
    }

    #[test]
    fn the_rate_follows_within_the_window() {
        let course = |s: u64| {
            if s < 40 {
                900 - 2 * s
            } else {
                820 - 10 * (s - 40)
            }
        };
        assert_eq!(watch((0..=40).map(course)).bytes_per_s, Some(2e6));
        assert_eq!(watch((0..=55).map(course)).bytes_per_s, Some(6e6));
        assert_eq!(watch((0..=70).map(course)).bytes_per_s, Some(10e6));
        let mut watch = DiskWatch::new(0);
        for s in 0..100_000 {
            watch.judge(s * NS_PER_S, &space(MB));
        }
        assert!(watch.window.len() <= 32, "{}", watch.window.len());
    }

    #[test]
    fn a_recording_begins_with_no_rate() {
        let mut watch = DiskWatch::new(0);
        for s in 0..20 {
            watch.judge(s * NS_PER_S, &space(700 * MB));
        }
        watch.begin_recording();
        assert_eq!(
            watch.judge(20 * NS_PER_S, &space(700 * MB)).bytes_per_s,
            None
        );
        for s in 21..=25 {
            watch.judge(s * NS_PER_S, &space((700 - 6 * (s as u64 - 20)) * MB));
        }
        let state = watch.judge(26 * NS_PER_S, &space(664 * MB));
        assert_eq!(state.bytes_per_s, Some(6e6));
        // The same time again brings no news.
        let again = watch.judge(26 * NS_PER_S, &space(600 * MB));
        assert_eq!(again.bytes_per_s, Some(6e6));
    }

    #[test]
    fn trouble_is_reported() {
        let mut watch = DiskWatch::new(0);
        let mut judge = |reading| watch.judge(0, &reading);
        assert_eq!(judge(space(MB)).fault, None);
        let changed = |change: fn(&mut Space)| {
            let mut space = space(MB).unwrap();
            change(&mut space);
            Ok(space)
        };
        let read_only = judge(changed(|s| s.read_only = true));
        assert_eq!(read_only.fault, Some(DiskFault::ReadOnly));
        let other = judge(changed(|s| s.device = 8));
        assert_eq!(other.fault, Some(DiskFault::MountLost));
        assert_eq!(other.free_bytes, None, "of another disk");
        assert!(judge(changed(|s| s.free_inodes = Some(3))).low_inodes);
        assert!(!judge(changed(|s| s.free_inodes = None)).low_inodes);
        let broken = judge(Err(DiskError::Io {
            path: "/recordings".into(),
            source: io::Error::from_raw_os_error(libc::EIO),
        }));
        let Some(DiskFault::Unreachable(said)) = broken.fault else {
            panic!("{broken:?}");
        };
        assert!(said.contains("Input/output"), "{said}");
        assert_eq!(judge(space(MB)).fault, None, "it came back");
    }

    #[test]
    fn a_real_disk_answers() {
        let folder = tempfile::tempdir().unwrap();
        let space = reading(folder.path()).unwrap();
        assert!(0 < space.free_bytes && space.free_bytes <= space.size_bytes);
        assert!(!space.read_only);
        let absent = reading(&folder.path().join("absent"));
        assert!(
            matches!(absent, Err(DiskError::Absent { .. })),
            "{absent:?}"
        );
    }
}
