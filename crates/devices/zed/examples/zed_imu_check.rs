//! Checks the IMU of a ZED camera: samples received and lost, restarts of the driver, frame syncs.
//!
//! ```text
//! cargo run -p zed --example zed_imu_check -- [SECONDS] [--serial N] [--without-pings]
//! ```
//!
//! Prints every event that is not a sample, and at the end the counts. With `--without-pings` the
//! driver's pings do not reach the device: it falls silent after six seconds and is started again.
//! Exits with 1 if a sample was lost.

#![expect(
    clippy::disallowed_methods,
    reason = "a program for people at a desk has a clock of its own"
)]

use std::env;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use zed::command::Command;
use zed::imu::{Event, HidPort, Imu, Link, LinkError, OpenError, Port, list};

const S: i64 = 1_000_000_000;
const RETRY_NS: i64 = 100_000_000;

/// Drops pings on request.
struct Pings<T> {
    inner: T,
    swallowed: bool,
}

impl<P: Port> Port for Pings<P> {
    type Link = Pings<P::Link>;

    fn open(&mut self) -> Result<Self::Link, OpenError> {
        Ok(Pings {
            inner: self.inner.open()?,
            swallowed: self.swallowed,
        })
    }
}

impl<L: Link> Link for Pings<L> {
    fn read(&mut self, report: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        self.inner.read(report, timeout)
    }

    fn set_feature(&mut self, report: &[u8]) -> Result<(), LinkError> {
        if self.swallowed && report == Command::Ping.report() {
            return Ok(());
        }
        self.inner.set_feature(report)
    }

    fn get_feature(&mut self, report: &mut [u8]) -> Result<usize, LinkError> {
        self.inner.get_feature(report)
    }
}

fn main() -> ExitCode {
    match check() {
        Ok(lost) if lost > 0 => ExitCode::FAILURE,
        Ok(_) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("zed_imu_check: {error}");
            ExitCode::FAILURE
        }
    }
}

/// How many samples were lost.
fn check() -> Result<u64, Box<dyn std::error::Error>> {
    let mut seconds = 5.0;
    let mut port = Pings {
        inner: HidPort::default(),
        swallowed: false,
    };
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--serial" => port.inner.serial = arguments.next(),
            "--without-pings" => port.swallowed = true,
            number => seconds = number.parse()?,
        }
    }
    for found in list()? {
        println!("zed_imu_check: found {found:?}");
    }
    let begin = Instant::now();
    let clock = || begin.elapsed().as_nanos() as i64;
    let until = (seconds * S as f64) as i64;
    let mut imu = Imu::open(port, clock())?;
    let (mut last_number, mut syncs) = (None, 0);
    while clock() < until {
        match imu.next(&clock, until) {
            Event::Sample(arrival) => {
                syncs += u64::from(arrival.sample.frame_sync);
                last_number = Some(arrival.numbered.number);
            }
            Event::Nothing => {}
            Event::Gone { detail } => {
                println!("@{:.3} gone: {detail}", clock() as f64 / 1e9);
                wait_for_it(&mut imu, &clock, until);
            }
            event => println!("@{:.3} {event:?}", clock() as f64 / 1e9),
        }
    }
    let rate = imu.rate_hz().unwrap_or(0.0);
    let (left, counters) = imu.finish(&clock);
    last_number = left.last().map(|a| a.numbered.number).or(last_number);
    println!(
        "end: received {}, lost {}, last number {last_number:?}, rate {rate:.3} Hz, frame syncs {syncs}; {counters:?}",
        counters.samples, counters.lost,
    );
    Ok(counters.lost)
}

/// Returns when the device is there again, or the time is over.
fn wait_for_it<P: Port>(imu: &mut Imu<P>, clock: &dyn Fn() -> i64, until: i64) {
    let mut watch = v4l2::hotplug::Watch::new(["/dev"]).ok();
    while !imu.is_open() && clock() < until {
        match imu.try_reopen(clock()) {
            Ok(()) => println!("@{:.3} there again", clock() as f64 / 1e9),
            Err(_) => {
                let wait = Duration::from_nanos(RETRY_NS as u64);
                match &mut watch {
                    Some(watch) => drop(watch.next(wait)),
                    None => std::thread::sleep(wait),
                }
            }
        }
    }
}
