//! Why a bag cannot be replayed.

use std::path::PathBuf;

use session_archive::mcap::ParseError;

/// Why a bag cannot be replayed. None of these goes away by trying again.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// A file or folder cannot be read: check the path and its permissions.
    #[error("reading a bag: {}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is not an MCAP file, and the message says how to make one of it.
    #[error("opening a bag: found {found}, expected MCAP; {remedy}: {}", path.display())]
    Storage {
        /// The file or folder.
        path: PathBuf,
        /// What it is.
        found: &'static str,
        /// The command that converts it.
        remedy: &'static str,
    },
    /// A chunk is compressed in a way that is not read here.
    #[error(
        "opening a bag: found chunks compressed with {compression:?}, expected zstd or none; convert it with `mcap \
         compress --compression zstd IN.mcap -o OUT.mcap`: {}", path.display()
    )]
    Compression {
        /// The file.
        path: PathBuf,
        /// What the chunk says.
        compression: String,
    },
    /// The file is damaged before its first chunk.
    #[error("reading a bag: byte {at}: {}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        at: u64,
        /// What does not fit.
        source: ParseError,
    },
    /// Say which topics are meant.
    #[error("choosing topics of a bag: {what}; it has {}: {}", list(topics), path.display())]
    Topics {
        /// The bag.
        path: PathBuf,
        /// What was looked for.
        what: String,
        /// Its image and IMU topics, with their types.
        topics: Vec<String>,
    },
    /// The messages cannot be placed in time: record the bag with stamps from the device's driver.
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
        /// Those without a stamp.
        missing: usize,
        /// Those with a stamp that does not rise.
        falling: usize,
        /// Those whose message is damaged.
        damaged: usize,
    },
    /// The two cameras do not expose together: no stereo can be had of them.
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
        /// Left images that have a time.
        total: usize,
        /// Those with a partner.
        paired: usize,
        /// The most that partners may be apart, ms.
        within_ms: f64,
        /// The most that can be allowed at this rate, ms.
        max_ms: f64,
        /// From a left image to the nearest right one, median, ms.
        apart_ms: f64,
    },
    /// The first image cannot be used, so no other can.
    #[error("opening a bag: the first image of {topic}: {what}: {}", path.display())]
    Image {
        /// The bag.
        path: PathBuf,
        /// Its topic.
        topic: String,
        /// What was found and what was expected.
        what: String,
    },
    /// What was looked at does not suffice to tell; a recording reads all of it.
    #[error("looking at the first 1 MiB of each file of a bag, which is all that a check reads")]
    Head {
        /// What could not be found in it.
        source: Box<BagError>,
    },
    /// A setting does not fit to the bag.
    #[error("opening a bag: {what}: {}", path.display())]
    Setting {
        /// The bag.
        path: PathBuf,
        /// What was found and what was expected.
        what: String,
    },
}

impl BagError {
    /// Whether more of the bag could make it good.
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

/// What more can be allowed, where less is.
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
