//! Validation limits: one table, each row with its source.
//!
//! A value above `warn` gives a warning, a value above `fail` makes the session unfit for use.
//! Limits are those of the published health check for Aria Gen 2 recordings (version 1.3.1, profile
//! `AriaGen2_Location`), where it has one. Some of those depend on a rate: its longest gap, 160 and
//! 210 ms, allows a 10 Hz camera to lose one frame with a warning and not two. Such a limit has a
//! floor in nominal periods of the stream, chosen so that it means the same for slower streams: the
//! effective limit is the larger of the two.

use std::borrow::Cow;
use std::fmt;

/// Unit of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// A fraction from 0 to 1.
    Ratio,
    /// Nanoseconds.
    Time,
    /// A count.
    Count,
    /// Degrees.
    Angle,
    /// 1 if true, 0 if false.
    Flag,
}

impl Unit {
    /// A value with its unit, as text.
    pub fn show(self, value: f64) -> String {
        if value.is_nan() || value.is_infinite() {
            return "n/a".to_owned();
        }
        match self {
            // A clock's rounding is not a deviation.
            Self::Ratio if value.abs() < 1e-6 => "0 %".to_owned(),
            Self::Ratio => format!("{} %", charts::significant(value * 100.0)),
            Self::Time => charts::si(value * 1e-9, "s"),
            Self::Count => charts::significant(value),
            Self::Angle => format!("{}\u{b0}", charts::significant(value)),
            Self::Flag if value == 0.0 => "no".to_owned(),
            Self::Flag => "yes".to_owned(),
        }
    }

    /// Name in JSON.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ratio => "ratio",
            Self::Time => "ns",
            Self::Count => "count",
            Self::Angle => "deg",
            Self::Flag => "flag",
        }
    }
}

/// One row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Name of the metric, as in `camera.dropped`.
    pub metric: &'static str,
    /// Title.
    pub title: &'static str,
    /// Unit.
    pub unit: Unit,
    /// A value above this is a warning.
    pub warn: f64,
    /// A value above this is a failure; infinite if no value fails a session.
    pub fail: f64,
    /// Floors of `warn` and `fail` in nominal periods, for limits that depend on the rate.
    pub periods: Option<(f64, f64)>,
    /// Source of the numbers.
    pub source: Cow<'static, str>,
}

const NEVER: f64 = f64::INFINITY;
const US: f64 = 1e3;
const MS: f64 = 1e6;
const S: f64 = 1e9;
const ARIA: &str = "Aria Gen 2 health check";
/// Source of the `calib` limits. Their values are the excess over two sigmas of tolerance and the
/// measurement uncertainty.
const VERIFY: &str =
    "docs/guides/calibration-verify.md: more than tolerance and measurement explain";

macro_rules! limit {
    ($metric:literal, $title:literal, $unit:ident, $warn:expr, $fail:expr, $periods:expr, $source:expr) => {
        Limit {
            metric: $metric,
            title: $title,
            unit: Unit::$unit,
            warn: $warn,
            fail: $fail,
            periods: $periods,
            source: Cow::Borrowed($source),
        }
    };
}

