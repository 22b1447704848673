//! A key of an input device: a remote, a keyboard's key, a GPIO button that the kernel already owns
//! (`gpio-keys`).
//!
//! The device is set to stamp its events on CLOCK_MONOTONIC, in microseconds. Events of other keys
//! and the key's own repeating are passed over. When the kernel's buffer ran over it says so
//! (`SYN_DROPPED`, Linux' `Documentation/input/event-codes.rst`): what follows up to the next
//! report is thrown away, and the key's state is read.

use std::collections::VecDeque;
use std::io;
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::time::{Duration, UNIX_EPOCH};

use evdev::raw_stream::RawDevice;
use evdev::{EventType, InputEvent, KeyCode, SynchronizationCode};

use super::{Button, Edge, Next};
use crate::DeviceError;
use crate::error::is_gone;
use crate::spec::{InputDevice, KeyButton};
use crate::wait::{Waker, Woke, wait};

/// Who may use input devices.
pub(crate) const MEND: &str =
    "the daemon's user needs the group that owns /dev/input/event*, see the udev rules in deploy/";

/// An open key.
#[derive(Debug)]
pub(crate) struct Key {
    device: RawDevice,
    what: String,
    reader: Reader,
    ready: VecDeque<Edge>,
}

/// Edges out of a device's events. Pure.
#[derive(Debug)]
struct Reader {
    key: KeyCode,
    pressed: bool,
    /// The kernel's buffer ran over, and the report that says so is not over.
    dropped: bool,
}

/// The result of an event.
#[derive(Debug, PartialEq, Eq)]
enum Worth {
    Nothing,
    Edge(Edge),
    /// Events were lost: ask for the key's state as of this time.
    Ask {
        at_ns: i64,
    },
}

impl Reader {
    fn take(&mut self, kind: EventType, code: u16, value: i32, at_ns: i64) -> Worth {
        let sync =
            |wanted: SynchronizationCode| kind == EventType::SYNCHRONIZATION && code == wanted.0;
        if sync(SynchronizationCode::SYN_DROPPED) {
            self.dropped = true;
        } else if self.dropped {
            if sync(SynchronizationCode::SYN_REPORT) {
                self.dropped = false;
                return Worth::Ask { at_ns };
            }
        } else if kind == EventType::KEY && code == self.key.0 && (value == 0 || value == 1) {
            // 2 is the key's own repeating.
            return self.level(at_ns, value == 1);
        }
        Worth::Nothing
    }

    fn level(&mut self, at_ns: i64, pressed: bool) -> Worth {
        if std::mem::replace(&mut self.pressed, pressed) == pressed {
            return Worth::Nothing;
        }
        Worth::Edge(Edge { at_ns, pressed })
    }
}

impl Key {
    /// Opens the device.
    ///
    /// # Errors
    /// See [`DeviceError`]; [`DeviceError::Unfit`] when the device lacks the key.
    pub(crate) fn open(spec: &KeyButton) -> Result<Self, DeviceError> {
        let has_key = |device: &RawDevice| {
            device
                .supported_keys()
                .is_some_and(|keys| keys.contains(spec.key))
        };
        let expected = format!("the key {:?}", spec.key);
        let (path, device) = find(&spec.device, &expected, has_key)?;
        let what = format!(
            "{} ({})",
            path.display(),
            device.name().unwrap_or("no name")
        );
        let failed = |e| DeviceError::from_io("setting up", &what, MEND, e);
        stamp_monotonic(&device).map_err(failed)?;
        let pressed = device.get_key_state().map_err(failed)?.contains(spec.key);
        Ok(Self {
            reader: Reader {
                key: spec.key,
                pressed,
                dropped: false,
            },
            device,
            what,
            ready: VecDeque::new(),
        })
    }

    /// Everything that is there to be read. Called when there is something.
    fn read(&mut self) -> io::Result<()> {
        let events: Vec<InputEvent> = self.device.fetch_events()?.collect();
        for event in events {
            let since = event.timestamp().duration_since(UNIX_EPOCH);
            let at_ns = since.map_or(0, |t| i64::try_from(t.as_nanos()).unwrap_or(i64::MAX));
            let mut worth =
                self.reader
                    .take(event.event_type(), event.code(), event.value(), at_ns);
            if let Worth::Ask { at_ns } = worth {
                log::warn!("{}: edges were lost", self.what);
                let pressed = self.device.get_key_state()?.contains(self.reader.key);
                worth = self.reader.level(at_ns, pressed);
            }
            if let Worth::Edge(edge) = worth {
                self.ready.push_back(edge);
            }
        }
        Ok(())
    }
}

impl Button for Key {
    fn next(&mut self, timeout: Option<Duration>, waker: &Waker) -> Result<Next, DeviceError> {
        if let Some(edge) = self.ready.pop_front() {
            return Ok(Next::Edge(edge));
        }
        let failed = |doing, what: &str, e: io::Error| {
            if is_gone(&e) {
                let what = what.to_owned();
                return DeviceError::Gone { what };
            }
            DeviceError::from_io(doing, what, MEND, e)
        };
        match wait(&[self.device.as_fd()], waker, timeout)
            .map_err(|e| failed("waiting for", &self.what, e))?
        {
            Woke::Called => return Ok(Next::Called),
            Woke::Time => return Ok(Next::Time),
            Woke::Ready(_) => {}
        }
        self.read().map_err(|e| failed("reading", &self.what, e))?;
        Ok(self.ready.pop_front().map_or(Next::Time, Next::Edge))
    }

