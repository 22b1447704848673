//! Placements out of CAD files, and rigs out of placements.
//!
//! Contract: every reader gives the parts of a file with `root_from_part` in metres, whatever the
//! file's unit. A file that cannot be understood is an error that says where (line, entity, column
//! or key) what was found and what was expected; no part is left out silently. What was assumed is
//! a note. Nothing here looks at shapes: a part is a name and the pose of its coordinate system.
//!
//! Readers: [`step`] (AP203, AP214, AP242 assemblies), [`urdf`], [`gltf`] (`.gltf` and `.glb`),
//! [`table`] (CSV and TOML). [`map`] makes a [`crate::Rig`] of parts, [`export`] writes a rig in
//! the same formats.
//!
//! ```
//! use cad_transforms::cad;
//! let text = "name,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\nleft_mount,20,140,100,0,0,30\n";
//! let cad = cad::read_bytes(text.as_bytes(), cad::Format::Csv)?;
//! assert_eq!(cad.parts[0].root_from_part.translation_m(), [0.02, 0.14, 0.1]);
//! # Ok::<(), cad::CadError>(())
//! ```

use std::fmt;
use std::path::{Path, PathBuf};

use crate::rig::CadSource;
use crate::transform::RigidTransform;

pub mod device;
pub mod export;
pub mod gltf;
pub mod map;
pub mod part21;
pub mod step;
pub mod table;
pub mod urdf;

/// Maximum distance of a part from the root, m. Beyond it, the file's unit is not the one that it
/// states: a plate on a chest drawn in millimetres and read as metres is hundreds of metres wide.
const FARTHEST_M: f64 = 10.0;

/// Parts that lie no farther from each other than this, m, suggest that metres were read as
/// millimetres.
const NEAREST_M: f64 = 0.002;

/// Maximum number of parts of a file: instances multiply, and a broken file could name billions.
pub(crate) const MOST_PARTS: usize = 100_000;

/// The content of a CAD file.
#[derive(Clone, Debug, PartialEq)]
pub struct Cad {
    /// All parts, in the order of the file, a parent before its children.
    pub parts: Vec<Part>,
    /// Assumptions and omissions of the reader.
    pub notes: Vec<String>,
}

/// A part and its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Its own name.
    pub name: String,
    /// Names from the root on, joined with `/`; no two parts share one.
    pub path: String,
    /// Takes coordinates in the part's own system to the root's, metres.
    pub root_from_part: RigidTransform,
    /// Where it stands in the file.
    pub place: String,
}

/// The formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// ISO 10303-21: `.step`, `.stp`, `.p21`.
    Step,
    /// `.urdf`, `.xml`.
    Urdf,
    /// `.gltf`, `.glb`.
    Gltf,
    /// `.csv`, `.tsv`, `.txt`.
    Csv,
    /// `.toml` with entries `[[part]]`.
    Toml,
}

/// Something wrong in a CAD file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Line, entity, column, key.
    pub place: String,
    /// What was found and what was expected.
    pub message: String,
}

/// Why a CAD file gave no parts.
#[derive(Debug, thiserror::Error)]
pub enum CadError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading a CAD file: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// No reader goes by this name.
    #[error(
        "reading a CAD file: its name ends in {found:?}, expected .step, .stp, .urdf, .gltf, .glb, .csv or .toml: {}",
        path.display()
    )]
    UnknownFormat {
        /// The ending.
        found: String,
        /// The file.
        path: PathBuf,
    },
    /// The file is wrong: correct everything listed.
    #[error("reading a {format} file: {}{}", lines(faults), in_file(path.as_deref()))]
    Invalid {
        /// What it was read as.
        format: Format,
        /// Everything that is wrong, as far as it was understood.
        faults: Vec<Fault>,
        /// The file, where the text came from one.
        path: Option<PathBuf>,
    },
}

/// Maximum length of a CAD file, bytes. An assembly of a rig takes a few megabytes.
pub const MAX_BYTES: u64 = 256 << 20;

/// Reads a CAD file, the format by the ending of its name, with its name and hash: a regular file
/// of at most [`MAX_BYTES`].
///
/// # Errors
/// [`CadError`].
pub fn read(path: &Path) -> Result<(Cad, CadSource), CadError> {
    let format = Format::of(path)?;
    let bytes = plain_file::read(path, MAX_BYTES).map_err(|source| CadError::Read {
        path: path.to_owned(),
        source,
    })?;
    let cad = read_bytes(&bytes, format).map_err(|error| match error {
        CadError::Invalid { format, faults, .. } => CadError::Invalid {
            format,
            faults,
            path: Some(path.to_owned()),
        },
        other => other,
    })?;
    let name = path.file_name().unwrap_or(path.as_os_str());
    let source = CadSource {
        file: name.to_string_lossy().into_owned(),
        blake3: blake3::hash(&bytes).to_hex().to_string(),
    };
    Ok((cad, source))
}

/// Reads the content of a CAD file.
///
/// # Errors
/// [`CadError::Invalid`].
pub fn read_bytes(bytes: &[u8], format: Format) -> Result<Cad, CadError> {
    let cad = match format {
        Format::Step => step::parts(bytes),
        Format::Gltf => gltf::parts(bytes),
        Format::Urdf => text(bytes).and_then(urdf::parts),
        Format::Csv => text(bytes).and_then(table::parts_of_csv),
        Format::Toml => text(bytes).and_then(table::parts_of_toml),
    };
    cad.and_then(plausible).map_err(|faults| CadError::Invalid {
        format,
        faults,
        path: None,
    })
}

