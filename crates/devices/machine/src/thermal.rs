//! Heat: temperatures, the margin to throttling, and whether the machine is throttled.
//!
//! Contract: [`Readings::read`] reads afresh; a sensor that is switched off or reads nonsense
//! counts as absent. [`Thermometer::judge`] is pure but for what it remembers: the highest clock
//! limit it has seen and the last counts of events. So what was set before the first look (a power
//! mode, say) is no throttling, and what comes later is. `throttled` is `None` where nothing would
//! show it.
//!
//! Sources: `Documentation/driver-api/thermal/sysfs-api.rst` and
//! `Documentation/admin-guide/pm/cpufreq.rst` of the kernel. On a Jetson Orin (not run there): the
//! passive trip at 70 °C only drives `hot-surface-alert`, which slows nothing, so a trip counts by
//! the cooling devices that are bound to it; `*-throttle-alert` report throttling; `oc1_event_cnt`
//! and `oc2_event_cnt` of `soctherm_oc` count too low a voltage and too high an average current,
//! each answered with lower clocks. `oc3` counts peaks of microseconds, several a second in normal
//! work, and is left out.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::sysfs::{Roots, integer, names, numbered, text};

/// Where a zone that names no temperature is taken to be slowed, °C: processors are a few degrees
/// above it.
pub(crate) const ASSUMED_LIMIT_C: f64 = 95.0;
/// Difference below its critical temperature at which such a zone is taken to be slowed, °C.
const BELOW_CRITICAL_C: f64 = 5.0;

/// One sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Zone {
    /// What it measures, in the kernel's words.
    pub name: String,
    /// Temperature, °C, if it reads a credible one.
    pub temp_c: Option<f64>,
    /// What happens at which temperature.
    pub trips: Vec<Trip>,
}

/// A temperature at which something happens.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Trip {
    /// What happens.
    pub kind: TripKind,
    /// At which temperature, °C.
    pub at_c: f64,
}

/// What happens at a trip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TripKind {
    /// The machine is made slower.
    Slows,
    /// A message only, a fan, or a hot surface is announced.
    Tells,
    /// The kernel switches off.
    Critical,
}

/// Something that can be made to cool, with how much it does: 0 is nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Cooling {
    /// What it is, in the kernel's words.
    pub name: String,
    /// Present state.
    pub state: i64,
    /// Its strongest.
    pub strongest: i64,
    /// Whether it cools by making the machine slower.
    pub slows: bool,
}

/// The clock that some of the processors are allowed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CpuLimit {
    /// Which processors: the kernel's `policyN`.
    pub name: String,
    /// Allowed now, kHz.
    pub allowed_khz: i64,
    /// What they can do, kHz.
    pub possible_khz: i64,
}

/// Everything that was read.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Readings {
    /// Sensors.
    pub zones: Vec<Zone>,
    /// Fans, clocks, alerts.
    pub cooling: Vec<Cooling>,
    /// Clock limits.
    pub cpus: Vec<CpuLimit>,
    /// Events of throttling, counted by the machine since it booted.
    pub events: BTreeMap<String, i64>,
}

/// What the readings mean.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Heat {
    /// Highest temperature, °C, if any sensor has one.
    pub hottest_c: Option<f64>,
    /// Where that is; empty if nowhere.
    pub zone: String,
    /// Margin to throttling of the zone that is nearest to it, °C; negative beyond.
    pub margin_c: Option<f64>,
    /// Which zone that is; empty if none.
    pub margin_zone: String,
    /// Margin of the zone that is nearest to its critical temperature, at which the kernel switches
    /// off, °C; `None` where no zone names one.
    pub critical_margin_c: Option<f64>,
    /// Whether the machine is slowed now; `None` where nothing would show it.
    pub throttled: Option<bool>,
    /// By what, for people; empty if not.
    pub detail: String,
}

impl Readings {
    /// Reads all sensors.
    pub fn read(roots: &Roots) -> Self {
        let thermal = roots.sys.join("class/thermal");
        let zones = numbered(&thermal, "thermal_zone")
            .into_iter()
            .map(|(number, folder)| {
                // Which cooling devices are bound to which trip: `cdevN` leads to the device.
                let bound: Vec<(i64, bool)> = numbered(&folder, "cdev")
                    .into_iter()
                    .filter_map(|(n, device)| {
                        let trip = integer(folder.join(format!("cdev{n}_trip_point")))?;
                        Some((trip, slows(&text(device.join("type"))?)))
                    })
                    .collect();
                let trips = names(&folder)
                    .iter()
                    .filter_map(|name| {
                        let n: i64 = name
                            .strip_prefix("trip_point_")?
                            .strip_suffix("_type")?
                            .parse()
                            .ok()?;
                        let mut bound = bound.iter().filter(|(trip, _)| *trip == n).peekable();
                        let kind = match text(folder.join(name))?.as_str() {
                            "critical" => TripKind::Critical,
                            // Without a bound device, the kernel's type is all that is known.
                            "passive"
                                if bound.peek().is_none() || bound.any(|(_, slows)| *slows) =>
                            {
                                TripKind::Slows
                            }
                            _ => TripKind::Tells,
                        };
                        // A trip that is not in use reads as 0 or -274 °C.
                        let at_c = celsius(integer(folder.join(format!("trip_point_{n}_temp")))?)
                            .filter(|c| *c > 0.0)?;
                        Some(Trip { kind, at_c })
                    })
                    .collect();
                Zone {
                    name: text(folder.join("type")).unwrap_or_else(|| format!("zone {number}")),
                    temp_c: integer(folder.join("temp")).and_then(celsius),
                    trips,
                }
            });
        let cooling = numbered(&thermal, "cooling_device")
            .into_iter()
            .filter_map(|(_, folder)| {
                let name = text(folder.join("type"))?;
                Some(Cooling {
                    slows: slows(&name),
                    name,
                    state: integer(folder.join("cur_state"))?,
                    strongest: integer(folder.join("max_state"))?,
                })
            });
        let cpus = numbered(roots.sys.join("devices/system/cpu/cpufreq"), "policy")
            .into_iter()
            .filter_map(|(number, folder)| {
                Some(CpuLimit {
                    name: format!("policy{number}"),
                    allowed_khz: integer(folder.join("scaling_max_freq"))?,
                    possible_khz: integer(folder.join("cpuinfo_max_freq"))?,
                })
            });
        Self {
            zones: zones.collect(),
            cooling: cooling.collect(),
            cpus: cpus.collect(),
            events: events(roots),
        }
    }
}

