//! Where sound goes: a beeper on a GPIO line, or an input device that plays tones.
//!
//! Contract of a [`Beeper`]: it sounds as last commanded until the next command, and is silent when
//! it is dropped. Sounding takes no longer than the system call. An error leaves it usable. A
//! beeper on a line has no pitch.

use std::io;

use evdev::raw_stream::RawDevice;
use evdev::{EventType, InputEvent, SoundCode};

use crate::DeviceError;
use crate::button::evdev::find;
use crate::light::gpio::OutputLine;
use crate::spec::{BeeperSpec, InputDevice, Line};

/// A beeper.
pub trait Beeper: Send {
    /// Sounds from now on at this frequency, Hz; none is silence.
    ///
    /// # Errors
    /// The error of the operating system.
    fn sound(&mut self, hz: Option<u16>) -> io::Result<()>;

    /// Which beeper it is, in words.
    fn describe(&self) -> &str;
}

/// Opens a beeper of this machine; it is silent.
///
/// # Errors
/// See [`DeviceError`].
pub fn open(spec: &BeeperSpec) -> Result<Box<dyn Beeper>, DeviceError> {
    Ok(match spec {
        BeeperSpec::Gpio { line, active_low } => Box::new(LineBeeper::open(line, *active_low)?),
        BeeperSpec::Tone(device) => Box::new(ToneBeeper::open(device)?),
    })
}

/// A beeper that is on or off.
#[derive(Debug)]
pub(crate) struct LineBeeper {
    line: OutputLine,
    what: String,
}

impl LineBeeper {
    /// Takes the line.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub(crate) fn open(line: &Line, active_low: bool) -> Result<Self, DeviceError> {
        Ok(Self {
            line: OutputLine::open(line, active_low)?,
            what: format!("beeper on GPIO {line}"),
        })
    }
}

impl Beeper for LineBeeper {
    fn sound(&mut self, hz: Option<u16>) -> io::Result<()> {
        self.line.set(hz.is_some())
    }

    fn describe(&self) -> &str {
        &self.what
    }
}

/// An input device with `SND_TONE`, like the PC speaker or a PWM beeper. After an error it is
/// opened again.
#[derive(Debug)]
pub(crate) struct ToneBeeper {
    spec: InputDevice,
    device: Option<RawDevice>,
    what: String,
}

impl ToneBeeper {
    /// Opens the device.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub(crate) fn open(spec: &InputDevice) -> Result<Self, DeviceError> {
        Ok(Self {
            spec: spec.clone(),
            device: Some(open_tone(spec)?),
            what: format!("beeper {spec}"),
        })
    }
}

fn open_tone(spec: &InputDevice) -> Result<RawDevice, DeviceError> {
    let plays = |device: &RawDevice| {
        let sounds = device.supported_sounds();
        sounds.is_some_and(|s| s.contains(SoundCode::SND_TONE))
    };
    Ok(find(spec, "tones (SND_TONE)", plays)?.1)
}

impl Beeper for ToneBeeper {
    fn sound(&mut self, hz: Option<u16>) -> io::Result<()> {
        let mut device = match self.device.take() {
            Some(device) => device,
            None => open_tone(&self.spec).map_err(io::Error::other)?,
        };
        let hz = i32::from(hz.unwrap_or(0));
        let tone = InputEvent::new(EventType::SOUND.0, SoundCode::SND_TONE.0, hz);
        device.send_events(&[tone])?;
        self.device = Some(device);
        Ok(())
    }

    fn describe(&self) -> &str {
        &self.what
    }
}

impl Drop for ToneBeeper {
    fn drop(&mut self) {
        if self.device.is_some() {
            let _ = self.sound(None);
        }
    }
}
