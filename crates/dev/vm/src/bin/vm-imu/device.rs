//! The microcontroller itself: a clock, a stream, commands, and what goes wrong. Pure: time comes
//! in, reports go out.
//!
//! Samples lie on a grid of the device's clock from when it is switched on, whether or not anybody
//! listens. Frames begin on a grid of the host's clock; the first sample at or after one carries
//! the flag and the new count.

use std::str::FromStr;

use rig_sim::device::DeviceImu;

/// Ticks of the device's clock in a second.
pub(crate) const TICKS_PER_S: u64 = 25_600;
/// The feature report that starts and stops the stream.
pub(crate) const STREAM: u8 = 0x32;
const REQUEST: u8 = 0x21;
const PING: u8 = 0xf2;
const RESET: u8 = 0xe1;
const NS_PER_S: i128 = 1_000_000_000;

/// A span of time in seconds, written FROM:FOR.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    from_s: f64,
    for_s: f64,
}

impl Span {
    /// From when to when, ns, if time begins at `begin`.
    pub(crate) fn at(self, begin: i64) -> (i64, i64) {
        let from = begin + (self.from_s * 1e9) as i64;
        (from, from + (self.for_s * 1e9) as i64)
    }
}

impl FromStr for Span {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(':');
        let numbers = parts.and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
        let (from_s, for_s) =
            numbers.ok_or(format!("found {text:?}, expected FROM:FOR in seconds"))?;
        Ok(Self { from_s, for_s })
    }
}

/// What the device is and what goes wrong with it. Times are ns of the host.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) rate: u32,
    pub(crate) clock_ppb: i64,
    pub(crate) uptime_ticks: u64,
    pub(crate) frame_ns: Option<f64>,
    pub(crate) frame_phase: i64,
    /// 0 for never.
    pub(crate) keep_alive: i64,
    pub(crate) silent: Vec<(i64, i64)>,
    pub(crate) stopped: Vec<i64>,
    pub(crate) deaf_from: i64,
    pub(crate) ignore_starts: u32,
    pub(crate) lose: Option<u64>,
    pub(crate) invalid: Option<u64>,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Device {
    settings: Settings,
    /// When it was switched on.
    on: i64,
    streaming: bool,
    pinged: i64,
    /// The next sample since it was switched on.
    next: u64,
    /// Frames that had begun when it was switched on.
    frames_before: i64,
    /// Frames since then.
    frames: i64,
    starts: Vec<u64>,
    lost: u64,
    not_valid: u64,
    pings: u64,
    changes: Vec<String>,
}

impl Device {
    pub(crate) fn new(settings: Settings, now: i64) -> Self {
        let mut device = Self {
            settings,
            on: now,
            streaming: false,
            pinged: now,
            next: 0,
            frames_before: 0,
            frames: 0,
            starts: Vec::new(),
            lost: 0,
            not_valid: 0,
            pings: 0,
            changes: Vec::new(),
        };
        device.power_on(now);
        device
    }

    /// It is plugged in, or was reset: everything restarts except the counts for the end.
    pub(crate) fn power_on(&mut self, now: i64) {
        self.on = now;
        self.streaming = false;
        self.next = 0;
        self.frames_before = self.begun(now);
        self.frames = 0;
    }

    /// Takes a feature report; what it did, or why it was refused.
    pub(crate) fn command(&mut self, report: &[u8], now: i64) -> Result<String, String> {
        match *report {
            [STREAM, 1, ..] => {
                if now >= self.settings.deaf_from && self.settings.ignore_starts > 0 {
                    self.settings.ignore_starts -= 1;
                    return Ok("start, ignored".into());
                }
                self.pinged = now;
                if !self.streaming {
                    self.streaming = true;
                    self.starts.push(0);
                    // Only what is measured from now on is sent.
                    self.next = self.next.max(self.first_after(now));
                    self.frames = self.begun(now) - self.frames_before;
                }
                Ok("start".into())
            }
            [STREAM, 0, ..] => {
                self.streaming = false;
                Ok(format!("stop, sent {}", self.starts.last().unwrap_or(&0)))
            }
            [REQUEST, PING, ..] => {
                self.pinged = now;
                self.pings += 1;
                Ok("ping".into())
            }
            [REQUEST, RESET, ..] => {
                self.power_on(now);
                Ok("reset".into())
            }
            _ => Err("refused".into()),
        }
    }

    pub(crate) fn is_streaming(&self) -> bool {
        self.streaming
    }

