//! What the checks need of a `Cargo.toml`, read line by line: the package's name and what it
//! depends on.
//!
//! Not a TOML parser. It reads the forms that this repository uses: a table per section, one
//! dependency a line, inline tables; values that go on over several lines are passed over.

/// A package of this repository.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Package {
    pub(crate) name: String,
    /// Its folder, from the repository root.
    pub(crate) folder: String,
    /// What it links, and what its build script links. Not what its tests link.
    pub(crate) dependencies: Vec<Dependency>,
}

/// A line that names another package.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Dependency {
    /// Name of the package, whatever it is called here.
    pub(crate) name: String,
    /// Line of the manifest, counted from 1.
    pub(crate) line: usize,
}

impl Package {
    /// Path of its manifest from the repository root.
    pub(crate) fn manifest(&self) -> String {
        format!("{}/Cargo.toml", self.folder)
    }
}

/// Reads a manifest; `None` for one without a package, as that of the workspace is.
pub(crate) fn parse(text: &str, folder: &str) -> Option<Package> {
    let mut name = None;
    let mut dependencies: Vec<Dependency> = Vec::new();
    let mut section = Section::Other;
    for (at, line) in text.lines().enumerate() {
        let line = line.trim();
        let number = at + 1;
        if let Some(header) = line.strip_prefix('[') {
            section = section_of(header);
            if let Section::Dependency(name) = &section {
                dependencies.push(Dependency {
                    name: name.clone(),
                    line: number,
                });
            }
            continue;
        }
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let key = key.trim();
        match &section {
            Section::Package if key == "name" => name = quoted(value),
            Section::Dependencies => {
                let (named, field) = key.split_once('.').unwrap_or((key, ""));
                let named = named.trim_matches('"');
                if !is_package_name(named) {
                    continue;
                }
                let renamed = match field {
                    "package" => quoted(value),
                    _ => value_of(value, "package"),
                };
                match dependencies.iter_mut().find(|known| known.name == named) {
                    // A second line with another field of the same dependency.
                    Some(known) => known.name = renamed.unwrap_or(named.to_owned()),
                    None => dependencies.push(Dependency {
                        name: renamed.unwrap_or(named.to_owned()),
                        line: number,
                    }),
                }
            }
            Section::Dependency(_) if key == "package" => {
                if let (Some(last), Some(renamed)) = (dependencies.last_mut(), quoted(value)) {
                    last.name = renamed;
                }
            }
            _ => {}
        }
    }
    Some(Package {
        name: name?,
        folder: folder.to_owned(),
        dependencies,
    })
}

enum Section {
    Package,
    Dependencies,
    /// `[dependencies.NAME]`
    Dependency(String),
    Other,
}

/// Reads a header without its first bracket: `dependencies]`, `target.'cfg(unix)'.dependencies]`.
fn section_of(header: &str) -> Section {
    let Some((header, _)) = header.rsplit_once(']') else {
        return Section::Other;
    };
    if header == "package" {
        return Section::Package;
    }
    if header.starts_with('[') || header.starts_with("workspace") {
        return Section::Other;
    }
    // A target is a triple or a condition, which may have dots inside quotes.
    let header = match header.strip_prefix("target.") {
        Some(rest) => ["dependencies", "build-dependencies"]
            .iter()
            .filter_map(|kind| rest.rfind(&format!(".{kind}")))
            .min()
            .map_or(header, |at| &rest[at + 1..]),
        None => header,
    };
    for kind in ["dependencies", "build-dependencies"] {
        if header == kind {
            return Section::Dependencies;
        }
        if let Some(name) = header.strip_prefix(&format!("{kind}.")) {
            return Section::Dependency(name.trim_matches('"').to_owned());
        }
    }
    Section::Other
}

fn is_package_name(name: &str) -> bool {
    !name.is_empty()
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "-_".contains(c))
}

/// The value of a field in an inline table.
fn value_of(table: &str, field: &str) -> Option<String> {
    let inside = table.trim().strip_prefix('{')?;
    let mut fields = inside.split([',', '}']);
    fields.find_map(|pair| {
        let (key, value) = pair.split_once('=')?;
        (key.trim() == field).then(|| quoted(value))?
    })
}

fn quoted(value: &str) -> Option<String> {
    let inside = value.trim().strip_prefix('"')?;
    Some(inside.split('"').next()?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_dependencies_of_every_form_are_read() {
        let text = r#"
[package]
name = "depth"
version.workspace = true

[lib]
name = "other"

[dependencies]
# a comment = with a sign
rayon.workspace = true
video = { path = "../video", package = "film" }
serde = { workspace = true, features = [
    "derive",
    "rc",
] }
"quoted" = "1"
learned = { workspace = true, optional = true }

[dependencies.calib]
path = "../calib"

[dependencies.lens]
package = "optics"

[build-dependencies]
made = "1"

[target.'cfg(unix)'.dependencies]
libc = "0.2"

[target.x86_64-unknown-linux-gnu.dependencies]
nix = "0.30"

[target.'cfg(target_os = "linux")'.dependencies.odometry]
path = "../odometry"

[target.'cfg(unix)'.dev-dependencies]
proptest = "1"

[dev-dependencies]
tempfile = "3"

[dev-dependencies.proptest]
version = "1"

[[bin]]
name = "program"
"#;
        let package = parse(text, "crates/vision/depth").expect("a package");
        assert_eq!(package.name, "depth");
        assert_eq!(package.manifest(), "crates/vision/depth/Cargo.toml");
        let found = package.dependencies.iter();
        let found: Vec<_> = found.map(|d| (d.name.as_str(), d.line)).collect();
        assert_eq!(
            found,
            [
                ("rayon", 11),
                ("film", 12),
                ("serde", 13),
                ("quoted", 17),
                ("learned", 18),
                ("calib", 20),
                ("optics", 23),
                ("made", 27),
                ("libc", 30),
                ("nix", 33),
                ("odometry", 35),
            ]
        );
    }

    #[test]
    fn a_workspace_is_no_package() {
        assert_eq!(
            parse("[workspace]\n[workspace.dependencies]\na = \"1\"", ""),
            None
        );
    }
}
