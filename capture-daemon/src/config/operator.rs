//! Settings of button, light, beeper and phone page, and how the file writes them.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use super::device::{A_USB_ID, usb_id};
use super::file::choice;
use super::section::Section;

/// What a person without a screen has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Operator {
    /// `[[button]]`: any of them starts and stops.
    pub buttons: Vec<Button>,
    /// `[[light]]`: all of them show the same.
    pub lights: Vec<Light>,
    /// `[[beeper]]`: all of them sound the same.
    pub beepers: Vec<Beeper>,
}

/// A line of a GPIO chip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// The chip's node.
    pub chip: PathBuf,
    /// The line's place on it.
    pub offset: u32,
    /// Whether low voltage means on.
    pub active_low: bool,
}

/// A button.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Button {
    /// On a GPIO line.
    Gpio {
        /// The line.
        line: Line,
        /// How long it has to be quiet to count, ms.
        debounce_ms: u32,
    },
    /// A key of an input device.
    Key {
        /// Its node; or the name that it tells.
        device: String,
        /// The key, as Linux calls it: `KEY_RECORD`.
        key: String,
    },
    /// A bit in the reports of a USB HID device.
    Hid {
        /// Vendor.
        vendor: u16,
        /// Product.
        product: u16,
        /// Which byte of a report.
        byte: usize,
        /// Which bits of it: any of them set is pressed.
        mask: u8,
    },
}

/// A light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Light {
    /// One colour on a GPIO line.
    Gpio(Line),
    /// Red, green and blue on three lines.
    GpioRgb([Line; 3]),
    /// One of the kernel's, by its name in /sys/class/leds.
    Led(String),
}

/// A beeper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Beeper {
    /// On a GPIO line.
    Gpio(Line),
    /// An input device that makes tones, by its node or its name.
    Tone(String),
}

/// `[page]`: the page for the phone, and the way by which a host fetches sessions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Page {
    /// Where it listens.
    pub listen: SocketAddr,
    /// File with the token that opens it; needed everywhere but on loopback.
    pub token_file: Option<PathBuf>,
    /// Folder in which the certificate is kept.
    pub folder: PathBuf,
}

pub(super) fn operator(root: &mut Section<'_>, folder: &Path) -> Operator {
    let buttons = root.sections("button", "[[button]]");
    let lights = root.sections("light", "[[light]]");
    let beepers = root.sections("beeper", "[[beeper]]");
    Operator {
        buttons: buttons
            .into_iter()
            .filter_map(|s| button(s, folder))
            .collect(),
        lights: lights
            .into_iter()
            .filter_map(|s| light(s, folder))
            .collect(),
        beepers: beepers
            .into_iter()
            .filter_map(|s| beeper(s, folder))
            .collect(),
    }
}

fn button(mut section: Section<'_>, folder: &Path) -> Option<Button> {
    #[derive(Clone, Copy)]
    enum Kind {
        Gpio,
        Key,
        Hid,
    }
    section.must_have("kind", "\"gpio\", \"key\" or \"hid\"");
    let kinds = [("gpio", Kind::Gpio), ("key", Kind::Key), ("hid", Kind::Hid)];
    let button = match choice(&mut section, "kind", &kinds)? {
        Kind::Gpio => {
            let line = line(&mut section, folder, "line");
            let debounce_ms = section.integer("debounce_ms", 0..=1000).unwrap_or(10) as u32;
            line.map(|line| Button::Gpio { line, debounce_ms })
        }
        Kind::Key => {
            let device = a_device(&mut section);
            let a_key = "a key as Linux calls it, like KEY_RECORD";
            let is_key = |key: &str| key.starts_with("KEY_") || key.starts_with("BTN_");
            let key = section.text("key", a_key, is_key);
            let key = key.unwrap_or_else(|| "KEY_RECORD".to_owned());
            device.map(|device| Button::Key { device, key })
        }
        Kind::Hid => {
            section.must_have("usb", A_USB_ID);
            let usb = section.text("usb", A_USB_ID, |text| usb_id(text).is_some());
            let byte = section.integer("byte", 0..=63).unwrap_or(0) as usize;
            let mask = section.integer("mask", 1..=255).unwrap_or(255) as u8;
            let usb = usb.as_deref().and_then(usb_id);
            usb.map(|(vendor, product)| Button::Hid {
                vendor,
                product,
                byte,
                mask,
            })
        }
    };
    section.finish();
    button
}

fn light(mut section: Section<'_>, folder: &Path) -> Option<Light> {
    section.must_have("kind", "\"gpio\" or \"led\"");
    let light = match choice(&mut section, "kind", &[("gpio", true), ("led", false)])? {
        true if section.has("red") || section.has("green") || section.has("blue") => {
            let colours = ["red", "green", "blue"].map(|key| line(&mut section, folder, key));
            let [Some(red), Some(green), Some(blue)] = colours else {
                section.finish();
                return None;
            };
            Some(Light::GpioRgb([red, green, blue]))
        }
        true => line(&mut section, folder, "line").map(Light::Gpio),
        false => {
            let a_name = "a name in /sys/class/leds";
            section.must_have("name", a_name);
            let is_name =
                |name: &str| !name.is_empty() && !name.contains('/') && !name.starts_with('.');
            section.text("name", a_name, is_name).map(Light::Led)
        }
    };
    section.finish();
    light
}

fn beeper(mut section: Section<'_>, folder: &Path) -> Option<Beeper> {
    section.must_have("kind", "\"gpio\" or \"tone\"");
    let beeper = match choice(&mut section, "kind", &[("gpio", true), ("tone", false)])? {
        true => line(&mut section, folder, "line").map(Beeper::Gpio),
        false => a_device(&mut section).map(Beeper::Tone),
    };
    section.finish();
    beeper
}

fn a_device(section: &mut Section<'_>) -> Option<String> {
    let a_device = "a node like /dev/input/event0, or the name that the device tells";
    section.must_have("device", a_device);
    section.text("device", a_device, |text| !text.is_empty())
}

fn line(section: &mut Section<'_>, folder: &Path, key: &'static str) -> Option<Line> {
    section.must_have("chip", "a node like /dev/gpiochip0");
    section.must_have(key, "the line's number on the chip");
    let chip = section.path("chip", folder);
    let offset = section.integer(key, 0..=4095);
    let active_low = section.flag("active_low").unwrap_or(false);
    Some(Line {
        chip: chip?,
        offset: offset? as u32,
        active_low,
    })
}

pub(super) fn page(mut section: Section<'_>, folder: &Path) -> Option<Page> {
    let an_address = "an address and a port, as in \"127.0.0.1:8077\" or \"0.0.0.0:8077\"";
    let is_address = |text: &str| text.parse::<SocketAddr>().is_ok();
    section.must_have("listen", an_address);
    let listen = section.text("listen", an_address, is_address);
    let listen = listen.and_then(|text| text.parse::<SocketAddr>().ok());
    let token_file = section.path("token_file", folder);
    let kept = section.path("folder", folder);
    if let Some(listen) = listen
        && !listen.ip().is_loopback()
        && token_file.is_none()
    {
        section.refuse(
            "listen",
            format_args!("is {listen}, which others can reach, expected token_file beside it"),
        );
    }
    section.finish();
    Some(Page {
        listen: listen?,
        token_file,
        folder: kept.unwrap_or_else(|| "/var/lib/paws/page".into()),
    })
}
