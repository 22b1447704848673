//! Output `splats`: the scene as 3D Gaussians that render what the cameras recorded.
//!
//! Contract: `splats.json` has sectors, views and the training; each sector is a `.ply` file as
//! 3DGS writes it, in the world of the bundle; `sky.npy` the colors behind the Gaussians, where
//! they depend on the direction; `held-out/N.png` view N as recorded and as rendered, side by side,
//! of some views; `NNN-coverage.npy`, `free-space.npy` and `sky-coverage.npy` what the views of the
//! training saw ([`SplatCoverage`]). Every Gaussian is in the sector in whose box its mean is. Its
//! parameters are finite.

mod coverage;
mod record;

pub use coverage::{SplatCoverageContent, SplatObservation, SplatSpaceBlock, read_coverage};
pub use record::{
    HeldOut, SplatBackground, SplatCheck, SplatCoverage, SplatNeighbor, SplatScene, SplatSector,
    SplatShutter, SplatTraining, SplatView,
};

use gaussians::files::{FileError, ply};
use gaussians::{Plane, Splats};

use record::FILE;

use super::{Fault, read_json, write_compact_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::array;
use crate::scene::OutputReader;

const SKY: &str = "sky.npy";

/// Path of the file of a sector.
fn sector_path(number: usize) -> String {
    format!("{number:03}.ply")
}

/// Path of the comparison of a view.
pub fn comparison_path(view: usize) -> String {
    format!("held-out/{view}.png")
}

/// Content of a scene beside its record.
#[derive(Clone, Copy, Debug, Default)]
pub struct SplatContent<'a> {
    /// Gaussians of each sector.
    pub sectors: &'a [Splats],
    /// Texels of the sky, row by row, in the octahedral map of the crate `splats`; none for a
    /// constant background.
    pub sky: &'a [[f32; 3]],
    /// Indices of views and PNG files of their comparisons.
    pub comparisons: &'a [(usize, Vec<u8>)],
    /// What the views of the training saw, if the record has its layout.
    pub coverage: Option<&'a SplatCoverageContent>,
}

/// Writes a scene. Number, file and hash of the Gaussians of each sector are those of the content.
///
/// # Errors
/// [`BundleError::Refused`] if the record contradicts the content or itself, and for numbers that
/// are not finite; [`BundleError::Io`].
///
/// ```
/// use gaussians::{Splat, Splats};
/// use scene_bundle::outputs::{self, splats};
/// # use scene_bundle::Bundle;
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
///
/// let mut ball = Splats::empty(0)?;
/// ball.push(&Splat::sphere(0.1, [0.9, 0.4, 0.1]))?;
/// let scene = splats::SplatScene {
///     degree: 0,
///     compensated: false,
///     background: splats::SplatBackground::Constant([0.5, 0.7, 0.9]),
///     sectors: vec![splats::SplatSector {
///         min_m: [-1.0; 3],
///         max_m: [1.0; 3],
///         count: 0,
///         file: String::new(),
///         blake3: String::new(),
///         views: Vec::new(),
///         neighbors: Vec::new(),
///     }],
///     views: Vec::new(),
///     training: splats::SplatTraining::default(),
///     coverage: None,
/// };
/// let content = splats::SplatContent { sectors: &[ball.clone()], ..Default::default() };
/// let draft = bundle.begin(outputs::SPLATS)?;
/// splats::write(&draft, &scene, &content)?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::SPLATS)?;
/// let scene = splats::read(&reader)?;
/// assert_eq!((scene.sectors[0].count, scene.sectors[0].file.as_str()), (1, "000.ply"));
/// assert_eq!(splats::read_sector(&reader, &scene, 0)?, ball);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(
    draft: &Draft,
    scene: &SplatScene,
    content: &SplatContent<'_>,
) -> Result<(), BundleError> {
    let mut scene = scene.clone();
    let refuse = |fault: Fault| fault.refused(draft, FILE);
    if content.sectors.len() != scene.sectors.len() {
        let found = format!("{} parts", content.sectors.len());
        return Err(refuse(Fault::new("sectors", found, "one for each sector")));
    }
    for (number, (sector, splats)) in scene.sectors.iter_mut().zip(content.sectors).enumerate() {
        sector.count = splats.len();
        sector.file = sector_path(number);
        // Until there are bytes.
        sector.blake3 = blake3::hash(&[]).to_hex().to_string();
    }
    scene.check().map_err(refuse)?;
    // One after the other: together they are as large as the scene.
    for (sector, splats) in scene.sectors.iter_mut().zip(content.sectors) {
        check_sector(sector, splats, scene.degree).map_err(refuse)?;
        let bytes = ply::write(splats, scene.compensated);
        sector.blake3 = blake3::hash(&bytes).to_hex().to_string();
        draft.write(&sector.file, &bytes)?;
    }
    let mut files = Vec::new();
    match scene.background {
        SplatBackground::Sky { size } if content.sky.len() == size * size => {
            if !content.sky.as_flattened().iter().all(|v| v.is_finite()) {
                let found = "a texel that is not finite".to_owned();
                return Err(refuse(Fault::new("sky", found, "finite numbers")));
            }
            let bytes = array::encode(&[size, size, 3], content.sky.as_flattened());
            files.push((SKY.to_owned(), bytes));
        }
        SplatBackground::Constant(_) if content.sky.is_empty() => {}
        _ => {
            let found = format!("{} texels", content.sky.len());
            return Err(refuse(Fault::new("sky", found, "those of the background")));
        }
    }
    for (view, png) in content.comparisons {
        if *view >= scene.views.len() {
            let found = format!("a comparison of view {view}");
            return Err(refuse(Fault::new("views", found, "one of the views")));
        }
        files.push((comparison_path(*view), png.clone()));
    }
    for (path, bytes) in files {
        draft.write(&path, &bytes)?;
    }
    match content.coverage {
        Some(coverage) => coverage::write(draft, &scene, coverage)?,
        None if scene.coverage.is_some() => {
            let found = "a record of coverage without it".to_owned();
            return Err(refuse(Fault::new("coverage", found, "both or none")));
        }
        None => {}
    }
    write_compact_json(draft, FILE, &scene)
}

