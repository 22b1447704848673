//! Points as LAS 1.2 or LAZ, point format 2 (ASPRS LAS specification 1.2; compression by Isenburg
//! 2013).
//!
//! Contract: coordinates are the bundle's world, metres, in steps of 0.1 mm from 0; they are in no
//! coordinate reference system. Colors are spread over 16 bits (times 257), as the specification
//! requires. Sigma cannot be represented. No date is written, so that the same points give the same
//! bytes.

use std::io::Cursor;
use std::path::Path;

use cad_transforms::output::{Existing, write};
use las::{Builder, Color, Point, Transform, Vector, Writer};

use super::error::ExportError;
use super::summary::Summary;
use crate::outputs::{self, cloud};
use crate::scene::Scene;

/// Metres in a step. 32 bits of them reach 214 km.
const STEP_M: f64 = 1e-4;
/// Factor from 8 to 16 bits that maps white to white.
const SPREAD: u16 = 257;

pub(super) fn export(scene: &Scene, compressed: bool, out: &Path) -> Result<Summary, ExportError> {
    let points = cloud::read(&scene.output(outputs::CLOUD)?)?;
    let refused = |error: las::Error| ExportError::Refused {
        format: if compressed { "laz" } else { "las" },
        found: format!("points, where {error}"),
        expected: "points within 214 km".to_owned(),
    };
    let step = Transform {
        scale: STEP_M,
        offset: 0.0,
    };
    let mut builder = Builder::from((1, 2));
    builder.date = None;
    builder.generating_software = concat!("paws-scene ", env!("CARGO_PKG_VERSION")).to_owned();
    builder.system_identifier = "OTHER".to_owned();
    builder.transforms = Vector {
        x: step,
        y: step,
        z: step,
    };
    builder.point_format = las::point::Format::new(2).map_err(refused)?;
    builder.point_format.is_compressed = compressed;
    let header = builder.into_header().map_err(refused)?;
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).map_err(refused)?;
    for point in &points {
        let [x, y, z] = point.x_in_world.map(f64::from);
        let [red, green, blue] = point.color.map(|c| u16::from(c) * SPREAD);
        let point = Point {
            x,
            y,
            z,
            // One return of one: the point comes from an image, not from the echo of a pulse.
            return_number: 1,
            number_of_returns: 1,
            color: Some(Color { red, green, blue }),
            ..Point::default()
        };
        writer.write_point(point).map_err(refused)?;
    }
    let bytes = writer.into_inner().map_err(refused)?.into_inner();
    write(out, &bytes, Existing::Refuse)?;
    Ok(Summary {
        description: format!("{} points", points.len()),
        notes: vec!["sigma cannot be represented in LAS and is left out".to_owned()],
        lost: Vec::new(),
    })
}
