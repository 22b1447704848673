//! The records that a session holds: Rust types generated from `proto/` by `cargo xtask schemas`,
//! and the schema that each is written with. What a stream is and which channel carries it:
//! [`crate::manifest`].

use prost::Message;

/// Foxglove's own schemas, used wherever one fits.
pub mod foxglove {
    #![allow(missing_docs, unreachable_pub, clippy::doc_markdown)]
    include!("record/generated/foxglove.rs");
}

/// Our schemas, for what no public one holds.
pub mod paws {
    #![allow(missing_docs, unreachable_pub, clippy::doc_markdown)]
    include!("record/generated/paws.rs");
}

pub use foxglove::{
    CameraCalibration, CompressedVideo, FrameTransform, FrameTransforms, Quaternion, Vector3,
};
pub use paws::{ClockMap, Event, Frame, FrameSet, Gap, Health, ImuBatch, Segment};
pub use prost::Message as Protobuf;

use crate::time::{HostTime, NS_PER_S};

/// A schema as MCAP stores it: encoding `protobuf`, data = a serialised `FileDescriptorSet`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Full protobuf name, as in `paws.Frame`.
    pub name: &'static str,
    /// Serialised `google.protobuf.FileDescriptorSet` with everything the message needs.
    pub descriptor_set: &'static [u8],
}

/// A message type that has a place in a session.
pub trait Record: Message + Default {
    /// The schema that the message is written with.
    const SCHEMA: Schema;
}

macro_rules! records {
    ($($type:ty = $name:literal;)*) => {
        $(impl Record for $type {
            const SCHEMA: Schema = Schema {
                name: $name,
                descriptor_set: include_bytes!(concat!("record/generated/", $name, ".desc")),
            };
        })*
        /// Every schema that version 1 of the format uses, in the order in which they are written.
        pub(crate) static SCHEMAS: &[Schema] = &[$(<$type as Record>::SCHEMA),*];
    };
}

records! {
    Segment = "paws.Segment";
    CompressedVideo = "foxglove.CompressedVideo";
    Frame = "paws.Frame";
    ImuBatch = "paws.ImuBatch";
    ClockMap = "paws.ClockMap";
    FrameSet = "paws.FrameSet";
    Gap = "paws.Gap";
    Event = "paws.Event";
    Health = "paws.Health";
    CameraCalibration = "foxglove.CameraCalibration";
    FrameTransforms = "foxglove.FrameTransforms";
}

/// The schema with this protobuf name, if version 1 knows it.
///
/// ```
/// use session_archive::record::{Event, Record, schema};
///
/// let event = schema("paws.Event").ok_or("not of version 1")?;
/// assert_eq!(*event, Event::SCHEMA);
/// assert_eq!(schema("paws.Unknown"), None);
/// # Ok::<(), &str>(())
/// ```
pub fn schema(name: &str) -> Option<&'static Schema> {
    SCHEMAS.iter().find(|s| s.name == name)
}

/// Host time as protobuf writes an instant.
///
/// ```
/// use session_archive::record::timestamp;
/// use session_archive::time::HostTime;
///
/// let stamp = timestamp(HostTime(5_250_000_000));
/// assert_eq!((stamp.seconds, stamp.nanos), (5, 250_000_000));
/// // Nanoseconds count forward, as protobuf demands it of times before zero too.
/// let before = timestamp(HostTime(-1));
/// assert_eq!((before.seconds, before.nanos), (-1, 999_999_999));
/// ```
pub fn timestamp(time: HostTime) -> prost_types::Timestamp {
    prost_types::Timestamp {
        seconds: time.0.div_euclid(NS_PER_S),
        nanos: time.0.rem_euclid(NS_PER_S) as i32,
    }
}

impl FrameTransform {
    /// The rigid transform from the coordinate frame `child` to `parent`: a translation in metres
    /// and a unit quaternion `w x y z`, valid from `at` on.
    ///
    /// ```
    /// use session_archive::record::FrameTransform;
    /// use session_archive::time::HostTime;
    ///
    /// // The camera sits 40 cm above the rig's origin and is not rotated against it.
    /// let camera = FrameTransform::placing("feet/left", "rig", [0.0, 0.0, 0.4], [1.0, 0.0, 0.0, 0.0], HostTime(0));
    /// assert_eq!((camera.child_frame_id.as_str(), camera.parent_frame_id.as_str()), ("feet/left", "rig"));
    /// assert_eq!(camera.translation.map(|t| t.z), Some(0.4));
    /// assert_eq!(camera.rotation.map(|q| q.w), Some(1.0));
    /// ```
    pub fn placing(
        child: &str,
        parent: &str,
        [x, y, z]: [f64; 3],
        rotation_wxyz: [f64; 4],
        at: HostTime,
    ) -> Self {
        let [w, rx, ry, rz] = rotation_wxyz;
        Self {
            timestamp: Some(timestamp(at)),
            parent_frame_id: parent.to_owned(),
            child_frame_id: child.to_owned(),
            translation: Some(Vector3 { x, y, z }),
            rotation: Some(Quaternion {
                x: rx,
                y: ry,
                z: rz,
                w,
            }),
        }
    }
}

impl Gap {
    /// Number of missing samples; both ends are included.
    ///
    /// ```
    /// use session_archive::record::Gap;
    /// use session_archive::record::paws::gap::Cause;
    ///
    /// let gap = Gap {
    ///     stream: "left_shoulder".to_owned(),
    ///     first: 120,
    ///     last: 124,
    ///     cause: Cause::EncoderOverload.into(),
    ///     ..Gap::default()
    /// };
    /// assert_eq!(gap.count(), 5);
    /// assert_eq!(gap.cause(), Cause::EncoderOverload);
    /// ```
    pub fn count(&self) -> u64 {
        self.last.saturating_sub(self.first).saturating_add(1)
    }
}
