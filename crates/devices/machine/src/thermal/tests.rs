use std::fs;

use super::*;
use crate::sysfs::fake::tree;

/// As users of Orin modules have published it: two zones, one of them off, trips with what they
/// drive.
const JETSON: &str = "
    sys/class/thermal/thermal_zone0/type = cpu-thermal
    sys/class/thermal/thermal_zone0/temp = 71500
    sys/class/thermal/thermal_zone0/trip_point_0_type = passive
    sys/class/thermal/thermal_zone0/trip_point_0_temp = 99000
    sys/class/thermal/thermal_zone0/trip_point_1_type = critical
    sys/class/thermal/thermal_zone0/trip_point_1_temp = 104500
    sys/class/thermal/thermal_zone0/trip_point_2_type = passive
    sys/class/thermal/thermal_zone0/trip_point_2_temp = 70000
    sys/class/thermal/thermal_zone0/cdev0 -> sys/class/thermal/cooling_device0
    sys/class/thermal/thermal_zone0/cdev0_trip_point = 0
    sys/class/thermal/thermal_zone0/cdev1 -> sys/class/thermal/cooling_device1
    sys/class/thermal/thermal_zone0/cdev1_trip_point = 0
    sys/class/thermal/thermal_zone0/cdev2 -> sys/class/thermal/cooling_device2
    sys/class/thermal/thermal_zone0/cdev2_trip_point = 2
    sys/class/thermal/thermal_zone1/type = gpu-thermal
    sys/class/thermal/thermal_zone1/temp = 68000
    sys/class/thermal/thermal_zone1/trip_point_0_type = passive
    sys/class/thermal/thermal_zone1/trip_point_0_temp = 80000
    sys/class/thermal/thermal_zone2/type = cv0-thermal
    sys/class/thermal/thermal_zone2/temp = -256000
    sys/class/thermal/cooling_device0/type = cpufreq-cpu0
    sys/class/thermal/cooling_device0/cur_state = 0
    sys/class/thermal/cooling_device0/max_state = 28
    sys/class/thermal/cooling_device1/type = cpu-throttle-alert
    sys/class/thermal/cooling_device1/cur_state = 0
    sys/class/thermal/cooling_device1/max_state = 1
    sys/class/thermal/cooling_device2/type = hot-surface-alert
    sys/class/thermal/cooling_device2/cur_state = 1
    sys/class/thermal/cooling_device2/max_state = 1
    sys/class/thermal/cooling_device3/type = pwm-fan
    sys/class/thermal/cooling_device3/cur_state = 3
    sys/class/thermal/cooling_device3/max_state = 7
    sys/devices/system/cpu/cpufreq/policy0/scaling_max_freq = 1497600
    sys/devices/system/cpu/cpufreq/policy0/cpuinfo_max_freq = 2201600
    sys/class/hwmon/hwmon3/name = soctherm_oc
    sys/class/hwmon/hwmon3/oc1_event_cnt = 0
    sys/class/hwmon/hwmon3/oc2_event_cnt = 2
    sys/class/hwmon/hwmon3/oc3_event_cnt = 27390
";

