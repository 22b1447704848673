//! Files of Gaussians: any bytes give Gaussians or an error, and Gaussians survive being written.

#![no_main]

use std::io::Write;

use gaussians::files::{FileError, SplatFile, dot_splat, glb, ply, spz};
use libfuzzer_sys::fuzz_target;

const MAX: usize = 10_000;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else {
        return;
    };
    let read = match mode % 4 {
        0 => ply::read(data, MAX),
        1 => dot_splat::read(data, MAX),
        2 => spz::read(data, MAX),
        // What lies behind the checksum of gzip.
        _ => old_spz(data),
    };
    let Ok(SplatFile {
        splats,
        compensated,
    }) = read
    else {
        return;
    };
    assert!(splats.len() <= MAX);
    assert!(splats.planes().iter().flatten().all(|v| v.is_finite()));
    let bytes = ply::write(&splats, compensated);
    let back = ply::read(&bytes, MAX).expect("what was written is read");
    assert_eq!((&back.splats, back.compensated), (&splats, compensated));
    // The others have ranges.
    let _ = glb::write(&splats, "fuzz");
    if let Ok(bytes) = spz::write(&splats, compensated) {
        let back = spz::read(&bytes, MAX).expect("what was written is read");
        assert_eq!(back.splats.len(), splats.len());
    }
});

fn old_spz(data: &[u8]) -> Result<SplatFile, FileError> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(data).expect("memory does not fail");
    spz::read(&encoder.finish().expect("memory does not fail"), MAX)
}
