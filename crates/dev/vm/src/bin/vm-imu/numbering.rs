//! How the device's reports are numbered: what a real ZED Mini does has not been seen.
//!
//! Its feature reports have numbers (0x32, 0x21), and the first byte of its input report is 0,
//! which is no report's number. The HID specification wants all reports numbered or none; Linux
//! keeps count for each type by itself (`hid_register_report`), so that input reports which the
//! descriptor declares before its first number have none. That fits the published facts best and is
//! the default here. A device could also do either of the two others, and a driver has to support
//! all three.

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Numbering {
    /// Input reports have no number; 64 bytes are read.
    None,
    /// Their first byte is their number, 1; 64 bytes are read. So a ZED 2 seems to do it.
    First,
    /// Their number, 1, comes in front of them; 65 bytes are read.
    Front,
}

/// The number of input reports that have one.
const INPUT: u8 = 0x01;

impl Numbering {
    /// The report descriptor.
    pub(crate) fn descriptor(self) -> Vec<u8> {
        let (number, payload) = match self {
            Self::None => (None, 64),
            Self::First => (Some(INPUT), 63),
            Self::Front => (Some(INPUT), 64),
        };
        const IN: u8 = 0x81;
        const FEATURE: u8 = 0xb1;
        let mut descriptor = vec![
            0x06, 0x00, 0xff, // usage page, vendor
            0x09, 0x01, // usage 1
            0xa1, 0x01, // collection, application
            0x15, 0x00, // from 0
            0x26, 0xff, 0x00, // to 255
            0x75, 0x08, // of 8 bits
        ];
        let mut report = |number: Option<u8>, count: u8, kind: u8| {
            if let Some(number) = number {
                descriptor.extend([0x85, number]);
            }
            descriptor.extend([0x95, count, 0x09, 0x01, kind, 0x02]);
        };
        report(number, payload, IN);
        report(Some(0x32), 1, FEATURE);
        report(Some(0x21), 1, FEATURE);
        report(Some(0x22), 3, FEATURE);
        descriptor.push(0xc0);
        descriptor
    }

    /// A report of 64 bytes as it goes over the link.
    pub(crate) fn numbered(self, report: &[u8]) -> Vec<u8> {
        match self {
            Self::None => report.to_vec(),
            Self::First => [&[INPUT], &report[1..]].concat(),
            Self::Front => [&[INPUT], report].concat(),
        }
    }
}
