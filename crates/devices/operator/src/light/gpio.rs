//! A light on one GPIO line, or on three as red, green and blue.

use std::io;

use gpiocdev::Request;
use gpiocdev::line::Value;

use super::Light;
use crate::DeviceError;
use crate::gpio::{describe, find, from_gpio};
use crate::pattern::LightState;
use crate::spec::{Channels, Line};

/// Lines that are held as outputs.
#[derive(Debug)]
pub(crate) struct GpioLight {
    lines: Channels<OutputLine>,
    what: String,
}

/// One line that is held as an output. Off when it is dropped. After an error it is taken again,
/// for its chip may have been unplugged.
#[derive(Debug)]
pub(crate) struct OutputLine {
    line: Line,
    active_low: bool,
    request: Option<Request>,
}

impl OutputLine {
    pub(crate) fn open(line: &Line, active_low: bool) -> Result<Self, DeviceError> {
        Ok(Self {
            line: line.clone(),
            active_low,
            request: Some(take(line, active_low)?),
        })
    }

    pub(crate) fn set(&mut self, on: bool) -> io::Result<()> {
        let value = if on { Value::Active } else { Value::Inactive };
        let request = match self.request.take() {
            Some(request) => request,
            None => take(&self.line, self.active_low).map_err(io::Error::other)?,
        };
        request.set_lone_value(value).map_err(io::Error::other)?;
        self.request = Some(request);
        Ok(())
    }
}

/// Takes a line as an output that is off.
fn take(line: &Line, active_low: bool) -> Result<Request, DeviceError> {
    let (chip, offset) = find(line)?;
    let mut builder = Request::builder();
    builder
        .on_chip(chip)
        .with_consumer("paws-signal")
        .with_line(offset)
        .as_output(Value::Inactive);
    if active_low {
        builder.as_active_low();
    }
    builder
        .request()
        .map_err(|e| from_gpio("taking", &describe(line), e))
}

impl Drop for OutputLine {
    fn drop(&mut self) {
        // Most drivers leave a released line at its last level.
        if self.request.is_some() {
            let _ = self.set(false);
        }
    }
}

impl GpioLight {
    /// Takes the lines.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub(crate) fn open(lines: &Channels<Line>, active_low: bool) -> Result<Self, DeviceError> {
        let what = format!("light on GPIO {lines}");
        let open = |line| OutputLine::open(line, active_low);
        let lines = match lines {
            Channels::One(line) => Channels::One(open(line)?),
            Channels::Three([r, g, b]) => Channels::Three([open(r)?, open(g)?, open(b)?]),
        };
        Ok(Self { lines, what })
    }
}

impl Light for GpioLight {
    fn show(&mut self, state: LightState) -> io::Result<()> {
        match &mut self.lines {
            Channels::One(line) => line.set(state.lit),
            Channels::Three(lines) => lines
                .iter_mut()
                .zip(state.colour.lines())
                .try_for_each(|(line, on)| line.set(on)),
        }
    }

    fn describe(&self) -> &str {
        &self.what
    }
}
