//! What the views of a training saw of a scene, from which images from other cameras get a
//! confidence.
//!
//! Contract: `NNN-coverage.npy` has a row for each Gaussian of the sector `NNN`, in the order of
//! its file; `free-space.npy` a row for each block of 4x4x4 voxels through which a view looked, in
//! the order of their indices; `sky-coverage.npy` a 1 for each texel in whose direction a view saw
//! sky. A Gaussian that nothing saw has no direction.

use super::super::Fault;
use super::record::{FILE, SplatCoverage, SplatScene};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{self, Column, Kind, TableWriter, array};
use crate::scene::OutputReader;

const SPACE: &str = "free-space.npy";
const SKY: &str = "sky-coverage.npy";

/// Bits of a set of directions.
const DIRECTIONS: u32 = 62;

const COVERAGE_COLUMNS: &[Column] = &[
    Column("instants", Kind::U32, 1),
    Column("directions", Kind::U64, 1),
    Column("finest_m", Kind::F32, 1),
    Column("color_error", Kind::F32, 1),
    Column("depth_error", Kind::F32, 1),
];

const SPACE_COLUMNS: &[Column] = &[
    Column("block", Kind::I32, 3),
    Column("voxels", Kind::U64, 1),
];

/// Path of what was seen of the Gaussians of a sector.
fn coverage_path(sector: usize) -> String {
    format!("{sector:03}-coverage.npy")
}

/// What views saw of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatObservation {
    /// Instants that saw it.
    pub instants: u32,
    /// Bits of the directions from which they did.
    pub directions: u64,
    /// Finest size of a pixel at its mean, m; 0 if nothing saw it.
    pub finest_m: f32,
    /// Error of the colors to which it contributes, 0 to 1.
    pub color_error: f32,
    /// Relative error of depth there, at most 1; NaN where none was measured.
    pub depth_error: f32,
}

/// A block of 4x4x4 voxels of space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplatSpaceBlock {
    /// Index along the axes of the world, blocks from its origin.
    pub index: [i32; 3],
    /// Bit `x + 4 y + 16 z` for each voxel through which a view looked.
    pub voxels: u64,
}

/// What was seen, beside the record.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatCoverageContent {
    /// Of each sector a row for each Gaussian.
    pub gaussians: Vec<Vec<SplatObservation>>,
    /// Blocks with a seen voxel, by ascending index.
    pub space: Vec<SplatSpaceBlock>,
    /// Whether sky was seen in the direction of each texel, row by row.
    pub sky: Vec<bool>,
}

impl SplatCoverage {
    pub(super) fn check(&self) -> Result<(), Fault> {
        let range = |value: f32, low: f32, high: f32| (low..=high).contains(&value);
        let valid = range(self.voxel_m, 0.01, 10.0)
            && range(self.range_m, 0.0, 1000.0)
            && (2..=4096).contains(&self.sky_texels);
        match valid {
            true => Ok(()),
            false => {
                let expected = "voxels of 0.01 to 10 m, a range up to 1000 m, 2 to 4096 texels";
                Err(Fault::new("coverage", format!("{self:?}"), expected))
            }
        }
    }
}

impl SplatObservation {
    fn is_valid(&self) -> bool {
        let share = |value: f32| (0.0..=1.0).contains(&value);
        let is_seen = self.instants > 0;
        self.directions >> DIRECTIONS == 0
            && is_seen == (self.directions != 0)
            && self.finest_m.is_finite()
            && is_seen == (self.finest_m > 0.0)
            && self.finest_m >= 0.0
            && share(self.color_error)
            && (self.depth_error.is_nan() || share(self.depth_error))
    }
}

/// Refuses what contradicts the record.
fn check(
    scene: &SplatScene,
    record: &SplatCoverage,
    content: &SplatCoverageContent,
) -> Result<(), Fault> {
    if content.gaussians.len() != scene.sectors.len() {
        let found = format!("{} parts", content.gaussians.len());
        return Err(Fault::new("coverage", found, "one for each sector"));
    }
    for (number, (seen, sector)) in content.gaussians.iter().zip(&scene.sectors).enumerate() {
        check_sector(&coverage_path(number), seen, sector.count)?;
    }
    check_space(&content.space)?;
    if content.sky.len() != record.sky_texels * record.sky_texels {
        let found = format!("{} texels", content.sky.len());
        return Err(Fault::new(SKY, found, "those of the record"));
    }
    Ok(())
}

