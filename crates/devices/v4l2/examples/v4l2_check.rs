//! Checks V4L2 cameras: the nodes, their modes and controls, and whether frames arrive completely
//! and in time.
//!
//! ```text
//! cargo run -p v4l2 --example v4l2_check                                        lists nodes, modes and controls
//! cargo run -p v4l2 --example v4l2_check -- capture WxH[@FPS] FRAMES NODE...    captures from all nodes simultaneously
//!      --fourcc YUYV   --buffers 4   --set CONTROL=VALUE
//! ```
//!
//! A line per camera has the frames, missing numbers, damaged and short frames, the time from one
//! frame to the next by the driver's timestamps, and the age of a frame at its delivery. Exits with
//! 1 if a camera did not deliver all frames.
#![expect(
    clippy::disallowed_methods,
    reason = "a program for people at a desk; it reads the clock to compute the age of frames"
)]

use std::error::Error;
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use v4l2::stream::{Sequence, Step};
use v4l2::{Camera, Fourcc, Interval, Mode, Next, Stream, StreamError, node};

type Failure = Box<dyn Error + Send + Sync>;

const USAGE: &str = "v4l2_check [capture WxH[@FPS] FRAMES NODE... [--fourcc YUYV] [--buffers 4] [--set CONTROL=VALUE]]";
/// Longer than any camera's interval.
const PATIENCE: Duration = Duration::from_secs(2);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.split_first() {
        None => list().map(|()| true),
        Some((verb, rest)) if verb == "capture" => Plan::of(rest).map(|plan| plan.run()),
        Some(_) => Err(USAGE.into()),
    };
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{}", chain(&*error));
            ExitCode::FAILURE
        }
    }
}

