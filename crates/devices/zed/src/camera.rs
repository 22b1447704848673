//! Stereolabs' USB cameras: identities, modes, settings; [`extension`] accesses their registers.
//!
//! Sources: zed-open-capture at 9373915 (`defines.hpp`, `videocapture_def.hpp`,
//! `videocapture.cpp`). None of it was ever tried on a real camera.

pub mod extension;

/// USB vendor number of Stereolabs.
pub const VENDOR: u16 = 0x2b03;

/// A camera with a USB plug.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Model {
    /// The first one; it has no IMU.
    Zed,
    /// The small one.
    ZedMini,
    /// The second one.
    Zed2,
    /// The second one in a housing.
    Zed2i,
}

/// A camera by its USB product number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// What it is.
    pub model: Model,
    /// Its firmware is so old that even the vendor's own library refuses it: update it with the
    /// vendor's tool.
    pub old_firmware: bool,
}

impl Model {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Zed, Self::ZedMini, Self::Zed2, Self::Zed2i];

    /// For people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Zed => "ZED",
            Self::ZedMini => "ZED Mini",
            Self::Zed2 => "ZED 2",
            Self::Zed2i => "ZED 2i",
        }
    }

    /// USB product number of its video part.
    const fn camera_product(self) -> u16 {
        match self {
            Self::Zed => 0xf582,
            Self::ZedMini => 0xf682,
            Self::Zed2 => 0xf780,
            Self::Zed2i => 0xf880,
        }
    }

    /// USB product number of its microcontroller.
    const fn imu_product(self) -> Option<u16> {
        match self {
            Self::Zed => None,
            Self::ZedMini => Some(0xf681),
            Self::Zed2 => Some(0xf781),
            Self::Zed2i => Some(0xf881),
        }
    }

    /// The camera whose microcontroller has this USB product number.
    pub fn of_imu(product: u16) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|m| m.imu_product() == Some(product))
    }
}

impl Identity {
    /// The camera whose video part has these USB numbers.
    pub fn of(vendor: u16, product: u16) -> Option<Self> {
        if vendor != VENDOR {
            return None;
        }
        let (model, old_firmware) = match product {
            0xf580 => (Model::Zed, true),
            0xf680 => (Model::ZedMini, true),
            _ => {
                let has = |m: &Model| m.camera_product() == product;
                (Model::ALL.into_iter().find(has)?, false)
            }
        };
        Some(Self {
            model,
            old_firmware,
        })
    }
}

/// A mode of the video part: YUYV 4:2:2, left and right side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// The vendor's name.
    pub name: &'static str,
    /// Width of both frames together, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Frames per second that it can have.
    pub rates_hz: &'static [u32],
}

/// What these cameras can do. The list is the vendor's for all of them.
pub const MODES: [Mode; 4] = [
    Mode {
        name: "HD2K",
        width: 4416,
        height: 1242,
        rates_hz: &[15],
    },
    Mode {
        name: "HD1080",
        width: 3840,
        height: 1080,
        rates_hz: &[15, 30],
    },
    Mode {
        name: "HD720",
        width: 2560,
        height: 720,
        rates_hz: &[15, 30, 60],
    },
    Mode {
        name: "VGA",
        width: 1344,
        height: 376,
        rates_hz: &[15, 30, 60, 100],
    },
];

impl Mode {
    /// What it sends at a rate, bytes per second.
    pub const fn bytes_per_s(self, rate_hz: u32) -> u64 {
        self.width as u64 * self.height as u64 * 2 * rate_hz as u64
    }
}

/// A V4L2 control to be written at start, and read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Its number in the kernel's `v4l2-controls.h`.
    pub id: u32,
    /// Its name there without the prefix.
    pub name: &'static str,
    /// What it is set to; none is what the driver calls its default.
    pub value: Option<i32>,
}

/// What to write at every start, for the camera keeps what an earlier program has set
/// (zed-ros2-wrapper, change log 5.4.1). Exposure and gain are automatic after
/// [`extension::set_auto_exposure`]; a camera of this make may ignore the standard controls for
/// them.
pub const SETTINGS: [Setting; 6] = [
    setting(0x0098_0900, "BRIGHTNESS", None),
    setting(0x0098_0901, "CONTRAST", None),
    setting(0x0098_0902, "SATURATION", None),
    setting(0x0098_0903, "HUE", None),
    setting(0x0098_091b, "SHARPNESS", None),
    setting(0x0098_090c, "AUTO_WHITE_BALANCE", Some(1)),
];

const fn setting(id: u32, name: &'static str, value: Option<i32>) -> Setting {
    Setting { id, name, value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identities_are_known_both_ways() {
        for model in Model::ALL {
            let identity = Identity::of(VENDOR, model.camera_product()).expect("known");
            assert_eq!((identity.model, identity.old_firmware), (model, false));
            if let Some(product) = model.imu_product() {
                assert_eq!(Model::of_imu(product), Some(model));
            }
        }
        let old = Identity::of(VENDOR, 0xf680).expect("known");
        assert_eq!((old.model, old.old_firmware), (Model::ZedMini, true));
        assert_eq!(Identity::of(0x046d, 0xf682), None);
        assert_eq!(Identity::of(VENDOR, 0xf681), None, "the microcontroller");
    }

    /// The rates are the vendor's, in MB/s.
    #[test]
    fn modes_need_what_they_need() {
        let most = |m: &Mode| m.bytes_per_s(m.rates_hz[m.rates_hz.len() - 1]) / 1_000_000;
        assert_eq!(
            MODES.iter().map(most).collect::<Vec<_>>(),
            [164, 248, 221, 101]
        );
    }
}
