//! `session.json`: what a session is, which streams it has and which segments.
//!
//! The manifest is replaced atomically when the session starts, with every new segment and when
//! it stops, so after a crash it is at most one segment behind; the segments carry enough to
//! rebuild it. It ends with a CRC-32 of itself: JSON with a changed digit still parses.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::layout;
use crate::record::{
    CameraCalibration, ClockMap, CompressedVideo, Event, Frame, FrameSet, FrameTransforms, Gap,
    Health, ImuBatch, Record, Segment,
};
use crate::storage::{self, Storage};
use crate::text;
use crate::time::{CivilTime, HostTime, TickLength};

/// Value of [`Manifest::format`].
pub const FORMAT: &str = "paws-session";
/// The version that this crate writes, and the newest that it reads.
pub const FORMAT_VERSION: u32 = 1;

/// Whether a session is complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Being recorded, or cut off while it was.
    Recording,
    /// Stopped and closed by the recorder.
    Closed,
    /// Rebuilt by recovery from a session that was cut off or damaged.
    Recovered,
}

/// State of one segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SegmentState {
    /// Being written, or cut off while it was.
    Open,
    /// Complete, with summary and footer.
    Closed,
    /// Given up after a failed write or sync; only the first `bytes` count.
    GivenUp,
}

/// One segment file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SegmentEntry {
    /// Position in the session, from 0; names the file.
    pub number: u32,
    /// How it ended.
    pub state: SegmentState,
    /// Bytes that count; of an open segment those at the last update of the manifest.
    pub bytes: u64,
    /// Earliest log time in it, where known.
    pub start: Option<HostTime>,
    /// Latest log time in it, where known.
    pub end: Option<HostTime>,
    /// Messages in it.
    pub messages: u64,
}

/// A stereo camera. Its stream of frames has the camera's name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// `left_shoulder`, `right_shoulder` or `feet` on the example rig.
    pub name: String,
    /// Width of the stereo frame as stored, left and right side by side, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `h264` or `h265`.
    pub codec: String,
    /// `grey` (chroma is neutral and means nothing) or `yuv420` (full-range BT.601).
    pub colour: String,
    /// Nominal frame rate.
    pub rate_hz: f64,
    /// Length of a tick of the frames' device clock.
    pub tick: TickLength,
    /// Cameras with the same trigger are exposed by the same signal; none: the camera runs free.
    pub trigger: Option<String>,
    /// What delivered the frames, for people.
    pub source: String,
    /// What encoded them, for people, as in `x264enc qp 20`.
    pub encoder: String,
}

/// An IMU. Its stream has the IMU's name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Name of its frame, as in `left_shoulder/imu`.
    pub name: String,
    /// Nominal sample rate.
    pub rate_hz: f64,
    /// Length of a tick of its device clock.
    pub tick: TickLength,
    /// What delivered the samples, for people.
    pub source: String,
    /// Noise of its samples, if the calibration in force at the start of the recording states it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<ImuNoise>,
}

/// Continuous-time noise of an IMU, the same on all axes (IEEE 952, Kalibr).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuNoise {
    /// Gyroscope white noise, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Gyroscope bias random walk, rad/s²/√Hz.
    pub gyro_random_walk: f64,
    /// Accelerometer white noise, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Accelerometer bias random walk, m/s³/√Hz.
    pub accel_random_walk: f64,
}

/// A file in `rig/`: a byte copy of what was in force when recording began.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RigFile {
    /// File name in `rig/`.
    pub name: String,
    /// Length, bytes.
    pub bytes: u64,
    /// BLAKE3 of the content, hex.
    pub blake3: String,
}

/// One channel of the segments. Ids are the same in every segment of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stream {
    /// MCAP channel id.
    pub id: u16,
    /// MCAP topic.
    pub topic: String,
    /// Full protobuf name of the messages.
    pub schema: String,
    /// The camera or IMU that it belongs to; empty for what belongs to the whole session.
    pub of: String,
}

/// The part of a numbered stream that was on disk when the manifest was written. Damage at the end
/// of a stream leaves no hole in the numbers; the extent shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Extent {
    /// Lowest number, of a sample or in a gap record.
    pub first: u64,
    /// Highest number, of a sample or in a gap record.
    pub last: u64,
    /// Earliest time of a sample or gap record.
    pub start: HostTime,
    /// Latest time of a sample or gap record.
    pub end: HostTime,
}

