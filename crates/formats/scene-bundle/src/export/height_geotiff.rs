//! Elevations as GeoTIFF 1.1 (OGC 19-008), 32-bit floating point.
//!
//! Contract: a folder with `level-N.tif` for each level. The top row has the greatest y. The
//! transform is that of pixels as areas: the tie point is the upper left **corner**, half a cell
//! from the center of its cell. Unknown cells are not-a-number, which the tag of GDAL names as "no
//! data". The coordinate system is a local one in metres: the world of a bundle has no place on
//! Earth.

use std::io::Cursor;
use std::path::Path;

use tiff::TiffError;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray32Float;
use tiff::tags::Tag;

use super::error::ExportError;
use super::folder::NewFolder;
use super::summary::Summary;
use crate::outputs::MAPS;
use crate::outputs::maps::{self, MapLevel};
use crate::scene::Scene;

/// Name of the coordinate system; `|` ends a text (7.2.2 of the standard).
const CITATION: &str = "world of a scene bundle|";
/// Version 1, revision 1.1, with four keys, each with its place and count: the model is
/// user-defined, pixels are areas, the citation is in the text, the unit is the metre (EPSG
/// 9001).
const KEYS: [u16; 20] = [
    1,
    1,
    1,
    4, //
    1024,
    0,
    1,
    32767, //
    1025,
    0,
    1,
    1, //
    1026,
    34737,
    CITATION.len() as u16,
    0, //
    3076,
    0,
    1,
    9001,
];

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let reader = scene.output(MAPS)?;
    let index = maps::read_index(&reader)?;
    let folder = NewFolder::begin(out)?;
    for number in 0..index.levels.len() {
        let level = maps::read_level(&reader, &index, number)?;
        let bytes = to_bytes(&level).map_err(|error| ExportError::Refused {
            format: "height-geotiff",
            found: format!("level {number}, where {error}"),
            expected: "an image of less than 4 GiB".to_owned(),
        })?;
        folder.write(&format!("level-{number}.tif"), &bytes)?;
    }
    folder.finish()?;
    Ok(Summary {
        description: format!("elevations of {} levels", index.levels.len()),
        notes: vec!["height-geotiff has elevations only: the other layers are left out".to_owned()],
        lost: Vec::new(),
    })
}

fn to_bytes(level: &MapLevel) -> Result<Vec<u8>, TiffError> {
    let grid = &level.grid;
    let rows = level.elevation.chunks_exact(grid.columns).rev();
    let heights: Vec<f32> = rows.flatten().copied().collect();
    let (left, top) = (grid.corner_m()[0], grid.corner_m()[1] + grid.size_m()[1]);
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file)?;
    let mut image = encoder.new_image::<Gray32Float>(grid.columns as u32, grid.rows as u32)?;
    let tags = image.encoder();
    tags.write_tag(
        Tag::ModelPixelScaleTag,
        &[grid.cell_m, grid.cell_m, 0.0][..],
    )?;
    tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, left, top, 0.0][..])?;
    tags.write_tag(Tag::GeoKeyDirectoryTag, &KEYS[..])?;
    tags.write_tag(Tag::GeoAsciiParamsTag, CITATION)?;
    tags.write_tag(Tag::GdalNodata, "nan")?;
    image.write_data(&heights)?;
    Ok(file.into_inner())
}
