//! Keyframes as images of single cameras with poses, the input of reconstruction programs.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Eye};

use super::error::ExportError;
use super::options::Options;
use crate::outputs::keyframes::{self, Keyframe};
use crate::outputs::rig::RigModel;
use crate::outputs::{self, rig};
use crate::scene::Scene;

/// One side of a stereo camera.
pub(super) struct Camera {
    /// Its stereo camera: index in the rig.
    pub(super) rig_index: usize,
    pub(super) eye: Eye,
    /// Camera model of the images as recorded.
    pub(super) model: CameraModel,
    /// `CAMERA/left` or `CAMERA/right`.
    pub(super) name: String,
}

/// One image with its pose.
pub(super) struct PosedImage {
    /// Index in [`PosedImages::cameras`].
    pub(super) camera: usize,
    pub(super) keyframe: Keyframe,
    /// Takes points in the optical frame of this image to the world.
    pub(super) world_from_camera: RigidTransform,
    /// `CAMERA/left/NNNNNN.png`.
    pub(super) path: String,
}

/// All selected images that exist.
pub(super) struct PosedImages {
    pub(super) rig: RigModel,
    /// Cameras that have images, in the rig's order, left before right.
    pub(super) cameras: Vec<Camera>,
    /// Sorted by camera and time.
    pub(super) images: Vec<PosedImage>,
    /// Keyframes without an image.
    pub(super) lost: Vec<String>,
}

/// Collects them. `format` is for messages.
pub(super) fn collect(
    scene: &Scene,
    options: &Options,
    format: &'static str,
) -> Result<PosedImages, ExportError> {
    let rig = rig::read(&scene.output(outputs::RIG)?)?;
    let keyframes = keyframes::read(&scene.output(outputs::KEYFRAMES)?)?;
    let names = || {
        rig.cameras
            .iter()
            .map(|c| c.name.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    };
    let refused = |found: String, expected: String| ExportError::Refused {
        format,
        found,
        expected,
    };
    if let Some(name) = options
        .cameras
        .iter()
        .find(|name| rig.camera(name).is_none())
    {
        return Err(refused(
            format!("no camera {name}"),
            format!("one of {}", names()),
        ));
    }
    if let Some(keyframe) = keyframes
        .iter()
        .find(|k| usize::from(k.camera) >= rig.cameras.len())
    {
        let found = format!("a keyframe of camera {}", keyframe.camera);
        return Err(refused(found, format!("one of the rig's: {}", names())));
    }
    let eyes: &[Eye] = if options.right {
        &[Eye::Left, Eye::Right]
    } else {
        &[Eye::Left]
    };
    let (mut cameras, mut images, mut lost) = (Vec::new(), Vec::new(), Vec::new());
    for (rig_index, stereo) in rig.cameras.iter().enumerate() {
        if !options.cameras.is_empty() && !options.cameras.contains(&stereo.name) {
            continue;
        }
        for &eye in eyes {
            let (side, model, left_from_camera) = match eye {
                Eye::Left => ("left", stereo.left, RigidTransform::identity()),
                Eye::Right => ("right", stereo.right, stereo.right_from_left.inverse()),
            };
            let name = format!("{}/{side}", stereo.name);
            let before = images.len();
            for keyframe in keyframes
                .iter()
                .filter(|k| usize::from(k.camera) == rig_index)
            {
                let path = format!("{name}/{:06}.png", keyframe.frame);
                if let Some(folder) = &options.images
                    && !folder.join(&path).is_file()
                {
                    lost.push(format!(
                        "no image of keyframe {} of {name}: {path}",
                        keyframe.frame
                    ));
                    continue;
                }
                images.push(PosedImage {
                    camera: cameras.len(),
                    keyframe: *keyframe,
                    world_from_camera: keyframe.world_from_left * left_from_camera,
                    path,
                });
            }
            if images.len() > before {
                cameras.push(Camera {
                    rig_index,
                    eye,
                    model,
                    name,
                });
            }
        }
    }
    if images.is_empty() {
        let found = if lost.is_empty() {
            "no keyframes".to_owned()
        } else {
            lost.swap_remove(0)
        };
        return Err(refused(found, "at least one image with a pose".to_owned()));
    }
    Ok(PosedImages {
        rig,
        cameras,
        images,
        lost,
    })
}
