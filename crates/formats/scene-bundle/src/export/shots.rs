//! Keyframes as pictures of single cameras with poses, which is what reconstruction programs take.

use cad_transforms::RigidTransform;
use calib::{CameraModel, Eye};

use super::{ExportError, Options};
use crate::outputs::keyframes::{self, Keyframe};
use crate::outputs::rig::RigModel;
use crate::outputs::{self, rig};
use crate::scene::Scene;

/// One eye of a camera.
pub(super) struct Camera {
    /// Its stereo camera: the place in the rig.
    pub(super) of_rig: usize,
    pub(super) eye: Eye,
    /// As its pictures were recorded.
    pub(super) model: CameraModel,
    /// `CAMERA/left` or `CAMERA/right`.
    pub(super) name: String,
}

/// One picture.
pub(super) struct Shot {
    /// The place in [`Shots::cameras`].
    pub(super) camera: usize,
    pub(super) keyframe: Keyframe,
    /// Takes points in the optical frame of this eye to the world.
    pub(super) world_from_camera: RigidTransform,
    /// `CAMERA/left/NNNNNN.png`.
    pub(super) picture: String,
}

/// All pictures that are wanted and there.
pub(super) struct Shots {
    pub(super) rig: RigModel,
    /// Those that have pictures, in the rig's order, left before right.
    pub(super) cameras: Vec<Camera>,
    /// Sorted by camera and time.
    pub(super) shots: Vec<Shot>,
    /// Keyframes without a picture.
    pub(super) lost: Vec<String>,
}

/// Collects them. `format` is for messages.
pub(super) fn collect(
    scene: &Scene,
    options: &Options,
    format: &'static str,
) -> Result<Shots, ExportError> {
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
    let (mut cameras, mut shots, mut lost) = (Vec::new(), Vec::new(), Vec::new());
    for (of_rig, stereo) in rig.cameras.iter().enumerate() {
        if !options.cameras.is_empty() && !options.cameras.contains(&stereo.name) {
            continue;
        }
        for &eye in eyes {
            let (side, model, left_from_camera) = match eye {
                Eye::Left => ("left", stereo.left, RigidTransform::identity()),
                Eye::Right => ("right", stereo.right, stereo.right_from_left.inverse()),
            };
            let name = format!("{}/{side}", stereo.name);
            let before = shots.len();
            for keyframe in keyframes.iter().filter(|k| usize::from(k.camera) == of_rig) {
                let picture = format!("{name}/{:06}.png", keyframe.frame);
                if let Some(folder) = &options.pictures
                    && !folder.join(&picture).is_file()
                {
                    lost.push(format!(
                        "no picture of keyframe {} of {name}: {picture}",
                        keyframe.frame
                    ));
                    continue;
                }
                shots.push(Shot {
                    camera: cameras.len(),
                    keyframe: *keyframe,
                    world_from_camera: keyframe.world_from_left * left_from_camera,
                    picture,
                });
            }
            if shots.len() > before {
                cameras.push(Camera {
                    of_rig,
                    eye,
                    model,
                    name,
                });
            }
        }
    }
    if shots.is_empty() {
        let found = if lost.is_empty() {
            "no keyframes".to_owned()
        } else {
            lost.swap_remove(0)
        };
        return Err(refused(
            found,
            "at least one picture with a pose".to_owned(),
        ));
    }
    Ok(Shots {
        rig,
        cameras,
        shots,
        lost,
    })
}