/// The default limits.
#[rustfmt::skip] // a table
pub const TABLE: &[Limit] = &[
    limit!("session.damage", "faults in the archive", Count, 0.0, 0.0, None,
        "recorded data must be readable and accounted for; recovery restores that"),
    limit!("session.unclosed", "cut off while recording", Flag, 0.0, NEVER, None,
        "data synced before the cut is complete"),
    limit!("session.degraded", "recorded in degraded mode (load shedding)", Time, 0.0, NEVER, None,
        "image quality or rate is reduced while heat, power or the disk are critical"),
    limit!("camera.dropped", "frames missing", Ratio, 0.001, 0.01, None, ARIA),
    limit!("camera.longest_gap", "longest gap", Time, 160.0 * MS, 210.0 * MS, Some((1.6, 2.1)), ARIA),
    limit!("camera.period_deviation", "period deviation (99.9 %)", Time, 250.0 * US, 500.0 * US, None,
        "Aria Gen 2 health check: 250 us, and more than 500 us in at most 0.1 % of frames"),
    limit!("camera.rate", "rate error", Ratio, 0.02, 0.1, None,
        "a camera that falls from 30 to 15 Hz need not skip a number (grand_tour_box issue 378)"),
    limit!("camera.non_monotonic", "times not rising", Count, 0.0, 0.0, None, ARIA),
    limit!("camera.bad", "bad frames", Count, 0.0, 0.0, None, ARIA),
    limit!("camera.frozen", "longest frozen image", Time, 0.0, S, None,
        "the recorder's own alarm comes after two periods and a second"),
    limit!("camera.eyes_apart", "left-right time offset (99.9 %)", Time, MS, NEVER, None,
        "docs/reference/sources.md: at 1 rad/s, 1 ms moves the smallest images of a ZED Mini by a third of a pixel"),
    limit!("camera.calibration", "eyes without calibration", Count, 0.0, NEVER, None,
        "Aria Gen 2 health check; a warning, since calibration can be made from the recording"),
    limit!("camera.calibration_size", "calibration for another image size, pixels", Count, 0.0, 0.0, None,
        "lens coordinates of another size are wrong, and reconstruction refuses them"),
    limit!("camera.calibration_padding", "eyes with a padded last row or column", Count, 0.0, NEVER, None,
        "recorders repeated an odd last row or column before sizes were recorded as they are; that moves no lens coordinate"),
    limit!("camera.undecoded", "images that cannot be decoded", Count, 0.0, 0.0, None,
        "every access unit is one image"),
    limit!("imu.dropped", "samples missing", Ratio, 0.001, 0.01, None, ARIA),
    limit!("imu.longest_gap", "longest gap", Time, 10.0 * MS, 15.0 * MS, Some((2.5, 3.5)),
        "Aria Gen 2 health check; slower IMUs: one sample may be missing, not two"),
    limit!("imu.period_deviation", "period deviation (99.9 %)", Time, 100.0 * US, 200.0 * US, None, ARIA),
    limit!("imu.rate", "rate error", Ratio, 0.05, NEVER, None,
        "IMUs run at 309 Hz where 400 are promised; integration takes the times, not the rate"),
    limit!("imu.non_monotonic", "times not rising", Count, 0.0, 0.0, None, ARIA),
    limit!("imu.bad", "bad batches", Count, 0.0, 0.0, None, ARIA),
    limit!("imu.stuck_value", "longest run of equal values", Time, 100.0 * MS, NEVER, None,
        "Aria Gen 2 health check, which counts such runs; six axes with noise do not repeat for long"),
    limit!("imu.frame_sync", "time offset to the camera, by frame sync", Time, 8.0 * MS, NEVER, None,
        "docs/reference/frame-sync.md: a camera's stamp is at most 8 ms late; more is a clock, or a count that has slipped"),
    limit!("stream.start_offset", "starts after the session", Time, 1.5 * S, 3.0 * S, None, ARIA),
    limit!("stream.end_offset", "ends before the session", Time, 1.5 * S, 3.0 * S, None, ARIA),
    limit!("stream.clock_sigma", "uncertainty of times (median)", Time, 2.0 * MS, 10.0 * MS, None,
        "goal for a camera without trigger: its offset known to 2 ms"),
    limit!("stream.unreliable_time", "unreliable times", Time, 10.0 * S, NEVER, Some((100.0, NEVER)),
        "a clock map converges within 64 samples, at the start and after a step"),
    limit!("rig.misalignment", "misalignment under one trigger (99.9 %)", Time, 250.0 * US, 500.0 * US, None, ARIA),
    limit!("rig.free_misalignment", "distance to its frame set (99.9 %)", Time, 0.0, 0.0, Some((0.5, 1.0)),
        "a camera without trigger is at most half a period of the slowest camera away; beyond a full period it is in the wrong set"),
    limit!("rig.frame_sets", "cameras without frame sets", Count, 0.0, NEVER, None,
        "frames of several cameras are read by set"),
    limit!("rig.transforms", "cameras without extrinsics", Count, 0.0, NEVER, None,
        "stereo extrinsics, and the pose on the rig if a rig file gives any; a warning, since extrinsics can be calibrated from the recording"),
    limit!("calib.camera_rotation", "camera rotation on the plate, beyond tolerance", Angle, 0.0, 1.0, None, VERIFY),
    limit!("calib.imu_rotation", "IMU rotation in its camera, beyond tolerance", Angle, 0.0, 1.0, None, VERIFY),
    limit!("calib.stereo_rotation", "stereo rotation, beyond tolerance", Angle, 0.0, 0.5, None,
        "docs/guides/calibration-verify.md; half a degree shifts rows by more than the search range of stereo matching"),
    limit!("calib.time_offset", "time offset, beyond tolerance", Time, 0.0, 5.0 * MS, None, VERIFY),
];

