//! The Gaussians as one file: `.ply` of 3DGS, `.spz`, `.splat`, binary glTF with the extension
//! `KHR_gaussian_splatting`.
//!
//! Contract: `.ply` and `.splat` keep the axes of the world, z up, since neither format states any;
//! `.spz` and glTF state that y is up, and positions, rotations and harmonics are rotated to that.
//! No format holds a sky. Sectors follow each other.

use std::path::Path;

use cad_transforms::output::{Existing, write};
use gaussians::Splats;
use gaussians::files::{dot_splat, glb, ply, spz};

use super::error::ExportError;
use super::summary::Summary;
use crate::outputs;
use crate::outputs::splats::{self, SplatBackground};
use crate::scene::Scene;

/// The program in files that name it.
const GENERATOR: &str = concat!("paws-scene ", env!("CARGO_PKG_VERSION"));

/// The file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SplatFormat {
    /// As 3DGS writes it.
    Ply,
    /// Compressed.
    Spz,
    /// One color each.
    Splat,
    /// Binary glTF.
    Glb,
}

impl SplatFormat {
    fn name(self) -> &'static str {
        match self {
            Self::Ply => "splat-ply",
            Self::Spz => "spz",
            Self::Splat => "splat",
            Self::Glb => "splat-glb",
        }
    }
}

pub(super) fn export(
    scene: &Scene,
    format: SplatFormat,
    out: &Path,
) -> Result<Summary, ExportError> {
    let reader = scene.output(outputs::SPLATS)?;
    let record = splats::read(&reader)?;
    let mut all = Splats::empty(record.degree).map_err(|error| refused(format, &error))?;
    for number in 0..record.sectors.len() {
        let sector = splats::read_sector(&reader, &record, number)?;
        for index in 0..sector.len() {
            let pushed = all.push(&sector.get(index));
            pushed.map_err(|error| refused(format, &error))?;
        }
    }
    let mut notes = Vec::new();
    let bytes = match format {
        SplatFormat::Spz => {
            notes.push(
                "y is up in SPZ: x, y, z of the world are written as x, z, -y, with the harmonics"
                    .to_owned(),
            );
            let rotated = all.transformed(&spz::rub_from_z_up());
            spz::write(&rotated, record.compensated).map_err(|error| refused(format, &error))?
        }
        SplatFormat::Splat => {
            notes.push("z is up as in the world; many viewers assume y down".to_owned());
            if record.degree > 0 {
                notes.push(
                    "harmonics above degree 0 cannot be represented in .splat and are left out"
                        .to_owned(),
                );
            }
            dot_splat::write(&all)
        }
        SplatFormat::Glb => {
            notes.push(
                "y is up in glTF: x, y, z of the world are written as x, z, -y, with the harmonics"
                    .to_owned(),
            );
            let rotated = all.transformed(&spz::rub_from_z_up());
            glb::write(&rotated, GENERATOR).map_err(|error| refused(format, &error))?
        }
        SplatFormat::Ply => {
            notes.push("z is up as in the world; many viewers assume y down".to_owned());
            ply::write(&all, record.compensated)
        }
    };
    if let SplatBackground::Sky { .. } = record.background {
        notes.push(format!(
            "{} cannot represent the sky, which is left out",
            format.name()
        ));
    }
    if record.compensated && matches!(format, SplatFormat::Splat | SplatFormat::Glb) {
        notes.push(format!(
            "{} cannot state that opacities are compensated: distant parts look too thick",
            format.name()
        ));
    }
    write(out, &bytes, Existing::Refuse)?;
    Ok(Summary {
        description: format!("{} Gaussians", all.len()),
        notes,
        lost: Vec::new(),
    })
}

fn refused(format: SplatFormat, error: &dyn std::error::Error) -> ExportError {
    ExportError::Refused {
        format: format.name(),
        found: format!("Gaussians where {error}"),
        expected: "values that the format can represent".to_owned(),
    }
}
