//! The table: which reading requests which step, when, and when it is released.

use serde::{Deserialize, Serialize};

use super::rung::{Leave, Rung};
use super::{Cause, Pressure, Step};
use crate::NS_PER_S;
use crate::battery::Power;

/// Free space above the reserve with which a recording may begin after the disk was full, bytes.
const START_AGAIN_BYTES: f64 = (256_u64 << 20) as f64;
/// With more than this in the batteries, %, the reported minutes left are no reason to stop.
const MUCH_PERCENT: f64 = 20.0;

/// Thresholds. The defaults suit a rig on the body; the supply has none, since a voltage means
/// nothing without the pack that gives it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Degrees below the temperature at which the machine is slowed: warn.
    pub heat_warn_c: f64,
    /// The same: lower the preview.
    pub heat_preview_c: f64,
    /// The same: lower the frame rate. Below zero: only once it is slowed.
    pub heat_frame_rate_c: f64,
    /// Degrees below the temperature at which the kernel switches off: stop.
    pub heat_stop_c: f64,
    /// Charge, %: warn.
    pub battery_warn_percent: f64,
    /// The same: lower the preview.
    pub battery_preview_percent: f64,
    /// The same: stop.
    pub battery_stop_percent: f64,
    /// Minutes until the batteries are empty: warn.
    pub battery_warn_minutes: f64,
    /// The same: stop.
    pub battery_stop_minutes: f64,
    /// Voltage of the input below which to warn, V.
    pub supply_warn_volts: Option<f64>,
    /// Voltage of the input below which to stop, V.
    pub supply_stop_volts: Option<f64>,
    /// Seconds until only the reserve is left: warn.
    pub disk_warn_s: f64,
    /// The same: lower the bitrate.
    pub disk_bitrate_s: f64,
    /// The same: stop. What the dwell time takes of it must leave enough to end cleanly.
    pub disk_stop_s: f64,
    /// How full the fullest queue to an encoder is, 0 to 1: warn and lower the preview.
    pub encoder_preview_fill: f64,
    /// The same: lower the bitrate.
    pub encoder_bitrate_fill: f64,
    /// The same: lower the frame rate.
    pub encoder_frame_rate_fill: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            heat_warn_c: 10.0,
            heat_preview_c: 6.0,
            heat_frame_rate_c: 1.0,
            // The clocks are throttled some 5 °C below already: this is a machine that cannot cope.
            heat_stop_c: 2.0,
            // Warned at 20 %, in distress at 5 %, as the users of body-worn recorders know it.
            battery_warn_percent: 20.0,
            battery_preview_percent: 12.0,
            battery_stop_percent: 5.0,
            battery_warn_minutes: 15.0,
            battery_stop_minutes: 3.0,
            supply_warn_volts: None,
            supply_stop_volts: None,
            // Time to walk back; then to finish what was begun.
            disk_warn_s: 600.0,
            disk_bitrate_s: 180.0,
            disk_stop_s: 10.0,
            encoder_preview_fill: 0.5,
            encoder_bitrate_fill: 0.75,
            encoder_frame_rate_fill: 0.9,
        }
    }
}

/// Limits that contradict each other.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum LimitsError {
    /// Give a number in the range.
    #[error("the limit {name} is {found}, expected {expected}")]
    Range {
        /// Which.
        name: &'static str,
        /// What it is.
        found: f64,
        /// What is possible.
        expected: &'static str,
    },
    /// Put them in order: a milder step comes first.
    #[error("the limit {first} ({first_is}) must come before {then} ({then_is})")]
    Order {
        /// The milder one.
        first: &'static str,
        /// What it is.
        first_is: f64,
        /// The stronger one.
        then: &'static str,
        /// What it is.
        then_is: f64,
    },
}

