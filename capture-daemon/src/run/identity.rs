//! Identifiers of recordings in virtual time.
//!
//! A recording in virtual time has no date, so its identifier cannot be derived from the time like
//! those of real recordings (UUID version 7). It is a UUID of version 8, a digest of all inputs:
//! the program's version, the configuration as far as it affects a session, name and length, and
//! the data read by the sources. So the same recording has the same identifier on every machine, in
//! every folder; recordings that differ in any input have different ones and can be stored in the
//! same library; and none can be confused with a real one.
//!
//! The folders of sessions and files are not part of the digest.

use super::build::RunParts;
use super::outcome::RecordOptions;
use crate::digest::Digest;
use crate::sources::AnySource;

/// Bytes of the identifier; the caller sets the bits that make it a UUID.
pub(super) fn of(built: &RunParts, options: &RecordOptions) -> [u8; 16] {
    let RunParts {
        sources,
        cameras,
        setup,
    } = built;
    let mut digest = Digest::new("paws: a recording in virtual time, 1");
    digest.value(&setup.software);
    digest.value(&setup.cameras);
    digest.value(&setup.imus);
    digest.value(&setup.calibrations);
    digest.value(&setup.transforms);
    for (name, content) in &setup.rig_files {
        digest.value(name);
        digest.bytes(content);
    }
    digest.value(&(setup.chunk_ns, setup.pre_roll_ns));
    digest.value(cameras);
    digest.value(if options.name.is_empty() {
        &setup.name
    } else {
        &options.name
    });
    digest.value(&options.seconds);
    for source in sources {
        digest.value(source.info());
        if let AnySource::Scheduled(source) = source {
            digest.bytes(&source.digest());
        }
    }
    let mut bytes = [0; 16];
    bytes.copy_from_slice(&digest.finish()[..16]);
    bytes
}
