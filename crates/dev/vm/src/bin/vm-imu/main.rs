//! `vm-imu`: a simulated ZED Mini microcontroller. It is behind the kernel's own HID drivers, by
//! uhid, and speaks the protocol as it was published: input reports, commands to start and stop,
//! the keep-alive without which the stream ends, reset; and it fails on request.
//!
//! It lives by absolute deadlines on CLOCK_MONOTONIC and sleeps in ppoll until the next, so that it
//! also works where time is virtual. A sample that is due is never left out because the program
//! came late; the queue behind it holds 64 reports, so after a stall reports go out in small
//! parcels.
//!
//! What is printed: a line for each command and each change, and at the end (`--seconds`, SIGTERM
//! or SIGINT) one with the samples sent since each start.

mod device;
mod numbering;
mod uhid;

use std::io;
use std::os::fd::AsFd;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result};
use clap::Parser;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::time::{ClockId, clock_gettime};

use crate::device::{Device, Settings, Span};
use crate::numbering::Numbering;
use crate::uhid::{Identity, Request, Uhid};

const S: i64 = 1_000_000_000;
/// Reports sent in one burst, and the pause before the next: 2000 in a second, when there is
/// something to catch up.
const PARCEL: usize = 8;
const PAUSE_NS: i64 = 4_000_000;

/// A simulated ZED Mini IMU behind /dev/uhid.
#[derive(Parser, Debug)]
struct Arguments {
    /// Samples per second of the device's clock.
    #[arg(long, default_value_t = 800)]
    rate: u32,
    /// How long to run; forever without.
    #[arg(long)]
    seconds: Option<f64>,
    /// What the device calls itself; "" for a device without a serial number.
    #[arg(long, default_value = "15618")]
    serial: String,
    /// USB product number, hexadecimal.
    #[arg(long, default_value = "f681", value_parser = |s: &str| u16::from_str_radix(s, 16))]
    product: u16,
    /// How reports are numbered.
    #[arg(long, value_enum, default_value_t = Numbering::None)]
    numbering: Numbering,
    /// How much faster than the host's the device's clock runs, parts in 1e9.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    clock_ppb: i64,
    /// Uptime that the device's clock begins with, s.
    #[arg(long, default_value_t = 0)]
    uptime: u64,
    /// Frames per second of the frame sync that the device receives; 0 for none.
    #[arg(long, default_value_t = 0.0)]
    frames: f64,
    /// A time on CLOCK_MONOTONIC at which a frame begins, ns.
    #[arg(long, default_value_t = 0)]
    frame_phase: i64,
    /// The stream ends so long after the last ping, s; 0 for never.
    #[arg(long, default_value_t = 6.0)]
    keep_alive: f64,
    /// Samples are made but not sent, FROM:FOR seconds since the program began. May be given
    /// several times.
    #[arg(long)]
    silent: Vec<Span>,
    /// The device is unplugged, FROM:FOR seconds.
    #[arg(long)]
    gone: Vec<Span>,
    /// The stream ends by itself at this second.
    #[arg(long)]
    stopped: Vec<f64>,
    /// Commands to start that do nothing from the first `--stopped` on, or from the beginning.
    #[arg(long, default_value_t = 0)]
    ignore_starts: u32,
    /// One sample in this number is lost in transit, at random.
    #[arg(long)]
    lose: Option<u64>,
    /// One sample in this number is marked not valid by the device, at random.
    #[arg(long)]
    invalid: Option<u64>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vm-imu: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Time on CLOCK_MONOTONIC, ns.
#[expect(
    clippy::disallowed_methods,
    reason = "the one clock of this program, which plays a device"
)]
fn now() -> i64 {
    let time = clock_gettime(ClockId::Monotonic);
    time.tv_sec * S + time.tv_nsec
}

fn seconds(s: f64) -> i64 {
    (s * S as f64) as i64
}

