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
    pub const ALL: [Self; 18] = [
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
        }
    }
}
