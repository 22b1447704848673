//! Controls: exposure, gain, white balance and whatever else a camera lets one set.

use std::fmt;

use rustix::io::Errno;

use super::{Camera, CameraError};
use crate::sys;

/// Maximum number of controls: a driver that lists more would never end.
const MOST: usize = 1024;

/// A control of a camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// The kernel's number of it, `V4L2_CID_…`.
    pub id: u32,
    /// The driver's name of it.
    pub name: String,
    /// What its values are.
    pub kind: ControlKind,
    /// Least value.
    pub minimum: i64,
    /// Greatest value.
    pub maximum: i64,
    /// Distance of two values.
    pub step: u64,
    /// What a driver starts with.
    pub default: i64,
    /// Cannot be written.
    pub read_only: bool,
    /// Cannot be read.
    pub write_only: bool,
    /// Has no effect at present, usually because an automatic one rules.
    pub inactive: bool,
    /// Cannot be written at present, usually because the camera streams.
    pub grabbed: bool,
    /// Its value changes by itself.
    pub volatile: bool,
    /// Choices of a menu.
    pub menu: Vec<MenuItem>,
}

/// What the values of a control are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlKind {
    /// A number.
    Integer,
    /// 0 or 1.
    Boolean,
    /// One of the choices in [`Control::menu`].
    Menu,
    /// One of the choices in [`Control::menu`], which are numbers.
    IntegerMenu,
    /// Bits.
    Bitmask,
    /// A number of 64 bits.
    Integer64,
    /// Does something when it is written, with any value.
    Button,
    /// A text or a structure, by the kernel's number of its kind; cannot be read or written here.
    Other(u32),
}

/// A choice of a menu.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MenuItem {
    /// The control's value that chooses it.
    pub value: i64,
    /// Name, or the number of an integer menu.
    pub name: String,
}

/// A value that a camera did not take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RejectedValue {
    /// The control.
    pub id: u32,
    /// What was written.
    pub asked: i64,
    /// What was read back, where that was possible.
    pub found: Option<i64>,
    /// What the driver said to it, where it said anything.
    pub why: Option<String>,
}

impl fmt::Display for RejectedValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "control {:#x}: wrote {}, ", self.id, self.asked)?;
        match self.found {
            Some(found) => write!(f, "found {found}")?,
            None => write!(f, "could not read it back")?,
        }
        match &self.why {
            Some(why) => write!(f, " ({why})"),
            None => Ok(()),
        }
    }
}

impl ControlKind {
    fn of(kind: u32) -> Self {
        match kind {
            1 => Self::Integer,
            2 => Self::Boolean,
            3 => Self::Menu,
            4 => Self::Button,
            5 => Self::Integer64,
            8 => Self::Bitmask,
            9 => Self::IntegerMenu,
            other => Self::Other(other),
        }
    }
}

/// `V4L2_CTRL_TYPE_CTRL_CLASS`: a heading, no control.
const HEADING: u32 = 6;

impl Control {
    /// None for headings and for those that are disabled for good.
    fn of(raw: &sys::QueryControl) -> Option<Self> {
        let is = |flag| raw.flags & flag != 0;
        if raw.kind == HEADING || is(0x1) {
            return None;
        }
        Some(Self {
            id: raw.id,
            name: sys::text(&raw.name),
            kind: ControlKind::of(raw.kind),
            minimum: raw.minimum,
            maximum: raw.maximum,
            step: raw.step,
            default: raw.default,
            grabbed: is(0x2),
            read_only: is(0x4),
            inactive: is(0x10),
            write_only: is(0x40),
            volatile: is(0x80),
            menu: Vec::new(),
        })
    }

    /// Whether [`Camera::control`] can read it.
    pub fn is_readable(&self) -> bool {
        !self.write_only && !matches!(self.kind, ControlKind::Button | ControlKind::Other(_))
    }
}

