//! Waits until a device node appears, changes or goes.
//!
//! Watch first, then look, then wait: a node that appears between looking and waiting is not
//! missed. A new node is reported when it is created and again when its permissions are set, so one
//! that could not be opened at first is to be tried again at [`Change::Changed`]. Nodes of cameras
//! and of HID devices are in `/dev` itself; links in `/dev/v4l/by-path` come later, by udev, in a
//! folder that goes with its last link.
//!
//! Nothing is polled, and no clock is read. Early, late and in bursts: every change is delivered
//! once, in order, unless the kernel's queue has run over, which is reported ([`Change::Lost`]).

use std::collections::VecDeque;
use std::ffi::OsStr;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};
use rustix::io::Errno;

use crate::wait::{self, Remaining};

/// Watches folders.
#[derive(Debug)]
pub struct Watch {
    inotify: OwnedFd,
    folders: Vec<(i32, PathBuf)>,
    /// Read and not yet delivered; no more than one read gives.
    waiting: VecDeque<Change>,
}

/// What happened in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// A node is there that was not.
    Appeared(PathBuf),
    /// Owner or permissions of a node were set.
    Changed(PathBuf),
    /// A node was removed.
    Removed(PathBuf),
    /// Changes were lost, or this folder itself was removed: scan everything, and watch again.
    Lost,
}

impl Change {
    /// The node that may be worth opening now.
    pub fn candidate(&self) -> Option<&Path> {
        match self {
            Self::Appeared(path) | Self::Changed(path) => Some(path),
            Self::Removed(_) | Self::Lost => None,
        }
    }
}

impl Watch {
    /// Watches these folders from now on; not what is in folders within them.
    ///
    /// # Errors
    /// A folder is not there, or the system has no more watches to give.
    pub fn new<P: AsRef<Path>>(folders: impl IntoIterator<Item = P>) -> io::Result<Self> {
        let inotify = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
        let mut watched = Vec::new();
        for folder in folders {
            let folder = folder.as_ref();
            let flags = WatchFlags::CREATE
                | WatchFlags::ATTRIB
                | WatchFlags::DELETE
                | WatchFlags::MOVED_FROM
                | WatchFlags::MOVED_TO
                | WatchFlags::ONLYDIR;
            let number = inotify::add_watch(&inotify, folder, flags).map_err(|errno| {
                let error = io::Error::from(errno);
                let text = format!("watching a folder: {error}: {}", folder.display());
                io::Error::new(error.kind(), text)
            })?;
            watched.push((number, folder.to_owned()));
        }
        Ok(Self {
            inotify,
            folders: watched,
            waiting: VecDeque::new(),
        })
    }

    /// The next change, or none once `timeout` is over.
    ///
    /// # Errors
    /// A system call fails.
    pub fn next(&mut self, timeout: Duration) -> io::Result<Option<Change>> {
        self.wait_for(timeout, |_| true)
    }

    /// The next change that matches `wanted`, or none once `timeout` is over. Other changes are
    /// discarded; `wanted` should accept [`Change::Lost`] where it matters.
    ///
    /// # Errors
    /// A system call fails.
    pub fn wait_for(
        &mut self,
        timeout: Duration,
        mut wanted: impl FnMut(&Change) -> bool,
    ) -> io::Result<Option<Change>> {
        let mut remaining = Remaining::new(timeout);
        loop {
            while let Some(change) = self.waiting.pop_front() {
                if wanted(&change) {
                    return Ok(Some(change));
                }
            }
            if wait::readable(self.inotify.as_fd(), &mut remaining)?.is_none() {
                return Ok(None);
            }
            self.read()?;
        }
    }

    fn read(&mut self) -> io::Result<()> {
        let mut bytes = [MaybeUninit::uninit(); 4096];
        let mut reader = inotify::Reader::new(&self.inotify, &mut bytes);
        loop {
            let event = match reader.next() {
                Err(Errno::AGAIN | Errno::INTR) => return Ok(()),
                event => event?,
            };
            let folder = self.folders.iter().find(|(n, _)| *n == event.wd());
            let node = match (folder, event.file_name()) {
                (Some((_, folder)), Some(name)) => {
                    Some(folder.join(OsStr::from_bytes(name.to_bytes())))
                }
                _ => None,
            };
            self.waiting.extend(change(event.events(), node));
            if reader.is_buffer_empty() {
                return Ok(());
            }
        }
    }
}

fn change(events: ReadFlags, node: Option<PathBuf>) -> Option<Change> {
    if events.intersects(ReadFlags::QUEUE_OVERFLOW | ReadFlags::IGNORED | ReadFlags::UNMOUNT) {
        return Some(Change::Lost);
    }
    // Without a name it is the folder's own attributes.
    let node = node?;
    if events.intersects(ReadFlags::CREATE | ReadFlags::MOVED_TO) {
        Some(Change::Appeared(node))
    } else if events.intersects(ReadFlags::DELETE | ReadFlags::MOVED_FROM) {
        Some(Change::Removed(node))
    } else {
        Some(Change::Changed(node))
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// Reached only when something hangs.
    const SOON: Duration = Duration::from_secs(600);
    const NOW: Duration = Duration::ZERO;

    #[test]
    fn a_node_comes_changes_and_goes() {
        let folder = tempfile::tempdir().unwrap();
        let (before, node) = (folder.path().join("video0"), folder.path().join("video1"));
        fs::write(&before, "").unwrap();
        let mut watch = Watch::new([folder.path()]).unwrap();
        assert_eq!(watch.next(NOW).unwrap(), None);

        fs::create_dir(&node).unwrap();
        fs::set_permissions(&node, Permissions::from_mode(0o700)).unwrap();
        fs::rename(&node, folder.path().join("video2")).unwrap();
        fs::remove_file(&before).unwrap();
        let changes: Vec<_> = std::iter::from_fn(|| watch.next(NOW).unwrap()).collect();
        assert_eq!(
            changes,
            [
                Change::Appeared(node.clone()),
                Change::Changed(node.clone()),
                Change::Removed(node),
                Change::Appeared(folder.path().join("video2")),
                Change::Removed(before),
            ]
        );
    }

    #[test]
    fn waiting_ends_with_the_node() {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut watch = Watch::new([a.path(), b.path()]).unwrap();
        let node = b.path().join("hidraw3");
        let found = std::thread::scope(|scope| {
            let waiting = scope.spawn(|| {
                watch.wait_for(SOON, |change| change.candidate().is_some_and(|p| p == node))
            });
            fs::write(a.path().join("video0"), "").unwrap();
            fs::write(&node, "").unwrap();
            waiting.join().unwrap().unwrap()
        });
        assert_eq!(found, Some(Change::Appeared(node)));
    }

    #[test]
    fn folders_that_are_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("v4l");
        let error = Watch::new([&missing]).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(error.to_string().ends_with("/v4l"), "{error}");

        fs::create_dir(&missing).unwrap();
        let mut watch = Watch::new([&missing]).unwrap();
        fs::remove_dir(&missing).unwrap();
        assert_eq!(watch.next(SOON).unwrap(), Some(Change::Lost));
        assert_eq!(Change::Lost.candidate(), None);
    }
}
