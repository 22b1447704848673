//! Power: batteries, mains, and the voltage of the supply.
//!
//! Contract: [`Readings::read`] reads afresh; what the machine does not tell is absent. [`judge`]
//! is pure. The battery of a mouse or a headset is not the machine's and is left out. A power bank
//! that feeds a Jetson over USB-C or a barrel plug is not seen by the kernel at all; what is seen
//! is the voltage of its input where an INA3221 measures it, which falls before an unregulated pack
//! is empty. A power bank regulates its output: it gives no warning, so count the hours.
//!
//! Sources: `Documentation/ABI/testing/sysfs-class-power` and `Documentation/hwmon/ina3221.rst` of
//! the kernel. Which rail is the input depends on the carrier board (`VDD_IN` on Orin NX and Nano
//! modules; not run there), so the configuration names it.

use serde::Serialize;

use crate::sysfs::{Roots, integer, names, numbered, text};

/// What a battery is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// It is being emptied.
    Discharging,
    /// It is being filled.
    Charging,
    /// Neither: full, or held.
    Resting,
    /// Not reported.
    Unknown,
}

/// One battery.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Battery {
    /// The kernel's name of it.
    pub name: String,
    /// What it is doing.
    pub status: Status,
    /// Charge, %.
    pub percent: Option<f64>,
    /// Energy in it, Wh.
    pub energy_wh: Option<f64>,
    /// Energy in it when full, Wh.
    pub full_wh: Option<f64>,
    /// Power taken from it or put into it, W.
    pub power_w: Option<f64>,
    /// Minutes until it is empty, as it reports.
    pub own_minutes: Option<f64>,
}

/// A measured voltage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rail {
    /// The chip that measures it.
    pub chip: String,
    /// What it measures.
    pub label: String,
    /// Voltage, V.
    pub volts: f64,
    /// Current, A.
    pub amperes: Option<f64>,
}

/// Everything that was read.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Readings {
    /// The machine's batteries.
    pub batteries: Vec<Battery>,
    /// Whether power comes from outside; `None` where no plug is known.
    pub plugged_in: Option<bool>,
    /// Measured voltages that have a name.
    pub rails: Vec<Rail>,
}

/// What the readings mean.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Power {
    /// Charge of all batteries together, %.
    pub percent: Option<f64>,
    /// Minutes until all are empty at the present power; `None` while none is being emptied.
    pub minutes_left: Option<f64>,
    /// Whether the machine runs on its batteries; `None` where it has none.
    pub on_battery: Option<bool>,
    /// Voltage of the rail that was named, V.
    pub supply_volts: Option<f64>,
    /// The rail that was named; empty if none was.
    pub rail: String,
}

impl Readings {
    /// Reads all batteries, plugs and rails.
    pub fn read(roots: &Roots) -> Self {
        let class = roots.sys.join("class/power_supply");
        let mut readings = Self::default();
        for name in names(&class) {
            let folder = class.join(&name);
            if text(folder.join("scope")).is_some_and(|scope| scope == "Device") {
                continue;
            }
            let micro = |file: &str| Some(integer(folder.join(file))? as f64 / 1e6);
            match text(folder.join("type")).as_deref() {
                Some("Battery") if integer(folder.join("present")) != Some(0) => {
                    // Charges, Ah, of drivers that report no energy. The voltage of a full battery
                    // is near enough the present one.
                    let volts = micro("voltage_now");
                    let or_charge = |energy: &str, charge: &str| {
                        micro(energy).or_else(|| Some(micro(charge)? * volts?))
                    };
                    readings.batteries.push(Battery {
                        status: match text(folder.join("status")).as_deref() {
                            Some("Discharging") => Status::Discharging,
                            Some("Charging") => Status::Charging,
                            Some("Full" | "Not charging") => Status::Resting,
                            _ => Status::Unknown,
                        },
                        percent: integer(folder.join("capacity"))
                            .filter(|percent| (0..=100).contains(percent))
                            .map(|percent| percent as f64),
                        energy_wh: or_charge("energy_now", "charge_now"),
                        full_wh: or_charge("energy_full", "charge_full").filter(|wh| *wh > 0.0),
                        // Some drivers give the direction as a sign, most do not.
                        power_w: or_charge("power_now", "current_now").map(f64::abs),
                        own_minutes: integer(folder.join("time_to_empty_now"))
                            .or_else(|| integer(folder.join("time_to_empty_avg")))
                            .filter(|seconds| *seconds > 0)
                            .map(|seconds| seconds as f64 / 60.0),
                        name,
                    });
                }
                Some("Mains" | "USB" | "UPS") => {
                    if let Some(online) = integer(folder.join("online")) {
                        let plugged_in = readings.plugged_in.get_or_insert(false);
                        // 1 and 2 are a fixed and a programmable voltage.
                        *plugged_in |= online > 0;
                    }
                }
                _ => {}
            }
        }
        readings.rails = rails(roots);
        readings
    }
}