fn events(roots: &Roots) -> BTreeMap<String, i64> {
    let hwmon = numbered(roots.sys.join("class/hwmon"), "hwmon");
    let jetson = hwmon.iter().flat_map(|(_, folder)| {
        [
            ("oc1_event_cnt", "voltage too low"),
            ("oc2_event_cnt", "current too high"),
        ]
        .map(|(file, name)| Some((name.to_owned(), integer(folder.join(file))?)))
    });
    let intel = roots
        .sys
        .join("devices/system/cpu/cpu0/thermal_throttle/package_throttle_count");
    let intel = integer(intel).map(|count| ("processor too hot".to_owned(), count));
    jetson.chain([intel]).flatten().collect()
}

/// Whether a cooling device of this type cools by making the processors slower. A fan does not;
/// others only dim a screen or announce (`LCD`, `hot-surface-alert`), or count in settings
/// (`TCC Offset`).
fn slows(kind: &str) -> bool {
    let kind = kind.to_ascii_lowercase();
    [
        "processor",
        "cpufreq",
        "devfreq",
        "cpuidle",
        "powerclamp",
        "throttle",
    ]
    .iter()
    .any(|word| kind.contains(word))
}

/// None where it cannot be true: a Jetson's zones read -256000 while their unit is off.
fn celsius(millidegrees: i64) -> Option<f64> {
    (-40_000..=150_000)
        .contains(&millidegrees)
        .then(|| millidegrees as f64 / 1000.0)
}

impl Zone {
    fn lowest(&self, kind: TripKind) -> Option<f64> {
        let trips = self.trips.iter().filter(|trip| trip.kind == kind);
        trips.map(|trip| trip.at_c).min_by(f64::total_cmp)
    }

    /// Where it is slowed, °C, as far as is known.
    fn limit_c(&self) -> f64 {
        let critical = self.lowest(TripKind::Critical);
        self.lowest(TripKind::Slows).unwrap_or_else(|| {
            ASSUMED_LIMIT_C.min(critical.map_or(f64::INFINITY, |c| c - BELOW_CRITICAL_C))
        })
    }
}

/// Turns readings into meaning.
#[derive(Clone, Debug, Default)]
pub struct Thermometer {
    highest_khz: BTreeMap<String, i64>,
    events: BTreeMap<String, i64>,
}

impl Thermometer {
    /// One that has seen nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// What the readings mean, after those before.
    pub fn judge(&mut self, readings: &Readings) -> Heat {
        let temperatures = || readings.zones.iter().filter_map(|z| Some((z, z.temp_c?)));
        let least = |(_, a): &(&Zone, f64), (_, b): &(&Zone, f64)| a.total_cmp(b);
        let hottest = temperatures().max_by(least);
        let nearest = temperatures()
            .map(|(z, c)| (z, z.limit_c() - c))
            .min_by(least);
        let critical = temperatures()
            .filter_map(|(z, c)| Some((z, z.lowest(TripKind::Critical)? - c)))
            .min_by(least);
        let name = |of: Option<(&Zone, f64)>| of.map_or_else(String::new, |(z, _)| z.name.clone());

        let slowed_by = self.slowed_by(readings);
        Heat {
            hottest_c: hottest.map(|(_, c)| c),
            zone: name(hottest),
            margin_c: nearest.map(|(_, c)| c),
            margin_zone: name(nearest),
            critical_margin_c: critical.map(|(_, c)| c),
            throttled: slowed_by.as_ref().map(|by| !by.is_empty()),
            detail: slowed_by.unwrap_or_default().join(", "),
        }
    }

    /// What slows the machine; `None` where nothing would show it.
    fn slowed_by(&mut self, readings: &Readings) -> Option<Vec<String>> {
        let mut by = Vec::new();
        let slowing: Vec<&Cooling> = readings.cooling.iter().filter(|c| c.slows).collect();
        // `intel_powerclamp` reads as -1 while it rests.
        for cooling in slowing.iter().filter(|c| c.state > 0) {
            by.push(format!(
                "{} {} of {}",
                cooling.name, cooling.state, cooling.strongest
            ));
        }
        for cpu in &readings.cpus {
            let highest = self.highest_khz.entry(cpu.name.clone()).or_insert(0);
            *highest = cpu.allowed_khz.max(*highest);
            if cpu.allowed_khz < *highest {
                by.push(format!(
                    "{} held at {} of {} MHz",
                    cpu.name,
                    cpu.allowed_khz / 1000,
                    cpu.possible_khz / 1000
                ));
            }
        }
        for (name, count) in &readings.events {
            let before = self.events.insert(name.clone(), *count);
            if before.is_some_and(|before| *count > before) {
                by.push(name.clone());
            }
        }
        let would_tell =
            !slowing.is_empty() || !readings.cpus.is_empty() || !readings.events.is_empty();
        would_tell.then_some(by)
    }
}

#[cfg(test)]
mod tests;
