//! Recordings interrupted by a power cut or a crash: found when the daemon starts, and closed.
//!
//! Contract: the content of such a session is not modified; only what a clean end would have added
//! is added ([`close_cut_off`]). A session with other damage is not touched and is reported. This
//! runs beside the recorder, at the lowest priority, and never on a session that is being recorded,
//! by this program or by another.

use std::fs::DirEntry;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use session_archive::recover::{RecoverError, close_cut_off};
use session_archive::storage::DiskStorage;
use session_archive::time::NS_PER_S;
use session_archive::verify::Report;
use session_archive::{manifest::Manifest, manifest::State};

use super::claim::{Claim, is_claimed};
use super::store::finish_discards;
use crate::error_chain::with_causes;

/// Niceness of the thread.
const NICE: i32 = 19;

/// Sessions in `folder` that were never closed and that no program records. To be called before a
/// session is begun there.
pub(super) fn find(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_open = |path: &PathBuf| {
        Manifest::read(&DiskStorage::new(path))
            .ok()
            .is_some_and(|manifest| manifest.state == State::Recording)
    };
    let is_left = |path: &PathBuf| is_open(path) && !is_claimed(path);
    // Hidden folders are being deleted.
    let is_hidden = |e: &DirEntry| e.file_name().as_encoded_bytes().starts_with(b".");
    let entries = entries.filter(|e| !is_hidden(e)).map(|e| e.path());
    let mut found: Vec<PathBuf> = entries.filter(is_left).collect();
    found.sort();
    found
}

/// Closes the sessions one after another on a thread of its own, and reports each. Then it deletes
/// the remains of discarded sessions in `folder`.
///
/// # Errors
/// The system provides no thread.
pub(super) fn close(
    folder: PathBuf,
    sessions: Vec<PathBuf>,
    report: impl Fn(String) + Send + 'static,
) -> std::io::Result<()> {
    let work = move || {
        // Applies to this thread alone, because Linux has a niceness per thread.
        let _ = rustix::process::nice(NICE);
        for session in sessions {
            report(close_one(&session));
        }
        finish_discards(&folder);
    };
    std::thread::Builder::new()
        .name("leftovers".to_owned())
        .spawn(work)
        .map(|_| ())
}

fn close_one(session: &Path) -> String {
    let path = session.display();
    // Without locks there is no other program to wait for.
    let _claim = Claim::wait(session);
    match close_cut_off(Arc::new(DiskStorage::new(session.to_owned()))) {
        Ok(Some(report)) => format!(
            "an earlier recording was cut off; the {:.1} s that were safe are closed: {path}",
            seconds(&report)
        ),
        Ok(None) => format!("an earlier recording was closed meanwhile: {path}"),
        Err(error @ RecoverError::Damaged(_)) => {
            format!("an earlier recording was cut off and cannot be closed here: {error}: {path}")
        }
        Err(error) => format!(
            "an earlier recording was cut off and could not be closed: {}: {path}",
            with_causes(&error)
        ),
    }
}

/// Time from the first sample to the last, s.
fn seconds(report: &Report) -> f64 {
    let streams = || report.streams.values().filter(|s| s.samples > 0);
    let start = streams().map(|s| s.start).min();
    let end = streams().map(|s| s.end).max();
    match (start, end) {
        (Some(start), Some(end)) => end.since(start) as f64 / NS_PER_S as f64,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;
    use std::time::Duration;

    use session_archive::layout;

    use super::*;
    use crate::config::Config;
    use crate::run::{RecordOptions, StopFlag, record};

    #[test]
    fn unclosed_session_is_closed() {
        let folder = tempfile::tempdir().expect("folder");
        let text = "disk.reserve_gb = 0\nencoder.element = \"x264enc\"\n[[camera]]\nname = \"feet\"\n\
                    source = { kind = \"synthetic\", width = 128, height = 64, rate_hz = 20, imu_rate_hz = 0 }\n";
        let config = Config::parse(text, folder.path()).expect("configuration");
        let options = RecordOptions {
            seconds: 2.0,
            virtual_time: true,
            name: String::new(),
            out: folder.path().to_owned(),
        };
        let done =
            record(&config, &options, &StopFlag::new(), Box::new(|_| {})).expect("recording");
        assert!(find(folder.path()).is_empty());
        // As before its end: the manifest states so, and the summary does not exist yet.
        let path = done.session.join(layout::MANIFEST);
        let mut manifest =
            Manifest::from_bytes(&std::fs::read(&path).expect("manifest")).expect("manifest");
        manifest.state = State::Recording;
        manifest.stopped = None;
        manifest.extents.clear();
        for segment in &mut manifest.segments {
            segment.state = session_archive::manifest::SegmentState::Open;
        }
        std::fs::write(&path, manifest.to_bytes()).expect("manifest");
        let segment = done.session.join(layout::segment(0));
        let length = std::fs::metadata(&segment).expect("segment").len();
        let file = std::fs::OpenOptions::new()
            .write(true)
            .open(&segment)
            .expect("segment");
        file.set_len(length * 3 / 4).expect("cut");

        let claim = Claim::wait(&done.session).expect("claim");
        assert!(find(folder.path()).is_empty(), "another one records it");
        drop(claim);
        let found = find(folder.path());
        assert_eq!(found, [done.session]);
        let (sender, text) = sync_channel(4);
        close(folder.path().to_owned(), found, move |text| {
            sender.send(text).expect("report")
        })
        .expect("thread");
        let text = text.recv_timeout(Duration::from_secs(60)).expect("report");
        assert!(
            text.starts_with("an earlier recording was cut off; the 1."),
            "{text}"
        );
        assert!(find(folder.path()).is_empty());
    }
}