impl Camera {
    /// All controls.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone) or [`Io`](CameraError::Io).
    pub fn controls(&self) -> Result<Vec<Control>, CameraError> {
        let mut all: Vec<Control> = Vec::new();
        let mut last = 0;
        for _ in 0..MOST {
            let mut raw = sys::QueryControl {
                id: last | sys::NEXT_CONTROL,
                ..Default::default()
            };
            let result = sys::query_control(self.fd(), &mut raw);
            if !self.listed("listing the controls", result)? || raw.id <= last {
                break;
            }
            last = raw.id;
            if let Some(mut control) = Control::of(&raw) {
                control.menu = self.menu(&control)?;
                all.push(control);
            }
        }
        Ok(all)
    }

    fn menu(&self, control: &Control) -> Result<Vec<MenuItem>, CameraError> {
        let mut items = Vec::new();
        if !matches!(control.kind, ControlKind::Menu | ControlKind::IntegerMenu) {
            return Ok(items);
        }
        for value in (control.minimum.max(0)..=control.maximum).take(MOST) {
            let mut raw = sys::QueryMenu {
                id: control.id,
                index: value as u32,
                ..Default::default()
            };
            // A menu may have holes.
            let result = sys::query_menu(self.fd(), &mut raw);
            if !self.listed("listing the choices of a control", result)? {
                continue;
            }
            let name = if control.kind == ControlKind::Menu {
                sys::text(&raw.name)
            } else {
                let [a, b, c, d, e, f, g, h, ..] = raw.name;
                i64::from_le_bytes([a, b, c, d, e, f, g, h]).to_string()
            };
            items.push(MenuItem { value, name });
        }
        Ok(items)
    }

    /// The value of a control.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone), or [`Io`](CameraError::Io) when there is no such control or it
    /// cannot be read.
    pub fn control(&self, id: u32) -> Result<i64, CameraError> {
        self.read_control(id)
            .map_err(|errno| self.control_failed("reading", id, errno))
    }

    /// Writes a control. Drivers round and clamp: [`write_and_check`](Self::write_and_check)
    /// reports that.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone), or [`Io`](CameraError::Io) when there is no such control, it
    /// cannot be written, or the value is out of its range.
    pub fn set_control(&self, id: u32, value: i64) -> Result<(), CameraError> {
        self.write_control(id, value)
            .map_err(|errno| self.control_failed("writing", id, errno))
    }

    /// Writes controls in the order given, then reads all of them back, and says which ones are not
    /// as they were written. The order matters: what is automatic has to be switched off before its
    /// value can be set. Those that cannot be read back count as taken if the driver accepted them.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone). All else is in the list.
    pub fn write_and_check(
        &self,
        values: &[(u32, i64)],
    ) -> Result<Vec<RejectedValue>, CameraError> {
        let mut said = Vec::with_capacity(values.len());
        for (id, value) in values {
            said.push(self.survived(*id, self.write_control(*id, *value))?.err());
        }
        let mut not_taken = Vec::new();
        for (i, (id, asked)) in values.iter().enumerate() {
            // Written twice: the last value counts.
            if values[i + 1..].iter().any(|(later, _)| later == id) {
                continue;
            }
            let readable = self.is_readable(*id)?;
            let found = if readable {
                self.survived(*id, self.read_control(*id))?.ok()
            } else {
                None
            };
            if said[i].is_none() && (found == Some(*asked) || !readable) {
                continue;
            }
            not_taken.push(RejectedValue {
                id: *id,
                asked: *asked,
                found,
                why: said[i].map(|errno| match errno {
                    Errno::INVAL if self.query(*id).is_err() => "no such control".into(),
                    Errno::INVAL | Errno::RANGE => "out of its range".into(),
                    Errno::ACCESS => "read-only, or ruled by an automatic control".into(),
                    Errno::BUSY => "cannot be changed while the camera streams".into(),
                    _ => std::io::Error::from(errno).to_string(),
                }),
            });
        }
        Ok(not_taken)
    }

