//! A walk with a simulated rig as the source of a camera: its settings, and their keys.

use std::path::{Path, PathBuf};

use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::Settings;

use super::file::{one_of, pixels};
use super::section::Section;

/// A walk with a simulated rig.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedConfig {
    /// Scene, light, duration, rate, image size per eye, quality. Cameras with the same settings
    /// share one walk.
    pub walk: Settings,
    /// File with faults; `None` for no faults.
    pub faults: Option<PathBuf>,
}

/// Default: ten minutes over a pavement by day, with cameras of a ZED Mini's smallest size at 15
/// Hz.
pub(super) fn simulated(section: &mut Section<'_>, folder: &Path) -> SimulatedConfig {
    let kind = one_of(section, "scene", &Kind::ALL.map(|kind| (kind.name(), kind)));
    let lighting = one_of(
        section,
        "light",
        &Lighting::ALL.map(|time| (time.name(), time)),
    );
    let qualities = [("fast", Quality::FAST), ("accurate", Quality::ACCURATE)];
    let quality = one_of(section, "quality", &qualities);
    let walk = Settings {
        kind,
        lighting,
        seed: section
            .integer("seed", 0..=i64::MAX)
            .map_or(1, i64::unsigned_abs),
        seconds: section.number("seconds", 0.1..=3600.0).unwrap_or(600.0),
        rate_hz: section.number("rate_hz", 0.1..=100.0).unwrap_or(15.0),
        width: pixels(section, "width", 32..=8192, 1344, 4) / 2,
        height: pixels(section, "height", 16..=4096, 376, 2),
        quality,
    };
    SimulatedConfig {
        walk,
        faults: section.path("faults", folder),
    }
}
