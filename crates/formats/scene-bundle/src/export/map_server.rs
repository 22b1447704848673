//! Occupancy as images with YAML, as `map_server` of ROS and Nav2 read them.
//!
//! Contract: a folder with `level-N.pgm` and `level-N.yaml` for each level. Occupied cells are 0,
//! free ones 254, unknown ones 205. With `negate: 0` a value `v` is read as the probability
//! `(255 - v) / 255` of an obstacle: above `occupied_thresh` occupied, below `free_thresh` free, in
//! between unknown. The one of 205 is 0.1961, so `free_thresh` must not be more (0.25, as some maps
//! have it, would make unknown ground free). The top row of the image has the greatest y, and
//! `origin` is the lower left corner of the lower left cell.

use std::path::Path;

use super::error::ExportError;
use super::folder::NewFolder;
use super::summary::Summary;
use crate::outputs::MAPS;
use crate::outputs::maps::{self, FREE, MapLevel, OCCUPIED};
use crate::scene::Scene;

const OCCUPIED_VALUE: u8 = 0;
const UNKNOWN_VALUE: u8 = 205;
const FREE_VALUE: u8 = 254;
const OCCUPIED_THRESHOLD: f64 = 0.65;
const FREE_THRESHOLD: f64 = 0.196;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let reader = scene.output(MAPS)?;
    let index = maps::read_index(&reader)?;
    let folder = NewFolder::begin(out)?;
    for number in 0..index.levels.len() {
        let level = maps::read_level(&reader, &index, number)?;
        let image = format!("level-{number}.pgm");
        folder.write(&image, &pgm(&level))?;
        folder.write(
            &format!("level-{number}.yaml"),
            yaml(&level, &image).as_bytes(),
        )?;
    }
    folder.finish()?;
    Ok(Summary {
        description: format!("occupancy of {} levels", index.levels.len()),
        notes: vec![
            "map-server has occupancy only: heights and the other layers are left out".to_owned(),
        ],
        lost: Vec::new(),
    })
}

fn pgm(level: &MapLevel) -> Vec<u8> {
    let (columns, rows) = (level.grid.columns, level.grid.rows);
    let mut bytes = format!("P5\n{columns} {rows}\n255\n").into_bytes();
    for row in level.occupancy.chunks_exact(columns).rev() {
        bytes.extend(row.iter().map(|value| match *value {
            FREE => FREE_VALUE,
            OCCUPIED => OCCUPIED_VALUE,
            _ => UNKNOWN_VALUE,
        }));
    }
    bytes
}

fn yaml(level: &MapLevel, image: &str) -> String {
    let [x, y] = level.grid.corner_m();
    format!(
        "image: {image}\nmode: trinary\nresolution: {}\norigin: [{x:?}, {y:?}, 0.0]\nnegate: 0\n\
         occupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}\n",
        level.grid.cell_m
    )
}
