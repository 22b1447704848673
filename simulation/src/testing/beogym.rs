//! A made-up folder of Beogym, generation 1.

use std::fs;
use std::io;
use std::path::Path;

use gaussians::files::ply;
use gaussians::{Splat, Splats};

/// `lidar_from_sector` of the sectors as their files have it: a quarter turn about y.
const ROWS: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]];

/// Writes two sectors along x of the LiDAR frame (y up), the second one `second_m` beyond the
/// first, each with two Gaussians and two cameras 2 m apart at 1 m above the ground, and a
/// [`map`].
///
/// # Errors
/// Those of writing.
pub fn write(folder: &Path, second_m: f64) -> io::Result<()> {
    for (k, name) in ["sec1", "sec2"].into_iter().enumerate() {
        let sector = folder.join(name);
        fs::create_dir_all(&sector)?;
        let mut splats = Splats::empty(1).map_err(io::Error::other)?;
        // Origin and a point at 2 m along z of the sector.
        for z in [0.0, 2.0] {
            let mut splat = Splat::sphere(0.1, [0.2 + 0.1 * k as f32, 0.5, 0.7]);
            splat.position_m = [0.0, 0.0, z];
            splats.push(&splat).map_err(io::Error::other)?;
        }
        fs::write(sector.join("point_cloud.ply"), ply::write(&splats, false))?;
        let t = [second_m * k as f64, -0.5, 3.0];
        let row = |r: [f64; 3]| format!("[{:.8e} {:.8e} {:.8e}]", r[0], r[1], r[2]);
        let rows: Vec<String> = ROWS.into_iter().chain([t]).map(row).collect();
        let text = format!("[{}]", rows.join("\n "));
        fs::write(sector.join("transformation.txt"), text)?;
        let camera = |z: f64| {
            format!(
                "{{\"id\": 0, \"img_name\": \"cam1_100.jpg\", \"width\": 1280, \"height\": 720, \
                 \"position\": [0.0, 0.0, {z}], \"rotation\": [[1,0,0],[0,1,0],[0,0,1]], \
                 \"fy\": 800.0, \"fx\": 800.0}}"
            )
        };
        let text = format!("[{}, {}]", camera(0.0), camera(2.0));
        fs::write(sector.join("cameras.json"), text)?;
    }
    fs::write(folder.join("surfaceMap.pcd"), map("ascii"))
}

/// A LiDAR map with its points as `ascii` or `binary`: ground of 12 x 8 m at y = -1.5 but for a
/// hole, a wall, a bridge 3 m above; x and z are the ground.
pub fn map(data: &str) -> Vec<u8> {
    let points = points();
    let count = points.len();
    let mut bytes = format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n\
         COUNT 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\n\
         DATA {data}\n"
    )
    .into_bytes();
    for [x, y, z] in points {
        match data {
            "ascii" => bytes.extend(format!("{x} {y} {z} 7\n").into_bytes()),
            _ => bytes.extend([x, y, z, 7.0].into_iter().flat_map(f32::to_le_bytes)),
        }
    }
    bytes
}

fn points() -> Vec<[f32; 3]> {
    let mut points = Vec::new();
    for i in 0..240 {
        for j in 0..160 {
            let [x, z] = [i, j].map(|k| 0.05 * k as f32 + 0.01);
            let is_hole = (4.0..5.0).contains(&x) && (4.0..5.0).contains(&z);
            if !is_hole {
                points.push([x, -1.5, z]);
            }
            if (6.0..8.0).contains(&x) {
                points.push([x, 1.5, z]);
            }
            if (2.0..2.2).contains(&x) {
                points.extend((1..40).map(|k| [x, -1.5 + 0.05 * k as f32, z]));
            }
        }
    }
    points
}
