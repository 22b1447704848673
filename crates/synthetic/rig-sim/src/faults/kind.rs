//! The kinds of faults, their names and units.

use std::ops::RangeInclusive;

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Frames are lost between sensor and host; their numbers are skipped.
    Dropped,
    /// Frames reach the host late, and those behind them wait.
    Late,
    /// Frames are delivered twice.
    Duplicated,
    /// Frames show, byte for byte, the picture before them.
    Frozen,
    /// The upper rows of frames are new, the lower ones those of the picture before.
    Torn,
    /// Everything from the device, samples of the IMU too, takes longer to arrive, by random times.
    LatencyBurst,
    /// The device's clocks jump.
    ClockStep,
    /// The device's clocks run faster than they did.
    ClockDrift,
    /// The device's clocks reach the end of 32 bits and go on from zero.
    TickWrap,
    /// The device is gone, and counts and ticks anew when it is back.
    Disconnect,
    /// Samples of the IMU are lost; their numbers are skipped.
    ImuGap,
    /// The IMU measures less far than it should: larger values are cut off.
    ImuClipping,
    /// Less light.
    Darkness,
    /// More light.
    Flash,
    /// Something lies over the lenses, from one side on.
    CoveredLens,
    /// Smears and dust on the lenses.
    DirtyLens,
    /// The lenses are out of focus.
    Blur,
    /// The camera has turned on its plate.
    ShiftedCamera,
}

/// How a fault lies in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultDuration {
    /// From its beginning to its end.
    UntilEnd,
    /// It happens at its beginning; there is no end to give.
    Instant,
    /// As many seconds as it is strong; there is no end to give.
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

    /// As files name it.
    pub fn name(self) -> &'static str {
        self.facts().0
    }

    /// What its strength is measured in.
    pub fn unit(self) -> &'static str {
        self.facts().1
    }

    /// Strengths that mean something.
    pub fn range(self) -> RangeInclusive<f64> {
        self.facts().2
    }

    /// How it lies in time.
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
            Self::Disconnect => ("disconnect", "s gone", 0.0..=3600.0, ByStrength),
            Self::ImuGap => ("imu_gap", "s lost", 0.0..=3600.0, ByStrength),
            Self::ImuClipping => ("imu_clipping", "share of the range", 0.0..=1.0, UntilEnd),
            Self::Darkness => ("darkness", "stops", 0.0..=30.0, UntilEnd),
            Self::Flash => ("flash", "times the light, added", 0.0..=1e4, UntilEnd),
            Self::CoveredLens => ("covered_lens", "share of the picture", 0.0..=1.0, UntilEnd),
            Self::DirtyLens => ("dirty_lens", "share of the lens", 0.0..=1.0, UntilEnd),
            Self::Blur => {
                let unit = "radius, share of the picture's width";
                ("blur", unit, 0.0..=0.1, UntilEnd)
            }
            Self::ShiftedCamera => ("shifted_camera", "degrees", 0.0..=45.0, UntilEnd),
        }
    }
}
