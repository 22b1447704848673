//! Which layer a package belongs to: its folder says so.

use super::manifest::Package;

/// A layer. Programs are at the top, what is for developers beside all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layer {
    /// Talks to other programs through files only.
    Program,
    /// Contracts on disk.
    Formats,
    /// Hardware, the machine, the link to the rig.
    Devices,
    /// Calibration and estimators.
    Vision,
    /// Simulated data.
    Synthetic,
    /// Tools that know nothing of the domain, and frames, rigid transforms, models of cameras and
    /// boards, which all others use.
    Support,
    /// For developers: tests, benchmarks, virtual machines.
    Dev,
}

/// Packages that are at the top level; `affordance` and `simulation` are planned.
const TOP_LEVEL: [(&str, Layer); 8] = [
    ("affordance", Layer::Program),
    ("cad-transforms", Layer::Support),
    ("calib", Layer::Program),
    ("capture-daemon", Layer::Program),
    ("collector", Layer::Program),
    ("reconstruction", Layer::Program),
    ("simulation", Layer::Program),
    ("tests", Layer::Dev),
];

/// Folders whose packages are one layer.
const FOLDERS: [(&str, Layer); 6] = [
    ("crates/dev", Layer::Dev),
    ("crates/devices", Layer::Devices),
    ("crates/formats", Layer::Formats),
    ("crates/support", Layer::Support),
    ("crates/synthetic", Layer::Synthetic),
    ("crates/vision", Layer::Vision),
];

/// The layer of a package, `None` where its folder is none of the known ones. A package inside the
/// folder of another, such as its fuzz targets, is a tool of its developers.
pub(crate) fn layer_of(package: &Package, packages: &[Package]) -> Option<Layer> {
    let is_inside = packages.iter().any(|other| {
        let inside = package.folder.strip_prefix(&other.folder);
        inside.is_some_and(|rest| rest.starts_with('/'))
    });
    if is_inside {
        return Some(Layer::Dev);
    }
    let find = |table: &[(&str, Layer)], name: &str| {
        let row = table.iter().find(|(folder, _)| *folder == name);
        row.map(|(_, layer)| *layer)
    };
    match package.folder.rsplit_once('/') {
        None => find(&TOP_LEVEL, &package.folder),
        Some((folder, _)) => find(&FOLDERS, folder),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn package(folder: &str) -> Package {
        Package {
            name: folder.rsplit('/').next().unwrap_or_default().to_owned(),
            folder: folder.to_owned(),
            dependencies: Vec::new(),
        }
    }

    #[test]
    fn the_folder_says_the_layer() {
        let packages = [
            package("collector"),
            package("collector-tools"),
            package("crates/formats/session-archive"),
            package("crates/formats/session-archive/fuzz"),
            package("crates/synthetic/rig-sim"),
            package("crates/other/x"),
            package("crates/formats"),
            package("cad-transforms"),
        ];
        let layers: Vec<_> = packages.iter().map(|p| layer_of(p, &packages)).collect();
        assert_eq!(layers[0], Some(Layer::Program));
        assert_eq!(layers[1], None);
        assert_eq!(layers[3], Some(Layer::Dev));
        assert_eq!(layers[4], Some(Layer::Synthetic));
        assert_eq!(layers[5], None);
        assert_eq!(layers[7], Some(Layer::Support));
        assert_eq!(layer_of(&packages[2], &packages[..4]), Some(Layer::Formats));
    }
}
