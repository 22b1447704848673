//! The input report: one IMU sample as the camera's microcontroller sends it. Pure: bytes in,
//! numbers out.
//!
//! 62 bytes of a read of 64, packed, little endian (Stereolabs' zed-open-capture,
//! `sensorcapture_def.hpp` at 9373915). Byte 0 is the kind of report, 0 from a ZED Mini and 1 from
//! a ZED 2 or 2i. Whether a real ZED Mini's reports are numbered has not been seen: where the
//! number comes in front of the report, the read has 65 bytes, and the first is passed over.
//!
//! * *Every number remains as the device sent it.* The scales are constants here; stored samples
//!   keep the counts and the scale.
//! * *A read that is no report* is a [`ReportError`] that says what was found and what was
//!   expected.
//! * *A report that the device itself calls not valid* is a [`Sample`] with `valid` false: its
//!   ticks and frame sync count, its measurements do not.
//!
//! Never compared with a real device.

/// Length of a read without a report number in front.
pub const REPORT_BYTES: usize = 64;
/// Bytes of a report that carry something.
const USED_BYTES: usize = 62;

/// Ticks in a second: a tick is 39.0625 us (`TS_SCALE` 39062.5 ns in `sensorcapture_def.hpp`).
pub const TICKS_PER_S: u64 = 25_600;
/// Degrees per second of one count of the gyroscope (`GYRO_SCALE` in `sensorcapture_def.hpp`).
pub const GYRO_DEG_PER_S: f64 = 1000.0 / 32768.0;
/// Metres per second squared of one count of the accelerometer (`ACC_SCALE` in
/// `sensorcapture_def.hpp`: 8 g with g = 9.8189). The vendor's SDK tells a range of 8 x 9.81
/// (zed-sdk issue 487), so the counts are what to keep.
pub const ACCEL_M_PER_S2: f64 = 9.8189 * 8.0 / 32768.0;
/// Degrees Celsius of one count of a temperature (`TEMP_SCALE`).
pub const TEMPERATURE_C: f64 = 0.01;
/// Microtesla of one count of the magnetometer (`MAG_SCALE`).
pub const MAGNETIC_UT: f64 = 1.0 / 16.0;

/// An invalid temperature (`TEMP_NOT_VALID`).
const NO_TEMPERATURE: i16 = -27315;
/// A field that holds a new value (`NEW_VAL`; 0 is none, 1 an old one).
const NEW: u8 = 2;

/// One sample, in the device's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Whether the device vouches for the measurements.
    pub valid: bool,
    /// The device's clock, 1/25600 s. Its time fits into nanoseconds in an `i64`.
    pub ticks: u64,
    /// Angular rate x y z, counts of [`GYRO_DEG_PER_S`].
    pub gyro: [i16; 3],
    /// Specific force x y z, counts of [`ACCEL_M_PER_S2`].
    pub accel: [i16; 3],
    /// This is the first sample since a camera frame began.
    pub frame_sync: bool,
    /// The camera tells the microcontroller of its frames; otherwise frame sync means nothing.
    pub sync_active: bool,
    /// Frames that the microcontroller counted by frame sync.
    pub sync_count: u32,
    /// Temperature of the IMU, 0.01 degC.
    pub temperature: i16,
    /// Magnetic field x y z, counts of [`MAGNETIC_UT`], where the report brings a new one (ZED 2
    /// and 2i).
    pub magnetic: Option<[i16; 3]>,
    /// The environment, where the report brings a new measurement (ZED 2 and 2i).
    pub environment: Option<Environment>,
    /// Times that the IMU noticed motion.
    pub moving_count: u32,
    /// Times that the IMU noticed free fall.
    pub falling_count: u32,
}

/// What a ZED 2 or 2i measures around it. Units of pressure and humidity depend on the firmware:
/// 0.01 hPa and 1/1024 %rH before 3.9, 0.0001 hPa and 0.01 %rH from then on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Environment {
    /// Temperature, 0.01 degC.
    pub temperature: i16,
    /// Air pressure.
    pub pressure: u32,
    /// Relative humidity.
    pub humidity: u32,
    /// Temperatures of the left and the right imager, 0.01 degC, where they are known.
    pub imagers: Option<[i16; 2]>,
}

