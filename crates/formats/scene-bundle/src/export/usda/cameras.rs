//! Cameras of the rig at their keyframes.

use std::fmt::Write;

use cad_transforms::RigidTransform;
use camera_models::CameraModel;

use crate::error::BundleError;
use crate::outputs::{KEYFRAMES, RIG, keyframes, rig};
use crate::scene::Scene;

/// Width of the image plane, mm: that of 35 mm film. Only its ratio to the focal length matters.
const APERTURE_MM: f64 = 36.0;

/// A camera and its poses.
pub(super) struct CameraPath {
    name: String,
    model: CameraModel,
    /// Seconds since the first keyframe, and `world_from_camera` of the optical frame.
    poses: Vec<(f64, RigidTransform)>,
}

/// Left eyes that have keyframes.
pub(super) fn read(scene: &Scene) -> Result<Vec<CameraPath>, BundleError> {
    let rig = rig::read(&scene.output(RIG)?)?;
    let keyframes = keyframes::read(&scene.output(KEYFRAMES)?)?;
    let first_ns = keyframes.iter().map(|k| k.time_ns).min().unwrap_or(0);
    let path = |(number, camera): (usize, &rig::RigCamera)| {
        let own = keyframes.iter().filter(|k| usize::from(k.camera) == number);
        let mut poses: Vec<(f64, RigidTransform)> = own
            .map(|k| (1e-9 * (k.time_ns - first_ns) as f64, k.world_from_left))
            .collect();
        poses.sort_by(|a, b| a.0.total_cmp(&b.0));
        (!poses.is_empty()).then(|| CameraPath {
            name: prim_name(&camera.name),
            model: camera.left,
            poses,
        })
    };
    Ok(rig.cameras.iter().enumerate().filter_map(path).collect())
}

/// Letters, digits and underscores; no digit first.
fn prim_name(name: &str) -> String {
    let of = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = name.chars().map(of).collect();
    match name.starts_with(|c: char| c.is_ascii_digit()) || name.is_empty() {
        true => format!("_{name}"),
        false => name,
    }
}

/// Adds the cameras in one scope.
pub(super) fn add(text: &mut String, paths: &[CameraPath]) {
    if paths.is_empty() {
        return;
    }
    text.push_str("\n    def Scope \"Cameras\"\n    {\n");
    for path in paths {
        camera(text, path);
    }
    text.push_str("    }\n");
}

fn camera(text: &mut String, path: &CameraPath) {
    let model = &path.model;
    let [width, height] = [model.width, model.height].map(f64::from);
    let mm_per_px = APERTURE_MM / width;
    let focal = model.fx * mm_per_px;
    // Pixels that are not square have an aperture that is higher or lower.
    let high_mm_per_px = focal / model.fy;
    // From the middle of the image; pixel centers are at whole numbers. The window of the image
    // moves against the principal point, and y of USD is up.
    let offset_x = (0.5 * width - (model.cx + 0.5)) * mm_per_px;
    let offset_y = ((model.cy + 0.5) - 0.5 * height) * high_mm_per_px;
    // Writing to a string does not fail.
    let _ = write!(
        text,
        "        def Camera \"{}\"\n        {{\n            \
         token projection = \"perspective\"\n            float2 clippingRange = (0.05, 100)\n            \
         float focalLength = {focal}\n            float horizontalAperture = {APERTURE_MM}\n            \
         float verticalAperture = {}\n            float horizontalApertureOffset = {offset_x}\n            \
         float verticalApertureOffset = {offset_y}\n            \
         matrix4d xformOp:transform.timeSamples = {{\n",
        path.name,
        height * high_mm_per_px
    );
    for (seconds, world_from_camera) in &path.poses {
        let _ = writeln!(
            text,
            "                {seconds}: {},",
            matrix(world_from_camera)
        );
    }
    text.push_str(
        "            }\n            uniform token[] xformOpOrder = [\"xformOp:transform\"]\n        }\n",
    );
}

/// Rows of a matrix that points are multiplied with from the left. Cameras of USD have y up and
/// look along -z.
fn matrix(world_from_camera: &RigidTransform) -> String {
    let row = |axis: [f64; 3], last: u8| {
        let [x, y, z] = axis;
        format!("({x}, {y}, {z}, {last})")
    };
    let [right, up, back] = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
        .map(|axis| row(world_from_camera.rotate(axis), 0));
    let place = row(world_from_camera.translation_m(), 1);
    format!("( {right}, {up}, {back}, {place} )")
}
