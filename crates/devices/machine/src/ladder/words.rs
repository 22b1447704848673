//! Texts of the ladder, for people.

use super::{Cause, Limits, Pressure, Step};
use crate::disk::DiskFault;

/// The present reading of a cause: `disk: 4 min left at 6.1 MB/s`.
pub(super) fn say(cause: Cause, pressure: &Pressure, limits: &Limits) -> String {
    let (name, reading) = match cause {
        Cause::Heat => ("heat", heat(pressure, limits)),
        Cause::Throttling => ("throttling", throttling(pressure)),
        Cause::Battery => ("battery", battery(pressure)),
        Cause::Supply => ("supply", supply(pressure)),
        Cause::Disk => ("disk", disk(pressure)),
        Cause::Encoder => ("encoder", encoder(pressure)),
    };
    let reading = reading.unwrap_or_else(|| "no longer tells".to_owned());
    format!("{name}: {reading}")
}

/// The reading and what is done.
pub(super) fn tell(
    cause: Cause,
    from: Step,
    to: Step,
    pressure: &Pressure,
    limits: &Limits,
) -> String {
    let done = match (to > from, to) {
        (_, Step::Normal) => "; all clear",
        (true, Step::Warn) => "",
        (true, Step::LowerPreview) => "; preview lowered",
        (true, Step::LowerBitrate) => "; bitrate lowered",
        (true, Step::LowerFrameRate) => "; frame rate lowered",
        (true, Step::StopCleanly) => "; recording must end",
        (false, Step::Warn) => "; easier, nothing lowered for it any more",
        (false, Step::LowerPreview) => "; easier, only the preview lowered",
        (false, Step::LowerBitrate) => "; easier, bitrate still lowered",
        (false, Step::LowerFrameRate | Step::StopCleanly) => "; easier, frame rate still lowered",
    };
    say(cause, pressure, limits) + done
}

fn heat(pressure: &Pressure, limits: &Limits) -> Option<String> {
    let heat = pressure.heat.as_ref()?;
    let is_critical = |margin: &f64| *margin <= limits.heat_stop_c;
    let limit = match (heat.critical_margin_c.filter(is_critical), heat.margin_c) {
        (Some(margin), _) => format!(", {margin:.1} °C before the machine switches off"),
        (None, Some(margin)) if margin < 0.0 => format!(
            ", {} is {:.1} °C beyond where it is slowed",
            heat.margin_zone, -margin
        ),
        (None, Some(margin)) => format!(
            ", {} is {margin:.1} °C below where it is slowed",
            heat.margin_zone
        ),
        (None, None) => String::new(),
    };
    Some(format!("{:.1} °C at {}{limit}", heat.hottest_c?, heat.zone))
}

fn throttling(pressure: &Pressure) -> Option<String> {
    let heat = pressure.heat.as_ref()?;
    Some(match heat.throttled? {
        true => format!("the machine is slowed ({})", heat.detail),
        false => "the machine is not slowed".to_owned(),
    })
}

fn battery(pressure: &Pressure) -> Option<String> {
    let power = pressure.power.as_ref()?;
    let percent = power.percent.map(|percent| format!("{percent:.0} %"));
    let left = match (power.on_battery?, power.minutes_left) {
        (false, _) => Some("power from outside".to_owned()),
        (true, left) => left.map(|minutes| format!("{} left", span(60.0 * minutes))),
    };
    let parts: Vec<String> = percent.into_iter().chain(left).collect();
    Some(parts.join(", "))
}

fn supply(pressure: &Pressure) -> Option<String> {
    let power = pressure.power.as_ref()?;
    Some(format!("{} at {:.2} V", power.rail, power.supply_volts?))
}

