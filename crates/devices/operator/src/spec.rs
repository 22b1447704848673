//! Buttons, lights and beepers as they stand in a configuration: one line of text each.
//!
//! ```text
//! button = "gpio:record-button,active-low,pull-up"     a GPIO line by its name,
//! button = "gpio:/dev/gpiochip0:3,debounce=5"          or by chip and offset; debounce in ms
//! button = "evdev:/dev/input/event3"                   a key by the device's path,
//! button = "evdev:name=Shutter remote,key=KEY_ENTER"   by its name,
//! button = "evdev:key=KEY_RECORD"                      or whatever device has the key
//! button = "hid:2b03:f681,byte=1,mask=0x01"            a bit of a USB HID report; report=3: of that number only
//! light  = "gpio:/dev/gpiochip0:4,active-low"          a light of one colour
//! light  = "gpio:red-led+green-led+blue-led"           three lines of one coloured light
//! light  = "sysfs:status"                              /sys/class/leds/status, of one or many colours
//! light  = "sysfs:red+green+blue"                      three of them as one coloured light
//! beeper = "gpio:beeper"                               on and off
//! beeper = "evdev:name=PC Speaker"                     with pitch
//! ```
//!
//! Contract: what is written by [`std::fmt::Display`] reads back as the same. Anything that is not
//! understood is an error that names the word and what could stand there; nothing is ignored.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use evdev::KeyCode;

/// The key that a record button has if none is named.
const RECORD_KEY: KeyCode = KeyCode::KEY_RECORD;
/// How long a button's level must last to count, if none is given: most contacts settle within 5
/// ms.
const DEBOUNCE: Duration = Duration::from_millis(20);

/// A text that is no button, light or beeper.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("reading {text:?}: found {found}, expected {expected}")]
pub struct SpecError {
    text: String,
    found: String,
    expected: &'static str,
}

/// A GPIO line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// By chip and offset.
    At {
        /// The chip's character device.
        chip: PathBuf,
        /// Which of its lines, from 0.
        offset: u32,
    },
    /// By the name that firmware or device tree gave it. Chips may change their numbers from boot
    /// to boot; names stay.
    Named(String),
}

/// What holds a GPIO line when nothing drives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bias {
    /// A resistor to the supply.
    PullUp,
    /// A resistor to ground.
    PullDown,
    /// Nothing.
    Disabled,
}

/// A button on a GPIO line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpioButton {
    /// Which line.
    pub line: Line,
    /// Pressed is low.
    pub active_low: bool,
    /// None leaves it as it is.
    pub bias: Option<Bias>,
    /// How long a level must last to count.
    pub debounce: Duration,
}

/// A key of an input device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyButton {
    /// Which device.
    pub device: InputDevice,
    /// Which of its keys.
    pub key: KeyCode,
}

/// An input device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InputDevice {
    /// By its node.
    Path(PathBuf),
    /// By the name that it gives itself.
    Named(String),
    /// The first one with the required capabilities.
    Any,
}

/// A bit in the reports of a USB HID device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HidButton {
    /// USB vendor.
    pub vendor: u16,
    /// USB product.
    pub product: u16,
    /// Only reports with this number in byte 0; all if none.
    pub report: Option<u8>,
    /// Which byte of the report, from 0, its number included where it has one.
    pub byte: usize,
    /// Pressed while any of these bits is set.
    pub mask: u8,
}

/// Where presses come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ButtonSpec {
    /// A GPIO line.
    Gpio(GpioButton),
    /// A key.
    Key(KeyButton),
    /// A bit of a report.
    Hid(HidButton),
}

/// Where light goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LightSpec {
    /// GPIO lines.
    Gpio {
        /// One line, or red, green, blue.
        lines: Channels<Line>,
        /// Lit is low.
        active_low: bool,
    },
    /// LEDs of the kernel.
    Sysfs(Channels<String>),
}

/// One output of a light, or three.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Channels<T> {
    /// On or off, or of many colours by itself.
    One(T),
    /// Red, green, blue.
    Three([T; 3]),
}

/// Where sound goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BeeperSpec {
    /// A beeper on a GPIO line.
    Gpio {
        /// Which line.
        line: Line,
        /// Sounds when low.
        active_low: bool,
    },
    /// An input device that plays tones.
    Tone(InputDevice),
}

/// A text on its way to a spec.
struct Words<'a> {
    text: &'a str,
    kind: &'a str,
    target: &'a str,
    options: Vec<&'a str>,
}

impl<'a> Words<'a> {
    fn split(text: &'a str, kinds: &'static str) -> Result<Self, SpecError> {
        let (kind, rest) = text
            .split_once(':')
            .ok_or_else(|| error(text, "no colon", kinds))?;
        let mut parts = rest.split(',');
        let target = parts.next().unwrap_or_default().trim();
        Ok(Self {
            text,
            kind: kind.trim(),
            target,
            options: parts.map(str::trim).collect(),
        })
    }

    /// Whether the word stands among the options; takes it out.
    fn flag(&mut self, word: &str) -> bool {
        let before = self.options.len();
        self.options.retain(|o| *o != word);
        self.options.len() < before
    }

