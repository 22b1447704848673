//! `transforms.json` of nerfstudio, with points, masks and depth beside it.
//!
//! Contract: `transform_matrix` takes points in the camera to the world of the bundle (z up,
//! metres), in OpenGL's axes: x right, y up, z backward. Every frame has its own intrinsics, in
//! COLMAP's pixel coordinates (half a pixel more than ours). nerfstudio has one kind of lens for
//! all frames, and requires depth for all frames or for none.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use calibration_files::Format;
use camera_models::{CameraModel, Distortion, Eye};
use serde_json::{Map, Value, json};

use super::depth_warp::DepthWarp;
use super::error::{ExportError, writing};
use super::folder::NewFolder;
use super::lenses::fitted;
use super::options::Options;
use super::posed_images::{PosedImage, PosedImages, collect};
use super::summary::Summary;
use crate::outputs::depth::{self, DepthIndex, DepthKey};
use crate::outputs::gray_png::{encode8, encode16};
use crate::outputs::masks::{self, Mask};
use crate::outputs::{self, cloud};
use crate::scene::{OutputReader, Scene};

const NAME: &str = "nerfstudio";
/// Offset of COLMAP's, and so of nerfstudio's, pixel coordinates against ours.
const PIXEL_OFFSET: f64 = 0.5;
/// Image folder if none is given.
const DEFAULT_IMAGE_FOLDER: &str = "images";
const POINTS: &str = "points.ply";

pub(super) fn export(scene: &Scene, options: &Options, out: &Path) -> Result<Summary, ExportError> {
    let posed_images = collect(scene, options, NAME)?;
    let images = match &options.images {
        None => DEFAULT_IMAGE_FOLDER.to_owned(),
        Some(folder) => relative_path(out, folder)?.to_string_lossy().into_owned(),
    };
    let mut summary = Summary::default();
    let mut models = Vec::new();
    for camera in &posed_images.cameras {
        let lens = fitted(&camera.name, &camera.model, Format::Nerfstudio)?;
        summary.notes.extend(lens.note);
        summary.lost.extend(lens.lost);
        models.push(lens.model);
    }
    let kind = kind_for_all(&posed_images, &models)?;

    let folder = NewFolder::begin(out)?;
    let masks = write_masks(scene, &posed_images, &folder)?;
    let depth = write_depth(scene, &posed_images, &folder, &mut summary)?;
    let mut root = Map::new();
    root.insert("camera_model".to_owned(), json!(kind));
    if scene.has(outputs::CLOUD) {
        folder.write(POINTS, &cloud::read_file(&scene.output(outputs::CLOUD)?)?)?;
        root.insert("ply_file_path".to_owned(), json!(POINTS));
    } else {
        summary
            .notes
            .push("the bundle has no points: ply_file_path is left out".to_owned());
    }
    let frames = posed_images.images.iter().enumerate().map(|(k, image)| {
        let mut frame = intrinsics(&models[image.camera]);
        frame.insert(
            "file_path".to_owned(),
            json!(format!("{images}/{}", image.path)),
        );
        frame.insert("transform_matrix".to_owned(), opengl(image));
        if let Some(masks) = &masks {
            frame.insert("mask_path".to_owned(), json!(masks[k]));
        }
        if depth {
            frame.insert("depth_file_path".to_owned(), json!(depth_path(image)));
        }
        Value::Object(frame)
    });
    // A line per frame: thousands of them are still readable.
    let frames: Vec<String> = frames.map(|frame| format!("  {frame}")).collect();
    let head: Vec<String> = root
        .iter()
        .map(|(key, value)| format!(" \"{key}\": {value},\n"))
        .collect();
    let text = format!(
        "{{\n{} \"frames\": [\n{}\n ]\n}}\n",
        head.concat(),
        frames.join(",\n")
    );
    folder.write("transforms.json", text.as_bytes())?;
    folder.finish()?;
    summary.description = format!(
        "{} images of {} cameras",
        posed_images.images.len(),
        posed_images.cameras.len()
    );
    summary.lost.extend(posed_images.lost);
    Ok(summary)
}