fn rails(roots: &Roots) -> Vec<Rail> {
    let chips = numbered(roots.sys.join("class/hwmon"), "hwmon");
    let rails = chips.iter().flat_map(|(_, folder)| {
        names(folder).into_iter().filter_map(|name| {
            let n: u32 = name
                .strip_prefix("in")?
                .strip_suffix("_label")?
                .parse()
                .ok()?;
            let label = text(folder.join(&name))?;
            // The INA3221 driver labels a sum of voltages over shunts, which is no rail, and boards
            // label channels that are not connected.
            if label == "NC" || label.starts_with("sum of") {
                return None;
            }
            Some(Rail {
                chip: text(folder.join("name")).unwrap_or_default(),
                label,
                volts: integer(folder.join(format!("in{n}_input")))? as f64 / 1e3,
                amperes: integer(folder.join(format!("curr{n}_input"))).map(|ma| ma as f64 / 1e3),
            })
        })
    });
    rails.collect()
}

/// What the readings mean. `rail` is the label of the machine's input, if one is known.
pub fn judge(readings: &Readings, rail: Option<&str>) -> Power {
    let batteries = &readings.batteries;
    let sum = |of: fn(&Battery) -> Option<f64>| -> Option<f64> {
        batteries.iter().map(of).sum::<Option<f64>>()
    };
    let energy = sum(|b| b.energy_wh);
    let by_energy = sum(|b| b.full_wh)
        .zip(energy)
        .map(|(full, now)| (100.0 * now / full).clamp(0.0, 100.0));
    // A single battery knows its own charge best. Batteries that report no energy have equal
    // weights.
    let by_mean = sum(|b| b.percent).map(|sum| sum / batteries.len() as f64);
    let percent = if batteries.len() == 1 {
        by_mean.or(by_energy)
    } else {
        by_energy.or(by_mean)
    };

    let emptied = || batteries.iter().filter(|b| b.status == Status::Discharging);
    let is_emptied = emptied().next().is_some();
    // Laptops empty one battery after the other: the power is that of those at work, the energy
    // all.
    let power: f64 = emptied().filter_map(|b| b.power_w).sum();
    let by_power = energy
        .filter(|_| is_emptied && power > 0.0)
        .map(|energy| 60.0 * energy / power);
    let by_own_account = emptied().map(|b| b.own_minutes).sum::<Option<f64>>();
    Power {
        percent: percent.filter(|_| !batteries.is_empty()),
        minutes_left: by_power.or(by_own_account.filter(|_| is_emptied)),
        on_battery: (!batteries.is_empty())
            .then(|| is_emptied && (readings.plugged_in != Some(true) || power > 0.0)),
        supply_volts: rail.and_then(|label| {
            let rail = readings.rails.iter().find(|rail| rail.label == label);
            rail.map(|rail| rail.volts)
        }),
        rail: rail.unwrap_or_default().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysfs::fake::tree;

    fn power(files: &str, rail: Option<&str>) -> Power {
        let (_root, roots) = tree(files);
        judge(&Readings::read(&roots), rail)
    }

    /// As two batteries of a laptop tell it, one after the other, with a mouse beside.
    const LAPTOP: &str = "
        sys/class/power_supply/AC/type = Mains
        sys/class/power_supply/AC/online = 0
        sys/class/power_supply/BAT0/type = Battery
        sys/class/power_supply/BAT0/present = 1
        sys/class/power_supply/BAT0/status = Discharging
        sys/class/power_supply/BAT0/capacity = 20
        sys/class/power_supply/BAT0/energy_now = 4000000
        sys/class/power_supply/BAT0/energy_full = 20000000
        sys/class/power_supply/BAT0/power_now = 12000000
        sys/class/power_supply/BAT1/type = Battery
        sys/class/power_supply/BAT1/status = Not charging
        sys/class/power_supply/BAT1/capacity = 80
        sys/class/power_supply/BAT1/energy_now = 16000000
        sys/class/power_supply/BAT1/energy_full = 20000000
        sys/class/power_supply/BAT1/power_now = 0
        sys/class/power_supply/hidpp_battery_0/type = Battery
        sys/class/power_supply/hidpp_battery_0/scope = Device
        sys/class/power_supply/hidpp_battery_0/status = Discharging
        sys/class/power_supply/hidpp_battery_0/capacity = 3
    ";

    #[test]
    fn two_batteries_count_together() {
        let power = power(LAPTOP, None);
        assert_eq!(power.percent, Some(50.0));
        assert_eq!(power.minutes_left, Some(100.0));
        assert_eq!(power.on_battery, Some(true));
    }

    #[test]
    fn a_battery_that_counts_charge() {
        let on_mains = |online: &str, status: &str| {
            power(
                &format!(
                    "
                    sys/class/power_supply/ucsi-source/type = USB
                    sys/class/power_supply/ucsi-source/online = {online}
                    sys/class/power_supply/battery/type = Battery
                    sys/class/power_supply/battery/status = {status}
                    sys/class/power_supply/battery/capacity = 42
                    sys/class/power_supply/battery/charge_now = 2000000
                    sys/class/power_supply/battery/charge_full = 4000000
                    sys/class/power_supply/battery/voltage_now = 12000000
                    sys/class/power_supply/battery/current_now = -1000000
                    "
                ),
                None,
            )
        };
        let emptied = on_mains("0", "Discharging");
        // The charge that it reports, not 50.
        assert_eq!(emptied.percent, Some(42.0));
        assert!((emptied.minutes_left.unwrap() - 120.0).abs() < 1e-9);
        assert_eq!(emptied.on_battery, Some(true));
        let filled = on_mains("1", "Charging");
        assert_eq!(filled.minutes_left, None);
        assert_eq!(filled.on_battery, Some(false));
        // A supply too weak for the load does not count as mains.
        assert_eq!(on_mains("1", "Discharging").on_battery, Some(true));
    }

    #[test]
    fn one_that_tells_only_minutes() {
        let power = power(
            "
            sys/class/power_supply/ups/type = Battery
            sys/class/power_supply/ups/status = Discharging
            sys/class/power_supply/ups/time_to_empty_now = 900
            ",
            None,
        );
        assert_eq!(power.minutes_left, Some(15.0));
        assert_eq!(power.percent, None);
        assert_eq!(power.on_battery, Some(true));
    }

    #[test]
    fn a_jetson_has_no_battery_but_a_rail() {
        let jetson = "
            sys/class/hwmon/hwmon1/name = ina3221
            sys/class/hwmon/hwmon1/in1_label = VDD_IN
            sys/class/hwmon/hwmon1/in1_input = 11840
            sys/class/hwmon/hwmon1/curr1_input = 1856
            sys/class/hwmon/hwmon1/in2_label = NC
            sys/class/hwmon/hwmon1/in2_input = 0
            sys/class/hwmon/hwmon1/in4_input = 9200
            sys/class/hwmon/hwmon1/in7_label = sum of shunt voltages
            sys/class/hwmon/hwmon1/in7_input = 12
        ";
        let jetson_power = power(jetson, Some("VDD_IN"));
        assert_eq!(jetson_power.supply_volts, Some(11.84));
        assert_eq!(jetson_power.on_battery, None);
        assert_eq!(jetson_power.percent, None);
        assert_eq!(power(jetson, Some("VIN")).supply_volts, None);
        assert_eq!(power(jetson, None).supply_volts, None);
        let (_root, roots) = tree(jetson);
        let rails = Readings::read(&roots).rails;
        assert_eq!(rails.len(), 1);
        assert_eq!(rails[0].amperes, Some(1.856));
    }

    #[test]
    fn a_machine_that_tells_nothing() {
        assert_eq!(power("proc/version = none", None), Power::default());
        // A battery bay that is empty is no battery.
        let empty = "
            sys/class/power_supply/BAT0/type = Battery
            sys/class/power_supply/BAT0/present = 0
            sys/class/power_supply/BAT0/capacity = 0
        ";
        assert_eq!(power(empty, None), Power::default());
    }
}