    /// The value of `name=value` among the options; takes it out.
    fn value(&mut self, name: &str) -> Option<&'a str> {
        let is = |o: &&str| o.strip_prefix(name).is_some_and(|r| r.starts_with('='));
        let at = self.options.iter().position(is)?;
        let option = self.options.remove(at);
        Some(option[name.len() + 1..].trim())
    }

    fn number(
        &mut self,
        name: &str,
        largest: u32,
        expected: &'static str,
    ) -> Result<Option<u32>, SpecError> {
        let Some(value) = self.value(name) else {
            return Ok(None);
        };
        parse_number(value)
            .filter(|n| *n <= largest)
            .map(Some)
            .ok_or_else(|| error(self.text, &format!("{name}={value}"), expected))
    }

    fn done(self, expected: &'static str) -> Result<(), SpecError> {
        match self.options.first() {
            None => Ok(()),
            Some(word) => Err(error(self.text, &format!("{word:?}"), expected)),
        }
    }

    fn unknown_kind(&self, expected: &'static str) -> SpecError {
        error(self.text, &format!("{:?}", self.kind), expected)
    }
}

fn error(text: &str, found: &str, expected: &'static str) -> SpecError {
    SpecError {
        text: text.to_owned(),
        found: found.to_owned(),
        expected,
    }
}

fn parse_number(text: &str) -> Option<u32> {
    match text.strip_prefix("0x") {
        Some(hex) => u32::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    }
}

fn line(text: &str, target: &str) -> Result<Line, SpecError> {
    const EXPECTED: &str = "a line's name, or CHIP:OFFSET like /dev/gpiochip0:3";
    if target.starts_with('/') {
        let (chip, offset) = target
            .rsplit_once(':')
            .ok_or_else(|| error(text, "a chip without an offset", EXPECTED))?;
        let offset = offset
            .parse()
            .map_err(|_| error(text, &format!("offset {offset:?}"), EXPECTED))?;
        return Ok(Line::At {
            chip: chip.into(),
            offset,
        });
    }
    if target.is_empty() {
        return Err(error(text, "no line", EXPECTED));
    }
    Ok(Line::Named(target.to_owned()))
}

fn channels<T>(
    text: &str,
    target: &str,
    one: impl Fn(&str) -> Result<T, SpecError>,
) -> Result<Channels<T>, SpecError> {
    let parts: Vec<&str> = target.split('+').map(str::trim).collect();
    match parts[..] {
        [single] => Ok(Channels::One(one(single)?)),
        [r, g, b] => Ok(Channels::Three([one(r)?, one(g)?, one(b)?])),
        _ => Err(error(
            text,
            &format!("{} outputs", parts.len()),
            "one, or three as RED+GREEN+BLUE",
        )),
    }
}

fn input_device(text: &str, target: &str) -> Result<InputDevice, SpecError> {
    if let Some(name) = target.strip_prefix("name=") {
        Ok(InputDevice::Named(name.trim().to_owned()))
    } else if target.starts_with('/') {
        Ok(InputDevice::Path(target.into()))
    } else if target.is_empty() || target == "any" {
        Ok(InputDevice::Any)
    } else {
        Err(error(
            text,
            &format!("{target:?}"),
            "a path like /dev/input/event3, name=NAME, or nothing for whatever fits",
        ))
    }
}

impl FromStr for ButtonSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        const KINDS: &str = "gpio:LINE, evdev:DEVICE or hid:VENDOR:PRODUCT";
        let mut words = Words::split(text, KINDS)?;
        match words.kind {
            "gpio" => gpio_button(words).map(Self::Gpio),
            "evdev" => {
                // `evdev:key=KEY_RECORD` names no device.
                if words.target.starts_with("key=") {
                    words.options.insert(0, words.target);
                    words.target = "";
                }
                let key = match words.value("key") {
                    None => RECORD_KEY,
                    Some(name) => name.parse().map_err(|_| {
                        error(
                            text,
                            &format!("key={name}"),
                            "a key of Linux like KEY_RECORD",
                        )
                    })?,
                };
                let device = input_device(text, words.target)?;
                words.done("key=NAME")?;
                Ok(Self::Key(KeyButton { device, key }))
            }
            "hid" => hid_button(words).map(Self::Hid),
            _ => Err(words.unknown_kind(KINDS)),
        }
    }
}

fn gpio_button(mut words: Words<'_>) -> Result<GpioButton, SpecError> {
    let bias = [
        ("pull-up", Bias::PullUp),
        ("pull-down", Bias::PullDown),
        ("no-pull", Bias::Disabled),
    ];
    let mut button = GpioButton {
        line: line(words.text, words.target)?,
        active_low: words.flag("active-low"),
        bias: None,
        debounce: DEBOUNCE,
    };
    for (word, bias) in bias {
        if words.flag(word) && button.bias.replace(bias).is_some() {
            return Err(error(
                words.text,
                "two pulls",
                "one of pull-up, pull-down, no-pull",
            ));
        }
    }
    if let Some(ms) = words.number("debounce", 1000, "milliseconds up to 1000")? {
        button.debounce = Duration::from_millis(ms.into());
    }
    words.done("active-low, pull-up, pull-down, no-pull or debounce=MS")?;
    Ok(button)
}