fn kind_for_all(
    posed_images: &PosedImages,
    models: &[CameraModel],
) -> Result<&'static str, ExportError> {
    let is_fisheye =
        |model: &CameraModel| matches!(model.distortion, Distortion::KannalaBrandt4 { .. });
    let all = models.iter().zip(&posed_images.cameras);
    let (wide, narrow): (Vec<_>, Vec<_>) = all.partition(|(model, _)| is_fisheye(model));
    match (&wide[..], &narrow[..]) {
        ([], _) => Ok("OPENCV"),
        (_, []) => Ok("OPENCV_FISHEYE"),
        ([(_, wide), ..], [(_, narrow), ..]) => Err(ExportError::Refused {
            format: NAME,
            found: format!(
                "a fisheye lens of {} and another one of {}",
                wide.name, narrow.name
            ),
            expected: "one kind for all: export cameras of one kind with --camera".to_owned(),
        }),
    }
}

fn intrinsics(model: &CameraModel) -> Map<String, Value> {
    let mut keys: BTreeMap<&str, f64> = BTreeMap::from([
        ("fl_x", model.fx),
        ("fl_y", model.fy),
        ("cx", model.cx + PIXEL_OFFSET),
        ("cy", model.cy + PIXEL_OFFSET),
        ("k1", 0.0),
        ("k2", 0.0),
        ("p1", 0.0),
        ("p2", 0.0),
    ]);
    let names = model.distortion.coefficient_names().iter().copied();
    keys.extend(names.zip(model.distortion.coefficients()));
    let mut map: Map<String, Value> = keys
        .into_iter()
        .map(|(k, v)| (k.to_owned(), json!(v)))
        .collect();
    map.insert("w".to_owned(), json!(model.width));
    map.insert("h".to_owned(), json!(model.height));
    map
}

fn opengl(image: &PosedImage) -> Value {
    let r = image.world_from_camera.rotation_rows();
    let t = image.world_from_camera.translation_m();
    // y and z have the opposite direction in OpenGL.
    let row = |i: usize| json!([r[3 * i], -r[3 * i + 1], -r[3 * i + 2], t[i]]);
    json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
}

/// Path of the mask of each image, where the bundle has masks: the camera's mask (white if there is
/// none) combined with the dynamic mask of the image, if there is one.
fn write_masks(
    scene: &Scene,
    posed_images: &PosedImages,
    folder: &NewFolder,
) -> Result<Option<Vec<String>>, ExportError> {
    if !scene.has(outputs::MASKS) {
        return Ok(None);
    }
    let reader = scene.output(outputs::MASKS)?;
    let mut of_cameras = Vec::new();
    for camera in &posed_images.cameras {
        let name = &posed_images.rig.cameras[camera.rig_index].name;
        let (width, height) = (camera.model.width, camera.model.height);
        let white = || Mask {
            width,
            height,
            pixels: vec![255; width as usize * height as usize],
        };
        let mask = masks::read(&reader, name, camera.eye)?.unwrap_or_else(white);
        check_mask_size(&mask, &camera.name, (width, height))?;
        let path = format!("masks/{}", masks::path(name, camera.eye));
        folder.write(&path, &encode8(width, height, &mask.pixels))?;
        of_cameras.push((mask, path));
    }
    let mut paths = Vec::new();
    for image in &posed_images.images {
        let camera = &posed_images.cameras[image.camera];
        let (of_camera, path) = &of_cameras[image.camera];
        let name = &posed_images.rig.cameras[camera.rig_index].name;
        let frame = image.keyframe.frame;
        let moving = match camera.eye {
            Eye::Left => masks::read_dynamic(&reader, name, frame)?,
            Eye::Right => None,
        };
        let Some(mut mask) = moving else {
            paths.push(path.clone());
            continue;
        };
        check_mask_size(&mask, &camera.name, (of_camera.width, of_camera.height))?;
        for (pixel, of_camera) in mask.pixels.iter_mut().zip(&of_camera.pixels) {
            *pixel &= of_camera;
        }
        let path = format!("masks/{}", masks::dynamic_path(name, frame));
        folder.write(&path, &encode8(mask.width, mask.height, &mask.pixels))?;
        paths.push(path);
    }
    Ok(Some(paths))
}