#[test]
fn a_jetson_tells_how_far_it_is_from_being_slowed() {
    let (root, roots) = tree(JETSON);
    let mut thermometer = Thermometer::new();
    let heat = thermometer.judge(&Readings::read(&roots));
    assert_eq!(
        heat,
        Heat {
            hottest_c: Some(71.5),
            zone: "cpu-thermal".into(),
            // Not cpu-thermal's trip at 70 °C, which only announces a hot surface.
            margin_c: Some(12.0),
            margin_zone: "gpu-thermal".into(),
            critical_margin_c: Some(33.0),
            // Neither the fan, nor the hot surface, nor the power mode set before.
            throttled: Some(false),
            detail: String::new(),
        }
    );

    let set = |file: &str, text: &str| fs::write(root.path().join(file), text).unwrap();
    let mut slowed = |file: &str, during: &str, after: &str, expected: &str| {
        set(file, during);
        let heat = thermometer.judge(&Readings::read(&roots));
        assert_eq!(
            (heat.throttled, heat.detail.as_str()),
            (Some(true), expected)
        );
        set(file, after);
        let heat = thermometer.judge(&Readings::read(&roots));
        assert_eq!((heat.throttled, heat.detail.as_str()), (Some(false), ""));
    };
    let alert = "sys/class/thermal/cooling_device1/cur_state";
    slowed(alert, "1", "0", "cpu-throttle-alert 1 of 1");
    let limit = "sys/devices/system/cpu/cpufreq/policy0/scaling_max_freq";
    slowed(
        limit,
        "729600",
        "1497600",
        "policy0 held at 729 of 2201 MHz",
    );
    let voltage = "sys/class/hwmon/hwmon3/oc1_event_cnt";
    slowed(voltage, "1", "1", "voltage too low");
}

#[test]
fn a_laptop_without_passive_trips_is_judged_by_assumption() {
    let (_root, roots) = tree(
        "
        sys/class/thermal/thermal_zone0/type = acpitz
        sys/class/thermal/thermal_zone0/temp = 27800
        sys/class/thermal/thermal_zone0/trip_point_0_type = critical
        sys/class/thermal/thermal_zone0/trip_point_0_temp = 128000
        sys/class/thermal/thermal_zone1/type = x86_pkg_temp
        sys/class/thermal/thermal_zone1/temp = 91000
        sys/class/thermal/thermal_zone1/trip_point_0_type = passive
        sys/class/thermal/thermal_zone1/trip_point_0_temp = 0
        sys/class/thermal/cooling_device0/type = Processor
        sys/class/thermal/cooling_device0/cur_state = 0
        sys/class/thermal/cooling_device0/max_state = 3
        sys/class/thermal/cooling_device1/type = TCC Offset
        sys/class/thermal/cooling_device1/cur_state = 3
        sys/class/thermal/cooling_device1/max_state = 63
        sys/class/thermal/cooling_device2/type = intel_powerclamp
        sys/class/thermal/cooling_device2/cur_state = -1
        sys/class/thermal/cooling_device2/max_state = 100
        sys/devices/system/cpu/cpu0/thermal_throttle/package_throttle_count = 7
        ",
    );
    let heat = Thermometer::new().judge(&Readings::read(&roots));
    assert_eq!(heat.zone, "x86_pkg_temp");
    assert_eq!(heat.margin_c, Some(ASSUMED_LIMIT_C - 91.0));
    assert_eq!(heat.margin_zone, "x86_pkg_temp");
    // 128 °C of the other zone: the processor names none.
    assert_eq!(heat.critical_margin_c, Some(128.0 - 27.8));
    assert_eq!(heat.throttled, Some(false));
}

#[test]
fn a_machine_without_sensors_tells_nothing() {
    let (_root, roots) = tree("proc/version = none");
    assert_eq!(Readings::read(&roots), Readings::default());
    assert_eq!(
        Thermometer::new().judge(&Readings::default()),
        Heat::default()
    );
}

#[test]
fn a_zone_with_only_a_critical_trip_is_slowed_below_it() {
    let zone = |critical: f64| Zone {
        name: "soc".into(),
        temp_c: Some(60.0),
        trips: vec![Trip {
            kind: TripKind::Critical,
            at_c: critical,
        }],
    };
    assert_eq!(zone(85.0).limit_c(), 80.0);
    assert_eq!(zone(120.0).limit_c(), ASSUMED_LIMIT_C);
}

#[test]
fn nonsense_is_no_temperature() {
    let check = |millidegrees, expected| assert_eq!(celsius(millidegrees), expected);
    check(48_500, Some(48.5));
    check(-5_000, Some(-5.0));
    check(0, Some(0.0));
    check(-256_000, None);
    check(2_147_483_647, None);
}