/// A measured quantity. Its badness grows with the pressure: a margin counts with its sign
/// inverted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    HeatMargin,
    CriticalMargin,
    Throttled,
    BatteryPercent,
    BatteryMinutes,
    /// Minutes while the charge agrees that little is left: a wrong gauge is no reason to stop.
    LastBatteryMinutes,
    SupplyVolts,
    DiskSeconds,
    DiskUsable,
    DiskInodes,
    DiskTrouble,
    EncoderFill,
}

impl Quantity {
    pub(super) fn cause(self) -> Cause {
        match self {
            Self::HeatMargin | Self::CriticalMargin => Cause::Heat,
            Self::Throttled => Cause::Throttling,
            Self::BatteryPercent | Self::BatteryMinutes | Self::LastBatteryMinutes => {
                Cause::Battery
            }
            Self::SupplyVolts => Cause::Supply,
            Self::DiskSeconds | Self::DiskUsable | Self::DiskInodes | Self::DiskTrouble => {
                Cause::Disk
            }
            Self::EncoderFill => Cause::Encoder,
        }
    }

    /// Its badness now, if it is known.
    pub(super) fn of(self, pressure: &Pressure) -> Option<f64> {
        let heat = pressure.heat.as_ref();
        let power = pressure.power.as_ref();
        let disk = pressure.disk.as_ref();
        let yes = |yes: bool| f64::from(u8::from(yes));
        // While power comes from outside, batteries are no pressure whatever is left in them.
        let battery = |left: fn(&Power) -> Option<f64>| match power?.on_battery? {
            true => left(power?),
            false => Some(f64::INFINITY),
        };
        match self {
            Self::HeatMargin => Some(-heat?.margin_c?),
            Self::CriticalMargin => Some(-heat?.critical_margin_c?),
            Self::Throttled => Some(yes(heat?.throttled?)),
            Self::BatteryPercent => Some(-battery(|p| p.percent)?),
            Self::BatteryMinutes => Some(-battery(|p| p.minutes_left)?),
            Self::LastBatteryMinutes => Some(-battery(|p| match p.percent {
                Some(percent) if percent > MUCH_PERCENT => Some(f64::INFINITY),
                _ => p.minutes_left,
            })?),
            Self::SupplyVolts => Some(-power?.supply_volts?),
            Self::DiskSeconds => match (disk?.seconds_left, disk?.bytes_per_s) {
                (Some(left), _) => Some(-left),
                // The rate is known, and nothing is being written: there is no pressure.
                (None, Some(_)) => Some(f64::NEG_INFINITY),
                (None, None) => None,
            },
            Self::DiskUsable => Some(-(disk?.usable_bytes? as f64)),
            Self::DiskInodes => Some(yes(disk?.low_inodes)),
            Self::DiskTrouble => Some(yes(disk?.fault.is_some())),
            Self::EncoderFill => pressure.encoder_fill,
        }
    }
}

impl Limits {
    /// Whether the limits are valid.
    pub(super) fn check(&self) -> Result<(), LimitsError> {
        self.check_ranges()?;
        self.check_order()
    }

