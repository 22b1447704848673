//! Time as the archive stores it: integers, never floating-point seconds.
//!
//! Three kinds of time meet in a session and must not be mixed up, so each has a type:
//!
//! * [`HostTime`]: nanoseconds on the recording machine's `CLOCK_MONOTONIC`. Every log time in
//!   the archive is one of these.
//! * [`CivilTime`]: nanoseconds of UTC since 1970, known only through the pair that the manifest
//!   records; never used to compute a duration.
//! * device ticks: an `i64` counter of a device, converted into nanoseconds by its [`TickLength`].
//!   What a tick means on the host's clock is the business of a clock map.

use std::fmt;
use std::ops::{Add, Sub};

use chrono::{DateTime, SecondsFormat};
use serde::{Deserialize, Serialize};

/// Nanoseconds in a second.
pub const NS_PER_S: i64 = 1_000_000_000;

/// An instant on the recording machine's `CLOCK_MONOTONIC`, ns.
///
/// ```
/// use session_archive::time::{HostTime, NS_PER_S};
///
/// let started = HostTime(5 * NS_PER_S);
/// let frame = started + 33_333_333;
/// assert_eq!(frame - started, 33_333_333);
/// assert_eq!(frame.to_string(), "5.033333333 s");
/// // Sums are clamped at the ends of the range.
/// assert_eq!(HostTime::MAX + 1, HostTime::MAX);
/// ```
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct HostTime(pub i64);

impl HostTime {
    /// The earliest representable instant; before everything recorded.
    pub const MIN: Self = Self(i64::MIN);
    /// The latest representable instant; after everything recorded.
    pub const MAX: Self = Self(i64::MAX);

    /// Nanoseconds, as stored.
    pub const fn ns(self) -> i64 {
        self.0
    }

    /// This instant plus `ns`, clamped at the ends of the range.
    #[must_use]
    pub const fn saturating_add(self, ns: i64) -> Self {
        Self(self.0.saturating_add(ns))
    }

    /// Nanoseconds from `earlier` to `self` (negative if `earlier` is later), clamped.
    pub const fn since(self, earlier: Self) -> i64 {
        self.0.saturating_sub(earlier.0)
    }
}

impl Add<i64> for HostTime {
    type Output = Self;
    fn add(self, ns: i64) -> Self {
        self.saturating_add(ns)
    }
}

impl Sub for HostTime {
    type Output = i64;
    fn sub(self, earlier: Self) -> i64 {
        self.since(earlier)
    }
}

impl fmt::Display for HostTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let ns = self.0.unsigned_abs();
        write!(
            f,
            "{sign}{}.{:09} s",
            ns / NS_PER_S as u64,
            ns % NS_PER_S as u64
        )
    }
}

/// UTC, ns since 1970-01-01T00:00:00Z, leap seconds not counted.
///
/// ```
/// use session_archive::time::CivilTime;
///
/// let started = CivilTime(1_403_715_273_262_142_976);
/// assert_eq!(started.to_string(), "2014-06-25T16:54:33.262Z");
/// ```
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct CivilTime(pub i64);

impl fmt::Display for CivilTime {
    /// RFC 3339 with milliseconds, the rest cut off, as in `2026-11-21T02:03:17.250Z`. Every `i64`
    /// is a date.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let time = DateTime::from_timestamp_nanos(self.0);
        f.write_str(&time.to_rfc3339_opts(SecondsFormat::Millis, true))
    }
}

/// Length of one device tick as an exact ratio of nanoseconds.
///
/// ```
/// use session_archive::time::{NS_PER_S, TickLength};
///
/// // An hour of the 25.6 kHz counter, without the error that a period of 39062 ns would give.
/// let hour = 3600 * 25_600;
/// assert_eq!(TickLength::ZED_MINI.ns(hour), Some(3600 * NS_PER_S));
/// assert_eq!(TickLength::NANOSECOND.ns(hour), Some(hour));
/// // What does not fit is none, not a wrong instant.
/// assert_eq!(TickLength { num: 1000, den: 1 }.ns(i64::MAX), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TickLength {
    /// Numerator, ns.
    pub num: u32,
    /// Denominator.
    pub den: u32,
}

impl TickLength {
    /// One tick is one nanosecond.
    pub const NANOSECOND: Self = Self { num: 1, den: 1 };
    /// The ZED Mini's IMU counter: 1/25600 s = 39062.5 ns (zed-open-capture, sensorcapture).
    pub const ZED_MINI: Self = Self {
        num: 78_125,
        den: 2,
    };

    /// Exact length of `ticks` in ns, rounded to nearest; `None` if it leaves the i64 range or
    /// the denominator is zero.
    pub fn ns(self, ticks: i64) -> Option<i64> {
        let (num, den) = (i128::from(self.num), i128::from(self.den));
        if den == 0 {
            return None;
        }
        i64::try_from((i128::from(ticks) * num + den / 2).div_euclid(den)).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn civil_time_prints_as_rfc_3339() {
        let cases = [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400 * NS_PER_S, "2000-02-29T00:00:00.000Z"),
            (1_403_715_273_262_142_976, "2014-06-25T16:54:33.262Z"),
            (
                4_107_542_399 * NS_PER_S + 999_999_999,
                "2100-02-28T23:59:59.999Z",
            ),
            (-1, "1969-12-31T23:59:59.999Z"),
            (i64::MIN, "1677-09-21T00:12:43.145Z"),
            (i64::MAX, "2262-04-11T23:47:16.854Z"),
        ];
        for (ns, text) in cases {
            assert_eq!(CivilTime(ns).to_string(), text);
        }
    }

    #[test]
    fn zed_mini_ticks_stay_exact_over_a_month() {
        let month_ticks = 30 * 24 * 3600 * 25_600_i64;
        assert_eq!(
            TickLength::ZED_MINI.ns(month_ticks),
            Some(30 * 24 * 3600 * NS_PER_S)
        );
        assert_eq!(TickLength::ZED_MINI.ns(1), Some(39_063));
        assert_eq!(TickLength::ZED_MINI.ns(2), Some(78_125));
        assert_eq!(TickLength { num: 1, den: 0 }.ns(1), None);
        assert_eq!(
            TickLength {
                num: u32::MAX,
                den: 1
            }
            .ns(i64::MAX),
            None
        );
    }
}
