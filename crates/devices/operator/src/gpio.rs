//! What buttons, lights and beepers on GPIO lines share: finding a line, and saying what is wrong.

use std::io;
use std::path::PathBuf;

use gpiocdev::Error;
use gpiocdev::chip::Chip;

use crate::DeviceError;
use crate::spec::Line;

/// Who may use GPIO lines.
pub(crate) const MEND: &str =
    "the daemon's user needs the group that owns /dev/gpiochip*, see the udev rules in deploy/";

/// Chip and offset of a line that is there and that nobody uses.
pub(crate) fn find(line: &Line) -> Result<(PathBuf, u32), DeviceError> {
    let what = describe(line);
    let (path, offset) = match line {
        Line::At { chip, offset } => (chip.clone(), *offset),
        Line::Named(name) => named(name, &what)?,
    };
    let failed = |error| from_gpio("looking at", &what, error);
    let chip = Chip::from_path(&path).map_err(failed)?;
    let lines = chip.info().map_err(failed)?.num_lines;
    if offset >= lines {
        return Err(DeviceError::Unfit {
            what,
            found: format!("a chip of {lines} lines"),
            expected: "an offset below that; `gpioinfo` lists them".into(),
        });
    }
    let info = chip.line_info(offset).map_err(failed)?;
    if info.used {
        let what = format!("{what} (held by {:?})", info.consumer);
        return Err(DeviceError::Busy { what });
    }
    Ok((path, offset))
}

fn named(name: &str, what: &str) -> Result<(PathBuf, u32), DeviceError> {
    let chips = gpiocdev::chip::chips().map_err(|e| from_gpio("listing chips for", what, e))?;
    let mut refused = None;
    for path in chips {
        match Chip::from_path(&path) {
            Ok(chip) => {
                if let Some(found) = chip.find_line_info(name) {
                    return Ok((path, found.offset));
                }
            }
            Err(error) => refused = Some(from_gpio("looking at a chip for", what, error)),
        }
    }
    Err(match refused {
        Some(error @ DeviceError::NotAllowed { .. }) => error,
        _ => DeviceError::NotFound {
            what: what.to_owned(),
            expected: "a line of that name; `gpioinfo` lists them".into(),
        },
    })
}

/// A line in words.
pub(crate) fn describe(line: &Line) -> String {
    format!("GPIO line {line}")
}

/// Sorts an error of the crate by what is to be done about it.
pub(crate) fn from_gpio(doing: &'static str, what: &str, error: Error) -> DeviceError {
    match error {
        Error::Os(errno) => {
            DeviceError::from_io(doing, what, MEND, io::Error::from_raw_os_error(errno.0))
        }
        Error::GpioChip(path, kind) => DeviceError::Unfit {
            what: what.to_owned(),
            found: format!("{} {kind}", path.display()),
            expected: "a GPIO chip like /dev/gpiochip0".into(),
        },
        Error::NoGpioChips() => DeviceError::NotFound {
            what: what.to_owned(),
            expected: "a GPIO chip; this machine has none".into(),
        },
        other => DeviceError::Io {
            doing,
            what: what.to_owned(),
            source: io::Error::other(other),
        },
    }
}
