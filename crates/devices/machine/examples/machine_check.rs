//! Prints the state of this machine.
//!
//! ```sh
//! cargo run -p machine --example machine_check              # once, as text
//! cargo run -p machine --example machine_check -- --json    # once, as JSON
//! cargo run -p machine --example machine_check -- --watch 60   # clocks, and each step, for 60 s
//! ```

use std::path::Path;
use std::time::Duration;

use machine::clock::{self, ClockWatch, StepAlarm};
use machine::ladder::{Ladder, Limits, Pressure};
use machine::thermal::Thermometer;
use machine::{NS_PER_S, Roots, battery, disk, realtime, thermal};
use serde_json::json;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        [] => println!("{}", as_text(&everything(), 0)),
        ["--json"] => println!("{:#}", everything()),
        ["--watch", seconds] => watch(seconds.parse()?)?,
        _ => return Err("expected nothing, --json, or --watch SECONDS".into()),
    }
    Ok(())
}

fn everything() -> serde_json::Value {
    let roots = Roots::default();
    let heat_readings = thermal::Readings::read(&roots);
    let heat = Thermometer::new().judge(&heat_readings);
    let power_readings = battery::Readings::read(&roots);
    let power = battery::judge(&power_readings, None);
    let reading = clock::read();
    let space = disk::reading(Path::new("."));
    let disk = disk::DiskWatch::new(0).judge(reading.monotonic_ns, &space);
    let pressure = Pressure {
        heat: Some(heat.clone()),
        power: Some(power.clone()),
        disk: Some(disk.clone()),
        encoder_fill: None,
    };
    let mut ladder = Ladder::new(Limits::default()).expect("the defaults agree with themselves");
    // The same reading for a minute: where the ladder would be if it stayed so.
    for second in 0..60 {
        ladder.reading(reading.monotonic_ns + second * NS_PER_S, &pressure);
    }
    let lock = realtime::lock_memory(&roots);
    let locked = realtime::locked_bytes(&roots);
    realtime::unlock_memory();
    json!({
        "heat": heat,
        "heat_readings": heat_readings,
        "power": power,
        "power_readings": power_readings,
        "disk_here": disk,
        "clock": ClockWatch::new().judge(&reading).0,
        "clock_kept_by": clock::discipline(&roots),
        "ladder": { "step": ladder.step(), "measures": ladder.mitigations(), "reasons": ladder.reasons() },
        "real_time": realtime::this_thread(realtime::PRIORITY),
        "memory_lock": lock,
        "memory_locked_bytes": locked,
    })
}

/// Indented lines, one for each value.
fn as_text(value: &serde_json::Value, depth: usize) -> String {
    let indent = "  ".repeat(depth);
    let line = |name: String, value: &serde_json::Value| match value {
        serde_json::Value::Object(_) | serde_json::Value::Array(_) => {
            let inner = as_text(value, depth + 1);
            let inner = if inner.is_empty() {
                String::new()
            } else {
                format!("\n{inner}")
            };
            format!("{indent}{name}:{inner}")
        }
        serde_json::Value::Null => format!("{indent}{name}: unknown"),
        other => format!("{indent}{name}: {other}"),
    };
    let lines: Vec<String> = match value {
        serde_json::Value::Object(map) => map.iter().map(|(k, v)| line(k.clone(), v)).collect(),
        serde_json::Value::Array(list) => list.iter().map(|v| line("-".into(), v)).collect(),
        other => vec![format!("{indent}{other}")],
    };
    lines.join("\n")
}

/// One line a second, and one immediately when civil time is set.
fn watch(seconds: i64) -> Result<(), Box<dyn std::error::Error>> {
    let alarm = StepAlarm::new()?;
    let mut watch = ClockWatch::new();
    let begun = clock::read().monotonic_ns;
    let mut next = begun;
    loop {
        let reading = clock::read();
        let (state, events) = watch.judge(&reading);
        let since_ms = (reading.monotonic_ns - begun) / 1_000_000;
        for event in &events {
            println!("{since_ms:7} ms  EVENT {event}");
        }
        if reading.monotonic_ns >= next {
            next += NS_PER_S;
            println!(
                "{since_ms:7} ms  civil = monotonic + {} ns, read within {} ns, synchronised: {:?}",
                state.civil_offset_ns, state.apart_ns, state.synchronised
            );
        }
        if reading.monotonic_ns - begun >= seconds * NS_PER_S {
            return Ok(());
        }
        let left = u64::try_from(next - reading.monotonic_ns).unwrap_or(0);
        if alarm.wait(Duration::from_nanos(left))? {
            println!(
                "{:7} ms  ALARM",
                (clock::read().monotonic_ns - begun) / 1_000_000
            );
        }
    }
}
