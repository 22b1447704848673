//! Which layer may depend on which, and whether the packages keep to it.
//!
//! The rules are those of `ARCHITECTURE.md`, as one table. Dependencies of tests are exempt: a test
//! may need what its crate must not know.

use std::collections::HashMap;

use super::layers::{Layer, layer_of};
use super::manifest::Package;
use super::place::Place;

/// What packages of some layers must not depend on.
struct Rule {
    /// Key of the number of its breaches in `docs/tidy.txt`.
    key: &'static str,
    from: &'static [Layer],
    to: &'static [Layer],
    /// The rule as a sentence, with its reason.
    text: &'static str,
}

use Layer::{Dev, Devices, Formats, Program, Support, Synthetic, Vision};

const RULES: [Rule; 7] = [
    Rule {
        key: "program-on-program",
        from: &[Program],
        to: &[Program],
        text: "programs never depend on programs: they talk through contracts on disk",
    },
    Rule {
        key: "library-on-program",
        from: &[Formats, Devices, Vision, Synthetic, Support],
        to: &[Program],
        text: "libraries never depend on programs",
    },
    Rule {
        key: "lower-on-vision",
        from: &[Formats, Devices, Support],
        to: &[Vision],
        text: "formats, devices and support do not depend on vision",
    },
    Rule {
        key: "vision-on-data",
        from: &[Vision],
        to: &[Formats, Devices, Synthetic],
        text: "vision takes plain data: it does not depend on formats, devices or synthetic",
    },
    Rule {
        key: "support-on-domain",
        from: &[Support],
        to: &[Formats, Devices, Synthetic],
        text: "support depends on support only",
    },
    Rule {
        key: "lower-on-source",
        from: &[Formats, Devices],
        to: &[Synthetic],
        text: "formats and devices do not depend on synthetic",
    },
    Rule {
        key: "any-on-dev",
        from: &[Program, Formats, Devices, Vision, Synthetic, Support],
        to: &[Dev],
        text: "nothing depends on dev",
    },
];

/// Key of the number of packages below the programs that depend on formats and on vision.
const JOINED: &str = "formats-with-vision";

/// The breaches of one rule.
#[derive(Debug, PartialEq)]
pub(crate) struct Breaches {
    pub(crate) key: &'static str,
    /// The line that depends, with the package, the dependence and the rule.
    pub(crate) places: Vec<Place>,
}

/// Checks every rule. Every rule has an entry, with or without breaches.
pub(crate) fn breaches(packages: &[Package]) -> Vec<Breaches> {
    let layers: HashMap<&str, Layer> = packages
        .iter()
        .filter_map(|package| Some((package.name.as_str(), layer_of(package, packages)?)))
        .collect();
    let mut all: Vec<Breaches> = Vec::new();
    for rule in &RULES {
        let mut places = Vec::new();
        for package in packages {
            let from = layers.get(package.name.as_str());
            if !from.is_some_and(|layer| rule.from.contains(layer)) {
                continue;
            }
            for dependency in &package.dependencies {
                let to = layers.get(dependency.name.as_str());
                if to.is_some_and(|layer| rule.to.contains(layer)) {
                    let (of, on) = (&package.name, &dependency.name);
                    let text = format!("{of} depends on {on}: {}", rule.text);
                    places.push(Place::new(&package.manifest(), dependency.line, text));
                }
            }
        }
        all.push(Breaches {
            key: rule.key,
            places,
        });
    }
    all.push(Breaches {
        key: JOINED,
        places: joined(packages, &layers),
    });
    all
}

/// Formats and vision are joined by programs only. What belongs to one of the two has a rule of its
/// own.
fn joined(packages: &[Package], layers: &HashMap<&str, Layer>) -> Vec<Place> {
    let mut places = Vec::new();
    for package in packages {
        match layers.get(package.name.as_str()) {
            Some(Devices | Synthetic | Support) => {}
            None | Some(Program | Dev | Formats | Vision) => continue,
        }
        let first_on = |layer: Layer| {
            let mut on = package.dependencies.iter();
            on.find(|dependency| layers.get(dependency.name.as_str()) == Some(&layer))
        };
        if let (Some(format), Some(vision)) = (first_on(Formats), first_on(Vision)) {
            let text = format!(
                "{} depends on {} and {}: formats and vision are joined by programs only",
                package.name, format.name, vision.name
            );
            places.push(Place::new(&package.manifest(), format.line, text));
        }
    }
    places
}

/// The packages whose folder is in no known layer; no rule is checked for them.
pub(crate) fn without_layer(packages: &[Package]) -> Vec<Place> {
    let without = packages
        .iter()
        .filter(|package| layer_of(package, packages).is_none());
    without
        .map(|package| {
            let text = format!("{} is in no known layer", package.name);
            Place::new(&package.manifest(), 1, text)
        })
        .collect()
}