/// Why a read is no sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReportError {
    /// Something else answers, or the link loses bytes.
    #[error(
        "reading an IMU report: found {found} bytes, expected {REPORT_BYTES}, or 65 with a report number in front"
    )]
    Length {
        /// Bytes that were read.
        found: usize,
    },
    /// Another kind of report, or another device.
    #[error(
        "reading an IMU report: found kind {found:#04x}, expected 0x00 (ZED Mini) or 0x01 (ZED 2, 2i)"
    )]
    Kind {
        /// The first byte.
        found: u8,
    },
    /// The clock is out of any range, so the bytes are damaged.
    #[error("reading an IMU report: the device's clock shows {found} ticks, more than 290 years")]
    Ticks {
        /// What it shows.
        found: u64,
    },
}

impl Sample {
    /// Reads a report as a hidraw read delivers it.
    ///
    /// # Errors
    /// See [`ReportError`].
    pub fn parse(read: &[u8]) -> Result<Self, ReportError> {
        let report = match read.len() {
            USED_BYTES..=REPORT_BYTES => read,
            65 => &read[1..],
            found => return Err(ReportError::Length { found }),
        };
        if report[0] > 1 {
            return Err(ReportError::Kind { found: report[0] });
        }
        let ticks = u64::from_le_bytes(bytes(report, 2));
        if ticks_ns(ticks).is_none() {
            return Err(ReportError::Ticks { found: ticks });
        }
        let i16_at = |at| i16::from_le_bytes(bytes(report, at));
        let u32_at = |at| u32::from_le_bytes(bytes(report, at));
        let xyz = |at| [i16_at(at), i16_at(at + 2), i16_at(at + 4)];
        let imagers = [i16_at(58), i16_at(60)];
        Ok(Self {
            valid: report[1] == 0,
            ticks,
            gyro: xyz(10),
            accel: xyz(16),
            frame_sync: report[22] != 0,
            sync_active: report[23] != 0,
            sync_count: u32_at(24),
            temperature: i16_at(28),
            magnetic: (report[30] == NEW).then(|| xyz(31)),
            moving_count: u32_at(38),
            falling_count: u32_at(43),
            environment: (report[47] == NEW).then(|| Environment {
                temperature: i16_at(48),
                pressure: u32_at(50),
                humidity: u32_at(54),
                imagers: (!imagers.contains(&NO_TEMPERATURE)).then_some(imagers),
            }),
        })
    }

    /// The device's clock, ns.
    pub fn device_ns(&self) -> i64 {
        ticks_ns(self.ticks).unwrap_or(i64::MAX)
    }
}

/// Ticks as nanoseconds, exactly but for the half nanosecond of an odd tick, which is rounded up as
/// in the archive. None beyond 292 years.
pub(crate) fn ticks_ns(ticks: u64) -> Option<i64> {
    i64::try_from((u128::from(ticks) * 78_125).div_ceil(2)).ok()
}

