//! The demo's three cameras and the daemon configuration that describes them.
//!
//! With real recordings at hand each camera replays another data set: a car in town, a room seen
//! by a drone together with its IMU, and a desk. Without them each camera makes its own pictures.

use std::path::{Path, PathBuf};

/// Where the pictures come from.
pub(crate) enum Cameras {
    Replayed { data: PathBuf },
    Synthetic,
}

const KITTI: &str = "02_stereo_odometry_kitti/KITTI_sequence_1";
const EUROC: &str = "03_stereo_imu/euroc_V1_01_micro/mav0";
const DESK: &str = "01_stereo_depth/foundationstereo_demo";

/// Real recordings where all three are there.
pub(crate) fn choose(data: Option<&Path>) -> Cameras {
    match data {
        Some(data)
            if [KITTI, EUROC, DESK]
                .iter()
                .all(|set| data.join(set).is_dir()) =>
        {
            Cameras::Replayed {
                data: data.to_owned(),
            }
        }
        _ => Cameras::Synthetic,
    }
}

impl Cameras {
    pub(crate) fn description(&self) -> &'static str {
        match self {
            Cameras::Replayed { .. } => {
                "replays of KITTI (left shoulder), EuRoC with IMU (right shoulder), a desk (feet)"
            }
            Cameras::Synthetic => {
                "synthetic pictures; set PAWS_DATA to replay real recordings (see `cargo xtask help`)"
            }
        }
    }

    /// The TOML that `pawsd record --config` reads.
    pub(crate) fn configuration(&self) -> String {
        let (left_shoulder, right_shoulder, feet) = match self {
            Cameras::Replayed { data } => {
                // Rust escapes quotes and backslashes as TOML does.
                let folder = |set: &str| format!("{:?}", data.join(set).display().to_string());
                (
                    format!(
                        "kind = \"replay\"\npath = {}\nrate_hz = 10.0\nrepeat = true\n",
                        folder(KITTI)
                    ),
                    format!(
                        "kind = \"replay\"\npath = {}\nrepeat = true\n",
                        folder(EUROC)
                    ),
                    format!(
                        "kind = \"replay\"\npath = {}\nrate_hz = 15.0\nrepeat = true\n",
                        folder(DESK)
                    ),
                )
            }
            Cameras::Synthetic => {
                let source = |seed: u32| {
                    format!(
                        "kind = \"synthetic\"\nwidth = 672\nheight = 376\nrate_hz = 15.0\nimu_rate_hz = 200.0\nseed = {seed}\n"
                    )
                };
                (source(1), source(2), source(3))
            }
        };
        format!(
            "# Written by `cargo xtask demo`.\n\n\
             [[camera]]\nname = \"left_shoulder\"\n[camera.source]\n{left_shoulder}\n\
             [[camera]]\nname = \"right_shoulder\"\n[camera.source]\n{right_shoulder}\n\
             [[camera]]\nname = \"feet\"\n[camera.source]\n{feet}"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_three_cameras_stand_in_either_configuration() {
        let data = PathBuf::from("/data of \"mine\"");
        for cameras in [Cameras::Synthetic, Cameras::Replayed { data }] {
            let text = cameras.configuration();
            for name in ["left_shoulder", "right_shoulder", "feet"] {
                assert!(text.contains(&format!("name = \"{name}\"")), "{text}");
            }
        }
    }

    #[test]
    fn a_path_with_quotes_stays_one_toml_string() {
        let data = PathBuf::from("/data of \"mine\"");
        let text = Cameras::Replayed { data }.configuration();
        assert!(text.contains(r#"path = "/data of \"mine\"/"#), "{text}");
    }

    #[test]
    fn an_incomplete_data_folder_is_not_used() {
        let empty = std::env::temp_dir().join("no such folder");
        assert!(matches!(choose(Some(&empty)), Cameras::Synthetic));
        assert!(matches!(choose(None), Cameras::Synthetic));
    }
}