impl Format {
    /// By the ending of a file's name.
    ///
    /// # Errors
    /// [`CadError::UnknownFormat`].
    pub fn of(path: &Path) -> Result<Self, CadError> {
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        match ending.to_ascii_lowercase().as_str() {
            "step" | "stp" | "p21" => Ok(Self::Step),
            "urdf" | "xml" => Ok(Self::Urdf),
            "gltf" | "glb" => Ok(Self::Gltf),
            "csv" | "tsv" | "txt" => Ok(Self::Csv),
            "toml" => Ok(Self::Toml),
            _ => Err(CadError::UnknownFormat {
                found: ending.into_owned(),
                path: path.to_owned(),
            }),
        }
    }
}

impl Cad {
    /// The part of this path, or the only one whose path ends so: `left_mount/zed` finds
    /// `plate/left_mount/zed`.
    ///
    /// # Errors
    /// In words, when there is none or more than one.
    pub fn find(&self, path: &str) -> Result<&Part, String> {
        if let Some(part) = self.parts.iter().find(|part| part.path == path) {
            return Ok(part);
        }
        let ends = |part: &&Part| {
            part.name == path
                || part
                    .path
                    .strip_suffix(path)
                    .is_some_and(|before| before.ends_with('/'))
        };
        let found: Vec<&Part> = self.parts.iter().filter(ends).collect();
        match found.as_slice() {
            [only] => Ok(only),
            [] => {
                let nearest = self
                    .parts
                    .iter()
                    .map(|part| {
                        let whole = strsim::osa_distance(path, &part.path);
                        (
                            whole.min(strsim::osa_distance(path, &part.name)),
                            &part.path,
                        )
                    })
                    .min();
                let hint = nearest.map_or(String::new(), |(_, path)| {
                    format!("; the nearest is {path:?}")
                });
                Err(format!(
                    "no part is called {path:?} among {}{hint}",
                    self.parts.len()
                ))
            }
            several => {
                let paths: Vec<&str> = several.iter().map(|part| part.path.as_str()).collect();
                Err(format!(
                    "{path:?} fits {} parts, write more of the path: {}",
                    paths.len(),
                    paths.join(", ")
                ))
            }
        }
    }
}

/// Refuses placements that are implausible for a plate.
fn plausible(mut cad: Cad) -> Result<Cad, Vec<Fault>> {
    let far: Vec<&Part> = cad
        .parts
        .iter()
        .filter(|part| part.root_from_part.distance_m() > FARTHEST_M)
        .collect();
    if let Some(part) = far.first() {
        let metres = part.root_from_part.distance_m();
        let more = match far.len() - 1 {
            0 => String::new(),
            n => format!(" (and {n} more)"),
        };
        let message = format!(
            "part {:?} is {metres:.1} m from the root{more}, expected at most {FARTHEST_M} m: \
             are the numbers in another unit than the file says?",
            part.path
        );
        let place = part.place.clone();
        return Err(vec![Fault { place, message }]);
    }
    let reach = cad
        .parts
        .iter()
        .map(|part| part.root_from_part.distance_m())
        .fold(0.0, f64::max);
    if reach > 0.0 && reach < NEAREST_M {
        cad.notes.push(format!(
            "all parts lie within {:.4} mm of the root: are the numbers in another unit than the file says?",
            1e3 * reach
        ));
    }
    Ok(cad)
}

fn text(bytes: &[u8]) -> Result<&str, Vec<Fault>> {
    std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()]
            .iter()
            .filter(|b| **b == b'\n')
            .count();
        vec![Fault::at_line(line, "bytes that are no UTF-8 text")]
    })
}

/// Makes names unique among siblings: where several share one, each gets `#1`, `#2`, ….
pub(crate) fn numbered(names: Vec<String>) -> Vec<String> {
    let mut given = std::collections::BTreeMap::new();
    let several: Vec<bool> = names
        .iter()
        .map(|name| names.iter().filter(|other| *other == name).count() > 1)
        .collect();
    let number = |(name, several): (String, bool)| {
        if !several {
            return name;
        }
        let count = given.entry(name.clone()).or_insert(0);
        *count += 1;
        format!("{name}#{count}")
    };
    names.into_iter().zip(several).map(number).collect()
}

/// A name that can be a step of a path.
pub(crate) fn step_of_path(name: &str) -> String {
    name.trim().replace('/', "_")
}

impl Fault {
    pub(crate) fn new(place: impl Into<String>, message: impl Into<String>) -> Self {
        Self {
            place: place.into(),
            message: message.into(),
        }
    }

    pub(crate) fn at_line(line: usize, message: impl Into<String>) -> Self {
        Self::new(format!("line {line}"), message)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Step => "STEP",
            Self::Urdf => "URDF",
            Self::Gltf => "glTF",
            Self::Csv => "CSV",
            Self::Toml => "TOML",
        })
    }
}

fn lines(faults: &[Fault]) -> String {
    match faults {
        [only] => only.to_string(),
        all => {
            let list: String = all.iter().map(|fault| format!("\n  {fault}")).collect();
            format!("{} problems{list}", all.len())
        }
    }
}

fn in_file(path: Option<&Path>) -> String {
    path.map(|path| format!("\nin {}", path.display()))
        .unwrap_or_default()
}
