//! A real rectified pair with its truth: Motorcycle at a quarter of its size, of the Middlebury
//! stereo sets (Scharstein et al., "High-resolution stereo datasets with subpixel-accurate ground
//! truth", GCPR 2014), with their mask of visible pixels.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use cad_transforms::RigidTransform;
use depth::Geometry;

use super::frames::Frame;

/// The folder of the real pair among the recordings.
pub(crate) const MOTORCYCLE: &str = "01_stereo_depth/middlebury2014_motorcycle_Q";
/// Its disparities, as OpenCV needs them: a multiple of 16 that holds the 70 of its `calib.txt`.
const MOTORCYCLE_RANGE: usize = 80;

/// The real pair.
///
/// # Errors
/// A file that cannot be read.
pub(crate) fn motorcycle(folder: &Path) -> Result<Frame> {
    let calibration = folder.join("calib.txt");
    let (cameras, _) = calibration_files::read_cameras(&calibration, None)
        .with_context(|| format!("reading {}", calibration.display()))?;
    let [left, right] = &cameras.cameras[..] else {
        bail!("not a pair: {}", calibration.display());
    };
    let right_from_left = right
        .camera_from_first
        .context("a pair without a baseline")?;
    let (left, right) = (&left.model, &right.model);
    let (width, height) = (left.width as usize, left.height as usize);
    let grey = |name: &str| {
        let path = folder.join(name);
        let pixels = grey_png(&path).with_context(|| format!("reading {}", path.display()))?;
        ensure!(
            pixels.len() == width * height,
            "another size: {}",
            path.display()
        );
        anyhow::Ok(pixels)
    };
    let path = folder.join("disp0GT.pfm");
    let truth =
        pfm(&path, [width, height]).with_context(|| format!("reading {}", path.display()))?;
    let mask = grey("mask0nocc.png")?;
    let known = mask.iter().zip(&truth);
    let visible = known.map(|(mask, truth)| *mask == 255 && truth.is_finite());
    Ok(Frame {
        name: "Motorcycle".to_owned(),
        width,
        height,
        eyes: [grey("im0.png")?, grey("im1.png")?],
        visible: visible.collect(),
        truth: truth
            .into_iter()
            .map(|d| if d.is_finite() { d } else { f32::NAN })
            .collect(),
        range: MOTORCYCLE_RANGE,
        geometry: Geometry {
            focal_px: left.fx,
            center: [left.cx, left.cy],
            baseline_m: -right_from_left.translation_m()[0],
            offset_px: right.cx - left.cx,
        },
        world_from_left: RigidTransform::identity(),
    })
}

/// An image file as gray levels (BT.601).
fn grey_png(path: &Path) -> Result<Vec<u8>> {
    let mut decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(path)?));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info()?;
    let mut data = vec![
        0;
        reader
            .output_buffer_size()
            .context("an image without a size")?
    ];
    let info = reader.next_frame(&mut data)?;
    data.truncate(info.buffer_size());
    let samples = info.color_type.samples();
    let luma = |p: &[u8]| match p {
        [r, g, b, ..] => {
            ((299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b) + 500) / 1000) as u8
        }
        _ => p[0],
    };
    Ok(data.chunks_exact(samples).map(luma).collect())
}

/// A portable float map of one channel, little-endian, first row first. The file has the last row
/// first.
fn pfm(path: &Path, [width, height]: [usize; 2]) -> Result<Vec<f32>> {
    let bytes = fs::read(path)?;
    let mut lines = bytes.splitn(4, |b| *b == b'\n');
    let mut line = || {
        let text = lines.next().context("the file is too short")?;
        anyhow::Ok(std::str::from_utf8(text)?.trim().to_owned())
    };
    let (kind, size, scale) = (line()?, line()?, line()?);
    ensure!(kind == "Pf", "found {kind:?}, expected Pf");
    ensure!(
        size == format!("{width} {height}"),
        "found a size of {size}, expected {width} {height}"
    );
    ensure!(
        scale.parse::<f64>()? < 0.0,
        "found big-endian numbers, expected little-endian ones"
    );
    let data = lines.next().context("the file is too short")?;
    ensure!(
        data.len() == width * height * 4,
        "found {} bytes",
        data.len()
    );
    let rows = data
        .chunks_exact(width * 4)
        .rev()
        .flat_map(|row| row.chunks_exact(4));
    Ok(rows
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect())
}