fn disk(pressure: &Pressure) -> Option<String> {
    let disk = pressure.disk.as_ref()?;
    let fault = disk.fault.as_ref().map(|fault| match fault {
        DiskFault::ReadOnly => "it has become read-only".to_owned(),
        DiskFault::MountLost => "another file system is in its place: it was unmounted".to_owned(),
        DiskFault::Unreachable(said) => format!("it does not answer: {said}"),
    });
    if fault.is_some() {
        return fault;
    }
    if disk.low_inodes {
        return Some("hardly any inodes are free, for files of the next session".to_owned());
    }
    let megabytes = |bytes: f64| bytes / 1e6;
    Some(match (disk.seconds_left, disk.bytes_per_s) {
        (Some(left), Some(rate)) => {
            format!("{} left at {:.1} MB/s", span(left), megabytes(rate))
        }
        _ => format!(
            "{:.0} MB free above the reserve",
            megabytes(disk.usable_bytes? as f64)
        ),
    })
}

fn encoder(pressure: &Pressure) -> Option<String> {
    let percent = 100.0 * pressure.encoder_fill?;
    Some(format!("its queue is {percent:.0} % full"))
}

/// A span of time in the unit that people would use, rounded down: time left is no promise.
fn span(seconds: f64) -> String {
    let seconds = seconds.max(0.0);
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{} min", (s / 60.0) as u64),
        s => format!("{} h", (s / 3600.0) as u64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::battery::Power;
    use crate::disk::DiskState;
    use crate::thermal::Heat;

    #[test]
    fn every_cause_says_why() {
        let limits = Limits::default();
        let mut pressure = Pressure {
            heat: Some(Heat {
                hottest_c: Some(96.53),
                zone: "cpu-thermal".into(),
                margin_c: Some(2.47),
                margin_zone: "cpu-thermal".into(),
                critical_margin_c: Some(7.97),
                throttled: Some(true),
                detail: "cpu-throttle-alert 1 of 1".into(),
            }),
            power: Some(Power {
                percent: Some(18.4),
                minutes_left: Some(22.9),
                on_battery: Some(true),
                supply_volts: Some(10.9),
                rail: "VDD_IN".into(),
            }),
            disk: Some(DiskState {
                usable_bytes: Some(1_500_000_000),
                bytes_per_s: Some(6.1e6),
                seconds_left: Some(246.0),
                ..DiskState::default()
            }),
            encoder_fill: Some(0.92),
        };
        let check = |pressure: &Pressure, cause, expected: &str| {
            assert_eq!(say(cause, pressure, &limits), expected);
        };
        check(
            &pressure,
            Cause::Heat,
            "heat: 96.5 °C at cpu-thermal, cpu-thermal is 2.5 °C below where it is slowed",
        );
        check(
            &pressure,
            Cause::Throttling,
            "throttling: the machine is slowed (cpu-throttle-alert 1 of 1)",
        );
        check(&pressure, Cause::Battery, "battery: 18 %, 22 min left");
        check(&pressure, Cause::Supply, "supply: VDD_IN at 10.90 V");
        check(&pressure, Cause::Disk, "disk: 4 min left at 6.1 MB/s");
        check(&pressure, Cause::Encoder, "encoder: its queue is 92 % full");
        assert_eq!(
            tell(
                Cause::Disk,
                Step::Warn,
                Step::LowerBitrate,
                &pressure,
                &limits
            ),
            "disk: 4 min left at 6.1 MB/s; bitrate lowered"
        );

        pressure.disk = Some(DiskState {
            fault: Some(DiskFault::ReadOnly),
            ..DiskState::default()
        });
        check(&pressure, Cause::Disk, "disk: it has become read-only");
        check(
            &Pressure::default(),
            Cause::Battery,
            "battery: no longer tells",
        );
    }

    #[test]
    fn spans_are_rounded_down() {
        assert_eq!(span(12.3), "12 s");
        assert_eq!(span(119.9), "1 min");
        assert_eq!(span(3599.0), "59 min");
        assert_eq!(span(2.9 * 3600.0), "2 h");
        assert_eq!(span(-1.0), "0 s");
    }
}
