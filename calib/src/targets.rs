//! `paws calib targets`: calibration boards to print, at true size.
//!
//! Contract: a PDF, the board's TOML beside it for the calibration commands, and Kalibr's YAML
//! where Kalibr knows such a board. No file is overwritten, and all files are written or none.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use boards::pdf::{self, Paper};
use boards::{Dictionary, Target};
use calibration_files::board;
use clap::{Args, ValueEnum};
use console_output::{Console, Outcome};

/// Kind of board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Kind {
    /// Tags, every corner with an id; parts of it can be used. As Kalibr draws it
    Aprilgrid,
    /// Black and white squares; must be visible completely
    Chessboard,
    /// A chessboard with markers; parts of it can be used. As OpenCV draws it
    Charuco,
}

/// Options of `paws calib targets`.
#[derive(Clone, Debug, Args)]
pub(crate) struct Options {
    /// The board
    #[arg(long, value_enum, default_value = "aprilgrid", conflicts_with = "from")]
    pub(crate) kind: Kind,
    /// Draw the board of this file (our TOML, or Kalibr's YAML) instead
    #[arg(long, value_name = "FILE")]
    pub(crate) from: Option<PathBuf>,
    /// Tags along x; inner corners of a chessboard; squares of a ChArUco board [default: 6, 9, 8]
    #[arg(long, value_name = "N", conflicts_with = "from")]
    pub(crate) columns: Option<u32>,
    /// Tags, inner corners or squares along y [default: 6]
    #[arg(long, value_name = "N", conflicts_with = "from")]
    pub(crate) rows: Option<u32>,
    /// Side of a tag or square in millimetres [default: the largest whole one that fits the paper]
    #[arg(long, value_name = "MM", conflicts_with = "from")]
    pub(crate) size_mm: Option<f64>,
    /// AprilGrid: gap between tags, as a multiple of their side
    #[arg(long, value_name = "X", default_value_t = 0.3, conflicts_with = "from")]
    pub(crate) spacing: f64,
    /// ChArUco: side of a marker in millimetres [default: three quarters of a square]
    #[arg(long, value_name = "MM", conflicts_with = "from")]
    pub(crate) marker_mm: Option<f64>,
    /// ChArUco: OpenCV's dictionary: 4X4, 5X5 or 6X6, then _50, _100 or _250
    #[arg(long, default_value = "5X5_100", conflicts_with = "from")]
    pub(crate) dictionary: String,
    /// Id of the first tag or marker
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "from")]
    pub(crate) first_id: u32,
    /// A4, A3, A2, A1, A0, Letter, or WIDTHxHEIGHT in millimetres
    #[arg(long, default_value = "A4")]
    pub(crate) paper: String,
    /// The PDF to write; the board's TOML goes beside it
    #[arg(long, value_name = "FILE.pdf")]
    pub(crate) out: PathBuf,
}

/// Runs `paws calib targets`.
///
/// # Errors
/// The board or the paper is impossible, the board does not fit, an output file exists already, or
/// cannot be written.
pub(crate) fn run(options: &Options, console: &mut Console<'_>) -> Result<Outcome> {
    // The names of the other files are derived from it.
    if options
        .out
        .extension()
        .is_none_or(|e| !e.eq_ignore_ascii_case("pdf"))
    {
        bail!(
            "reading --out: found {}, expected a name that ends in .pdf",
            options.out.display()
        );
    }
    let Some(paper) = Paper::parse(&options.paper) else {
        let expected = "A4, A3, A2, A1, A0, Letter, or WIDTHxHEIGHT in millimetres";
        bail!(
            "reading --paper: found {:?}, expected {expected}",
            options.paper
        );
    };
    let (target, paper) = match &options.from {
        Some(file) => {
            let target = board::read(file)?;
            let turned = !paper.fits(&target) && paper.rotated().fits(&target);
            (target, if turned { paper.rotated() } else { paper })
        }
        None => choose(options, paper)?,
    };
    let page = pdf::draw(&target, paper)?;
    let mut files = vec![(options.out.clone(), page)];
    files.push((
        options.out.with_extension("toml"),
        board::to_toml(&target).into_bytes(),
    ));
    files.extend(
        board::to_kalibr(&target)
            .map(|text| (options.out.with_extension("yaml"), text.into_bytes())),
    );
    write_new(&files)?;
    console.line(format!(
        "{} on {:.0} x {:.0} mm of paper",
        pdf::describe(&target),
        paper.width_mm,
        paper.height_mm
    ))?;
    if target.is_rotationally_symmetric() {
        console.line(
            "note: this chessboard is symmetric under a rotation by 180 degrees; an even and an odd number of inner corners would not be",
        )?;
    }
    for (path, _) in &files {
        console.line(path.display())?;
    }
    Ok(Outcome::Fine)
}

