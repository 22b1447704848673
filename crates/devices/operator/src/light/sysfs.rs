//! An LED of the kernel: `/sys/class/leds/NAME`, of one colour, of many in one (the multicolour
//! class), or three of them as one.
//!
//! What blinked the LED before (its trigger) is switched off while the light is ours, and back on
//! at the end; what a trigger was set to beyond its name is lost. Files are opened at each write,
//! so an LED on USB that was unplugged works again once it is back. See
//! `Documentation/ABI/testing/sysfs-class-led` and `sysfs-class-led-multicolor` in Linux' source.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::Light;
use crate::DeviceError;
use crate::pattern::LightState;
use crate::spec::Channels;

/// Where the kernel keeps its LEDs.
const LEDS: &str = "/sys/class/leds";
/// Who may set them.
pub(crate) const MEND: &str =
    "the daemon's user must be able to write brightness and trigger, see the udev rules in deploy/";

/// LEDs that are ours for now.
#[derive(Debug)]
pub(crate) struct SysfsLight {
    leds: Channels<Led>,
    what: String,
}

/// One LED.
#[derive(Debug)]
struct Led {
    folder: PathBuf,
    max: u64,
    /// Which of red, green, blue each of its parts is, where it has parts; 3 for one that is none
    /// of them.
    parts: Option<Vec<usize>>,
    trigger: Option<String>,
    brightness: String,
}

impl SysfsLight {
    /// Takes the LEDs.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub(crate) fn open(names: &Channels<String>) -> Result<Self, DeviceError> {
        Self::open_in(Path::new(LEDS), names)
    }

    fn open_in(root: &Path, names: &Channels<String>) -> Result<Self, DeviceError> {
        let open = |name: &String| Led::open(&root.join(name));
        let leds = match names {
            Channels::One(name) => Channels::One(open(name)?),
            Channels::Three([r, g, b]) => Channels::Three([open(r)?, open(g)?, open(b)?]),
        };
        let what = format!("LED {names}");
        Ok(Self { leds, what })
    }
}

impl Led {
    fn open(folder: &Path) -> Result<Self, DeviceError> {
        let what = format!("LED {}", folder.display());
        let failed = |doing| {
            let what = what.clone();
            move |e| DeviceError::from_io(doing, &what, MEND, e)
        };
        let read = |file: &str| fs::read_to_string(folder.join(file));
        let max = read("max_brightness").map_err(failed("reading"))?;
        let max = max.trim().parse().ok().filter(|max| *max > 0);
        let max = max.ok_or_else(|| DeviceError::Unfit {
            what: what.clone(),
            found: format!("max_brightness {max:?}"),
            expected: "a number above 0".into(),
        })?;
        let mut led = Self {
            folder: folder.to_owned(),
            max,
            parts: read("multi_index").ok().map(|index| parts(&index)),
            trigger: read("trigger").ok().and_then(|all| chosen(&all)),
            brightness: read("brightness").map_err(failed("reading"))?,
        };
        if led.trigger.as_deref() == Some("none") {
            led.trigger = None;
        }
        if led.trigger.is_some() {
            led.write("trigger", "none").map_err(failed("setting"))?;
        }
        led.set([0; 3]).map_err(failed("setting"))?;
        Ok(led)
    }

    fn write(&self, file: &str, text: &str) -> io::Result<()> {
        fs::write(self.folder.join(file), text)
    }

    /// Levels of red, green, blue; an LED of one colour takes the brightest.
    fn set(&self, rgb: [u8; 3]) -> io::Result<()> {
        let top = rgb.into_iter().max().unwrap_or(0);
        if let (Some(parts), 1..) = (&self.parts, top) {
            let levels = parts
                .iter()
                .map(|&part| rgb.get(part).copied().unwrap_or(0));
            let levels: Vec<String> = levels.map(|level| self.scaled(level)).collect();
            self.write("multi_intensity", &levels.join(" "))?;
        }
        // Colours of a multicolour LED are levels of the whole's brightness.
        let level = if self.parts.is_some() && top > 0 {
            u8::MAX
        } else {
            top
        };
        self.write("brightness", &self.scaled(level))
    }

    fn scaled(&self, level: u8) -> String {
        (self.max * u64::from(level)).div_ceil(255).to_string()
    }
}

impl Drop for Led {
    fn drop(&mut self) {
        let restored = match &self.trigger {
            Some(trigger) => self.write("trigger", trigger),
            None => self.write("brightness", self.brightness.trim()),
        };
        if let Err(error) = restored {
            log::debug!("restoring {}: {error}", self.folder.display());
        }
    }
}