fn check_sector(path: &str, seen: &[SplatObservation], count: usize) -> Result<(), Fault> {
    if seen.len() != count {
        let found = format!("{} rows", seen.len());
        return Err(Fault::new(path, found, "one for each Gaussian"));
    }
    match seen.iter().position(|seen| !seen.is_valid()) {
        Some(row) => {
            let found = format!("row {row}: {:?}", seen[row]);
            let expected = "directions and a size where something saw it, errors of 0 to 1";
            Err(Fault::new(path, found, expected))
        }
        None => Ok(()),
    }
}

fn check_space(space: &[SplatSpaceBlock]) -> Result<(), Fault> {
    if !space.is_sorted_by(|a, b| a.index < b.index) {
        let found = "blocks in another order".to_owned();
        return Err(Fault::new(SPACE, found, "ascending indices"));
    }
    match space.iter().find(|block| block.voxels == 0) {
        Some(block) => {
            let found = format!("no voxel in the block {:?}", block.index);
            Err(Fault::new(SPACE, found, "blocks with a seen voxel"))
        }
        None => Ok(()),
    }
}

/// Writes what was seen.
pub(super) fn write(
    draft: &Draft,
    scene: &SplatScene,
    content: &SplatCoverageContent,
) -> Result<(), BundleError> {
    let Some(record) = &scene.coverage else {
        let found = "coverage without its record".to_owned();
        let fault = Fault::new("coverage", found, "both or none");
        return Err(fault.refused(draft, FILE));
    };
    let checked = check(scene, record, content);
    checked.map_err(|fault| fault.refused(draft, FILE))?;
    for (number, seen) in content.gaussians.iter().enumerate() {
        let mut table = TableWriter::create(draft, &coverage_path(number), COVERAGE_COLUMNS)?;
        for of in seen {
            table.row(|row| {
                row.u32(of.instants);
                row.u64(of.directions);
                row.f32(&[of.finest_m, of.color_error, of.depth_error]);
            })?;
        }
        table.finish()?;
    }
    let mut table = TableWriter::create(draft, SPACE, SPACE_COLUMNS)?;
    for block in &content.space {
        table.row(|row| {
            block.index.iter().for_each(|index| row.i32(*index));
            row.u64(block.voxels);
        })?;
    }
    table.finish()?;
    let texels: Vec<u8> = content.sky.iter().map(|seen| u8::from(*seen)).collect();
    draft.write(SKY, &array::encode(&[record.sky_texels; 2], &texels))
}

/// Reads what the views of the training saw of all sectors; `None` where the scene has none.
/// Memory is that of the files.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_coverage(
    reader: &OutputReader,
    scene: &SplatScene,
) -> Result<Option<SplatCoverageContent>, BundleError> {
    let Some(record) = &scene.coverage else {
        return Ok(None);
    };
    let mut content = SplatCoverageContent::default();
    for (number, sector) in scene.sectors.iter().enumerate() {
        let path = coverage_path(number);
        let (bytes, file) = (reader.read(&path)?, reader.file_path(&path));
        let rows = npy::rows(&bytes, COVERAGE_COLUMNS, &file)?;
        let seen: Vec<SplatObservation> = rows
            .map(|mut row| {
                let (instants, directions) = (row.u32(), row.u64());
                let [finest_m, color_error, depth_error] = row.f32();
                SplatObservation {
                    instants,
                    directions,
                    finest_m,
                    color_error,
                    depth_error,
                }
            })
            .collect();
        let checked = check_sector("rows", &seen, sector.count);
        checked.map_err(|fault| fault.malformed(reader, &path))?;
        content.gaussians.push(seen);
    }
    let (bytes, file) = (reader.read(SPACE)?, reader.file_path(SPACE));
    let rows = npy::rows(&bytes, SPACE_COLUMNS, &file)?;
    let blocks = rows.map(|mut row| SplatSpaceBlock {
        index: [row.i32(), row.i32(), row.i32()],
        voxels: row.u64(),
    });
    content.space = blocks.collect();
    check_space(&content.space).map_err(|fault| fault.malformed(reader, SPACE))?;
    let file = reader.file_path(SKY);
    let texels = array::decode::<u8>(&reader.read(SKY)?, &[record.sky_texels; 2], &file)?;
    if let Some(texel) = texels.iter().find(|texel| **texel > 1) {
        let fault = Fault::new("texels", format!("a {texel}"), "0 and 1");
        return Err(fault.malformed(reader, SKY));
    }
    content.sky = texels.into_iter().map(|texel| texel == 1).collect();
    Ok(Some(content))
}
