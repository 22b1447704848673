//! Which version of each system package a program needs, symbol by symbol, and whether the oldest
//! system that it is made for has that version. Pure.
//!
//! Debian's packages of libraries carry a file `symbols` that says for each symbol in which version
//! it came (deb-symbols(5)). So the answer names the symbol to blame, also for libraries whose own
//! symbols have no versions, as GStreamer's and GLib's.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};

use super::elf::Symbol;

/// The oldest system that the recorder runs on: JetPack 6, which is Ubuntu 22.04. Package by
/// package the version there (packages.ubuntu.com, jammy).
pub(super) const OLDEST_SYSTEM: [(&str, &str); 5] = [
    ("libc6", "2.35"),
    ("libgcc-s1", "12"),
    ("libglib2.0-0", "2.72"),
    ("libgstreamer-plugins-base1.0-0", "1.20"),
    ("libgstreamer1.0-0", "1.20"),
];

/// One library, by the name that programs ask for it.
#[derive(Default)]
struct Library {
    package: String,
    /// `name@version` and the version of the package that brought it.
    since: BTreeMap<String, String>,
}

/// The libraries of the packages whose `symbols` files were read.
#[derive(Default)]
pub(super) struct Libraries(BTreeMap<String, Library>);

/// What a program needs of one package, and the symbol that asks for it.
#[derive(Debug, PartialEq)]
pub(super) struct Need {
    pub(super) package: String,
    pub(super) version: String,
    pub(super) symbol: String,
}

impl Libraries {
    /// Takes in a `symbols` file. Its lines: `LIBRARY PACKAGE #MINVER#` begins a library, ` SYMBOL
    /// VERSION` is one of its symbols; those that begin with `|` or `*` are for other tools.
    pub(super) fn read(&mut self, text: &str) -> Result<()> {
        let mut current: Option<&mut Library> = None;
        for line in text.lines() {
            if line.starts_with(['|', '*', '#']) || line.trim().is_empty() {
                continue;
            }
            let mut words = line.split_whitespace();
            let (first, second) = words
                .next()
                .zip(words.next())
                .with_context(|| format!("expected two words in a symbols file, found {line:?}"))?;
            if !line.starts_with(' ') {
                let library = self.0.entry(first.to_owned()).or_default();
                second.clone_into(&mut library.package);
                current = Some(library);
            } else {
                let library = current
                    .as_mut()
                    .with_context(|| format!("a symbol before the first library: {line:?}"))?;
                library.since.insert(first.to_owned(), second.to_owned());
            }
        }
        Ok(())
    }

    /// What the program needs, one entry for each package in their order. A symbol that no library
    /// has is an error, unless it is weak.
    pub(super) fn needs(&self, libraries: &[String], symbols: &[Symbol]) -> Result<Vec<Need>> {
        let mut asked = Vec::new();
        for name in libraries {
            // The loader is a part of the C library, and its file has the same package.
            let library = self
                .0
                .get(name)
                .with_context(|| format!("the program needs {name}, which no known package has"))?;
            asked.push(library);
        }
        let mut needs: BTreeMap<&str, Need> = BTreeMap::new();
        for symbol in symbols {
            let key = format!("{}@{}", symbol.name, symbol.version);
            let found = asked
                .iter()
                .find_map(|library| Some((library, library.since.get(&key)?)));
            let Some((library, version)) = found else {
                if symbol.is_weak {
                    continue;
                }
                bail!(
                    "the program needs the symbol {key}, which none of its libraries has: {}",
                    libraries.join(", ")
                );
            };
            let version = upstream(version);
            let need = needs.entry(&library.package).or_insert_with(|| Need {
                package: library.package.clone(),
                version: version.to_owned(),
                symbol: key.clone(),
            });
            if is_newer(version, &need.version) {
                version.clone_into(&mut need.version);
                need.symbol = key;
            }
        }
        Ok(needs.into_values().collect())
    }
}

/// The needs that the oldest system does not meet, in words.
pub(super) fn too_new(needs: &[Need]) -> Vec<String> {
    needs
        .iter()
        .filter_map(|need| {
            let Need {
                package,
                version,
                symbol,
            } = need;
            match OLDEST_SYSTEM.iter().find(|(name, _)| name == package) {
                None => Some(format!(
                    "{symbol} needs the package {package}, whose version on JetPack 6 is not known here"
                )),
                Some((_, has)) if is_newer(version, has) => Some(format!(
                    "{symbol} needs {package} {version}; JetPack 6 has {has}"
                )),
                Some(_) => None,
            }
        })
        .collect()
}