/// `N` bytes at `at`; the caller knows that they are there.
fn bytes<const N: usize>(report: &[u8], at: usize) -> [u8; N] {
    std::array::from_fn(|k| report[at + k])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rig_sim::device::{DeviceImu, clock::IMU_TICK};

    use super::*;

    fn device_sample() -> impl Strategy<Value = DeviceImu> {
        (
            0..1_i64 << 47,
            any::<[i16; 3]>(),
            any::<[i16; 3]>(),
            any::<(i16, bool, u32)>(),
        )
            .prop_map(
                |(ticks, gyro, accel, (temperature, frame_sync, count))| DeviceImu {
                    number: 0,
                    index: 0,
                    ticks,
                    arrival_ns: 0,
                    taken_ns: 0,
                    gyro,
                    accel,
                    temperature,
                    frame_sync,
                    frame_sync_count: count,
                },
            )
    }

    proptest! {
        /// The simulated device is the other side: what it writes is what is read, with a report
        /// number or without.
        #[test]
        fn what_the_simulated_device_sends_is_read(sent in device_sample()) {
            let report = sent.report();
            let numbered: Vec<u8> = [&[1], &report[..]].concat();
            for read in [&report[..], &numbered, &report[..USED_BYTES]] {
                let sample = Sample::parse(read).expect("a report");
                prop_assert_eq!(sample.ticks as i64, sent.ticks);
                prop_assert_eq!((sample.gyro, sample.accel), (sent.gyro, sent.accel));
                prop_assert_eq!(sample.temperature, sent.temperature);
                prop_assert_eq!((sample.frame_sync, sample.sync_count), (sent.frame_sync, sent.frame_sync_count));
                prop_assert!(sample.valid && sample.sync_active);
                prop_assert_eq!((sample.magnetic, sample.environment), (None, None));
                prop_assert_eq!(Some(sample.device_ns()), IMU_TICK.ns(sent.ticks));
            }
        }

        /// Two ticks are 78125 ns, from the first tick to beyond any uptime, without an error that
        /// grows.
        #[test]
        fn ticks_are_exact(ticks in 0..2 * TICKS_PER_S * 86_400 * 365 * 100) {
            let ns = ticks_ns(ticks).expect("in range");
            prop_assert_eq!(i128::from(ns) * 2, i128::from(ticks) * 78_125 + i128::from(ticks % 2));
        }

        /// Any bytes give an answer.
        #[test]
        fn any_bytes_are_safe(read in prop::collection::vec(any::<u8>(), 0..80)) {
            let parsed = Sample::parse(&read);
            if !(USED_BYTES..=65).contains(&read.len()) {
                prop_assert_eq!(parsed, Err(ReportError::Length { found: read.len() }));
            }
        }
    }

    #[test]
    fn thirty_days_to_the_nanosecond() {
        let days = 30 * 86_400 * TICKS_PER_S;
        assert_eq!(ticks_ns(days), Some(30 * 86_400 * 1_000_000_000));
        assert_eq!(
            ticks_ns(days + 1),
            Some(30 * 86_400 * 1_000_000_000 + 39_063)
        );
        assert_eq!(
            ticks_ns(days + 2),
            Some(30 * 86_400 * 1_000_000_000 + 78_125)
        );
        assert_eq!(ticks_ns(u64::MAX), None);
    }

    #[test]
    fn what_is_no_report_is_refused_with_what_was_found() {
        let mut report = [0; REPORT_BYTES];
        let length = Sample::parse(&report[..61]).expect_err("short");
        assert_eq!(
            length.to_string(),
            "reading an IMU report: found 61 bytes, expected 64, or 65 with a report number in front"
        );
        report[0] = 2;
        assert_eq!(Sample::parse(&report), Err(ReportError::Kind { found: 2 }));
        report[0] = 1;
        report[2..10].fill(0xff);
        let found = u64::MAX;
        assert_eq!(Sample::parse(&report), Err(ReportError::Ticks { found }));
    }

    #[test]
    fn a_zed_2_brings_more() {
        let mut report = [0; REPORT_BYTES];
        report[0] = 1;
        report[1] = 1;
        report[30] = NEW;
        report[31..37].copy_from_slice(&[1, 0, 2, 0, 3, 0]);
        report[38] = 7;
        report[43] = 8;
        report[47] = NEW;
        report[48] = 9;
        report[50] = 10;
        report[54] = 11;
        report[58..62].copy_from_slice(&[12, 0, 13, 0]);
        let sample = Sample::parse(&report).expect("a report");
        assert!(!sample.valid);
        assert_eq!(sample.magnetic, Some([1, 2, 3]));
        assert_eq!((sample.moving_count, sample.falling_count), (7, 8));
        let environment = Environment {
            temperature: 9,
            pressure: 10,
            humidity: 11,
            imagers: Some([12, 13]),
        };
        assert_eq!(sample.environment, Some(environment));
        report[58..60].copy_from_slice(&NO_TEMPERATURE.to_le_bytes());
        let imagers = Sample::parse(&report).expect("a report").environment;
        assert_eq!(imagers.and_then(|e| e.imagers), None);
    }
}
