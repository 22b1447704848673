//! What a source element's times and numbers mean, as data: one row each.
//!
//! GStreamer does not define what a PTS is: every element decides by itself. The rows say what was
//! read in the elements' sources; docs/guides/gstreamer-sources.md has the long form. **Only
//! v4l2src and videotestsrc have been run by this project**, against kernel drivers that emulate
//! cameras; the others' figures are assumptions until someone measures them on the device, and a
//! configuration overrides them.

/// Which instant a source's PTS is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stamp {
    /// The driver's timestamp: the start of exposure with uvcvideo, else undefined.
    Driver,
    /// The clock was read when the element received the frame: after exposure, readout, image
    /// processing, and whatever kept the process from running.
    Delivery,
    /// Synthetic: without an exposure.
    Synthetic,
    /// Not known.
    Unknown,
}

/// Where a frame's number comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Numbers {
    /// The buffer's offset is the device's own count, so that a frame that was lost before the
    /// element is a hole in it.
    Offset,
    /// Inferred from times and the nominal rate: the offset is missing, or counts only what was
    /// delivered.
    Times,
}

/// Meaning and accuracy of the times and numbers of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// Which instant a PTS is.
    pub stamp: Stamp,
    /// How much later than that instant the PTS is on average, ns. 0 also where it is not known.
    pub latency_ns: i64,
    /// Standard deviation of what remains, ns.
    pub sigma_ns: u64,
    /// Where numbers come from.
    pub numbers: Numbers,
}

/// One row of the table.
#[derive(Debug)]
pub struct Row {
    /// The element's factory.
    pub element: &'static str,
    /// Meaning and accuracy of its times and numbers.
    pub policy: Policy,
    /// Source of this row.
    pub source: &'static str,
}

const MS: u64 = 1_000_000;

/// Policy of an element that is not in the table.
pub const UNKNOWN: Policy = Policy {
    stamp: Stamp::Unknown,
    latency_ns: 0,
    sigma_ns: 50 * MS,
    numbers: Numbers::Times,
};

const fn delivery(sigma_ns: u64) -> Policy {
    Policy {
        stamp: Stamp::Delivery,
        latency_ns: 0,
        sigma_ns,
        numbers: Numbers::Times,
    }
}

/// All rows.
pub static ROWS: &[Row] = &[
    Row {
        element: "v4l2src",
        // GStreamer itself takes away microseconds (measured); the rest is the possible deviation
        // of a driver's stamp from the exposure.
        policy: Policy {
            stamp: Stamp::Driver,
            latency_ns: 0,
            sigma_ns: MS,
            numbers: Numbers::Offset,
        },
        source: "gst-plugins-good, gstv4l2src.c: clock time less the age of the driver's stamp, \
                 offset = the driver's sequence, off by one from the second frame on (1.22); measured \
                 with vivid",
    },
    Row {
        element: "nvarguscamerasrc",
        policy: delivery(30 * MS),
        source: "NVIDIA's gstnvarguscamerasrc.cpp (Jetson r36): a live source that lets its base \
                 class stamp buffers as they leave, and sets no offset; sigma assumed, one period \
                 at 30 Hz",
    },
    Row {
        element: "zedsrc",
        policy: delivery(20 * MS),
        source: "zed-gstreamer, gstzedsrc.cpp: the pipeline's clock read after grab(), offset = \
                 its own count of delivered frames; sigma from the spread of 20 ms between cameras \
                 that users report (community.stereolabs.com/t/8142)",
    },
    Row {
        element: "zedxonesrc",
        policy: delivery(20 * MS),
        source: "zed-gstreamer, gstzedxonesrc.cpp: as zedsrc",
    },
    Row {
        element: "videotestsrc",
        policy: Policy {
            stamp: Stamp::Synthetic,
            latency_ns: 0,
            sigma_ns: 1_000,
            numbers: Numbers::Offset,
        },
        source: "gst-plugins-base, gstvideotestsrc.c: PTS = number of the frame / rate, offset = \
                 that number",
    },
];

impl Policy {
    /// The policy of a source element, by the name of its factory; [`UNKNOWN`] if it is not in the
    /// table.
    pub fn of(element: &str) -> Policy {
        ROWS.iter()
            .find(|row| row.element == element)
            .map_or(UNKNOWN, |row| row.policy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_has_one_row_with_a_source() {
        for (at, row) in ROWS.iter().enumerate() {
            assert!(ROWS[..at].iter().all(|other| other.element != row.element));
            assert!(row.source.len() > 20 && row.policy.sigma_ns > 0, "{row:?}");
            assert_eq!(Policy::of(row.element), row.policy);
        }
        assert_eq!(Policy::of("rtspsrc"), UNKNOWN);
    }
}