/// The limits in force.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits(Vec<Limit>);

impl Default for Limits {
    fn default() -> Self {
        Self(TABLE.to_vec())
    }
}

/// Why a limit cannot be set: the text must be `METRIC=WARN,FAIL` with rising numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BadLimit(String);

impl fmt::Display for BadLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for BadLimit {}

impl Limits {
    /// The row of a metric.
    pub fn of(&self, metric: &str) -> Option<&Limit> {
        self.0.iter().find(|l| l.metric == metric)
    }

    /// The limits that differ from the table, as [`Self::set`] takes them.
    pub fn moved(&self) -> Vec<String> {
        let moved = self.0.iter().zip(TABLE).filter(|(row, table)| row != table);
        moved
            .map(|(row, _)| {
                format!(
                    "{}={},{}",
                    row.metric,
                    limit_text(row.warn),
                    limit_text(row.fail)
                )
            })
            .collect()
    }

    /// All rows.
    pub fn rows(&self) -> &[Limit] {
        &self.0
    }

    /// Sets both limits of a metric from `METRIC=WARN,FAIL`, in the unit of the table (ratio, ns,
    /// count, deg, flag); `never` for no limit, and `METRIC=never` for both.
    ///
    /// # Errors
    /// The text has another form.
    pub fn set(&mut self, text: &str) -> Result<(), BadLimit> {
        let bad = |what: String| BadLimit(format!("limit {text:?}: {what}"));
        let (metric, limits) = text
            .split_once('=')
            .ok_or_else(|| bad("expected METRIC=WARN,FAIL".to_owned()))?;
        let metric = metric.trim();
        let (warn, fail) = match (limits.split_once(','), limits.trim()) {
            (Some(both), _) => both,
            (None, "never") => ("never", "never"),
            (None, _) => {
                return Err(bad("expected two limits, WARN,FAIL, or `never`".to_owned()));
            }
        };
        let number = |text: &str| match text.trim() {
            "never" => Ok(NEVER),
            text => text
                .parse::<f64>()
                .ok()
                .filter(|v| v.is_finite() && *v >= 0.0)
                .ok_or_else(|| bad(format!("{text:?} is not a number from 0 up"))),
        };
        let (warn, fail) = (number(warn)?, number(fail)?);
        if warn > fail {
            return Err(bad("a warning comes before a failure".to_owned()));
        }
        let known = self.0.iter().map(|l| l.metric);
        let nearest = known.max_by(|a, b| {
            strsim::jaro_winkler(a, metric).total_cmp(&strsim::jaro_winkler(b, metric))
        });
        let nearest = nearest.unwrap_or_default();
        let row = self
            .0
            .iter_mut()
            .find(|l| l.metric == metric)
            .ok_or_else(|| {
                bad(format!(
                    "no such metric; did you mean {nearest}? `paws validate --metrics` lists them"
                ))
            })?;
        (row.warn, row.fail, row.periods) = (warn, fail, None);
        row.source = Cow::Borrowed("set on the command line");
        // Setting a table limit to its default keeps the source.
        let table = TABLE.iter().find(|table| table.metric == metric);
        if let Some(table) = table
            && (table.warn, table.fail, table.periods) == (warn, fail, None)
        {
            row.source = table.source.clone();
        }
        Ok(())
    }
}

/// A limit as [`Limits::set`] takes it.
pub fn limit_text(limit: f64) -> String {
    match limit {
        NEVER => "never".to_owned(),
        limit => limit.to_string(),
    }
}

