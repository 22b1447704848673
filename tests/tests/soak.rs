//! Three minutes of virtual time: nothing is missing and the memory is constant. `bench soak` does
//! an hour. The only test of this file, because another one would use memory in the same process.

use harness::rig::Rig;
use harness::soak::soak;

#[test]
fn memory_is_constant_and_every_sample_is_stored() {
    const SECONDS: u32 = 180;
    let folder = tempfile::tempdir().expect("folder");
    let rig = Rig::small(3);
    let result = soak(&rig, SECONDS, folder.path()).expect("recording");
    result.check_counts(&rig, SECONDS).expect("counts");
    let growth = result.growth(60.0).expect("looks");
    println!(
        "{SECONDS} s in {:.1} s; the memory grew by {} KiB after the first minute",
        result.wall_s,
        growth / 1024
    );
    assert!(
        growth < 10 << 20,
        "{growth} bytes more: {:?}",
        result.samples
    );
}
