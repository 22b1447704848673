//! Collision geometry as a robot description of one link (URDF).
//!
//! Contract: a folder with `scene.urdf` and an OBJ file for each convex part. The description has
//! one link without joints and without mass, which readers fix to the world; each part is a
//! collision element and a visual one in its place in the world of the bundle, z up, in metres.

use std::fmt::Write;
use std::path::Path;

use super::error::ExportError;
use super::folder::NewFolder;
use super::mjcf::{MIN_VOLUME_M3, volume_m3};
use super::summary::Summary;
use crate::outputs::COLLISION;
use crate::outputs::collision::{self, ConvexPart};
use crate::scene::Scene;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let collision = collision::read(&scene.output(COLLISION)?)?;
    let folder = NewFolder::begin(out)?;
    let (mut elements, mut parts, mut lost) = (String::new(), 0, Vec::new());
    for (number, part) in collision.parts.iter().enumerate() {
        let volume = volume_m3(part);
        if volume < MIN_VOLUME_M3 {
            lost.push(format!(
                "part {number} of {volume:e} m3: readers refuse meshes that are flat"
            ));
            continue;
        }
        let path = format!("part-{number}.obj");
        folder.write(&path, to_obj(part).as_bytes())?;
        let name = format!("{}_{number}", part.kind.name());
        for element in ["visual", "collision"] {
            // Writing to a string does not fail.
            let _ = write!(
                elements,
                "    <{element} name=\"{name}\">\n      <geometry>\n        \
                 <mesh filename=\"{path}\"/>\n      </geometry>\n    </{element}>\n"
            );
        }
        parts += 1;
    }
    let text = format!(
        "<?xml version=\"1.0\"?>\n<robot name=\"terrain\">\n  <link name=\"terrain\">\n{elements}  \
         </link>\n</robot>\n"
    );
    folder.write("scene.urdf", text.as_bytes())?;
    folder.finish()?;
    let mut notes = vec!["planes of parts are left out: URDF has none".to_owned()];
    if !collision.layers.is_empty() {
        notes.push(format!(
            "URDF has no height fields: the ground of {} layers is left out where no part covers it",
            collision.layers.len()
        ));
    }
    Ok(Summary {
        description: format!("{parts} convex parts"),
        notes,
        lost,
    })
}

fn to_obj(part: &ConvexPart) -> String {
    let mut text = String::new();
    for [x, y, z] in &part.vertices_m {
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    for [a, b, c] in part.triangles.iter().map(|own| own.map(|i| i + 1)) {
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text
}
