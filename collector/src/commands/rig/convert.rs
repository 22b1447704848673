//! `paws rig convert`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use cad_transforms::cad::map::{Map, rig_of_frames};
use cad_transforms::cad::{self, Format, export};
use cad_transforms::output::{self, Existing};
use cad_transforms::{Rig, RigError};
use console_output::text::count;
use console_output::{BadArguments, Console, Outcome};

use super::show;
use super::text_file::text_of;

/// Converts `src` and writes `out`, or prints the parts without `out`.
pub(super) fn run(
    src: &Path,
    map: Option<&Path>,
    out: Option<&Path>,
    existing: Existing,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    if let Some(rig) = rig_file(src)? {
        let Some(out) = out else {
            bail!("--list is for CAD files; paws rig show prints a rig file");
        };
        if map.is_some() {
            let what = "--map is for CAD files, and this is a rig file";
            return Err(BadArguments(what.to_owned()).into());
        }
        return export_rig(&rig, out, existing, console);
    }
    let (cad, source) = cad::read(src)?;
    for note in &cad.notes {
        console.line(format!("note: {note}"))?;
    }
    let Some(out) = out else {
        let width = cad.parts.iter().map(|p| p.path.len()).max().unwrap_or(0);
        console.line(format!(
            "{:width$}  {:>9} {:>9} {:>9}  rotation vector, deg",
            "part", "x mm", "y mm", "z mm"
        ))?;
        for part in &cad.parts {
            let [x, y, z] = part.root_from_part.translation_m().map(|v| 1e3 * v + 0.0);
            let turn = show::degrees(part.root_from_part.rotation_vector());
            console.line(format!(
                "{:width$}  {x:9.3} {y:9.3} {z:9.3}  {turn}",
                part.path
            ))?;
        }
        return Ok(Outcome::Fine);
    };
    let rig = match map {
        Some(path) => {
            let map = Map::parse(&text_of(path)?);
            map.and_then(|map| map.rig(&cad, source))
                .with_context(|| format!("mapping {} with {}", src.display(), path.display()))?
        }
        None => {
            let name = src.file_stem().unwrap_or_default().to_string_lossy();
            rig_of_frames(&cad, &name, source).with_context(|| format!("in {}", src.display()))?
        }
    };
    if Format::of(out).ok() != Some(Format::Toml) {
        let what = format!(
            "{} does not end in .toml, as a rig file does",
            out.display()
        );
        return Err(BadArguments(what).into());
    }
    rig.write(out, existing)?;
    let frames = count(rig.frames().count() as u64 - 1, "frame");
    console.line(format!(
        "wrote {frames} to {}; now paws rig check {}",
        out.display(),
        out.display()
    ))?;
    Ok(Outcome::Fine)
}

/// The rig, if the file is a rig file: TOML with `format` at the top and without parts.
fn rig_file(path: &Path) -> Result<Option<Rig>> {
    if Format::of(path).ok() != Some(Format::Toml) {
        return Ok(None);
    }
    let text = text_of(path)?;
    let begins = |key: &str| text.lines().any(|line| line.trim_start().starts_with(key));
    if begins("[[part]]") && !begins("format") {
        return Ok(None);
    }
    match Rig::parse(&text) {
        Ok(rig) => Ok(Some(rig)),
        Err(RigError::Invalid { problems, .. }) => Err(RigError::Invalid {
            problems,
            path: Some(path.to_owned()),
        }
        .into()),
        Err(error) => Err(error.into()),
    }
}

fn export_rig(
    rig: &Rig,
    out: &Path,
    existing: Existing,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let ending = out.extension().unwrap_or_default().to_string_lossy();
    let text = match ending.to_ascii_lowercase().as_str() {
        "urdf" => export::urdf(rig),
        "gltf" => export::gltf(rig, &export::Scene::default()),
        "csv" => export::csv(rig),
        "toml" => export::toml(rig),
        _ => {
            let what = format!(
                "{} ends in none of .urdf, .gltf, .csv, .toml",
                out.display()
            );
            return Err(BadArguments(what).into());
        }
    };
    output::write(out, text.as_bytes(), existing)?;
    console.line(format!(
        "wrote {}; tolerances, serials, loops and tags stay in the rig file",
        out.display()
    ))?;
    Ok(Outcome::Fine)
}
