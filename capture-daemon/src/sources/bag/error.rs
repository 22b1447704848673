//! Errors of replaying a bag.

use std::path::PathBuf;

use session_archive::mcap::ParseError;

/// Error of replaying a bag. A retry will not help.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// A file or folder cannot be read: check the path and its permissions.
    #[error("reading a bag: {}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// It is not an MCAP file; the message contains a command for conversion.
    #[error("opening a bag: found {found}, expected MCAP; {remedy}: {}", path.display())]
    Storage {
        /// The file or folder.
        path: PathBuf,
        /// The storage found.
        found: &'static str,
        /// The command that converts it.
        remedy: &'static str,
    },
    /// A chunk has an unsupported compression.
    #[error(
        "opening a bag: found chunks compressed with {compression:?}, expected zstd or none; convert it with `mcap \
         compress --compression zstd IN.mcap -o OUT.mcap`: {}", path.display()
    )]
    Compression {
        /// The file.
        path: PathBuf,
        /// The compression found.
        compression: String,
    },
    /// The file is damaged before its first chunk.
    #[error("reading a bag: byte {at}: {}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        at: u64,
        /// The mismatch.
        source: ParseError,
    },
    /// Configure the topics.
    #[error("choosing topics of a bag: {what}; it has {}: {}", list(topics), path.display())]
    Topics {
        /// The bag.
        path: PathBuf,
        /// The topic searched for.
        what: String,
        /// Its image and IMU topics, with their types.
        topics: Vec<String>,
    },
    /// The messages have no usable times: record the bag with timestamps from the device's driver.
    #[error(
        "timing a bag: of {total} messages on {topic}, {missing} have no time in their header, {falling} one that is not \
         after that of the message before, and {damaged} cannot be read; expected two or more, and at least half of them \
         with a time that rises: {}", path.display()
    )]
    Times {
        /// The bag.
        path: PathBuf,
        /// Their topic.
        topic: String,
        /// Messages on it.
        total: usize,
        /// Number of messages without a timestamp.
        missing: usize,
        /// Number of messages whose timestamp does not increase.
        falling: usize,
        /// Number of damaged messages.
        damaged: usize,
    },
    /// The two cameras do not expose simultaneously: their images are no stereo pairs.
    #[error(
        "pairing images of a bag: of {total} left images, {paired} have a right one within {within_ms:.1} ms, expected \
         half of them or more; the nearest one is {apart_ms:.1} ms away in the median, so the two cameras are not \
         synchronised ({topics}); {}name the topics of one stereo camera as left_topic and right_topic, or record \
         cameras that are triggered together: {}",
        allow_more(*within_ms, *max_ms), path.display()
    )]
    Unsynchronised {
        /// The bag.
        path: PathBuf,
        /// Topics of left and right images, with their rates.
        topics: String,
        /// Number of left images with a time.
        total: usize,
        /// Number of left images with a partner.
        paired: usize,
        /// Maximum time difference of partners, ms.
        within_ms: f64,
        /// Largest limit that this rate permits, ms.
        max_ms: f64,
        /// Median time difference from a left image to the nearest right one, ms.
        apart_ms: f64,
    },
    /// The first image is unusable, so all are.
    #[error("opening a bag: the first image of {topic}: {what}: {}", path.display())]
    Image {
        /// The bag.
        path: PathBuf,
        /// Its topic.
        topic: String,
        /// What was found and what was expected.
        what: String,
    },
    /// The head of the bag is not sufficient; a recording reads all of it.
    #[error("looking at the first 1 MiB of each file of a bag, which is all that a check reads")]
    Head {
        /// The error in the head.
        source: Box<BagError>,
    },
    /// A setting does not match the bag.
    #[error("opening a bag: {what}: {}", path.display())]
    Setting {
        /// The bag.
        path: PathBuf,
        /// What was found and what was expected.
        what: String,
    },
}

impl BagError {
    /// Whether the rest of the bag could resolve the error.
    pub(super) fn needs_more_data(&self) -> bool {
        matches!(
            self,
            Self::Topics { .. }
                | Self::Times { .. }
                | Self::Unsynchronised { .. }
                | Self::Image { .. }
                | Self::Setting { .. }
        )
    }
}

/// Advice to increase the limit, if it is below the largest one.
fn allow_more(within_ms: f64, max_ms: f64) -> String {
    match within_ms < max_ms {
        true => format!("allow more with pair_within_ms (up to {max_ms:.1} at this rate), "),
        false => String::new(),
    }
}

fn list(topics: &[String]) -> String {
    match topics {
        [] => "no topic with images or IMU samples".to_owned(),
        topics => topics.join(", "),
    }
}