impl Extent {
    /// Widens the extent so that it covers `other` too.
    ///
    /// ```
    /// use session_archive::manifest::Extent;
    /// use session_archive::time::HostTime;
    ///
    /// let chunk = |first, last, start, end| Extent { first, last, start: HostTime(start), end: HostTime(end) };
    /// let mut whole = chunk(0, 14, 0, 466_666_662);
    /// whole.cover(chunk(15, 29, 499_999_995, 966_666_657));
    /// assert_eq!(whole, chunk(0, 29, 0, 966_666_657));
    /// ```
    pub fn cover(&mut self, other: Self) {
        self.first = self.first.min(other.first);
        self.last = self.last.max(other.last);
        self.start = self.start.min(other.start);
        self.end = self.end.max(other.end);
    }
}

/// How and when recording ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stop {
    /// When.
    pub at: HostTime,
    /// Who or what stopped it, as in `button`, `duration`, `disk full`.
    pub reason: String,
}

/// The manifest of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// [`FORMAT_VERSION`] of the writer.
    pub format_version: u32,
    /// A UUID, unique among all sessions of all rigs.
    pub session_id: String,
    /// Given by the user; may be empty.
    pub name: String,
    /// What wrote the session.
    pub software: String,
    /// Whether it is complete.
    pub state: State,
    /// When recording began, host clock.
    pub started: HostTime,
    /// The same instant in civil time, as well as the recorder knew it.
    pub started_civil: CivilTime,
    /// Chunk length that the writer aimed at, ns.
    pub chunk_ns: i64,
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// The IMUs.
    pub imus: Vec<Imu>,
    /// The channels.
    pub streams: Vec<Stream>,
    /// The files in `rig/`.
    pub rig: Vec<RigFile>,
    /// The segments, in order.
    pub segments: Vec<SegmentEntry>,
    /// The numbered streams (cameras and IMUs, by name), as far as they were on disk.
    pub extents: BTreeMap<String, Extent>,
    /// How it ended; none while recording.
    pub stopped: Option<Stop>,
}

/// Why a manifest cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The file cannot be read: not a session folder, or the file system reports an I/O error.
    #[error("reading {manifest}", manifest = layout::MANIFEST)]
    Io(#[from] std::io::Error),
    /// The content is not a manifest: damaged; recovery rebuilds it from the segments.
    #[error("{manifest} is damaged: {0}", manifest = layout::MANIFEST)]
    Damaged(String),
    /// Written by a newer version: update this program.
    #[error(
        "{manifest} has format version {found}; this program reads up to {FORMAT_VERSION}",
        manifest = layout::MANIFEST
    )]
    TooNew {
        /// The version found.
        found: u32,
    },
}

/// Maximum length of a manifest, bytes. A session of a whole day has 1440 segments and takes 0.4
/// MB.
pub const MAX_BYTES: u64 = 16 << 20;

/// Marks the checksum line; the CRC covers everything before it.
const CRC_KEY: &str = "\n  \"crc32\": \"";

