//! All layers of the maps as `grid_map_msgs/msg/GridMap` of ROS 2, in one MCAP file.
//!
//! Contract: one message per level, on the topic `/level_N`, in the profile `ros2`: encoded as CDR,
//! with the definitions of the messages, uncompressed. Stamps are 0 and the frame is `map`. The
//! first cell of a grid map is that of greatest x and y; x falls along the rows and y along the
//! columns of its matrices, which are column-major (grid_map: GridMapMath, GridMapMsgHelpers). So
//! the data of a layer are those of the output from the last to the first.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use cad_transforms::output::{Existing, write};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};

use super::error::ExportError;
use super::summary::Summary;
use crate::outputs::MAPS;
use crate::outputs::maps::{self, MapLevel, UNKNOWN};
use crate::scene::Scene;

mod cdr;
mod definition;

use cdr::CdrWriter;

const MESSAGE_TYPE: &str = "grid_map_msgs/msg/GridMap";
const FRAME: &str = "map";

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let reader = scene.output(MAPS)?;
    let index = maps::read_index(&reader)?;
    let mut messages = Vec::new();
    for number in 0..index.levels.len() {
        messages.push(message(&maps::read_level(&reader, &index, number)?));
    }
    let bytes = to_mcap(&messages).map_err(|error| ExportError::Refused {
        format: "grid-map",
        found: format!("{} levels, where {error}", messages.len()),
        expected: "messages of less than 4 GiB".to_owned(),
    })?;
    write(out, &bytes, Existing::Refuse)?;
    Ok(Summary {
        description: format!("all layers of {} levels", messages.len()),
        notes: vec![
            "grid_map has 32-bit numbers only: occupancy, views and flags are converted, unknown occupancy to not-a-number"
                .to_owned(),
        ],
        lost: Vec::new(),
    })
}

fn to_mcap(messages: &[Vec<u8>]) -> Result<Vec<u8>, McapError> {
    let options = WriteOptions::new()
        .profile("ros2")
        .library(concat!("paws-scene ", env!("CARGO_PKG_VERSION")))
        .compression(None);
    let mut writer = options.create(Cursor::new(Vec::new()))?;
    let schema = writer.add_schema(MESSAGE_TYPE, "ros2msg", definition::GRID_MAP.as_bytes())?;
    for (number, message) in messages.iter().enumerate() {
        let topic = format!("/level_{number}");
        let channel = writer.add_channel(schema, &topic, "cdr", &Default::default())?;
        let header = MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: 0,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header, message)?;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
}

fn message(level: &MapLevel) -> Vec<u8> {
    let layers = layers(level);
    let grid = &level.grid;
    let [length_x, length_y] = grid.size_m();
    let [left, bottom] = grid.corner_m();
    let mut cdr = CdrWriter::new();
    // The header.
    cdr.i32(0);
    cdr.u32(0);
    cdr.string(FRAME);
    // The geometry, with the pose of the center.
    cdr.f64(&[grid.cell_m, length_x, length_y]);
    cdr.f64(&[left + 0.5 * length_x, bottom + 0.5 * length_y, 0.0]);
    cdr.f64(&[0.0, 0.0, 0.0, 1.0]);
    cdr.u32(layers.len() as u32);
    layers.iter().for_each(|(name, _)| cdr.string(name));
    // A cell is valid if it has an elevation.
    cdr.u32(1);
    cdr.string("elevation");
    cdr.u32(layers.len() as u32);
    let (rows, columns) = (grid.columns as u32, grid.rows as u32);
    for (_, values) in &layers {
        cdr.u32(2);
        cdr.string("column_index");
        cdr.u32(columns);
        cdr.u32(rows * columns);
        cdr.string("row_index");
        cdr.u32(rows);
        cdr.u32(rows);
        cdr.u32(0);
        cdr.u32(rows * columns);
        values.iter().rev().for_each(|value| cdr.f32(*value));
    }
    // The circular buffers begin at their first cell.
    cdr.u16(0);
    cdr.u16(0);
    cdr.finish()
}

fn layers(level: &MapLevel) -> Vec<(&'static str, Cow<'_, [f32]>)> {
    let mut layers: Vec<(&'static str, Cow<'_, [f32]>)> = Vec::new();
    for (name, values) in level.numbers() {
        layers.push((name, Cow::Borrowed(values)));
    }
    for (k, name) in ["normal_x", "normal_y", "normal_z"].into_iter().enumerate() {
        layers.push((name, level.normal.iter().map(|normal| normal[k]).collect()));
    }
    // Not -1: comparisons with a threshold would take it for free.
    let number = |value: &i8| match *value {
        UNKNOWN => f32::NAN,
        known => f32::from(known),
    };
    let occupancy = level.occupancy.iter().map(number);
    layers.push(("occupancy", occupancy.collect()));
    let numbers = |values: &[u8]| values.iter().map(|value| f32::from(*value)).collect();
    layers.push(("views", numbers(&level.views)));
    layers.push(("flags", numbers(&level.flags)));
    layers
}