/// Reads the record of a scene.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<SplatScene, BundleError> {
    let scene: SplatScene = read_json(reader, FILE)?;
    let checked = scene.check();
    checked.map_err(|fault| fault.malformed(reader, FILE))?;
    Ok(scene)
}

/// Reads the Gaussians of a sector. Memory is that of the file, however many Gaussians the record
/// or the file state.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`], also for a sector that the record does
/// not have.
pub fn read_sector(
    reader: &OutputReader,
    scene: &SplatScene,
    number: usize,
) -> Result<Splats, BundleError> {
    let Some(sector) = scene.sectors.get(number) else {
        let found = format!("sector {number} of {}", scene.sectors.len());
        let fault = Fault::new("sectors", found, "a sector of the record");
        return Err(fault.malformed(reader, FILE));
    };
    let bytes = reader.read(&sector.file)?;
    let malformed = |fault: Fault| fault.malformed(reader, &sector.file);
    let found = blake3::hash(&bytes).to_hex();
    if found.as_str() != sector.blake3 {
        let found = format!("content with the hash {found}");
        return Err(malformed(Fault::new(
            "file",
            found,
            "the hash of the record",
        )));
    }
    let file = ply::read(&bytes, sector.count).map_err(|error: FileError| {
        let expected = "Gaussians as 3DGS writes them, in the number of the record";
        malformed(Fault::new("file", error.to_string(), expected))
    })?;
    if file.splats.len() != sector.count || file.compensated != scene.compensated {
        let found = format!("{} Gaussians", file.splats.len());
        let expected = "number and mode of the record";
        return Err(malformed(Fault::new("file", found, expected)));
    }
    check_sector(sector, &file.splats, scene.degree).map_err(malformed)?;
    Ok(file.splats)
}

/// The file of a sector as stored, checked against its hash: any viewer of Gaussians can show it.
///
/// # Errors
/// As [`OutputReader::read`].
pub fn read_sector_file(
    reader: &OutputReader,
    sector: &SplatSector,
) -> Result<Vec<u8>, BundleError> {
    reader.read(&sector.file)
}

/// Reads the texels of the sky, row by row; none where the background is constant.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_sky(reader: &OutputReader, scene: &SplatScene) -> Result<Vec<[f32; 3]>, BundleError> {
    let SplatBackground::Sky { size } = scene.background else {
        return Ok(Vec::new());
    };
    let values =
        array::decode::<f32>(&reader.read(SKY)?, &[size, size, 3], &reader.file_path(SKY))?;
    if !values.iter().all(|value| value.is_finite()) {
        let found = "a number that is not finite".to_owned();
        return Err(Fault::new("texels", found, "finite numbers").malformed(reader, SKY));
    }
    let (texels, _) = values.as_chunks::<3>();
    Ok(texels.to_vec())
}

/// The PNG file of a comparison, if the view has one.
///
/// # Errors
/// As [`OutputReader::read`].
pub fn read_comparison(reader: &OutputReader, view: usize) -> Result<Option<Vec<u8>>, BundleError> {
    let path = comparison_path(view);
    let exists = reader.paths().any(|of| of == path);
    exists.then(|| reader.read(&path)).transpose()
}

/// Whether the means are in the sector's box and the harmonics of the scene's degree.
fn check_sector(sector: &SplatSector, splats: &Splats, degree: usize) -> Result<(), Fault> {
    if splats.degree() != degree {
        let found = format!("harmonics of degree {}", splats.degree());
        return Err(Fault::new(&sector.file, found, "the degree of the record"));
    }
    for k in 0..3 {
        let range = sector.min_m[k]..=sector.max_m[k];
        let mut means = splats.planes()[Plane::POSITION + k].iter();
        if let Some(number) = means.position(|mean| !range.contains(&f64::from(*mean))) {
            let found = format!("Gaussian {number} beyond the box");
            return Err(Fault::new(&sector.file, found, "means in the box"));
        }
    }
    Ok(())
}
