//! The demo's daemon configuration: a walk with a simulated rig.

use std::path::Path;

/// Columns of a stereo frame and rows, on the shoulders and of the feet camera, and frames per
/// second. Tags on shoes need the larger images and the higher rate.
const SHOULDER: (u32, u32) = (896, 252);
const FEET: (u32, u32) = (1344, 376);
const RATE_HZ: f64 = 15.0;

/// The TOML that `pawsd record --config` reads, for a walk of this many seconds with the rig of
/// this file.
pub(crate) fn configuration(rig: &Path, seconds: u32) -> String {
    // Rust escapes quotes and backslashes as TOML does.
    let rig = rig.display().to_string();
    // The daemon starts its cameras a little before it records.
    let walk = f64::from(seconds) + 5.0;
    let camera = |(name, (width, height)): (&str, (u32, u32))| {
        format!(
            "[[camera]]\nname = {name:?}\ntrigger = \"walk\"\n[camera.source]\nkind = \"sim\"\n\
             scene = \"pavement\"\nseconds = {walk:?}\nrate_hz = {RATE_HZ:?}\n\
             width = {width}\nheight = {height}\n\n"
        )
    };
    let cameras = [
        ("left_shoulder", SHOULDER),
        ("right_shoulder", SHOULDER),
        ("feet", FEET),
    ];
    let cameras = cameras.map(camera).concat();
    format!("# Written by `cargo xtask demo`.\n\n[rig]\nfile = {rig:?}\n\n{cameras}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_three_cameras_are_simulated_on_one_rig() {
        let text = configuration(Path::new("/rigs/\"mine\".toml"), 20);
        for name in ["left_shoulder", "right_shoulder", "feet"] {
            assert!(text.contains(&format!("name = \"{name}\"")), "{text}");
        }
        assert_eq!(text.matches("kind = \"sim\"").count(), 3);
        assert!(text.contains(r#"file = "/rigs/\"mine\".toml""#), "{text}");
    }
}