impl Limit {
    /// Whether it needs a deep validation.
    pub fn is_deep(&self) -> bool {
        self.metric == "camera.undecoded" || self.metric.starts_with("calib.")
    }

    /// Effective limits for a stream with this nominal period, ns.
    pub fn in_force(&self, period_ns: f64) -> (f64, f64) {
        let (warn, fail) = self.periods.unwrap_or((0.0, 0.0));
        let at_least = |limit: f64, periods: f64| {
            if period_ns.is_finite() && period_ns > 0.0 {
                limit.max(periods * period_ns)
            } else {
                limit
            }
        };
        (at_least(self.warn, warn), at_least(self.fail, fail))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_has_the_published_limits() {
        let limits = Limits::default();
        let check = |metric: &str, warn: f64, fail: f64| {
            let row = limits.of(metric).unwrap();
            assert_eq!((row.warn, row.fail), (warn, fail), "{metric}");
        };
        check("camera.dropped", 0.001, 0.01);
        check("camera.longest_gap", 160e6, 210e6);
        check("camera.period_deviation", 250e3, 500e3);
        check("rig.misalignment", 250e3, 500e3);
        check("imu.dropped", 0.001, 0.01);
        check("imu.longest_gap", 10e6, 15e6);
        check("imu.period_deviation", 100e3, 200e3);
        check("stream.start_offset", 1.5e9, 3e9);
        check("stream.end_offset", 1.5e9, 3e9);
    }

    #[test]
    fn every_row_is_sensible() {
        for (i, row) in TABLE.iter().enumerate() {
            assert!(row.warn <= row.fail, "{}", row.metric);
            let (warn, fail) = row.in_force(1e8);
            assert!(warn <= fail, "{}", row.metric);
            assert!(!row.source.is_empty() && !row.title.is_empty());
            assert!(TABLE[..i].iter().all(|r| r.metric != row.metric));
        }
    }

    #[test]
    fn gap_limits_scale_with_the_period_of_slow_streams() {
        let limits = Limits::default();
        let gap = |metric: &str, hz: f64| limits.of(metric).unwrap().in_force(1e9 / hz);
        assert_eq!(gap("camera.longest_gap", 60.0), (160e6, 210e6));
        assert_eq!(gap("camera.longest_gap", 10.0), (160e6, 210e6));
        assert_eq!(gap("camera.longest_gap", 5.0), (320e6, 420e6));
        assert_eq!(gap("imu.longest_gap", 800.0), (10e6, 15e6));
        // One lost sample of a 200 Hz IMU makes a gap of exactly the published limit.
        assert_eq!(gap("imu.longest_gap", 200.0), (12.5e6, 17.5e6));
        assert_eq!(gap("camera.longest_gap", 0.0), (160e6, 210e6));
    }

    #[test]
    fn limits_can_be_set_and_errors_are_reported() {
        let mut limits = Limits::default();
        limits.set("camera.dropped=0.02,0.05").unwrap();
        limits.set("imu.longest_gap=1e7, never").unwrap();
        assert_eq!(
            limits.moved(),
            ["camera.dropped=0.02,0.05", "imu.longest_gap=10000000,never"]
        );
        let row = limits.of("imu.longest_gap").unwrap();
        assert_eq!(row.in_force(5e6), (1e7, f64::INFINITY));
        limits.set("imu.rate=never").unwrap();
        let row = limits.of("imu.rate").unwrap();
        assert_eq!((row.warn, row.fail), (NEVER, NEVER));
        // Setting a default changes nothing.
        limits.set("imu.rate=0.05,never").unwrap();
        assert_eq!(limits.moved().len(), 2);
        let mut fails = |text: &str, part: &str| {
            let error = limits.set(text).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        };
        fails("camera.dropped=never,1", "a warning comes before");
        fails("camera.droped=1,2", "did you mean camera.dropped?");
        fails("camera.dropped=2,1", "a warning comes before");
        fails("camera.dropped=2", "expected two limits");
        fails("camera.dropped", "expected METRIC=");
        fails("camera.dropped=-1,2", "not a number");
    }
}
