//! /dev/uhid: a HID device in user space. Layout: the kernel's `linux/uhid.h`.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;

use crate::numbering::Numbering;

/// Stereolabs.
const VENDOR: u16 = 0x2b03;
/// Firmware 2.5, the last that is known of a ZED Mini.
const RELEASE: u32 = 0x0205;
const BUS_USB: u16 = 3;
/// Longest event: its type and the largest of its bodies.
const EVENT_BYTES: usize = 4 + 4376;

const DESTROY: u32 = 1;
const OPEN: u32 = 4;
const CLOSE: u32 = 5;
const GET_REPORT: u32 = 9;
const GET_REPORT_REPLY: u32 = 10;
const CREATE2: u32 = 11;
const INPUT2: u32 = 12;
const SET_REPORT: u32 = 13;
const SET_REPORT_REPLY: u32 = 14;
/// What a refused request is answered with.
const EIO: u16 = 5;

/// What the device says of itself.
pub(crate) struct Identity {
    pub(crate) name: String,
    pub(crate) serial: String,
    pub(crate) product: u16,
    pub(crate) numbering: Numbering,
}

/// Something that the kernel wants.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Request {
    /// The first program has opened the device.
    Open,
    /// The last one has closed it.
    Close,
    /// A feature report is sent.
    Set { id: u32, report: Vec<u8> },
    /// The host requests a feature report.
    Get { id: u32, number: u8 },
    /// The kernel has taken the device, let it go, or wants something that is not known here.
    Other(u32),
}

/// A device that is plugged in. Dropping it unplugs it.
pub(crate) struct Uhid {
    file: File,
    numbering: Numbering,
}

impl Uhid {
    pub(crate) fn create(identity: &Identity) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        options
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK);
        let mut file = options.open("/dev/uhid").map_err(|error| {
            io::Error::new(error.kind(), format!("opening: {error}: /dev/uhid"))
        })?;
        file.write_all(&create_event(identity))?;
        Ok(Self {
            file,
            numbering: identity.numbering,
        })
    }

    /// Sends an input report.
    pub(crate) fn input(&mut self, report: &[u8]) -> io::Result<()> {
        let report = self.numbering.numbered(report);
        let length = (report.len() as u16).to_le_bytes();
        self.send(INPUT2, &[&length[..], &report].concat())
    }

    pub(crate) fn answer_set(&mut self, id: u32, taken: bool) -> io::Result<()> {
        let error = if taken { 0 } else { EIO };
        let body = [&id.to_le_bytes()[..], &error.to_le_bytes()].concat();
        self.send(SET_REPORT_REPLY, &body)
    }

    pub(crate) fn answer_get(&mut self, id: u32, report: Option<&[u8]>) -> io::Result<()> {
        let (error, report) = report.map_or((EIO, &[][..]), |report| (0, report));
        let length = (report.len() as u16).to_le_bytes();
        let body = [&id.to_le_bytes()[..], &error.to_le_bytes(), &length, report].concat();
        self.send(GET_REPORT_REPLY, &body)
    }

    /// All that the kernel has to say.
    pub(crate) fn requests(&mut self) -> io::Result<Vec<Request>> {
        let mut requests = Vec::new();
        loop {
            let mut event = [0; EVENT_BYTES];
            match self.file.read(&mut event) {
                Ok(_) => requests.push(request(&event)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(requests),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn send(&mut self, kind: u32, body: &[u8]) -> io::Result<()> {
        self.file
            .write_all(&[&kind.to_le_bytes()[..], body].concat())
    }
}

impl AsFd for Uhid {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl Drop for Uhid {
    fn drop(&mut self) {
        if let Err(error) = self.send(DESTROY, &[]) {
            eprintln!("vm-imu: unplugging the device: {error}");
        }
    }
}

fn create_event(identity: &Identity) -> Vec<u8> {
    let mut event = CREATE2.to_le_bytes().to_vec();
    for (text, length) in [(&*identity.name, 128), ("", 64), (&*identity.serial, 64)] {
        // The last byte is 0, as the kernel requires.
        let text = &text.as_bytes()[..text.len().min(length - 1)];
        event.extend(text);
        event.resize(event.len() + length - text.len(), 0);
    }
    let descriptor = identity.numbering.descriptor();
    event.extend((descriptor.len() as u16).to_le_bytes());
    event.extend(BUS_USB.to_le_bytes());
    for number in [u32::from(VENDOR), u32::from(identity.product), RELEASE, 0] {
        event.extend(number.to_le_bytes());
    }
    event.extend(descriptor);
    event
}

fn request(event: &[u8; EVENT_BYTES]) -> Request {
    let u32_at =
        |at: usize| u32::from_le_bytes([event[at], event[at + 1], event[at + 2], event[at + 3]]);
    match u32_at(0) {
        OPEN => Request::Open,
        CLOSE => Request::Close,
        GET_REPORT => Request::Get {
            id: u32_at(4),
            number: event[8],
        },
        SET_REPORT => {
            let length = usize::from(u16::from_le_bytes([event[10], event[11]]));
            Request::Set {
                id: u32_at(4),
                report: event[12..].iter().copied().take(length).collect(),
            }
        }
        other => Request::Other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_device_is_described_where_the_kernel_looks() {
        let identity = Identity {
            name: "n".repeat(200),
            serial: "15618".into(),
            product: 0xf681,
            numbering: Numbering::None,
        };
        let event = create_event(&identity);
        assert_eq!(event[..4], [11, 0, 0, 0]);
        assert_eq!((event[4 + 126], event[4 + 127]), (b'n', 0));
        assert_eq!(event[4 + 192..4 + 198], *b"15618\0");
        let length = usize::from(u16::from_le_bytes([event[260], event[261]]));
        assert_eq!(event[262..264], [3, 0]);
        assert_eq!(event[264..272], [0x03, 0x2b, 0, 0, 0x81, 0xf6, 0, 0]);
        assert_eq!(event[280..], Numbering::None.descriptor()[..]);
        assert_eq!(event.len(), 280 + length);
    }

    #[test]
    fn requests_are_read() {
        let mut event = [0; EVENT_BYTES];
        event[..14].copy_from_slice(&[13, 0, 0, 0, 7, 0, 0, 0, 0x32, 0, 2, 0, 0x32, 1]);
        let report = vec![0x32, 1];
        assert_eq!(request(&event), Request::Set { id: 7, report });
        event[..9].copy_from_slice(&[9, 0, 0, 0, 8, 0, 0, 0, 0x32]);
        assert_eq!(
            request(&event),
            Request::Get {
                id: 8,
                number: 0x32
            }
        );
    }
}