fn chain(error: &(dyn Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(error) = source {
        let _ = write!(text, ": {error}");
        source = error.source();
    }
    text
}

fn list() -> Result<(), Failure> {
    for node in node::list(Path::new("/sys"), Path::new("/dev"))? {
        let captures = match &node.captures {
            Ok(true) => "captures".to_owned(),
            Ok(false) => "captures nothing".to_owned(),
            Err(error) => chain(error),
        };
        let driver = node.driver.as_deref().unwrap_or("no driver");
        println!("{node}, {driver}, index {}: {captures}", node.index);
        if let Some(usb) = &node.usb {
            println!("  {} Mbit/s, controller {}", usb.speed_mbit, usb.controller);
        }
        if matches!(node.captures, Ok(true)) {
            describe(&Camera::open(&node.path)?)?;
        }
    }
    Ok(())
}

fn describe(camera: &Camera) -> Result<(), Failure> {
    println!("  is set to {}", camera.format()?);
    for modes in camera.modes()? {
        println!("  {} ({})", modes.fourcc, modes.description);
        for size in modes.sizes {
            let rates: Vec<_> = size.intervals.iter().map(ToString::to_string).collect();
            println!("    {}: {}", size.sizes, rates.join(", "));
        }
    }
    for control in camera.controls()? {
        let value = if control.is_readable() {
            camera.control(control.id)?.to_string()
        } else {
            "-".into()
        };
        println!(
            "  {:#x} {:?} {} = {value} ({} to {} by {}, default {}{})",
            control.id,
            control.kind,
            control.name,
            control.minimum,
            control.maximum,
            control.step,
            control.default,
            if control.inactive { ", inactive" } else { "" }
        );
        for item in control.menu {
            println!("    {} {}", item.value, item.name);
        }
    }
    Ok(())
}

struct Plan {
    mode: Mode,
    frames: u32,
    buffers: u32,
    controls: Vec<(u32, i64)>,
    nodes: Vec<String>,
}

impl Plan {
    fn of(arguments: &[String]) -> Result<Self, Failure> {
        let mut positional = Vec::new();
        let (mut fourcc, mut buffers, mut controls) = (Fourcc(*b"YUYV"), 4, Vec::new());
        let mut rest = arguments.iter();
        while let Some(argument) = rest.next() {
            let mut value = || rest.next().ok_or(USAGE);
            match argument.as_str() {
                "--fourcc" => fourcc = value()?.parse()?,
                "--buffers" => buffers = value()?.parse()?,
                "--set" => {
                    let (id, number) = value()?.split_once('=').ok_or(USAGE)?;
                    let hexadecimal = id
                        .strip_prefix("0x")
                        .ok_or("a control is a number like 0x980900")?;
                    controls.push((u32::from_str_radix(hexadecimal, 16)?, number.parse()?));
                }
                _ => positional.push(argument.clone()),
            }
        }
        let [mode, frames, nodes @ ..] = positional.as_slice() else {
            return Err(USAGE.into());
        };
        let (size, rate) = mode.split_once('@').unwrap_or((mode, "30"));
        let (width, height) = size.split_once('x').ok_or(USAGE)?;
        Ok(Self {
            mode: Mode {
                fourcc,
                width: width.parse()?,
                height: height.parse()?,
                interval: Interval::of_rate(rate.parse()?),
            },
            frames: frames.parse()?,
            buffers,
            controls,
            nodes: nodes.to_vec(),
        })
    }

    /// Whether all cameras delivered all frames.
    fn run(&self) -> bool {
        thread::scope(|scope| {
            let running: Vec<_> = self
                .nodes
                .iter()
                .map(|node| {
                    scope.spawn(move || {
                        let result = self.capture(node);
                        match &result {
                            Ok(report) => println!("{node}: {report}"),
                            Err(error) => println!("{node}: {}", chain(&**error)),
                        }
                        result.is_ok_and(|report| report.end.is_none())
                    })
                })
                .collect();
            let mut all = true;
            for thread in running {
                all &= thread.join().is_ok_and(|one| one);
            }
            all
        })
    }

    fn capture(&self, node: &str) -> Result<Report, Failure> {
        let camera = Camera::open(Path::new(node))?;
        for not_taken in camera.write_and_check(&self.controls)? {
            println!("{node}: {not_taken}");
        }
        let format = camera.set_mode(&self.mode)?;
        let mut stream = Stream::start(&camera, self.buffers)?;
        let mut report = Report {
            mode: format.to_string(),
            buffers: stream.buffers(),
            ..Report::default()
        };
        while report.times.len() < self.frames as usize {
            // What is lent out has to be back before the stream can be restarted.
            let error = match stream.next(PATIENCE) {
                Ok(Next::Frame(buffer)) => {
                    report.note(&buffer);
                    continue;
                }
                Ok(Next::Nothing) => {
                    report.end = Some(format!("no frame for {} s", PATIENCE.as_secs()));
                    break;
                }
                Err(error) => error,
            };
            if !matches!(error, StreamError::Interrupted { .. }) || report.restarts == 3 {
                report.end = Some(chain(&error));
                break;
            }
            println!("{node}: {}, restarting", chain(&error));
            report.restarts += 1;
            report.sequence = Sequence::default();
            stream.restart()?;
        }
        Ok(report)
    }
}

#[derive(Default)]
struct Report {
    mode: String,
    buffers: usize,
    sequence: Sequence,
    missed: u64,
    odd_steps: u64,
    corrupt: u64,
    short: u64,
    restarts: u64,
    stamps: String,
    times: Vec<i64>,
    ages: Vec<i64>,
    /// Of all bytes looked at, so that the frames are really read.
    sum: u64,
    end: Option<String>,
}

impl Report {
    fn note(&mut self, buffer: &v4l2::Buffer<'_>) {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        let info = buffer.info();
        match self.sequence.follow(info.sequence) {
            Step::First | Step::Next => {}
            Step::Missed(count) => self.missed += u64::from(count),
            Step::Repeated | Step::Back(_) => self.odd_steps += 1,
        }
        self.corrupt += u64::from(info.corrupt);
        self.short += u64::from(info.short);
        if self.stamps.is_empty() {
            self.stamps = format!("{:?} {:?}", info.clock, info.stamped);
        }
        self.ages
            .push(now.tv_sec * 1_000_000_000 + now.tv_nsec - info.time_ns);
        self.times.push(info.time_ns);
        self.sum += buffer
            .bytes()
            .iter()
            .step_by(4096)
            .map(|b| u64::from(*b))
            .sum::<u64>();
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}, {} buffers: {} frames, missed {}, odd steps {}, corrupt {}, short {}, restarts {}, stamps {}",
            self.mode,
            self.buffers,
            self.times.len(),
            self.missed,
            self.odd_steps,
            self.corrupt,
            self.short,
            self.restarts,
            self.stamps
        )?;
        let steps = self
            .times
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect();
        if let Some([least, median, greatest]) = spread(steps) {
            write!(f, "; dt {least:.3} {median:.3} {greatest:.3} ms")?;
        }
        if let Some([least, median, greatest]) = spread(self.ages.clone()) {
            write!(f, "; age {least:.3} {median:.3} {greatest:.3} ms")?;
        }
        write!(f, "; sum {}", self.sum)?;
        match &self.end {
            Some(end) => write!(f, "; ended: {end}"),
            None => Ok(()),
        }
    }
}

/// Least, median and greatest, ns to ms.
fn spread(mut values: Vec<i64>) -> Option<[f64; 3]> {
    values.sort_unstable();
    let at = |i: usize| values[i] as f64 / 1e6;
    let last = values.len().checked_sub(1)?;
    Some([at(0), at(values.len() / 2), at(last)])
}