    fn is_debounced(&self) -> bool {
        false
    }

    fn describe(&self) -> &str {
        &self.what
    }
}

/// Finds and opens an input device that `fits`.
pub(crate) fn find(
    device: &InputDevice,
    expected: &str,
    fits: impl Fn(&RawDevice) -> bool,
) -> Result<(PathBuf, RawDevice), DeviceError> {
    let unfit = |path: &PathBuf, device: &RawDevice| DeviceError::Unfit {
        what: path.display().to_string(),
        found: format!("{:?} without it", device.name().unwrap_or("a device")),
        expected: expected.to_owned(),
    };
    if let InputDevice::Path(path) = device {
        let opened = RawDevice::open(path)
            .map_err(|e| DeviceError::from_io("opening", &path.display().to_string(), MEND, e))?;
        if !fits(&opened) {
            return Err(unfit(path, &opened));
        }
        return Ok((path.clone(), opened));
    }
    let mut refused = None;
    for path in event_nodes() {
        let opened = match RawDevice::open(&path) {
            Ok(opened) => opened,
            Err(e) => {
                let what = path.display().to_string();
                refused = Some(DeviceError::from_io("opening", &what, MEND, e));
                continue;
            }
        };
        match device {
            InputDevice::Named(name) if opened.name() != Some(name) => {}
            _ if fits(&opened) => return Ok((path, opened)),
            InputDevice::Named(_) => refused = Some(unfit(&path, &opened)),
            _ => {}
        }
    }
    Err(match refused {
        Some(error @ (DeviceError::NotAllowed { .. } | DeviceError::Unfit { .. })) => error,
        _ => DeviceError::NotFound {
            what: match device {
                InputDevice::Named(name) => format!("input device {name:?}"),
                _ => "an input device".into(),
            },
            expected: format!("one with {expected} in /dev/input, as `evtest` lists them"),
        },
    })
}

/// The nodes of input devices, by their numbers.
pub(crate) fn event_nodes() -> Vec<PathBuf> {
    let mut nodes: Vec<(u32, PathBuf)> = std::fs::read_dir("/dev/input")
        .into_iter()
        .flatten()
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let number = path.file_name()?.to_str()?.strip_prefix("event")?;
            Some((number.parse().ok()?, path))
        })
        .collect();
    nodes.sort();
    nodes.into_iter().map(|(_, path)| path).collect()
}

/// Events are stamped on the clock of everything that we record.
fn stamp_monotonic(device: &RawDevice) -> io::Result<()> {
    use rustix::ioctl::{Setter, ioctl, opcode};
    /// `EVIOCSCLOCKID` of linux/input.h: `_IOW('E', 0xa0, int)`.
    const SET_CLOCK: rustix::ioctl::Opcode = opcode::write::<i32>(b'E', 0xa0);
    /// `CLOCK_MONOTONIC` of linux/time.h.
    const MONOTONIC: i32 = 1;
    // SAFETY: the call reads one int through the pointer it is given, as the opcode says, and keeps
    // nothing.
    unsafe {
        let set = Setter::<SET_CLOCK, i32>::new(MONOTONIC);
        ioctl(device.as_fd(), set)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: EventType = EventType::KEY;
    const SYN: EventType = EventType::SYNCHRONIZATION;
    const RECORD: u16 = KeyCode::KEY_RECORD.0;

    fn reader() -> Reader {
        Reader {
            key: KeyCode::KEY_RECORD,
            pressed: false,
            dropped: false,
        }
    }

    fn edge(at_ns: i64, pressed: bool) -> Worth {
        Worth::Edge(Edge { at_ns, pressed })
    }

    #[test]
    fn other_keys_other_events_and_repeating_are_passed_over() {
        let mut reader = reader();
        assert_eq!(reader.take(KEY, 30, 1, 1), Worth::Nothing);
        assert_eq!(
            reader.take(EventType::RELATIVE, RECORD, 1, 2),
            Worth::Nothing
        );
        assert_eq!(reader.take(KEY, RECORD, 1, 3), edge(3, true));
        assert_eq!(reader.take(SYN, 0, 0, 3), Worth::Nothing);
        assert_eq!(reader.take(KEY, RECORD, 2, 4), Worth::Nothing);
        assert_eq!(reader.take(KEY, RECORD, 1, 5), Worth::Nothing);
        assert_eq!(reader.take(KEY, RECORD, 0, 6), edge(6, false));
    }

    #[test]
    fn after_lost_events_the_state_is_asked_once_and_only_a_change_counts() {
        let mut reader = reader();
        assert_eq!(reader.take(KEY, RECORD, 1, 1), edge(1, true));
        assert_eq!(reader.take(SYN, 3, 0, 2), Worth::Nothing);
        assert_eq!(reader.take(KEY, RECORD, 0, 2), Worth::Nothing);
        assert_eq!(reader.take(SYN, 0, 0, 3), Worth::Ask { at_ns: 3 });
        assert_eq!(reader.level(3, true), Worth::Nothing);
        assert_eq!(reader.take(KEY, RECORD, 0, 4), edge(4, false));
        assert_eq!(reader.take(SYN, 3, 0, 5), Worth::Nothing);
        assert_eq!(reader.take(SYN, 0, 0, 6), Worth::Ask { at_ns: 6 });
        assert_eq!(reader.level(6, true), edge(6, true));
    }
}
