//! Gaussians and camera poses of a sector, as 3DGS writes them.

use std::path::Path;

use cad_transforms::RigidTransform;
use gaussians::files::ply;
use gaussians::{Plane, Splats};
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use splats::{Background, Scene};

use super::numbers::rotation_and_scale;
use super::{BeogymConfig, carried, wrong};
use crate::error::SimulationError;
use crate::scene::similarity::Similarity;

/// Color behind Gaussians that were trained without a sky.
const BACKGROUND: [f32; 3] = [0.0; 3];

/// Reads Gaussians and carries them into the world.
pub(super) fn read(
    bytes: &[u8],
    path: &Path,
    world_from_sector: &Similarity,
    config: &BeogymConfig,
) -> Result<Scene, SimulationError> {
    let file = ply::read(bytes, config.max_gaussians).map_err(|error| {
        let expected = "Gaussians of 3DGS with scales, rotations, opacities and harmonics; \
                        a file that Open3D saved has only points";
        wrong(path, error.to_string(), expected)
    })?;
    if file.splats.is_empty() {
        return Err(wrong(path, "0 Gaussians".to_owned(), "at least one"));
    }
    if file.compensated {
        let found = "compensated opacities".to_owned();
        return Err(wrong(path, found, "Gaussians as 3DGS trains them"));
    }
    let splats = carry(&file.splats, world_from_sector)
        .map_err(|found| wrong(path, found, "Gaussians that stay finite in the world"))?;
    Ok(Scene {
        splats,
        background: Background::Constant(BACKGROUND),
    })
}

/// The same Gaussians in another frame, scaled first.
fn carry(splats: &Splats, to_from_here: &Similarity) -> Result<Splats, String> {
    let scale = to_from_here.scale();
    if scale == 1.0 {
        return Ok(splats.transformed(&to_from_here.rigid()));
    }
    let mut planes = splats.planes().to_vec();
    for plane in &mut planes[Plane::POSITION..Plane::POSITION + 3] {
        plane.iter_mut().for_each(|value| *value *= scale as f32);
    }
    for plane in &mut planes[Plane::SCALE..Plane::SCALE + 3] {
        plane
            .iter_mut()
            .for_each(|value| *value += libm::log(scale) as f32);
    }
    let scaled = Splats::from_planes(splats.degree(), planes).map_err(|e| e.to_string())?;
    Ok(scaled.transformed(&to_from_here.rigid()))
}

/// A camera in `cameras.json` of 3DGS: its center, and its axes in the sector as columns.
#[derive(Deserialize)]
struct Camera {
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
}

/// Poses of cameras in the world.
pub(super) fn cameras(
    text: &str,
    path: &Path,
    world_from_sector: &Similarity,
) -> Result<Vec<RigidTransform>, SimulationError> {
    let cameras: Vec<Camera> = serde_json::from_str(text).map_err(|error| {
        wrong(
            path,
            error.to_string(),
            "cameras.json of 3DGS: a list with position and rotation",
        )
    })?;
    let pose = |(index, camera): (usize, &Camera)| {
        let matrix = Matrix3::from_fn(|row, column| camera.rotation[row][column]);
        let rotation = match rotation_and_scale(&matrix) {
            Ok((rotation, 1.0)) => Ok(rotation),
            Ok((_, scale)) => Err((format!("axes of length {scale}"), "axes of length 1")),
            Err(error) => Err(error),
        };
        let rotation = rotation.map_err(|(found, expected)| {
            wrong(path, format!("camera {index}: {found}"), expected)
        })?;
        let position = Vector3::from(camera.position);
        if !position.iter().all(|v| v.is_finite()) {
            let found = format!("camera {index}: a position that is not finite");
            return Err(wrong(path, found, "finite numbers"));
        }
        Ok(carried(world_from_sector, (rotation, position)))
    };
    cameras.iter().enumerate().map(pose).collect()
}