impl Manifest {
    /// The manifest as the bytes of `session.json`.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.truncate(text.len().saturating_sub("\n}".len()));
        text.push(',');
        let crc = crc32fast::hash(text.as_bytes());
        text.push_str(&format!("{CRC_KEY}{crc:08x}\"\n}}\n"));
        text.into_bytes()
    }

    /// The manifest in the bytes of `session.json`.
    ///
    /// # Errors
    /// [`ManifestError::Damaged`] or [`ManifestError::TooNew`].
    ///
    /// ```
    /// use session_archive::manifest::Manifest;
    ///
    /// # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
    /// let mut bytes = std::fs::read(format!("{folder}/session.json"))?;
    /// let manifest = Manifest::from_bytes(&bytes)?;
    /// assert_eq!(manifest.to_bytes(), bytes);
    ///
    /// // One digit of one number: still JSON, but not what was written.
    /// let digit = bytes.iter().position(u8::is_ascii_digit).ok_or("no digit")?;
    /// bytes[digit] ^= 1;
    /// let damaged = Manifest::from_bytes(&bytes).unwrap_err();
    /// assert_eq!(damaged.to_string(), "session.json is damaged: its checksum does not match");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ManifestError> {
        let damaged = |what: &str| ManifestError::Damaged(what.to_owned());
        let text = std::str::from_utf8(bytes).map_err(|_| damaged("not UTF-8"))?;
        let at = text
            .rfind(CRC_KEY)
            .ok_or_else(|| damaged("it has no checksum"))?;
        let stored = text[at + CRC_KEY.len()..]
            .get(..8)
            .ok_or_else(|| damaged("it is cut off"))?;
        let found = format!("{:08x}", crc32fast::hash(&text.as_bytes()[..at]));
        let rest = &text[at + CRC_KEY.len() + 8..];
        if stored != found || rest != "\"\n}\n" {
            return Err(damaged("its checksum does not match"));
        }
        let manifest: Self = serde_json::from_str(text).map_err(|e| damaged(&e.to_string()))?;
        manifest.checked()
    }

    /// What the head of every segment repeats: the manifest as it was when the session was
    /// created, as compact JSON.
    pub fn identity(&self) -> String {
        let created = Self {
            state: State::Recording,
            segments: Vec::new(),
            extents: BTreeMap::new(),
            stopped: None,
            ..self.clone()
        };
        serde_json::to_string(&created).unwrap_or_default()
    }

    /// The manifest that [`Self::identity`] gave.
    ///
    /// # Errors
    /// [`ManifestError::Damaged`] or [`ManifestError::TooNew`].
    pub fn from_identity(text: &str) -> Result<Self, ManifestError> {
        let manifest: Self =
            serde_json::from_str(text).map_err(|e| ManifestError::Damaged(e.to_string()))?;
        manifest.checked()
    }

    fn checked(self) -> Result<Self, ManifestError> {
        if self.format != FORMAT {
            return Err(ManifestError::Damaged(format!(
                "its format is {:?}",
                self.format
            )));
        }
        if self.format_version > FORMAT_VERSION {
            return Err(ManifestError::TooNew {
                found: self.format_version,
            });
        }
        if self.segments.iter().zip(0..).any(|(s, i)| s.number != i) {
            return Err(ManifestError::Damaged(
                "its segments are not numbered from 0".to_owned(),
            ));
        }
        if let Some((name, e)) = self.extents.iter().find(|(_, e)| e.first > e.last) {
            return Err(ManifestError::Damaged(format!(
                "its extent of {name:?} goes from {} to {}",
                e.first, e.last
            )));
        }
        // The names become paths; a manifest from elsewhere must not reach out of its folder.
        if let Some(file) = self.rig.iter().find(|f| !layout::is_file_name(&f.name)) {
            return Err(ManifestError::Damaged(format!(
                "its rig file {:?} is no file name",
                file.name
            )));
        }
        let cameras = self.cameras.iter().map(|c| &c.name);
        let mut names: Vec<&String> = cameras.chain(self.imus.iter().map(|i| &i.name)).collect();
        if let Some(name) = names.iter().find(|name| !layout::is_stream_name(name)) {
            return Err(ManifestError::Damaged(format!(
                "its camera or IMU {name:?} is no name; expected letters, digits, _, - and . \
                 with / between parts"
            )));
        }
        // Free text (name, sources, encoders, reasons) is kept as it is; these are identifiers that
        // programs compare.
        let words = self.cameras.iter().flat_map(|c| {
            let trigger = c.trigger.as_deref().unwrap_or_default();
            [&c.codec, &c.colour, trigger]
        });
        if let Some(word) = words.into_iter().find(|word| !text::is_plain(word)) {
            return Err(ManifestError::Damaged(format!(
                "{word:?} of a camera has control characters"
            )));
        }
        names.sort_unstable();
        if let Some(same) = names.windows(2).find(|two| two[0] == two[1]) {
            return Err(ManifestError::Damaged(format!(
                "it has two cameras or IMUs {:?}",
                same[0]
            )));
        }
        Ok(self)
    }

    /// Reads the manifest of a session folder.
    ///
    /// # Errors
    /// See [`ManifestError`].
    ///
    /// ```
    /// use session_archive::manifest::{Manifest, State};
    /// use session_archive::record::ImuBatch;
    /// use session_archive::storage::DiskStorage;
    ///
    /// # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
    /// let manifest = Manifest::read(&DiskStorage::new(folder))?;
    /// assert_eq!(manifest.state, State::Closed);
    /// assert_eq!(manifest.camera("left_shoulder").map(|c| (c.width, c.height)), Some((64, 24)));
    /// assert_eq!(manifest.stream::<ImuBatch>("feet/imu").map(|s| s.topic.as_str()), Some("/feet/imu/samples"));
    /// assert!(manifest.stream::<ImuBatch>("left_shoulder/imu").is_none());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn read(storage: &dyn Storage) -> Result<Self, ManifestError> {
        Self::from_bytes(&storage::read_up_to(storage, layout::MANIFEST, MAX_BYTES)?)
    }

    /// The stream of messages of type `R` that belong to `of` (a camera, an IMU, or `""`).
    pub fn stream<R: Record>(&self, of: &str) -> Option<&Stream> {
        self.streams
            .iter()
            .find(|s| s.of == of && s.schema == R::SCHEMA.name)
    }

    /// The camera with this name.
    pub fn camera(&self, name: &str) -> Option<&Camera> {
        self.cameras.iter().find(|c| c.name == name)
    }
}

