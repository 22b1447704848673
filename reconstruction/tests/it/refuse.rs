//! Sessions that differ from what was validated are refused, and later changes are detected.

use std::error::Error;
use std::fs;
use std::path::Path;

use reconstruction::input::{Check, Input, InputError};
use session_archive::handoff::{HandOffError, Verdict};
use session_archive::layout;
use session_input::{FrameFault, ImuFault, ReadError};

use crate::session::{hand_over, index, seal, seal_only};

fn session() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    hand_over(folder.path());
    folder
}

fn refused(folder: &Path) -> InputError {
    Input::open(folder).expect_err("must be refused")
}

fn replace(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).expect("read");
    assert!(text.contains(from), "{from} in {}", path.display());
    fs::write(path, text.replace(from, to)).expect("write");
}

fn flip(path: &Path, at: u64) {
    let mut bytes = fs::read(path).expect("read");
    bytes[at as usize] ^= 1;
    fs::write(path, bytes).expect("write");
}

#[test]
fn a_file_or_a_folder_is_accepted_and_nothing_else() {
    let folder = session();
    assert!(Input::open(folder.path()).is_ok());
    assert!(Input::open(&folder.path().join(layout::HANDOFF)).is_ok());
    let links = tempfile::tempdir().expect("folder");
    let link = links.path().join("handoff");
    std::os::unix::fs::symlink(folder.path().join(layout::HANDOFF), &link).expect("link");
    assert!(Input::open(&link).is_ok(), "a link to the file");
    for path in [
        folder.path().join(layout::MANIFEST),
        folder.path().join("nowhere"),
    ] {
        let error = refused(&path);
        assert!(matches!(error, InputError::Path { .. }), "{error:?}");
    }
}

#[test]
fn a_session_that_was_not_handed_over_is_refused() {
    let folder = session();
    fs::remove_file(folder.path().join(layout::HANDOFF)).expect("remove");
    let error = refused(folder.path());
    assert!(
        matches!(
            &error,
            InputError::HandOff {
                error: HandOffError::Missing,
                ..
            }
        ),
        "{error:?}"
    );
    let source = error.source().expect("a source").to_string();
    assert!(source.contains("`paws handoff`"), "{source}");
}

#[test]
fn a_session_that_failed_its_validation_is_refused() {
    let folder = session();
    seal(folder.path(), Verdict::Fail);
    let error = refused(folder.path());
    assert!(
        matches!(
            &error,
            InputError::HandOff {
                error: HandOffError::Failed,
                ..
            }
        ),
        "{error:?}"
    );
    seal(folder.path(), Verdict::Warn);
    assert!(Input::open(folder.path()).is_ok());
}

#[test]
fn an_edited_hand_off_is_refused() {
    let folder = session();
    replace(&folder.path().join(layout::HANDOFF), "PASS", "WARN");
    let error = refused(folder.path());
    assert!(
        matches!(
            &error,
            InputError::HandOff {
                error: HandOffError::Invalid(_),
                ..
            }
        ),
        "{error:?}"
    );
}

#[test]
fn any_changed_file_is_refused() {
    for file in [
        layout::MANIFEST.to_owned(),
        layout::INDEX.to_owned(),
        layout::rig_file("rig.toml"),
        layout::segment(0),
    ] {
        let folder = session();
        flip(&folder.path().join(&file), 5);
        let error = refused(folder.path());
        let changed = |error: &InputError| match error {
            InputError::HandOff {
                error: HandOffError::Changed { path, .. },
                ..
            } => *path == file,
            _ => false,
        };
        assert!(changed(&error), "{file}: {error:?}");
        fs::remove_file(folder.path().join(&file)).expect("remove");
        assert!(changed(&refused(folder.path())), "{file} removed");
    }
}

#[test]
fn unsealed_files_are_not_read() {
    let all = [
        layout::MANIFEST.to_owned(),
        layout::INDEX.to_owned(),
        layout::rig_file("rig.toml"),
        layout::segment(0),
    ];
    let folder = session();
    for left_out in 0..all.len() {
        let mut files = all.to_vec();
        let expected = files.remove(left_out);
        seal_only(folder.path(), Verdict::Pass, &files);
        let error = refused(folder.path());
        assert!(
            matches!(&error, InputError::NotSealed { file, .. } if *file == expected),
            "{expected}: {error:?}"
        );
    }
}

#[test]
fn an_index_of_another_session_is_refused() {
    let folder = session();
    let other = session();
    // The other session has a longer segment; its index is sealed with this one nevertheless.
    let segment = other.path().join(layout::segment(0));
    let mut bytes = fs::read(&segment).expect("read");
    bytes.extend([0; 8]);
    fs::write(&segment, bytes).expect("write");
    index(other.path());
    let path = |folder: &tempfile::TempDir| folder.path().join(layout::INDEX);
    fs::copy(path(&other), path(&folder)).expect("copy");
    seal(folder.path(), Verdict::Pass);
    let error = refused(folder.path());
    assert!(matches!(&error, InputError::Index { .. }), "{error:?}");
}

#[test]
fn bytes_that_change_after_the_check_are_detected_where_they_are_used() {
    let folder = session();
    let input = Input::open(folder.path()).expect("open");
    let frames = &input
        .index()
        .camera("left_shoulder")
        .expect("camera")
        .frames;
    // In the middle of the second GOP.
    let start = frames
        .iter()
        .position(|f| f.key > 0)
        .expect("a second group");
    let broken = start + 2;
    let length = frames.iter().filter(|f| f.key as usize == start).count();
    assert!(length > 4);
    let batch = input.index().imus[0].batches[7];
    let segment = folder.path().join(layout::segment(0));
    flip(&segment, frames[broken].offset + 9);
    flip(&segment, batch.offset + 9);

    let error = refused(folder.path());
    assert!(matches!(error, InputError::HandOff { .. }), "{error:?}");
    // Skipping the check of content still never returns corrupt data.
    let input = Input::open_with(folder.path(), Check::Lengths, |_, _| {}).expect("open");
    let views: Vec<_> = input
        .session()
        .frames("left_shoulder")
        .expect("frames")
        .collect();
    for (position, (view, frame)) in views.iter().zip(frames).enumerate() {
        let lost = (broken..start + length).contains(&position);
        assert_eq!(view.is_err(), lost, "frame {}", frame.number);
        if let Err(error) = view {
            let named = matches!(error, ReadError::Frame { number, fault: FrameFault::Bytes(_), .. }
                if *number == frame.number);
            assert!(named, "{error:?}");
        }
    }
    let batches: Vec<_> = input
        .session()
        .imu_batches("feet/imu")
        .expect("imu")
        .collect();
    let failed: Vec<usize> = (0..50).filter(|&b| batches[b].is_err()).collect();
    assert_eq!(failed, [7]);
    assert!(matches!(
        &batches[7],
        Err(ReadError::Imu {
            first: 70,
            last: 79,
            fault: ImuFault::Bytes(_),
            ..
        })
    ));
    // Sets with a loss are errors, and later ones are returned as before.
    let sets: Vec<_> = input.session().sets().expect("sets").collect();
    let good = sets.iter().filter(|s| s.is_ok()).count();
    assert!(good > 20 && good < 45, "{good}");
    assert!(sets.last().is_some_and(Result::is_ok));
}