    /// When something is to be done next, ns.
    pub(crate) fn next_due(&self) -> i64 {
        if self.streaming {
            self.taken(self.next)
        } else {
            i64::MAX
        }
    }

    /// The next report that is due at `now`.
    pub(crate) fn sample(&mut self, now: i64) -> Option<Vec<u8>> {
        self.end_stream(now);
        while self.streaming && self.taken(self.next) <= now {
            let n = self.next;
            self.next += 1;
            let taken = self.taken(n);
            let frames = self.begun(taken) - self.frames_before;
            let frame_sync = frames > self.frames;
            self.frames = frames;
            if self
                .settings
                .silent
                .iter()
                .any(|(from, to)| (*from..*to).contains(&taken))
            {
                continue;
            }
            if is_one_in(self.settings.lose, n, 1) {
                self.lost += 1;
                continue;
            }
            if let Some(sent) = self.starts.last_mut() {
                *sent += 1;
            }
            return Some(self.report(n, taken, frame_sync));
        }
        None
    }

    /// What has changed by itself since the last call, for people.
    pub(crate) fn changes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.changes)
    }

    /// Samples sent since each start.
    pub(crate) fn starts(&self) -> &[u64] {
        &self.starts
    }

    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }

    pub(crate) fn not_valid(&self) -> u64 {
        self.not_valid
    }

    pub(crate) fn pings(&self) -> u64 {
        self.pings
    }

    /// Frames since it was switched on.
    pub(crate) fn frames(&self) -> i64 {
        self.frames
    }

    /// Ends the stream where nobody pings, or where that was planned.
    fn end_stream(&mut self, now: i64) {
        let due = |at: &i64| *at <= now;
        if self.settings.stopped.iter().any(due) {
            self.settings.stopped.retain(|at| *at > now);
            self.end("by itself");
        }
        let keep_alive = self.settings.keep_alive;
        if keep_alive > 0 && now - self.pinged >= keep_alive {
            self.end("for want of pings");
        }
    }

    fn end(&mut self, why: &str) {
        if std::mem::take(&mut self.streaming) {
            let sent = self.starts.last().unwrap_or(&0);
            self.changes
                .push(format!("the stream ended {why}, sent {sent}"));
        }
    }

    fn report(&mut self, n: u64, taken: i64, frame_sync: bool) -> Vec<u8> {
        // A swing to and fro about each axis, and gravity.
        let wave = |k: u64| ((n * k % 4096) as i16 - 2048).abs() * 8 - 8192;
        let sample = DeviceImu {
            number: n,
            index: n,
            ticks: self.ticks(n) as i64,
            arrival_ns: taken,
            taken_ns: taken,
            gyro: [wave(1), wave(2), wave(3)],
            accel: [wave(1) / 8, wave(2) / 8, 4091],
            temperature: 3125,
            frame_sync,
            frame_sync_count: self.frames as u32,
        };
        let mut report = sample.report().to_vec();
        if self.settings.frame_ns.is_none() {
            report[22..28].fill(0);
        }
        if is_one_in(self.settings.invalid, n, 2) {
            report[1] = 1;
            self.not_valid += 1;
        }
        report
    }

    /// Ticks of sample `n`.
    fn ticks(&self, n: u64) -> u64 {
        self.settings.uptime_ticks + self.grid(n)
    }

    fn grid(&self, n: u64) -> u64 {
        (u128::from(n) * u128::from(TICKS_PER_S) / u128::from(self.settings.rate)) as u64
    }

    /// When sample `n` is taken, ns of the host.
    fn taken(&self, n: u64) -> i64 {
        let speed = NS_PER_S + i128::from(self.settings.clock_ppb);
        let device_ns = i128::from(self.grid(n)) * 78_125 / 2;
        self.on + (device_ns * NS_PER_S).div_euclid(speed) as i64
    }

    /// The first sample that is taken after `now`.
    fn first_after(&self, now: i64) -> u64 {
        let guess =
            (now - self.on).max(0) as u128 * u128::from(self.settings.rate) / NS_PER_S as u128;
        // The clock rate may deviate by some parts in a thousand.
        let mut n = (guess - guess / 256) as u64;
        while self.taken(n) <= now {
            n += 1;
        }
        n
    }

    /// Frames that have begun at a time, from the host's zero on.
    fn begun(&self, time: i64) -> i64 {
        let Some(period) = self.settings.frame_ns else {
            return 0;
        };
        ((time - self.settings.frame_phase) as f64 / period).floor() as i64
    }
}

