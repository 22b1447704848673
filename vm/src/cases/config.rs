//! Configurations of `pawsd` for guests.

/// Three small made-up cameras with IMUs, and the program's own encoder in software.
pub(crate) fn synthetic(chunk_ms: u32) -> String {
    let mut text = format!(
        "[session]\nout = \"/run/archive\"\nchunk_ms = {chunk_ms}\npre_roll_s = 0\n\
         [disk]\nreserve_gb = 0\n\
         [encoder]\nelement = \"x264enc\"\n\
         [control]\nsocket = \"/run/paws/pawsd.sock\"\n"
    );
    for name in ["left_shoulder", "right_shoulder", "feet"] {
        text += &format!(
            "[[camera]]\nname = \"{name}\"\n[camera.source]\nkind = \"synthetic\"\n\
             width = 320\nheight = 96\nrate_hz = 30\nimu_rate_hz = 400\n"
        );
    }
    text
}
