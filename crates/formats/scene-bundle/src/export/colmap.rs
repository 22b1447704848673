//! A COLMAP model of the keyframes: cameras, images, points, as text or binary (COLMAP
//! `src/colmap/scene/reconstruction_io.cc` and its page on output formats).
//!
//! Contract: pixel coordinates gain half a pixel, poses are `camera_from_world`, quaternions `w x y
//! z`. Images have no 2D points and points no tracks: the bundle has none. The error of a point is
//! -1, which is COLMAP's "not computed". Both forms hold the same numbers.

use std::path::{Path, PathBuf};

use calibration_files::Format;
use camera_models::{CameraSet, NamedCamera};

use super::error::ExportError;
use super::folder::NewFolder;
use super::lenses::fitted;
use super::options::Options;
use super::posed_images::{PosedImages, collect};
use super::summary::Summary;
use crate::outputs;
use crate::outputs::cloud::{self, CloudPoint};
use crate::scene::Scene;

/// Text or binary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    Text,
    Binary,
}

/// COLMAP's error of a point that has none.
const NO_ERROR: f64 = -1.0;

pub(super) fn export(
    scene: &Scene,
    form: Form,
    options: &Options,
    out: &Path,
) -> Result<Summary, ExportError> {
    let (format, name) = match form {
        Form::Text => (Format::Colmap, "colmap-text"),
        Form::Binary => (Format::ColmapBin, "colmap-binary"),
    };
    let posed_images = collect(scene, options, name)?;
    let mut summary = Summary::default();
    let mut cameras = Vec::new();
    for camera in &posed_images.cameras {
        let lens = fitted(&camera.name, &camera.model, format)?;
        summary.notes.extend(lens.note);
        summary.lost.extend(lens.lost);
        cameras.push(NamedCamera {
            name: camera.name.clone(),
            model: lens.model,
            camera_from_first: None,
        });
    }
    let set = CameraSet {
        cameras,
        imu: None,
        provenance: camera_models::Provenance {
            format: None,
            files: Vec::<PathBuf>::new(),
            part: None,
        },
    };
    let files =
        calibration_files::contents(&set, format).map_err(|error| ExportError::Refused {
            format: name,
            found: format!("cameras, where {error}"),
            expected: "lenses that it can hold".to_owned(),
        })?;
    let points = if scene.has(outputs::CLOUD) {
        cloud::read(&scene.output(outputs::CLOUD)?)?
    } else {
        summary.notes.push("the bundle has no points".to_owned());
        Vec::new()
    };

    for (output, what) in [
        (outputs::MASKS, "which pixels to mask"),
        (outputs::DEPTH, "depth"),
        (outputs::CLOUD, "sigma of points"),
    ] {
        if scene.has(output) {
            (summary.notes).push(format!(
                "{what} cannot be represented in COLMAP's model and is left out"
            ));
        }
    }

    let folder = NewFolder::begin(out)?;
    // Numbered from 1 in their order, with half a pixel more. The rig file is not needed: every
    // image has its pose.
    for (file, bytes) in files
        .iter()
        .filter(|(file, _)| file.starts_with("cameras."))
    {
        folder.write(file, bytes)?;
    }
    match form {
        Form::Text => {
            folder.write("images.txt", images_text(&posed_images).as_bytes())?;
            folder.write("points3D.txt", points_text(&points).as_bytes())?;
        }
        Form::Binary => {
            folder.write("images.bin", &images_binary(&posed_images))?;
            folder.write("points3D.bin", &points_binary(&points))?;
        }
    }
    folder.finish()?;
    summary.description = format!(
        "{} images of {} cameras, {} points",
        posed_images.images.len(),
        posed_images.cameras.len(),
        points.len()
    );
    summary.lost.extend(posed_images.lost);
    Ok(summary)
}

/// Number, quaternion `w x y z` and translation of `camera_from_world`, number of the camera, name.
fn images(posed_images: &PosedImages) -> impl Iterator<Item = (u32, [f64; 7], u32, &str)> {
    (1..).zip(&posed_images.images).map(|(id, image)| {
        let camera_from_world = image.world_from_camera.inverse();
        let [w, i, j, k] = camera_from_world.rotation_wxyz();
        let [x, y, z] = camera_from_world.translation_m();
        (
            id,
            [w, i, j, k, x, y, z],
            image.camera as u32 + 1,
            image.path.as_str(),
        )
    })
}

fn images_text(posed_images: &PosedImages) -> String {
    let mut text = format!(
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   \
         POINTS2D[] as (X, Y, POINT3D_ID)\n# Number of images: {}, mean observations per image: 0\n",
        posed_images.images.len()
    );
    for (id, pose, camera, name) in images(posed_images) {
        let pose: Vec<String> = pose.iter().map(|v| format!("{v:?}")).collect();
        // The second line, of 2D points, is empty.
        text += &format!("{id} {} {camera} {name}\n\n", pose.join(" "));
    }
    text
}

fn images_binary(posed_images: &PosedImages) -> Vec<u8> {
    let mut bytes = (posed_images.images.len() as u64).to_le_bytes().to_vec();
    for (id, pose, camera, name) in images(posed_images) {
        bytes.extend(id.to_le_bytes());
        bytes.extend(pose.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(camera.to_le_bytes());
        bytes.extend(name.as_bytes());
        bytes.push(0);
        bytes.extend(0_u64.to_le_bytes());
    }
    bytes
}

fn points_text(points: &[CloudPoint]) -> String {
    let mut text = format!(
        "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, \
         POINT2D_IDX)\n# Number of points: {}, mean track length: 0\n",
        points.len()
    );
    for (id, point) in (1_u64..).zip(points) {
        let [x, y, z] = point.x_in_world.map(f64::from);
        let [r, g, b] = point.color;
        text += &format!("{id} {x:?} {y:?} {z:?} {r} {g} {b} {NO_ERROR:?}\n");
    }
    text
}

fn points_binary(points: &[CloudPoint]) -> Vec<u8> {
    let mut bytes = (points.len() as u64).to_le_bytes().to_vec();
    for (id, point) in (1_u64..).zip(points) {
        bytes.extend(id.to_le_bytes());
        bytes.extend(
            point
                .x_in_world
                .iter()
                .flat_map(|v| f64::from(*v).to_le_bytes()),
        );
        bytes.extend(point.color);
        bytes.extend(NO_ERROR.to_le_bytes());
        bytes.extend(0_u64.to_le_bytes());
    }
    bytes
}
