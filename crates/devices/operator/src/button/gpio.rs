//! A button on a GPIO line, through the kernel's GPIO character device (its second version, Linux
//! 5.10).
//!
//! The kernel debounces: in the chip where it can, in its own timers elsewhere. An edge then
//! carries the time at which the level had lasted long enough, so it is late by the debounce time.
//! A kernel that refuses leaves debouncing to us. Edges beyond the kernel's buffer are lost, oldest
//! first; the level is read after every gap in their numbers. Before Linux 6.6 a line says nothing
//! when its chip is unplugged, so the chip's node is watched.

use std::os::fd::{AsFd, OwnedFd};
use std::path::PathBuf;
use std::time::Duration;

use gpiocdev::Request;
use gpiocdev::line::{EdgeDetection, EdgeKind, EventClock, Value};
use gpiocdev::request::Builder;
use rustix::fs::inotify;

use super::{Button, Edge, Next};
use crate::DeviceError;
use crate::error::is_gone;
use crate::gpio::{MEND, describe, find, from_gpio};
use crate::spec::{Bias, GpioButton};
use crate::wait::{Waker, Woke, wait};

/// Edges that the kernel keeps for us: a bouncing contact gives dozens.
const KERNEL_EDGES: u32 = 256;

/// An open line.
#[derive(Debug)]
pub(crate) struct GpioLine {
    request: Request,
    chip: PathBuf,
    /// Says when something happens to the chip's node.
    node: OwnedFd,
    what: String,
    debounced: bool,
    buffer: Vec<u64>,
    order: Order,
}

/// Notices lost edges by their numbers. Pure.
#[derive(Debug, Default)]
struct Order {
    number: u32,
    pressed: bool,
}

/// The result of an event.
#[derive(Debug, PartialEq, Eq)]
enum Worth {
    Edge(Edge),
    /// It says nothing new.
    Nothing,
    /// Edges before it were lost: ask for the level as of this time.
    Ask {
        at_ns: i64,
    },
}

impl Order {
    fn take(&mut self, number: u32, at_ns: i64, pressed: bool) -> Worth {
        let missed = number != self.number.wrapping_add(1);
        self.number = number;
        if missed {
            return Worth::Ask { at_ns };
        }
        self.level(at_ns, pressed)
    }

    fn level(&mut self, at_ns: i64, pressed: bool) -> Worth {
        if std::mem::replace(&mut self.pressed, pressed) == pressed {
            return Worth::Nothing;
        }
        Worth::Edge(Edge { at_ns, pressed })
    }
}

impl GpioLine {
    /// Takes the line.
    ///
    /// # Errors
    /// See [`DeviceError`]; [`DeviceError::Busy`] names who holds the line.
    pub(crate) fn open(spec: &GpioButton) -> Result<Self, DeviceError> {
        let what = describe(&spec.line);
        let (chip, offset) = find(&spec.line)?;
        // Before the line is taken, so that the chip cannot go unseen.
        let node = watch(&chip)
            .map_err(|e| DeviceError::from_io("watching the chip of", &what, MEND, e))?;
        let build = |debounce: Duration| -> Builder {
            let mut builder = Request::builder();
            builder
                .on_chip(&chip)
                .with_consumer("paws-button")
                .with_kernel_event_buffer_size(KERNEL_EDGES)
                .with_line(offset)
                .as_input()
                .with_edge_detection(EdgeDetection::BothEdges)
                .with_event_clock(EventClock::Monotonic)
                .with_debounce_period(debounce)
                .with_bias(spec.bias.map(|bias| match bias {
                    Bias::PullUp => gpiocdev::line::Bias::PullUp,
                    Bias::PullDown => gpiocdev::line::Bias::PullDown,
                    Bias::Disabled => gpiocdev::line::Bias::Disabled,
                }));
            if spec.active_low {
                builder.as_active_low();
            }
            builder
        };
        let mut debounced = true;
        let request = build(spec.debounce).request().or_else(|error| {
            log::debug!("{what}: the kernel does not debounce it: {error}");
            debounced = false;
            build(Duration::ZERO).request()
        });
        let request = request.map_err(|e| from_gpio("taking", &what, e))?;
        let order = Order {
            number: 0,
            pressed: read_level(&request, &what)?,
        };
        Ok(Self {
            buffer: vec![0; request.edge_event_u64_size()],
            request,
            chip,
            node,
            what,
            debounced,
            order,
        })
    }