    /// What the driver says to one control; only a camera that is disconnected ends everything.
    fn survived<T>(
        &self,
        id: u32,
        result: Result<T, Errno>,
    ) -> Result<Result<T, Errno>, CameraError> {
        match result {
            Err(errno) => match self.control_failed("setting up", id, errno) {
                gone @ CameraError::Gone { .. } => Err(gone),
                _ => Ok(Err(errno)),
            },
            ok => Ok(ok),
        }
    }

    fn is_readable(&self, id: u32) -> Result<bool, CameraError> {
        let result = self.survived(id, self.query(id))?;
        Ok(result
            .ok()
            .and_then(|raw| Control::of(&raw))
            .is_none_or(|control| control.is_readable()))
    }

    fn query(&self, id: u32) -> Result<sys::QueryControl, Errno> {
        let mut raw = sys::QueryControl {
            id,
            ..Default::default()
        };
        sys::query_control(self.fd(), &mut raw).map(|()| raw)
    }

    fn read_control(&self, id: u32) -> Result<i64, Errno> {
        let kind = ControlKind::of(self.query(id)?.kind);
        let bits = sys::get_control(self.fd(), id)?;
        Ok(match kind {
            ControlKind::Integer64 => bits,
            ControlKind::Bitmask => i64::from(bits as u32),
            _ => i64::from(bits as i32),
        })
    }

    fn write_control(&self, id: u32, value: i64) -> Result<(), Errno> {
        // The kernel looks at the lower half only, unless the control has 64 bits.
        let fits = match ControlKind::of(self.query(id)?.kind) {
            ControlKind::Integer64 => true,
            ControlKind::Bitmask => u32::try_from(value).is_ok(),
            _ => i32::try_from(value).is_ok(),
        };
        if !fits {
            return Err(Errno::RANGE);
        }
        sys::set_control(self.fd(), id, value)
    }

    fn control_failed(&self, doing: &str, id: u32, errno: Errno) -> CameraError {
        match CameraError::of("", errno, self.path()) {
            gone @ CameraError::Gone { .. } => gone,
            _ => CameraError::Io {
                doing: format!("{doing} control {id:#x} of the camera"),
                path: self.path().to_owned(),
                source: errno.into(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_driver_tells_of_a_control() {
        let mut raw = sys::QueryControl {
            id: 0x0098_0913,
            kind: 1,
            minimum: -5,
            maximum: 100,
            step: 1,
            flags: 0x10 | 0x80,
            ..Default::default()
        };
        raw.name[..4].copy_from_slice(b"Gain");
        let control = Control::of(&raw).unwrap();
        assert_eq!((control.name.as_str(), control.minimum), ("Gain", -5));
        assert!(control.inactive && control.volatile && control.is_readable());
        assert!(!control.read_only && !control.grabbed && !control.write_only);

        for (kind, flags) in [(HEADING, 0), (1, 0x1)] {
            assert_eq!(Control::of(&sys::QueryControl { kind, flags, ..raw }), None);
        }
        for (kind, flags) in [(4, 0), (7, 0), (0x0100, 0), (1, 0x40)] {
            let control = Control::of(&sys::QueryControl { kind, flags, ..raw }).unwrap();
            assert!(!control.is_readable(), "{control:?}");
        }
    }

    #[test]
    fn what_was_not_taken() {
        let mut not_taken = RejectedValue {
            id: 0x0098_0913,
            asked: 300,
            found: Some(100),
            why: None,
        };
        assert_eq!(
            not_taken.to_string(),
            "control 0x980913: wrote 300, found 100"
        );
        not_taken.found = None;
        not_taken.why = Some("no such control".into());
        assert_eq!(
            not_taken.to_string(),
            "control 0x980913: wrote 300, could not read it back (no such control)"
        );
    }
}