/// The board of the options; without a size, the largest that fits the paper.
fn choose(options: &Options, paper: Paper) -> Result<(Target, Paper)> {
    if let Some(size) = options.size_mm {
        let target = board(options, size)?;
        let turned = !paper.fits(&target) && paper.rotated().fits(&target);
        return Ok((target, if turned { paper.rotated() } else { paper }));
    }
    let longest = paper.width_mm.max(paper.height_mm) as u32;
    for size in (5..=longest).rev() {
        let target = board(options, f64::from(size))?;
        if let Some(paper) = [paper, paper.rotated()]
            .into_iter()
            .find(|p| p.fits(&target))
        {
            return Ok((target, paper));
        }
    }
    bail!(
        "choosing a size: not even 5 mm fit {}, expected fewer columns and rows or larger paper",
        options.paper
    )
}

fn board(options: &Options, size_mm: f64) -> Result<Target> {
    let rows = options.rows.unwrap_or(6);
    Ok(match options.kind {
        Kind::Aprilgrid => Target::AprilGrid {
            columns: options.columns.unwrap_or(6),
            rows,
            tag_m: metres(size_mm),
            spacing: options.spacing,
            first_id: options.first_id,
        },
        Kind::Chessboard => Target::Chessboard {
            columns: options.columns.unwrap_or(9),
            rows,
            square_m: metres(size_mm),
        },
        Kind::Charuco => {
            let Some(dictionary) = Dictionary::aruco(&options.dictionary) else {
                bail!(
                    "reading --dictionary: found {:?}, expected 4X4_50, 5X5_100, 6X6_250 or alike",
                    options.dictionary
                );
            };
            Target::Charuco {
                columns: options.columns.unwrap_or(8),
                rows,
                square_m: metres(size_mm),
                marker_m: metres(options.marker_mm.unwrap_or(0.75 * size_mm)),
                dictionary,
                first_id: options.first_id,
            }
        }
    })
}

/// Metres, rounded to a micrometre, so that 29 mm is 0.029 in the file.
fn metres(mm: f64) -> f64 {
    (1000.0 * mm).round() / 1e6
}

/// Writes new files: all, or none if one exists.
fn write_new(files: &[(PathBuf, Vec<u8>)]) -> Result<()> {
    for (path, _) in files {
        if path.symlink_metadata().is_ok() {
            bail!(
                "this file exists already and is not overwritten: {}",
                path.display()
            );
        }
    }
    if let Some(folder) = files[0].0.parent().filter(|f| *f != Path::new("")) {
        fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    }
    for (path, bytes) in files {
        let written = OpenOptions::new().write(true).create_new(true).open(path);
        let written: io::Result<()> = written.and_then(|mut file| file.write_all(bytes));
        written.with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_not_overwritten_and_written_all_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("b.toml"), "mine").unwrap();
        let files = vec![(at("b.pdf"), b"x".to_vec()), (at("b.toml"), b"y".to_vec())];
        let error = write_new(&files).unwrap_err().to_string();
        assert!(error.contains("b.toml"), "{error}");
        assert!(!at("b.pdf").exists());
        assert_eq!(fs::read(at("b.toml")).unwrap(), b"mine");
    }
}
