//! What this machine has that could be a button, a light or a beeper, as it would stand in a
//! configuration.
//!
//! Contract: a look, not a test: nothing is set or pressed. What cannot be opened is listed with
//! what mends it. Nothing found is an empty list. Sorted, so that two looks compare.

use std::fs;
use std::path::Path;

use evdev::raw_stream::RawDevice;
use evdev::{KeyCode, SoundCode};
use gpiocdev::chip::Chip;

use crate::DeviceError;
use crate::button::evdev::{MEND, event_nodes};

/// What a device could be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Use {
    /// A button.
    Button,
    /// A light.
    Light,
    /// A beeper.
    Beeper,
    /// Lines of a GPIO chip, which can be any of them.
    Lines,
}

/// One device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceEntry {
    /// What it could be.
    pub as_what: Use,
    /// How to write it, see [`spec`](crate::spec). For [`Use::Lines`] without the line.
    pub spec: String,
    /// What it calls itself.
    pub name: String,
    /// Why it cannot be used, and what mends that.
    pub problem: Option<String>,
}

/// Keys that a button on its own may have, likeliest first.
const KEYS: [KeyCode; 8] = [
    KeyCode::KEY_RECORD,
    KeyCode::KEY_CAMERA,
    KeyCode::KEY_PLAYPAUSE,
    KeyCode::KEY_VOLUMEUP,
    KeyCode::KEY_POWER,
    KeyCode::KEY_ENTER,
    KeyCode::KEY_SPACE,
    KeyCode::BTN_0,
];

/// Everything that is there.
pub fn all() -> Vec<DeviceEntry> {
    let mut found: Vec<DeviceEntry> = event_nodes().iter().flat_map(|n| input(n)).collect();
    found.extend(leds(Path::new("/sys/class/leds")));
    found.extend(chips());
    found.sort_by(|a, b| (a.as_what, &a.spec).cmp(&(b.as_what, &b.spec)));
    found
}

/// An input device: nothing, a button, a beeper or both.
fn input(node: &Path) -> Vec<DeviceEntry> {
    let spec = format!("evdev:{}", node.display());
    let device = match RawDevice::open(node) {
        Ok(device) => device,
        Err(e) => {
            let error = DeviceError::from_io("opening", &spec, MEND, e);
            return vec![DeviceEntry {
                as_what: Use::Button,
                spec,
                name: String::new(),
                problem: Some(error.to_string()),
            }];
        }
    };
    let name = device.name().unwrap_or_default().to_owned();
    let mut found = Vec::new();
    if let Some(keys) = device.supported_keys()
        && let Some(key) = KEYS.into_iter().find(|key| keys.contains(*key))
    {
        found.push(DeviceEntry {
            as_what: Use::Button,
            spec: format!("{spec},key={key:?}"),
            name: name.clone(),
            problem: None,
        });
    }
    let sounds = device.supported_sounds();
    if sounds.is_some_and(|s| s.contains(SoundCode::SND_TONE)) {
        found.push(DeviceEntry {
            as_what: Use::Beeper,
            spec,
            name,
            problem: None,
        });
    }
    found
}

fn leds(root: &Path) -> Vec<DeviceEntry> {
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    let led = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let brightness = entry.path().join("brightness");
        // Opened, which changes nothing, because permissions alone do not tell.
        let problem = fs::OpenOptions::new().write(true).open(brightness).err();
        let spec = format!("sysfs:{name}");
        let mend = crate::light::sysfs::MEND;
        let problem = problem.map(|e| DeviceError::from_io("opening", &spec, mend, e).to_string());
        Some(DeviceEntry {
            as_what: Use::Light,
            spec,
            name,
            problem,
        })
    };
    entries.filter_map(led).collect()
}

fn chips() -> Vec<DeviceEntry> {
    let chips = gpiocdev::chip::chips().unwrap_or_default();
    let chip = |path: std::path::PathBuf| {
        let spec = format!("gpio:{}", path.display());
        let info = Chip::from_path(&path).and_then(|chip| chip.info());
        let (name, problem) = match info {
            Ok(info) => (format!("{}, {} lines", info.label, info.num_lines), None),
            Err(e) => {
                let error = crate::gpio::from_gpio("opening", &spec, e);
                (String::new(), Some(error.to_string()))
            }
        };
        DeviceEntry {
            as_what: Use::Lines,
            spec,
            name,
            problem,
        }
    };
    chips.into_iter().map(chip).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_led_without_brightness_is_listed_with_its_problem() {
        let root = tempfile::tempdir().unwrap();
        for name in ["good", "odd"] {
            fs::create_dir(root.path().join(name)).unwrap();
        }
        fs::write(root.path().join("good/brightness"), "0").unwrap();
        let mut found = leds(root.path());
        found.sort_by(|a, b| a.spec.cmp(&b.spec));
        let seen: Vec<_> = found
            .iter()
            .map(|f| (f.spec.as_str(), f.problem.is_some()))
            .collect();
        assert_eq!(seen, [("sysfs:good", false), ("sysfs:odd", true)]);
    }

    #[test]
    fn no_leds_at_all_is_an_empty_list() {
        assert_eq!(leds(Path::new("/nowhere/at/all")), []);
    }
}