    fn check_ranges(&self) -> Result<(), LimitsError> {
        let finite = "a number";
        let positive = "a number above 0";
        let percent = "0 to 100";
        let fill = "above 0, to 1";
        let volts = |volts: Option<f64>| volts.unwrap_or(1.0);
        let any = f64::NEG_INFINITY..=f64::INFINITY;
        let above_0 = f64::MIN_POSITIVE..=f64::INFINITY;
        let to_1 = f64::MIN_POSITIVE..=1.0;
        for (name, found, range, expected) in [
            ("heat_warn_c", self.heat_warn_c, &any, finite),
            ("heat_preview_c", self.heat_preview_c, &any, finite),
            ("heat_frame_rate_c", self.heat_frame_rate_c, &any, finite),
            ("heat_stop_c", self.heat_stop_c, &above_0, positive),
            (
                "battery_warn_percent",
                self.battery_warn_percent,
                &(0.0..=100.0),
                percent,
            ),
            (
                "battery_preview_percent",
                self.battery_preview_percent,
                &(0.0..=100.0),
                percent,
            ),
            (
                "battery_stop_percent",
                self.battery_stop_percent,
                &(0.0..=100.0),
                percent,
            ),
            (
                "battery_warn_minutes",
                self.battery_warn_minutes,
                &above_0,
                positive,
            ),
            (
                "battery_stop_minutes",
                self.battery_stop_minutes,
                &above_0,
                positive,
            ),
            (
                "supply_warn_volts",
                volts(self.supply_warn_volts),
                &above_0,
                positive,
            ),
            (
                "supply_stop_volts",
                volts(self.supply_stop_volts),
                &above_0,
                positive,
            ),
            ("disk_warn_s", self.disk_warn_s, &above_0, positive),
            ("disk_bitrate_s", self.disk_bitrate_s, &above_0, positive),
            (
                "disk_stop_s",
                self.disk_stop_s,
                &(5.0..=f64::INFINITY),
                "5 or more, to end cleanly",
            ),
            (
                "encoder_preview_fill",
                self.encoder_preview_fill,
                &to_1,
                fill,
            ),
            (
                "encoder_bitrate_fill",
                self.encoder_bitrate_fill,
                &to_1,
                fill,
            ),
            (
                "encoder_frame_rate_fill",
                self.encoder_frame_rate_fill,
                &to_1,
                fill,
            ),
        ] {
            if !found.is_finite() || !range.contains(&found) {
                return Err(LimitsError::Range {
                    name,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Margins and what is left fall towards the stronger step.
    fn check_order(&self) -> Result<(), LimitsError> {
        let falling = [
            (
                "heat_warn_c",
                self.heat_warn_c,
                "heat_preview_c",
                self.heat_preview_c,
            ),
            (
                "heat_preview_c",
                self.heat_preview_c,
                "heat_frame_rate_c",
                self.heat_frame_rate_c,
            ),
            (
                "battery_warn_percent",
                self.battery_warn_percent,
                "battery_preview_percent",
                self.battery_preview_percent,
            ),
            (
                "battery_preview_percent",
                self.battery_preview_percent,
                "battery_stop_percent",
                self.battery_stop_percent,
            ),
            (
                "battery_warn_minutes",
                self.battery_warn_minutes,
                "battery_stop_minutes",
                self.battery_stop_minutes,
            ),
            (
                "disk_warn_s",
                self.disk_warn_s,
                "disk_bitrate_s",
                self.disk_bitrate_s,
            ),
            (
                "disk_bitrate_s",
                self.disk_bitrate_s,
                "disk_stop_s",
                self.disk_stop_s,
            ),
            (
                "encoder_frame_rate_fill",
                self.encoder_frame_rate_fill,
                "encoder_bitrate_fill",
                self.encoder_bitrate_fill,
            ),
            (
                "encoder_bitrate_fill",
                self.encoder_bitrate_fill,
                "encoder_preview_fill",
                self.encoder_preview_fill,
            ),
        ];
        let supply = self.supply_warn_volts.zip(self.supply_stop_volts);
        let supply =
            supply.map(|(warn, stop)| ("supply_warn_volts", warn, "supply_stop_volts", stop));
        for (high, high_is, low, low_is) in falling.into_iter().chain(supply) {
            if high_is < low_is {
                // A queue fills towards the stronger step, everything else runs out.
                let ((first, first_is), (then, then_is)) = if high.starts_with("encoder") {
                    ((low, low_is), (high, high_is))
                } else {
                    ((high, high_is), (low, low_is))
                };
                return Err(LimitsError::Order {
                    first,
                    first_is,
                    then,
                    then_is,
                });
            }
        }
        Ok(())
    }

    /// All rungs.
    pub(super) fn rungs(&self) -> Vec<Rung> {
        use Leave::{After, NextRecording};
        use Quantity::*;
        use Step::*;
        const S: i64 = NS_PER_S;
        let minute = After(60 * S);
        // A margin counts with its sign inverted, and is easier when it is larger by `by`.
        let below = |quantity, step, limit: f64, enter_ns, by: f64, leave| {
            Rung::new(quantity, step, (-limit, enter_ns), (-(limit + by), leave))
        };
        let yes = |quantity, step, enter_ns, leave| {
            Rung::new(quantity, step, (1.0, enter_ns), (0.0, leave))
        };
        let fill = |step, limit: f64, enter_ns, leave| {
            Rung::new(EncoderFill, step, (limit, enter_ns), (0.3 * limit, leave))
        };

        let mut rungs = vec![
            // Heat follows a measure within minutes.
            below(HeatMargin, Warn, self.heat_warn_c, 5 * S, 4.0, minute),
            below(
                HeatMargin,
                LowerPreview,
                self.heat_preview_c,
                10 * S,
                4.0,
                minute,
            ),
            below(
                HeatMargin,
                LowerFrameRate,
                self.heat_frame_rate_c,
                20 * S,
                6.0,
                After(180 * S),
            ),
            below(
                CriticalMargin,
                StopCleanly,
                self.heat_stop_c,
                3 * S,
                10.0,
                minute,
            ),
            // Clocks are lowered for a moment in normal work, too.
            yes(Throttled, Warn, 5 * S, minute),
            yes(Throttled, LowerPreview, 15 * S, minute),
            // Gauges jump when the load changes.
            below(
                BatteryPercent,
                Warn,
                self.battery_warn_percent,
                10 * S,
                3.0,
                minute,
            ),
            below(
                BatteryPercent,
                LowerPreview,
                self.battery_preview_percent,
                10 * S,
                3.0,
                minute,
            ),
            below(
                BatteryPercent,
                StopCleanly,
                self.battery_stop_percent,
                10 * S,
                3.0,
                minute,
            ),
            below(
                BatteryMinutes,
                Warn,
                self.battery_warn_minutes,
                30 * S,
                5.0,
                minute,
            ),
            below(
                LastBatteryMinutes,
                StopCleanly,
                self.battery_stop_minutes,
                30 * S,
                3.0,
                minute,
            ),
            // Time left jumps with the scene: a turn of the head doubles the rate for seconds.
            below(
                DiskSeconds,
                Warn,
                self.disk_warn_s,
                5 * S,
                0.5 * self.disk_warn_s,
                minute,
            ),
            below(
                DiskSeconds,
                LowerBitrate,
                self.disk_bitrate_s,
                5 * S,
                0.0,
                NextRecording,
            ),
            below(
                DiskSeconds,
                StopCleanly,
                self.disk_stop_s,
                2 * S,
                30.0,
                After(10 * S),
            ),
            below(
                DiskUsable,
                StopCleanly,
                0.0,
                2 * S,
                START_AGAIN_BYTES,
                After(2 * S),
            ),
            yes(DiskInodes, Warn, 2 * S, minute),
            yes(DiskTrouble, StopCleanly, 2 * S, After(5 * S)),
            // A queue that is half full is seconds from dropping.
            fill(Warn, self.encoder_preview_fill, 2 * S, minute),
            fill(
                LowerPreview,
                self.encoder_preview_fill,
                2 * S,
                NextRecording,
            ),
            fill(
                LowerBitrate,
                self.encoder_bitrate_fill,
                3 * S,
                NextRecording,
            ),
            fill(
                LowerFrameRate,
                self.encoder_frame_rate_fill,
                6 * S,
                NextRecording,
            ),
        ];
        // The voltage sags while the load is high, and recovers by half a volt when it is not.
        let supply = [
            (Warn, self.supply_warn_volts),
            (StopCleanly, self.supply_stop_volts),
        ];
        for (step, volts) in supply {
            rungs.extend(volts.map(|v| below(SupplyVolts, step, v, 10 * S, 0.5, minute)));
        }
        rungs
    }
}