/// The channels of a session with these cameras and IMUs: the same table for the same rig, so
/// that every segment of every version-1 session is laid out alike.
///
/// ```
/// use session_archive::manifest::{Imu, is_state, stream_table};
/// use session_archive::time::TickLength;
///
/// let imu = Imu {
///     name: "feet/imu".to_owned(),
///     rate_hz: 200.0,
///     tick: TickLength::ZED_MINI,
///     source: "example".to_owned(),
///     noise: None,
/// };
/// let streams = stream_table(&[], &[imu]);
/// assert_eq!(streams.iter().map(|s| s.id).collect::<Vec<_>>(), (1..=8).collect::<Vec<_>>());
/// assert_eq!(streams[6].topic, "/feet/imu/samples");
/// // Samples are events in time; the transforms of the rig and the clock's map are state.
/// let state: Vec<&str> = streams.iter().filter(|s| is_state(s)).map(|s| s.topic.as_str()).collect();
/// assert_eq!(state, ["/rig/transforms", "/feet/imu/clock"]);
/// ```
pub fn stream_table(cameras: &[Camera], imus: &[Imu]) -> Vec<Stream> {
    let mut streams: Vec<Stream> = Vec::new();
    let mut add = |topic: String, schema: &str, of: &str| {
        let id = streams.len() as u16 + 1;
        streams.push(Stream {
            id,
            topic,
            schema: schema.to_owned(),
            of: of.to_owned(),
        });
    };
    for (topic, schema) in [
        ("/segment", Segment::SCHEMA),
        ("/events", Event::SCHEMA),
        ("/gaps", Gap::SCHEMA),
        ("/health", Health::SCHEMA),
        ("/frame_sets", FrameSet::SCHEMA),
        ("/rig/transforms", FrameTransforms::SCHEMA),
    ] {
        add(topic.to_owned(), schema.name, "");
    }
    for camera in cameras {
        let name = &camera.name;
        add(format!("/{name}/video"), CompressedVideo::SCHEMA.name, name);
        add(format!("/{name}/frames"), Frame::SCHEMA.name, name);
        add(format!("/{name}/clock"), ClockMap::SCHEMA.name, name);
        for eye in ["left", "right"] {
            let of = format!("{name}/{eye}");
            add(
                format!("/{of}/calibration"),
                CameraCalibration::SCHEMA.name,
                &of,
            );
        }
    }
    for imu in imus {
        let name = &imu.name;
        add(format!("/{name}/samples"), ImuBatch::SCHEMA.name, name);
        add(format!("/{name}/clock"), ClockMap::SCHEMA.name, name);
    }
    streams
}

/// Whether a stream holds state rather than events: its newest message is repeated at the head of
/// every segment, so that each segment can be read alone.
pub fn is_state(stream: &Stream) -> bool {
    [
        CameraCalibration::SCHEMA.name,
        FrameTransforms::SCHEMA.name,
        ClockMap::SCHEMA.name,
    ]
    .contains(&stream.schema.as_str())
}