/// The packages, and the folders at the top level, that `ARCHITECTURE.md` does not name in a span
/// of code. `paths` are the files of the repository; folders whose name begins with a dot are
/// exempt.
pub(crate) fn unnamed<'a>(
    architecture: &str,
    packages: &[Package],
    paths: impl Iterator<Item = &'a str>,
) -> Vec<Place> {
    let spans: Vec<&str> = architecture.split('`').skip(1).step_by(2).collect();
    let mut folders: Vec<&str> = paths
        .filter_map(|path| Some(path.split_once('/')?.0))
        .filter(|folder| !folder.starts_with('.'))
        .collect();
    folders.sort_unstable();
    folders.dedup();
    let mut places = Vec::new();
    for folder in folders {
        let inside = format!("{folder}/");
        if !spans
            .iter()
            .any(|span| *span == folder || span.starts_with(&inside))
        {
            let text = format!("does not name the folder {folder}");
            places.push(Place::new("ARCHITECTURE.md", 1, text));
        }
    }
    for package in packages {
        if !spans.contains(&package.name.as_str()) && !spans.contains(&package.folder.as_str()) {
            let text = format!("does not name the package {}", package.name);
            places.push(Place::new("ARCHITECTURE.md", 1, text));
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::manifest::Dependency;

    /// A package out of its folder and what it depends on.
    fn package(folder: &str, on: &[&str]) -> Package {
        let dependencies = on.iter().enumerate().map(|(line, name)| Dependency {
            name: (*name).to_owned(),
            line: line + 1,
        });
        Package {
            name: folder.rsplit('/').next().unwrap_or_default().to_owned(),
            folder: folder.to_owned(),
            dependencies: dependencies.collect(),
        }
    }

    fn workspace() -> Vec<Package> {
        vec![
            package(
                "capture-daemon",
                &["archive", "zed", "calib", "rig-sim", "video"],
            ),
            package(
                "collector",
                &["archive", "odometry", "calib", "cad-transforms"],
            ),
            package("simulation", &["archive", "depth", "rig-sim"]),
            package(
                "crates/vision/calib",
                &["cad-transforms", "plain-file", "serde"],
            ),
            package("cad-transforms", &["plain-file"]),
            package("crates/formats/archive", &["plain-file", "cad-transforms"]),
            package("crates/formats/bundle", &["archive"]),
            package("crates/devices/zed", &["v4l2", "archive"]),
            package("crates/devices/v4l2", &[]),
            package(
                "crates/vision/odometry",
                &["calib", "cad-transforms", "depth"],
            ),
            package("crates/vision/depth", &[]),
            package("crates/synthetic/rig-sim", &["archive", "video", "zed"]),
            package("crates/support/plain-file", &[]),
            package("crates/support/video", &["plain-file"]),
            package(
                "crates/dev/bench",
                &["collector", "depth", "tests", "archive"],
            ),
            package("tests", &["collector", "capture-daemon"]),
        ]
    }

    /// The keys of the rules that are broken, each as often as it is.
    fn broken(packages: &[Package]) -> Vec<&'static str> {
        let all = breaches(packages).into_iter();
        all.flat_map(|rule| vec![rule.key; rule.places.len()])
            .collect()
    }

    #[test]
    fn layers_that_keep_to_the_rules_have_no_breach() {
        assert_eq!(broken(&workspace()), Vec::<&str>::new());
    }

    #[test]
    fn each_rule_is_broken_by_one_more_line() {
        for (from, on, expected) in [
            ("capture-daemon", "collector", "program-on-program"),
            ("zed", "collector", "library-on-program"),
            ("cad-transforms", "collector", "library-on-program"),
            ("archive", "calib", "lower-on-vision"),
            ("v4l2", "depth", "lower-on-vision"),
            ("plain-file", "odometry", "lower-on-vision"),
            ("odometry", "archive", "vision-on-data"),
            ("calib", "zed", "vision-on-data"),
            ("depth", "rig-sim", "vision-on-data"),
            ("cad-transforms", "archive", "support-on-domain"),
            ("bundle", "rig-sim", "lower-on-source"),
            ("v4l2", "rig-sim", "lower-on-source"),
            ("collector", "tests", "any-on-dev"),
            ("depth", "bench", "any-on-dev"),
            ("rig-sim", "calib", "formats-with-vision"),
        ] {
            let mut packages = workspace();
            let package = packages.iter_mut().find(|package| package.name == from);
            package.expect("a package").dependencies.push(Dependency {
                name: on.to_owned(),
                line: 9,
            });
            assert_eq!(broken(&packages), [expected], "{from} on {on}");
        }
    }

    #[test]
    fn a_breach_names_package_dependence_and_rule() {
        let mut packages = workspace();
        packages[9].dependencies.push(Dependency {
            name: "archive".into(),
            line: 9,
        });
        let all = breaches(&packages);
        let place = all.iter().flat_map(|rule| &rule.places).next();
        assert_eq!(
            place.expect("a breach").to_string(),
            "crates/vision/odometry/Cargo.toml:9: odometry depends on archive: vision takes plain data: \
             it does not depend on formats, devices or synthetic"
        );
    }

    #[test]
    fn a_package_in_no_layer_is_named_and_breaks_no_rule() {
        let mut packages = workspace();
        packages.push(package("lens", &["collector", "tests"]));
        assert_eq!(broken(&packages), Vec::<&str>::new());
        let places = without_layer(&packages);
        assert_eq!(places.len(), 1);
        assert!(places[0].text.contains("lens"));
    }

    #[test]
    fn what_the_architecture_does_not_name_is_found() {
        let packages = [package("calib", &[]), package("crates/vision/depth", &[])];
        let paths = [
            "calib/a.rs",
            "crates/b.rs",
            ".ci/run",
            "docs/c.md",
            "README.md",
        ];
        let missing = |text: &str| {
            let places = unnamed(text, &packages, paths.into_iter());
            places
                .into_iter()
                .map(|place| place.text)
                .collect::<Vec<_>>()
        };
        assert_eq!(
            missing("`calib`, `crates/vision`, **`depth`**, `docs`"),
            Vec::<String>::new()
        );
        assert_eq!(
            missing("calib `crates/vision`, `in-depth` `docs/c.md`"),
            [
                "does not name the folder calib",
                "does not name the package calib",
                "does not name the package depth"
            ]
        );
    }
}