/// The parts of a multicolour LED out of its `multi_index`, as places in red, green, blue.
fn parts(index: &str) -> Vec<usize> {
    let place = |name| ["red", "green", "blue"].iter().position(|c| *c == name);
    index
        .split_whitespace()
        .map(|name| place(name).unwrap_or(3))
        .collect()
}

/// The trigger in brackets: `none [heartbeat] timer`.
fn chosen(triggers: &str) -> Option<String> {
    let (_, rest) = triggers.split_once('[')?;
    let (name, _) = rest.split_once(']')?;
    Some(name.to_owned())
}

impl Light for SysfsLight {
    fn show(&mut self, state: LightState) -> io::Result<()> {
        let rgb = state.colour.rgb();
        match &self.leds {
            Channels::One(led) if led.parts.is_some() => led.set(rgb),
            Channels::One(led) => led.set(if state.lit { [255; 3] } else { [0; 3] }),
            Channels::Three(leds) => leds
                .iter()
                .zip(rgb)
                .try_for_each(|(led, level)| led.set([level; 3])),
        }
    }

    fn describe(&self) -> &str {
        &self.what
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Colour;

    /// A folder like the kernel's.
    fn led(root: &Path, name: &str, files: &[(&str, &str)]) {
        let folder = root.join(name);
        fs::create_dir(&folder).unwrap();
        for (file, text) in files {
            fs::write(folder.join(file), text).unwrap();
        }
    }

    fn read(root: &Path, file: &str) -> String {
        fs::read_to_string(root.join(file)).unwrap()
    }

    const ORANGE: LightState = LightState {
        lit: true,
        colour: Colour::Orange,
    };

    #[test]
    fn one_colour_is_on_and_off_and_its_trigger_comes_back() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        led(
            root,
            "status",
            &[
                ("max_brightness", "15\n"),
                ("brightness", "7\n"),
                ("trigger", "none [heartbeat] timer\n"),
            ],
        );
        let mut light = SysfsLight::open_in(root, &Channels::One("status".to_owned())).unwrap();
        assert_eq!(read(root, "status/trigger"), "none");
        assert_eq!(read(root, "status/brightness"), "0");
        light.show(ORANGE).unwrap();
        assert_eq!(read(root, "status/brightness"), "15");
        light
            .show(LightState {
                lit: false,
                colour: Colour::Orange,
            })
            .unwrap();
        assert_eq!(read(root, "status/brightness"), "0");
        drop(light);
        assert_eq!(read(root, "status/trigger"), "heartbeat");
    }

    #[test]
    fn without_a_trigger_the_brightness_comes_back() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let files = [
            ("max_brightness", "1\n"),
            ("brightness", "1\n"),
            ("trigger", "[none] timer\n"),
        ];
        led(root, "a", &files);
        drop(SysfsLight::open_in(root, &Channels::One("a".to_owned())).unwrap());
        assert_eq!(read(root, "a/brightness"), "1");
        assert_eq!(read(root, "a/trigger"), "[none] timer\n");
    }

    #[test]
    fn many_colours_in_one_are_set_in_the_order_of_the_led() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let files = [
            ("max_brightness", "255"),
            ("brightness", "0"),
            ("multi_index", "green white red blue\n"),
        ];
        led(root, "rgb", &files);
        let mut light = SysfsLight::open_in(root, &Channels::One("rgb".to_owned())).unwrap();
        light.show(ORANGE).unwrap();
        assert_eq!(read(root, "rgb/multi_intensity"), "110 0 255 0");
        assert_eq!(read(root, "rgb/brightness"), "255");
        light.show(LightState::DARK).unwrap();
        assert_eq!(read(root, "rgb/brightness"), "0");
    }

    #[test]
    fn three_leds_are_one_light() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        for name in ["r", "g", "b"] {
            led(
                root,
                name,
                &[("max_brightness", "100"), ("brightness", "0")],
            );
        }
        let names = Channels::Three(["r", "g", "b"].map(String::from));
        let mut light = SysfsLight::open_in(root, &names).unwrap();
        light.show(ORANGE).unwrap();
        let levels = ["r", "g", "b"].map(|n| read(root, &format!("{n}/brightness")));
        assert_eq!(levels, ["100", "44", "0"]);
    }

    #[test]
    fn what_is_no_led_is_refused() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        led(root, "odd", &[("max_brightness", "0"), ("brightness", "0")]);
        let open = |name: &str| {
            let names = Channels::One(name.to_owned());
            SysfsLight::open_in(root, &names).map(|_| ()).unwrap_err()
        };
        assert!(matches!(open("odd"), DeviceError::Unfit { .. }));
        assert!(matches!(open("absent"), DeviceError::NotFound { .. }));
    }
}