    fn gone(&self) -> DeviceError {
        let what = self.what.clone();
        DeviceError::Gone { what }
    }

    /// One event. Called when there is one.
    fn read(&mut self) -> Result<Worth, DeviceError> {
        let failed = |error: std::io::Error| {
            if is_gone(&error) {
                self.gone()
            } else {
                DeviceError::from_io("reading", &self.what, MEND, error)
            }
        };
        // Read here rather than by the crate, which hides the system's error number.
        let mut bytes = vec![0u8; self.buffer.len() * 8];
        let n = rustix::io::read(self.request.as_fd(), &mut bytes).map_err(|e| failed(e.into()))?;
        if n != bytes.len() {
            return Err(self.gone());
        }
        for (word, chunk) in self.buffer.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_ne_bytes(*chunk);
        }
        let event = self
            .request
            .edge_event_from_slice(&self.buffer)
            .map_err(|e| from_gpio("reading", &self.what, e))?;
        let at_ns = i64::try_from(event.timestamp_ns).unwrap_or(i64::MAX);
        let pressed = event.kind == EdgeKind::Rising;
        Ok(match self.order.take(event.line_seqno, at_ns, pressed) {
            Worth::Ask { at_ns } => {
                log::warn!("{}: edges were lost", self.what);
                let pressed = read_level(&self.request, &self.what)?;
                self.order.level(at_ns, pressed)
            }
            worth => worth,
        })
    }
}

/// Tells when the node is removed, which for one that is open counts as a change of its links.
fn watch(chip: &PathBuf) -> std::io::Result<OwnedFd> {
    let watch = inotify::init(inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK)?;
    let flags = inotify::WatchFlags::ATTRIB | inotify::WatchFlags::DELETE_SELF;
    inotify::add_watch(&watch, chip, flags)?;
    Ok(watch)
}

fn read_level(request: &Request, what: &str) -> Result<bool, DeviceError> {
    let value = request
        .lone_value()
        .map_err(|e| from_gpio("reading", what, e))?;
    Ok(value == Value::Active)
}

impl Button for GpioLine {
    fn next(&mut self, timeout: Option<Duration>, waker: &Waker) -> Result<Next, DeviceError> {
        let devices = [self.request.as_fd(), self.node.as_fd()];
        let woke = wait(&devices, waker, timeout)
            .map_err(|e| DeviceError::from_io("waiting for", &self.what, MEND, e))?;
        Ok(match woke {
            Woke::Called => Next::Called,
            Woke::Time => Next::Time,
            Woke::Ready(1) => {
                while rustix::io::read(&self.node, &mut [0u8; 1024]).is_ok_and(|n| n > 0) {}
                if !self.chip.exists() {
                    return Err(self.gone());
                }
                Next::Time
            }
            Woke::Ready(_) => match self.read()? {
                Worth::Edge(edge) => Next::Edge(edge),
                Worth::Nothing | Worth::Ask { .. } => Next::Time,
            },
        })
    }

    fn is_debounced(&self) -> bool {
        self.debounced
    }

    fn describe(&self) -> &str {
        &self.what
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_in_order_are_edges_and_a_gap_asks_for_the_level() {
        let mut order = Order::default();
        let edge = |at_ns, pressed| Worth::Edge(Edge { at_ns, pressed });
        assert_eq!(order.take(1, 10, true), edge(10, true));
        assert_eq!(order.take(2, 20, false), edge(20, false));
        assert_eq!(order.take(5, 50, true), Worth::Ask { at_ns: 50 });
        assert_eq!(order.level(50, false), Worth::Nothing);
        assert_eq!(order.take(6, 60, false), Worth::Nothing);
        assert_eq!(order.take(7, 70, true), edge(70, true));
    }

    #[test]
    fn a_button_held_at_the_start_gives_only_its_release() {
        let mut order = Order {
            number: 0,
            pressed: true,
        };
        let release = Edge {
            at_ns: 5,
            pressed: false,
        };
        assert_eq!(order.take(1, 5, false), Worth::Edge(release));
    }
}
