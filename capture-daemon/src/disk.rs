//! State of the machine: free space and temperature.
//!
//! Contract: every call reads the current values, takes microseconds on a local disk and caches
//! nothing. Free space is the space that an ordinary user may still write, without the blocks
//! reserved for root. A machine without sensors has no temperature; a sensor that is switched off
//! or reports an implausible value is ignored.

use std::fs;
use std::io;
use std::path::Path;

/// Minimum free space above the reserve at the start of a recording, bytes. With less, the
/// recording would end immediately.
pub const START_MARGIN_BYTES: u64 = 256 << 20;

/// Folder of the Linux temperature sensors (`Documentation/ABI/testing/sysfs-class-thermal`).
const THERMAL: &str = "/sys/class/thermal";

/// Free space on the file system that holds `path`, bytes.
///
/// # Errors
/// `path` does not exist or cannot be reached.
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    let stat = rustix::fs::statvfs(path)?;
    Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// Highest temperature of all sensors, °C; `None` without a valid one.
pub fn hottest_c() -> Option<f64> {
    hottest_in(Path::new(THERMAL))
}

fn hottest_in(folder: &Path) -> Option<f64> {
    let sensors = fs::read_dir(folder).ok()?;
    sensors
        .filter_map(|sensor| fs::read_to_string(sensor.ok()?.path().join("temp")).ok())
        .filter_map(|text| celsius(&text))
        .max_by(f64::total_cmp)
}

/// Temperature in a sensor's `temp` file, which contains millidegrees Celsius. `None` if it is
/// implausible: a Jetson's zones read -256000 while their unit is off.
fn celsius(text: &str) -> Option<f64> {
    let millidegrees: i32 = text.trim().parse().ok()?;
    (-40_000..=150_000)
        .contains(&millidegrees)
        .then(|| f64::from(millidegrees) / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_space_is_that_of_the_file_system() {
        let folder = tempfile::tempdir().unwrap();
        let free = free_bytes(folder.path()).unwrap();
        let stat = rustix::fs::statvfs(folder.path()).unwrap();
        let size = stat.f_blocks * stat.f_frsize;
        assert!(0 < free && free <= size, "{free} of {size}");
        let absent = free_bytes(&folder.path().join("absent")).unwrap_err();
        assert_eq!(absent.kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn sensor_text_is_millidegrees_or_rejected() {
        let check =
            |text: &str, expected: Option<f64>| assert_eq!(celsius(text), expected, "{text:?}");
        check("48500\n", Some(48.5));
        check("-5000\n", Some(-5.0));
        check("0\n", Some(0.0));
        check("-256000\n", None);
        check("2147483647\n", None);
        check("99999999999\n", None);
        check("", None);
        check("warm\n", None);
    }

    #[test]
    fn hottest_sensor_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(hottest_in(folder.path()), None);
        assert_eq!(hottest_in(&folder.path().join("absent")), None);
        let zones = [
            ("zone0", "41000"),
            ("zone1", "57250"),
            ("zone2", "-256000"),
            ("zone3", "x"),
        ];
        for (zone, text) in zones {
            fs::create_dir(folder.path().join(zone)).unwrap();
            fs::write(folder.path().join(zone).join("temp"), text).unwrap();
        }
        fs::create_dir(folder.path().join("cooling_device0")).unwrap();
        assert_eq!(hottest_in(folder.path()), Some(57.25));
    }
}