fn run(arguments: &Arguments) -> Result<()> {
    let begin = now();
    let end = arguments.seconds.map_or(i64::MAX, |s| begin + seconds(s));
    let absolute = |spans: &[Span]| spans.iter().map(|s| s.at(begin)).collect::<Vec<_>>();
    let gone = absolute(&arguments.gone);
    let stopped: Vec<i64> = arguments
        .stopped
        .iter()
        .map(|&s| begin + seconds(s))
        .collect();
    let mut device = Device::new(
        Settings {
            rate: arguments.rate.max(1),
            clock_ppb: arguments.clock_ppb,
            uptime_ticks: arguments.uptime * device::TICKS_PER_S,
            frame_ns: (arguments.frames > 0.0).then(|| S as f64 / arguments.frames),
            frame_phase: arguments.frame_phase,
            keep_alive: seconds(arguments.keep_alive),
            silent: absolute(&arguments.silent),
            deaf_from: stopped.iter().copied().min().unwrap_or(begin),
            stopped,
            ignore_starts: arguments.ignore_starts,
            lose: arguments.lose,
            invalid: arguments.invalid,
        },
        begin,
    );
    let identity = Identity {
        name: "Simulated ZED-M Hid Device".into(),
        serial: arguments.serial.clone(),
        product: arguments.product,
        numbering: arguments.numbering,
    };
    let ended = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, ended.clone())?;
    }

    let tell = |text: &str| {
        let ms = (now() - begin) / 1_000_000;
        println!("vm-imu @{}.{:03} {text}", ms / 1000, ms % 1000);
    };
    let mut bus: Option<Uhid> = None;
    let mut pause = begin;
    while !ended.load(Ordering::Relaxed) && now() < end {
        let time = now();
        let absence = gone.iter().find(|(from, to)| (*from..*to).contains(&time));
        match (&bus, absence) {
            (Some(_), Some(_)) => {
                bus = None;
                tell("unplugged");
            }
            (None, None) => {
                bus = Some(Uhid::create(&identity).context("plugging in the device")?);
                device.power_on(time);
                tell("plugged in");
            }
            _ => {}
        }
        let Some(uhid) = &mut bus else {
            let until = absence.map_or(end, |(_, to)| *to);
            wait(None, until.min(end).min(time + S))?;
            continue;
        };
        let mut parcel = 0;
        while time >= pause
            && parcel < PARCEL
            && let Some(report) = device.sample(time)
        {
            uhid.input(&report)?;
            parcel += 1;
        }
        if parcel == PARCEL {
            pause = time + PAUSE_NS;
        }
        for text in device.changes() {
            tell(&text);
        }
        let next_gone = gone
            .iter()
            .map(|(from, _)| *from)
            .filter(|&from| from > time);
        let due = device
            .next_due()
            .max(pause)
            .min(next_gone.min().unwrap_or(i64::MAX));
        if wait(Some(uhid), due.min(end).min(time + S))? {
            for request in uhid.requests()? {
                let text = answer(uhid, &mut device, request, now())?;
                tell(&text);
            }
        }
    }
    let starts: Vec<String> = device.starts().iter().map(u64::to_string).collect();
    println!(
        "vm-imu end: sent since each start: {}; sent in all {}, lost on purpose {}, not valid {}, frames {}, pings {}",
        if starts.is_empty() {
            "none".into()
        } else {
            starts.join(" ")
        },
        device.starts().iter().sum::<u64>(),
        device.lost(),
        device.not_valid(),
        device.frames(),
        device.pings(),
    );
    Ok(())
}

/// Sleeps until `deadline` or until the kernel has something to say: then true.
fn wait(uhid: Option<&Uhid>, deadline: i64) -> Result<bool> {
    let left = (deadline - now()).max(0);
    let timeout = Timespec {
        tv_sec: left / S,
        tv_nsec: left % S,
    };
    let mut fds = Vec::new();
    if let Some(uhid) = uhid {
        fds.push(PollFd::from_borrowed_fd(uhid.as_fd(), PollFlags::IN));
    }
    match poll(&mut fds, Some(&timeout)) {
        Ok(ready) => Ok(ready > 0),
        Err(rustix::io::Errno::INTR) => Ok(false),
        Err(errno) => Err(io::Error::from(errno)).context("waiting for the kernel"),
    }
}

/// Answers a request of the kernel; what it was, for people.
fn answer(uhid: &mut Uhid, device: &mut Device, request: Request, now: i64) -> Result<String> {
    Ok(match request {
        Request::Open => "opened".into(),
        Request::Close => "closed".into(),
        Request::Set { id, report } => {
            let taken = device.command(&report, now);
            uhid.answer_set(id, taken.is_ok())?;
            let what = taken.unwrap_or_else(|what| what);
            format!("command {report:02x?}: {what}")
        }
        Request::Get { id, number } => {
            let state =
                (number == device::STREAM).then(|| [number, u8::from(device.is_streaming())]);
            uhid.answer_get(id, state.as_ref().map(|s| &s[..]))?;
            format!("requested {number:#04x}: {state:02x?}")
        }
        Request::Other(kind) => format!("event {kind} of the kernel"),
    })
}