fn check_mask_size(
    mask: &Mask,
    camera: &str,
    (width, height): (u32, u32),
) -> Result<(), ExportError> {
    if (mask.width, mask.height) == (width, height) {
        return Ok(());
    }
    Err(ExportError::Refused {
        format: NAME,
        found: format!("a mask of {camera} of {}x{}", mask.width, mask.height),
        expected: format!("{width}x{height}, as its images have"),
    })
}

fn depth_path(image: &PosedImage) -> String {
    format!("depth/{}", image.path)
}

/// Whether all frames have depth; then it is written, warped to the images as they were recorded.
fn write_depth(
    scene: &Scene,
    posed_images: &PosedImages,
    folder: &NewFolder,
    summary: &mut Summary,
) -> Result<bool, ExportError> {
    if !scene.has(outputs::DEPTH) {
        return Ok(false);
    }
    let reader = scene.output(outputs::DEPTH)?;
    let index = depth::read_index(&reader)?;
    let found: Vec<Option<&DepthKey>> = posed_images
        .images
        .iter()
        .map(|image| key_of(&index, posed_images, image))
        .collect();
    let without = found.iter().filter(|key| key.is_none()).count();
    if without > 0 {
        summary.notes.push(format!(
            "{without} of {} images have no depth, and nerfstudio takes it for all or none: depth is left out",
            found.len()
        ));
        return Ok(false);
    }
    let mut depth_warps: BTreeMap<usize, DepthWarp> = BTreeMap::new();
    for (image, key) in posed_images.images.iter().zip(found.into_iter().flatten()) {
        let model = &posed_images.cameras[image.camera].model;
        let depth_warp = depth_warps
            .entry(image.camera)
            .or_insert_with(|| DepthWarp::new(&index.views[key.view], model));
        write_one(&reader, &index, key, depth_warp, folder, &depth_path(image))?;
    }
    Ok(true)
}

fn key_of<'a>(
    index: &'a DepthIndex,
    posed_images: &PosedImages,
    image: &PosedImage,
) -> Option<&'a DepthKey> {
    let camera = &posed_images.cameras[image.camera];
    if camera.eye == Eye::Right {
        return None;
    }
    let name = &posed_images.rig.cameras[camera.rig_index].name;
    let view = index.views.iter().position(|view| view.camera == *name)?;
    index
        .images
        .iter()
        .find(|key| key.view == view && key.frame == image.keyframe.frame)
}

fn write_one(
    reader: &OutputReader,
    index: &DepthIndex,
    key: &DepthKey,
    depth_warp: &DepthWarp,
    folder: &NewFolder,
    path: &str,
) -> Result<(), ExportError> {
    let image = depth::read(reader, index, key)?;
    let (width, height) = depth_warp.size();
    folder.write(path, &encode16(width, height, &depth_warp.depth(&image)))
}

/// Path of the image folder for a program that reads a file in `out`: relative where possible.
fn relative_path(out: &Path, images: &Path) -> Result<PathBuf, ExportError> {
    let parent = match out.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).map_err(writing(parent))?;
    let whole = |path: &Path| fs::canonicalize(path).map_err(writing(path));
    let (parent, images) = (whole(parent)?, whole(images)?);
    let out = parent.join(out.file_name().unwrap_or_default());
    let common = out
        .components()
        .zip(images.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = out.components().skip(common).map(|_| "..");
    let mut path: PathBuf = up.collect();
    path.extend(images.components().skip(common));
    Ok(path)
}