/// The same choice in every run: one number in `n`.
fn is_one_in(n: Option<u64>, number: u64, salt: u64) -> bool {
    let Some(n) = n.filter(|&n| n > 0) else {
        return false;
    };
    let mut x = number
        .wrapping_add(salt << 48)
        .wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x ^= x >> 31;
    x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (x ^ (x >> 29)).is_multiple_of(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;
    const START: [u8; 2] = [STREAM, 1];

    fn settings() -> Settings {
        Settings {
            rate: 800,
            clock_ppb: 0,
            uptime_ticks: 0,
            frame_ns: Some(S as f64 / 30.0),
            frame_phase: 0,
            keep_alive: 6 * S,
            silent: Vec::new(),
            stopped: Vec::new(),
            deaf_from: 0,
            ignore_starts: 0,
            lose: None,
            invalid: None,
        }
    }

    /// Reports until `until`; pings each second on request.
    fn run(device: &mut Device, from: i64, until: i64, pings: bool) -> Vec<Vec<u8>> {
        let mut reports = Vec::new();
        for now in (from..until).step_by(1_000_000) {
            if pings && (now - from) % S == 0 {
                device.command(&[REQUEST, PING], now).expect("taken");
            }
            while let Some(report) = device.sample(now) {
                reports.push(report);
            }
        }
        reports
    }

    fn u64_at(report: &[u8], at: usize) -> u64 {
        u64::from_le_bytes(std::array::from_fn(|k| report[at + k]))
    }

    #[test]
    fn a_pinged_stream_goes_on_and_another_ends_after_six_seconds() {
        let mut device = Device::new(settings(), 0);
        assert!(run(&mut device, 0, S, true).is_empty(), "not started");
        device.command(&START, S).expect("taken");
        assert_eq!(run(&mut device, S, 21 * S, true).len(), 20 * 800 - 1);
        let left = run(&mut device, 21 * S, 40 * S, false).len();
        assert!((5 * 800 - 1..=5 * 800 + 1).contains(&left), "{left}");
        assert!(!device.is_streaming());
        device.command(&START, 40 * S).expect("taken");
        run(&mut device, 40 * S, 41 * S, true);
        assert_eq!(device.starts()[1], 799);
    }

    #[test]
    fn ticks_and_flags_are_on_their_grids() {
        let mut device = Device::new(settings(), 0);
        device.command(&START, 0).expect("taken");
        let reports = run(&mut device, 0, 10 * S, true);
        for pair in reports.windows(2) {
            assert_eq!(u64_at(&pair[1], 2) - u64_at(&pair[0], 2), 32);
        }
        let flagged: Vec<_> = reports.iter().filter(|r| r[22] == 1).collect();
        assert_eq!(flagged.len(), 299);
        for (k, report) in flagged.iter().enumerate() {
            assert_eq!(u64_at(report, 24) as u32, k as u32 + 1);
            let late = u64_at(report, 2) as f64 / 25_600.0 - (k as f64 + 1.0) / 30.0;
            assert!((-1e-9..1.25e-3).contains(&late), "{late}");
        }
    }

    #[test]
    fn faults_are_as_planned() {
        let mut device = Device::new(
            Settings {
                silent: vec![(2 * S, 3 * S)],
                stopped: vec![5 * S],
                deaf_from: 5 * S,
                ignore_starts: 2,
                lose: Some(10),
                invalid: Some(100),
                ..settings()
            },
            0,
        );
        device.command(&START, 0).expect("taken");
        let sent = run(&mut device, 0, 8 * S, true).len() as u64;
        assert_eq!(sent + device.lost(), 4 * 800 - 1);
        assert!((250..390).contains(&device.lost()), "{}", device.lost());
        assert!(
            (10..60).contains(&device.not_valid()),
            "{}",
            device.not_valid()
        );
        assert_eq!(device.changes().len(), 1);
        for streaming in [false, false, true] {
            device.command(&START, 8 * S).expect("taken");
            assert_eq!(device.is_streaming(), streaming);
        }
        device.command(&[REQUEST, RESET], 9 * S).expect("taken");
        assert!(!device.is_streaming());
        assert!(device.command(&[9, 9], 9 * S).is_err());
    }

    #[test]
    fn a_fast_clock_makes_samples_come_sooner() {
        let fast = Settings {
            clock_ppb: 100_000,
            ..settings()
        };
        let mut device = Device::new(fast, 0);
        device.command(&START, 0).expect("taken");
        assert_eq!(run(&mut device, 0, 100 * S, true).len(), 80_007);
    }
}
