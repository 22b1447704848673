//! Depth maps of a Kinect in a kitchen, with their poses: time and agreement, there is no truth.

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use nalgebra::Vector3;
use terrain::mesh::Mesh;
use terrain::{PixelClass, RowMotion};

use super::keyframes::DepthFrame;
use super::scores::Quantiles;
use super::truth::distance_to_triangle;

/// Folder among the recordings.
pub(super) const FOLDER: &str = "08_rgbd_mesh/tsdf_fusion_kinect50";
/// Vertices farther than this from the other surface, m, have nothing to agree with.
const REACH_M: f64 = 0.05;
const CELL_M: f64 = 0.1;

/// The frames in the order of their names.
///
/// # Errors
/// A file that cannot be read or is not as expected.
pub(super) fn frames(folder: &Path) -> Result<Vec<DepthFrame>> {
    let numbers = |path: &Path| -> Result<Vec<f64>> {
        let text =
            fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        let words = text.split_whitespace().map(str::parse);
        words
            .collect::<Result<_, _>>()
            .with_context(|| format!("reading the numbers of {}", path.display()))
    };
    let intrinsics = numbers(&folder.join("camera-intrinsics.txt"))?;
    ensure!(
        intrinsics.len() == 9,
        "found {} numbers of intrinsics, expected 9",
        intrinsics.len()
    );
    let images = folder.join("rgbd-frames");
    let mut names: Vec<String> = fs::read_dir(&images)
        .with_context(|| format!("reading {}", images.display()))?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter_map(|name| Some(name.strip_suffix(".depth.png")?.to_owned()))
        .collect();
    names.sort();
    let frame = |name: &String| {
        let (size, depth_m) = depth(&images.join(format!("{name}.depth.png")))?;
        let pose = numbers(&images.join(format!("{name}.pose.txt")))?;
        let rows: [f64; 16] = pose
            .try_into()
            .map_err(|found: Vec<f64>| anyhow::anyhow!("{} numbers of a pose", found.len()))?;
        // Files have five digits.
        let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rows[4 * i + j]));
        let translation = [3, 7, 11].map(|i| rows[i]);
        let matrix = nalgebra::Matrix3::from_fn(|i, j| rotation[i][j]);
        let q = nalgebra::UnitQuaternion::from_matrix(&matrix);
        let q = q.quaternion();
        let pixels = depth_m.len();
        Ok(DepthFrame {
            size,
            focal_px: [intrinsics[0], intrinsics[4]],
            center_px: [intrinsics[2], intrinsics[5]],
            world_from_view: RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], translation)?,
            row_motion: RowMotion::default(),
            sigma_m: depth_m.iter().map(|z| sigma_m(*z)).collect(),
            depth_m,
            classes: vec![PixelClass::Static; pixels],
        })
    };
    names.iter().map(frame).collect()
}

/// Axial noise of a Kinect, m (Nguyen, Izadi, Lovell 2012).
fn sigma_m(depth_m: f32) -> f32 {
    0.0012 + 0.0019 * (depth_m - 0.4) * (depth_m - 0.4)
}

/// Size and depths, m; 0 for none.
fn depth(path: &Path) -> Result<([usize; 2], Vec<f32>)> {
    let context = || format!("reading {}", path.display());
    let file = fs::File::open(path).with_context(context)?;
    let decoder = png::Decoder::new(std::io::BufReader::new(file));
    let mut reader = decoder.read_info().with_context(context)?;
    let size = reader
        .output_buffer_size()
        .context("an image of that size")?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).with_context(context)?;
    ensure!(
        info.bit_depth == png::BitDepth::Sixteen && info.color_type == png::ColorType::Grayscale,
        "found {:?} {:?}, expected 16 bits of gray: {}",
        info.bit_depth,
        info.color_type,
        path.display()
    );
    let depth = bytes
        .chunks_exact(2)
        .map(|b| u16::from_be_bytes([b[0], b[1]]));
    // 65535 is a pixel without depth as well.
    let metres = depth.map(|mm| {
        if mm == u16::MAX {
            0.0
        } else {
            1e-3 * f32::from(mm)
        }
    });
    Ok((
        [info.width as usize, info.height as usize],
        metres.collect(),
    ))
}

/// Distances of the vertices of a surface from another one, and the share of them that has it
/// within 5 cm.
pub(super) fn agreement(of: &Mesh, with: &Mesh) -> (Quantiles, f64) {
    let cell = |v: f64| (v / CELL_M).floor() as i32;
    let mut table: HashMap<[i32; 3], Vec<[Vector3<f64>; 3]>> = HashMap::new();
    for triangle in &with.triangles {
        let corners = triangle.map(|i| Vector3::from(with.positions[i as usize].map(f64::from)));
        let range = |k: usize| {
            let least = corners.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min);
            let most = corners
                .iter()
                .map(|c| c[k])
                .fold(f64::NEG_INFINITY, f64::max);
            cell(least - REACH_M)..=cell(most + REACH_M)
        };
        for x in range(0) {
            for y in range(1) {
                for z in range(2) {
                    table.entry([x, y, z]).or_default().push(corners);
                }
            }
        }
    }
    let distances: Vec<f64> = of
        .positions
        .iter()
        .filter_map(|position| {
            let x = position.map(f64::from);
            let triangles = table.get(&x.map(cell))?;
            let x = Vector3::from(x);
            let all = triangles.iter().map(|own| distance_to_triangle(own, &x));
            all.reduce(f64::min).filter(|nearest| *nearest <= REACH_M)
        })
        .collect();
    let share = distances.len() as f64 / of.positions.len().max(1) as f64;
    (Quantiles::of(distances), share)
}
