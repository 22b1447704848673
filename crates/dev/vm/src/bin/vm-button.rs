//! A record button for guests: an input device through uinput that is pressed at given times.
//!
//! ```text
//! vm-button press@0.5 double@2 long@4 down@8 up@20 unplug@21 plug@22 press@23 end@25
//! ```
//!
//! Times are seconds after the start. `press` lasts 80 ms, `double` is two of them 120 ms apart,
//! `long` lasts 2 s; `bounce` is a press whose contact opens and closes within 6 ms at both ends.
//! The device is plugged in at the start, unless the first step is `plug`. Each thing that is done
//! is a line of JSON on standard output with its time on CLOCK_MONOTONIC, the node of the device
//! when it is plugged in. Times are waited for with the kernel's timers, so it runs in virtual time
//! as well.

use std::io::Write;
use std::str::FromStr;

use anyhow::{Context, bail};
use clap::Parser;
use evdev::uinput::VirtualDevice;
use evdev::{AttributeSet, EventType, InputEvent, KeyCode};
use rustix::thread::{ClockId as SleepClock, Timespec};

const NS_PER_MS: i64 = 1_000_000;
const NS_PER_S: i64 = 1_000_000_000;

/// A record button for guests, pressed at given times.
#[derive(Parser)]
struct Args {
    /// The key, as Linux names it.
    #[arg(long, default_value = "KEY_RECORD")]
    key: String,
    /// The name that the device gives itself.
    #[arg(long, default_value = "vm-button")]
    name: String,
    /// What to do when: press, double, long, bounce, down, up, unplug, plug or end, then @SECONDS.
    #[arg(required = true)]
    steps: Vec<Step>,
}

/// One thing to do with the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Act {
    Down,
    Up,
    Unplug,
    Plug,
    End,
}

/// The commands of the person: acts at nanoseconds after the start.
#[derive(Clone, Debug)]
struct Step(Vec<(i64, Act)>);

impl FromStr for Step {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        const EXPECTED: &str =
            "press, double, long, bounce, down, up, unplug, plug or end, then @SECONDS";
        let Some((kind, at)) = text.split_once('@') else {
            bail!("found {text:?}, expected {EXPECTED}");
        };
        let seconds: f64 = at.parse().with_context(|| format!("found {at:?}"))?;
        if !(0.0..1e6).contains(&seconds) {
            bail!("found {seconds} s, expected 0 to a million");
        }
        let acts: &[(i64, Act)] = match kind {
            "press" => &[(0, Act::Down), (80, Act::Up)],
            "double" => &[
                (0, Act::Down),
                (80, Act::Up),
                (200, Act::Down),
                (280, Act::Up),
            ],
            "long" => &[(0, Act::Down), (2000, Act::Up)],
            "bounce" => &[
                (0, Act::Down),
                (2, Act::Up),
                (4, Act::Down),
                (6, Act::Up),
                (8, Act::Down),
                (120, Act::Up),
                (123, Act::Down),
                (126, Act::Up),
            ],
            "down" => &[(0, Act::Down)],
            "up" => &[(0, Act::Up)],
            "unplug" => &[(0, Act::Unplug)],
            "plug" => &[(0, Act::Plug)],
            "end" => &[(0, Act::End)],
            _ => bail!("found {kind:?}, expected {EXPECTED}"),
        };
        let start = (seconds * NS_PER_S as f64).round() as i64;
        let acts = acts.iter().map(|&(ms, act)| (start + ms * NS_PER_MS, act));
        Ok(Self(acts.collect()))
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "this program plays a script on the machine's clock"
)]
fn now_ns() -> i64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    t.tv_sec * NS_PER_S + t.tv_nsec
}

fn wait_until(at_ns: i64) {
    let at = Timespec {
        tv_sec: at_ns / NS_PER_S,
        tv_nsec: at_ns % NS_PER_S,
    };
    while rustix::thread::clock_nanosleep_absolute(SleepClock::Monotonic, &at).is_err() {}
}

fn plug(name: &str, key: KeyCode) -> anyhow::Result<(VirtualDevice, String)> {
    let mut keys = AttributeSet::<KeyCode>::new();
    keys.insert(key);
    let mut device = VirtualDevice::builder()
        .context("opening /dev/uinput")?
        .name(name)
        .with_keys(&keys)?
        .build()
        .context("making an input device")?;
    let node = device
        .enumerate_dev_nodes_blocking()
        .context("looking for the node of the new input device")?
        .next()
        .context("the new input device has no node")??;
    Ok((device, node.display().to_string()))
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let Ok(key) = args.key.parse::<KeyCode>() else {
        bail!(
            "found --key {:?}, expected a name like KEY_RECORD",
            args.key
        );
    };
    let mut acts: Vec<(i64, Act)> = args.steps.into_iter().flat_map(|step| step.0).collect();
    acts.sort_by_key(|(at, _)| *at);
    if acts.first().is_some_and(|(_, act)| *act != Act::Plug) {
        acts.insert(0, (0, Act::Plug));
    }

    let begun = now_ns();
    let mut device: Option<VirtualDevice> = None;
    for (at, act) in acts {
        wait_until(begun + at);
        let at_ns = now_ns();
        let mut node = None;
        match (act, &mut device) {
            (Act::Down | Act::Up, Some(device)) => {
                let value = i32::from(act == Act::Down);
                let event = InputEvent::new(EventType::KEY.0, key.0, value);
                device.emit(&[event]).context("pressing")?;
            }
            (Act::Down | Act::Up, None) => bail!("{act:?} while it is unplugged"),
            (Act::Unplug, device) => *device = None,
            (Act::Plug, device) => {
                let (plugged, path) = plug(&args.name, key)?;
                *device = Some(plugged);
                node = Some(path);
            }
            (Act::End, _) => break,
        }
        let did = format!("{act:?}").to_lowercase();
        let line = serde_json::json!({ "at_ns": at_ns, "did": did, "node": node });
        let mut out = std::io::stdout().lock();
        writeln!(out, "{line}").and_then(|()| out.flush())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_become_acts_at_their_times() {
        let acts = |text: &str| text.parse::<Step>().map(|step| step.0);
        let ms = |n: i64| n * NS_PER_MS;
        assert_eq!(
            acts("double@1.5").unwrap(),
            [
                (ms(1500), Act::Down),
                (ms(1580), Act::Up),
                (ms(1700), Act::Down),
                (ms(1780), Act::Up)
            ]
        );
        for odd in ["press", "press@x", "press@-1", "press@nan", "push@1"] {
            assert!(acts(odd).is_err(), "{odd}");
        }
    }
}
