//! Configurations of `pawsd` for guests.

/// The cameras of every rig here.
pub(crate) const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];
/// The IMU of the rig with devices.
pub(crate) const IMU: &str = "left_shoulder/imu";

/// Three synthetic cameras with IMUs, so small and slow that a guest on a busy host keeps up.
pub(crate) fn synthetic(chunk_ms: u32) -> String {
    let mut text = format!(
        "[session]\nout = \"/run/archive\"\nchunk_ms = {chunk_ms}\npre_roll_s = 0\n\
         [disk]\nreserve_gb = 0\n\
         [encoder]\nelement = \"x264enc\"\n\
         [control]\nsocket = \"/run/paws/pawsd.sock\"\n"
    );
    for name in CAMERAS {
        text += &format!(
            "[[camera]]\nname = \"{name}\"\n[camera.source]\nkind = \"synthetic\"\n\
             width = 160\nheight = 64\nrate_hz = 15\nimu_rate_hz = 200\n"
        );
    }
    text
}

/// Two small V4L2 cameras, one for each eye.
pub(crate) fn pair() -> String {
    format!(
        "[session]\nout = \"/run/archive\"\npre_roll_s = 0\n[disk]\nreserve_gb = 0\n[encoder]\nelement = \"x264enc\"\n\
         [[camera]]\nname = \"{}\"\n[camera.source]\nkind = \"v4l2\"\ndevice = \"/dev/video0\"\n\
         right_device = \"/dev/video1\"\nwidth = 640\nheight = 96\nrate_hz = 30\n",
        CAMERAS[0]
    )
}

/// Three small V4L2 cameras, an IMU behind hidraw that belongs to the first, the buttons and the
/// light of `rig.sh`.
pub(crate) fn devices(gpio: bool) -> String {
    let mut text = "[session]\nout = \"/run/archive\"\npre_roll_s = 0\n\
         [disk]\nreserve_gb = 0\n\
         [encoder]\nelement = \"x264enc\"\n\
         [control]\nsocket = \"/run/paws/pawsd.sock\"\n"
        .to_owned();
    text += if gpio {
        "[operator]\nbuttons = [\"gpio:record-button\", \"evdev:name=vm-button,key=KEY_RECORD\"]\n\
         lights = [\"gpio:record-light\"]\n"
    } else {
        "[operator]\nbuttons = [\"evdev:name=vm-button,key=KEY_RECORD\"]\n"
    };
    for (i, name) in CAMERAS.into_iter().enumerate() {
        text += &format!(
            "[[camera]]\nname = \"{name}\"\n[camera.source]\nkind = \"v4l2\"\ndevice = \"/dev/video{i}\"\n\
             width = 320\nheight = 96\nrate_hz = 30\n"
        );
        if i == 0 {
            text += "imu = \"zed\"\nimu_rate_hz = 800\n";
        }
    }
    text
}
