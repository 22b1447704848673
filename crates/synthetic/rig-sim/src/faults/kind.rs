//! The kinds of faults, their names and units.

use std::ops::RangeInclusive;

/// Kind of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Frames are lost between sensor and host; their numbers are skipped.
    Dropped,
    /// Frames arrive late, and later frames wait behind them.
    Late,
    /// Frames are delivered twice.
    Duplicated,
    /// Frozen frame: repeats the previous image byte for byte.
    Frozen,
    /// Torn frame: the lower rows are those of the previous image.
    Torn,
    /// Everything from the device, IMU samples included, arrives with additional random latency.
    LatencyBurst,
    /// The device's clocks jump.
    ClockStep,
    /// The device's clocks run faster than they did.
    ClockDrift,
    /// The device's counters of 32 bits wrap to zero.
    TickWrap,
    /// The device is disconnected; its counters and clocks restart after it reconnects.
    Disconnect,
    /// Samples of the IMU are lost; their numbers are skipped.
    ImuGap,
    /// The IMU saturates below its nominal range.
    ImuClipping,
    /// Less light.
    Darkness,
    /// More light.
    Flash,
    /// An object covers part of both lenses, from one side.
    CoveredLens,
    /// Smears and dust on the lenses.
    DirtyLens,
    /// The lenses are out of focus.
    Blur,
    /// The camera, with its IMU, has rotated on the rig.
    ShiftedCamera,
    /// Mud on the tag of a shoe.
    TagDirt,
    /// Something covers part of the tag of a shoe, from the toe on.
    TagCovered,
    /// The tag of a shoe slips forward and turns.
    TagSlip,
    /// The tag of a shoe is lost.
    TagLost,
    /// Cloth of the trousers hangs over the instep.
    Trousers,
    /// A foot slides forward after it is flat on the ground.
    FootSlip,
    /// The ground yields under a foot.
    SoftGround,
    /// The wearer stops and jumps on the spot.
    Jump,
}

/// What a fault acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// A camera with its IMU.
    Camera,
    /// A foot of the wearer, with shoe and tags.
    Foot,
    /// The wearer.
    Wearer,
}

/// Duration of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultDuration {
    /// From its begin to its end.
    UntilEnd,
    /// Happens at its begin; has no end.
    Instant,
    /// Lasts for its strength in seconds; has no end.
    ByStrength,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 26] = [
        Self::Dropped,
        Self::Late,
        Self::Duplicated,
        Self::Frozen,
        Self::Torn,
        Self::LatencyBurst,
        Self::ClockStep,
        Self::ClockDrift,
        Self::TickWrap,
        Self::Disconnect,
        Self::ImuGap,
        Self::ImuClipping,
        Self::Darkness,
        Self::Flash,
        Self::CoveredLens,
        Self::DirtyLens,
        Self::Blur,
        Self::ShiftedCamera,
        Self::TagDirt,
        Self::TagCovered,
        Self::TagSlip,
        Self::TagLost,
        Self::Trousers,
        Self::FootSlip,
        Self::SoftGround,
        Self::Jump,
    ];

    /// Name in files.
    pub fn name(self) -> &'static str {
        self.facts().0
    }

    /// Unit of the strength.
    pub fn unit(self) -> &'static str {
        self.facts().1
    }

    /// Valid strengths.
    pub fn range(self) -> RangeInclusive<f64> {
        self.facts().2
    }

    /// Duration.
    pub fn duration(self) -> FaultDuration {
        self.facts().3
    }

    /// What it acts on.
    pub fn subject(self) -> Subject {
        match self {
            Self::TagDirt
            | Self::TagCovered
            | Self::TagSlip
            | Self::TagLost
            | Self::Trousers
            | Self::FootSlip
            | Self::SoftGround => Subject::Foot,
            Self::Jump => Subject::Wearer,
            _ => Subject::Camera,
        }
    }

    fn facts(
        self,
    ) -> (
        &'static str,
        &'static str,
        RangeInclusive<f64>,
        FaultDuration,
    ) {
        use FaultDuration::{ByStrength, Instant, UntilEnd};
        match self {
            Self::Dropped => ("dropped", "share of frames", 0.0..=1.0, UntilEnd),
            Self::Late => ("late", "s, one frame in ten", 0.0..=10.0, UntilEnd),
            Self::Duplicated => ("duplicated", "share of frames", 0.0..=1.0, UntilEnd),
            Self::Frozen => ("frozen", "share of frames", 0.0..=1.0, UntilEnd),
            Self::Torn => ("torn", "share of frames", 0.0..=1.0, UntilEnd),
            Self::LatencyBurst => ("latency_burst", "s, mean", 0.0..=10.0, UntilEnd),
            Self::ClockStep => ("clock_step", "s", -3600.0..=3600.0, Instant),
            Self::ClockDrift => ("clock_drift", "ppm", -1000.0..=1000.0, UntilEnd),
            Self::TickWrap => ("tick_wrap", "0 or 1", 0.0..=1.0, Instant),
            Self::Disconnect => ("disconnect", "s disconnected", 0.0..=3600.0, ByStrength),
            Self::ImuGap => ("imu_gap", "s lost", 0.0..=3600.0, ByStrength),
            Self::ImuClipping => ("imu_clipping", "share of the range", 0.0..=1.0, UntilEnd),
            Self::Darkness => ("darkness", "stops", 0.0..=30.0, UntilEnd),
            Self::Flash => ("flash", "times the light, added", 0.0..=1e4, UntilEnd),
            Self::CoveredLens => ("covered_lens", "share of the image", 0.0..=1.0, UntilEnd),
            Self::DirtyLens => ("dirty_lens", "share of the lens", 0.0..=1.0, UntilEnd),
            Self::Blur => {
                let unit = "radius, share of the image's width";
                ("blur", unit, 0.0..=0.1, UntilEnd)
            }
            Self::ShiftedCamera => ("shifted_camera", "degrees", 0.0..=45.0, UntilEnd),
            Self::TagDirt => ("tag_dirt", "share of cells", 0.0..=1.0, UntilEnd),
            Self::TagCovered => ("tag_covered", "share of the tag", 0.0..=1.0, UntilEnd),
            Self::TagSlip => {
                let unit = "m forward, and 0.6 degrees per mm";
                ("tag_slip", unit, 0.0..=0.1, Instant)
            }
            Self::TagLost => ("tag_lost", "0 or 1", 0.0..=1.0, UntilEnd),
            Self::Trousers => ("trousers", "m over the instep", 0.0..=0.3, UntilEnd),
            Self::FootSlip => ("foot_slip", "m in every stance", 0.0..=0.3, UntilEnd),
            Self::SoftGround => ("soft_ground", "m", 0.0..=0.2, UntilEnd),
            Self::Jump => ("jump", "m", 0.0..=0.5, Instant),
        }
    }
}