/// `1:2.34~rc1-5` is version `2.34` of the software: without the distribution's parts.
fn upstream(version: &str) -> &str {
    let version = version.split_once(':').map_or(version, |(_, rest)| rest);
    version.split(['-', '~', '+']).next().unwrap_or(version)
}

/// Whether `left` is a later version than `right`; numbers between dots, missing ones are 0.
fn is_newer(left: &str, right: &str) -> bool {
    let numbers = |version: &str| -> Vec<u32> {
        let mut numbers: Vec<u32> = version
            .split('.')
            .map(|part| part.parse().unwrap_or(0))
            .collect();
        while numbers.last() == Some(&0) {
            numbers.pop();
        }
        numbers
    };
    numbers(left) > numbers(right)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "\
libgstreamer-1.0.so.0 libgstreamer1.0-0 #MINVER#
* Build-Depends-Package: libgstreamer1.0-dev
 gst_init@Base 1.0.0
 gst_task_pool_get_max_threads@Base 1.20.0
 gst_clock_is_system_monotonic@Base 1.22.0
libc.so.6 libc6 #MINVER#
| libc6 (>> 2.36), libc6 (<< 2.37)
 stat@GLIBC_2.33 2.33
 arc4random@GLIBC_2.36 2.36
";

    fn needs(symbols: &[(&str, &str, bool)]) -> Result<Vec<Need>> {
        let mut libraries = Libraries::default();
        libraries.read(FILE)?;
        let symbols: Vec<Symbol> = symbols
            .iter()
            .map(|(name, version, is_weak)| Symbol {
                name: (*name).to_owned(),
                version: (*version).to_owned(),
                is_weak: *is_weak,
            })
            .collect();
        let asked = ["libgstreamer-1.0.so.0".to_owned(), "libc.so.6".to_owned()];
        libraries.needs(&asked, &symbols)
    }

    #[test]
    fn the_newest_symbol_of_a_package_says_which_version_is_needed() -> Result<()> {
        let found = needs(&[
            ("gst_task_pool_get_max_threads", "Base", false),
            ("gst_init", "Base", false),
            ("stat", "GLIBC_2.33", false),
            ("__gmon_start__", "Base", true),
        ])?;
        let said: Vec<_> = found
            .iter()
            .map(|need| format!("{} {}", need.package, need.version))
            .collect();
        assert_eq!(said, ["libc6 2.33", "libgstreamer1.0-0 1.20.0"]);
        assert!(too_new(&found).is_empty());
        Ok(())
    }

    #[test]
    fn what_jetpack_6_lacks_is_named() -> Result<()> {
        let found = needs(&[
            ("gst_clock_is_system_monotonic", "Base", false),
            ("arc4random", "GLIBC_2.36", true),
        ])?;
        assert_eq!(
            too_new(&found),
            [
                "arc4random@GLIBC_2.36 needs libc6 2.36; JetPack 6 has 2.35",
                "gst_clock_is_system_monotonic@Base needs libgstreamer1.0-0 1.22.0; JetPack 6 has 1.20",
            ]
        );
        let unknown = Need {
            package: "libudev1".into(),
            version: "183".into(),
            symbol: "udev_new@LIBUDEV_183".into(),
        };
        assert_eq!(too_new(&[unknown]).len(), 1);
        Ok(())
    }

    #[test]
    fn a_symbol_that_no_library_has_is_an_error() {
        let error = needs(&[("gst_from_tomorrow", "Base", false)]).expect_err("nobody has it");
        assert!(error.to_string().contains("gst_from_tomorrow@Base"));
    }

    #[test]
    fn versions_compare_by_their_numbers() {
        assert!(is_newer("2.36", "2.35"));
        assert!(is_newer("1.20.1", "1.20"));
        assert!(!is_newer("1.20.0", "1.20"));
        assert!(!is_newer("1.9", "1.20"));
        assert_eq!(upstream("1:2.34~rc1-5"), "2.34");
    }
}