fn hid_button(mut words: Words<'_>) -> Result<HidButton, SpecError> {
    const IDS: &str = "VENDOR:PRODUCT in hexadecimal like 2b03:f681";
    let (vendor, product) = words
        .target
        .split_once(':')
        .and_then(|(v, p)| {
            let hex = |t| u16::from_str_radix(t, 16).ok();
            Some((hex(v)?, hex(p)?))
        })
        .ok_or_else(|| error(words.text, &format!("{:?}", words.target), IDS))?;
    let report = words.number("report", 255, "a report's number up to 255")?;
    let byte = words.number("byte", 4095, "a byte of the report up to 4095")?;
    let mask = words.number("mask", 255, "bits of one byte like 0x01")?;
    if mask == Some(0) {
        return Err(error(words.text, "mask=0", "at least one bit"));
    }
    let button = HidButton {
        vendor,
        product,
        report: report.map(|n| n as u8),
        byte: byte.unwrap_or(0) as usize,
        mask: mask.unwrap_or(0xff) as u8,
    };
    words.done("report=NUMBER, byte=NUMBER or mask=BITS")?;
    Ok(button)
}

impl FromStr for LightSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        const KINDS: &str = "gpio:LINE or sysfs:NAME";
        let mut words = Words::split(text, KINDS)?;
        match words.kind {
            "gpio" => {
                let lines = channels(text, words.target, |t| line(text, t))?;
                let active_low = words.flag("active-low");
                words.done("active-low")?;
                Ok(Self::Gpio { lines, active_low })
            }
            "sysfs" => {
                let names = channels(text, words.target, |name| led_name(text, name))?;
                words.done("no option")?;
                Ok(Self::Sysfs(names))
            }
            _ => Err(words.unknown_kind(KINDS)),
        }
    }
}

fn led_name(text: &str, name: &str) -> Result<String, SpecError> {
    if name.is_empty() || name.contains('/') || name.starts_with('.') {
        return Err(error(
            text,
            &format!("{name:?}"),
            "a name out of /sys/class/leds, not a path",
        ));
    }
    Ok(name.to_owned())
}

impl FromStr for BeeperSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        const KINDS: &str = "gpio:LINE or evdev:DEVICE";
        let mut words = Words::split(text, KINDS)?;
        match words.kind {
            "gpio" => {
                let line = line(text, words.target)?;
                let active_low = words.flag("active-low");
                words.done("active-low")?;
                Ok(Self::Gpio { line, active_low })
            }
            "evdev" => {
                let device = input_device(text, words.target)?;
                words.done("no option")?;
                Ok(Self::Tone(device))
            }
            _ => Err(words.unknown_kind(KINDS)),
        }
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::At { chip, offset } => write!(f, "{}:{offset}", chip.display()),
            Self::Named(name) => f.write_str(name),
        }
    }
}

impl fmt::Display for InputDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Path(path) => write!(f, "{}", path.display()),
            Self::Named(name) => write!(f, "name={name}"),
            Self::Any => f.write_str("any"),
        }
    }
}

impl<T: fmt::Display> fmt::Display for Channels<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One(one) => one.fmt(f),
            Self::Three([r, g, b]) => write!(f, "{r}+{g}+{b}"),
        }
    }
}

fn low(active_low: bool) -> &'static str {
    if active_low { ",active-low" } else { "" }
}

impl fmt::Display for ButtonSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gpio(button) => {
                write!(f, "gpio:{}{}", button.line, low(button.active_low))?;
                f.write_str(match button.bias {
                    None => "",
                    Some(Bias::PullUp) => ",pull-up",
                    Some(Bias::PullDown) => ",pull-down",
                    Some(Bias::Disabled) => ",no-pull",
                })?;
                if button.debounce != DEBOUNCE {
                    write!(f, ",debounce={}", button.debounce.as_millis())?;
                }
                Ok(())
            }
            Self::Key(button) => write!(f, "evdev:{},key={:?}", button.device, button.key),
            Self::Hid(button) => {
                write!(f, "hid:{:04x}:{:04x}", button.vendor, button.product)?;
                if let Some(report) = button.report {
                    write!(f, ",report={report}")?;
                }
                write!(f, ",byte={},mask={:#04x}", button.byte, button.mask)
            }
        }
    }
}

impl fmt::Display for LightSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gpio { lines, active_low } => write!(f, "gpio:{lines}{}", low(*active_low)),
            Self::Sysfs(names) => write!(f, "sysfs:{names}"),
        }
    }
}

impl fmt::Display for BeeperSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gpio { line, active_low } => write!(f, "gpio:{line}{}", low(*active_low)),
            Self::Tone(device) => write!(f, "evdev:{device}"),
        }
    }
}

#[cfg(test)]
mod tests;
