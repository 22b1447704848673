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
        let (pixels, size) =
            grey_png(&path).with_context(|| format!("reading {}", path.display()))?;
        ensure!(size == [width, height], "another size: {}", path.display());
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

/// The pair reduced to half of its size by area: its texture is finer and has less noise.
pub(crate) fn halved(frame: &Frame) -> Frame {
    let (width, height) = (frame.width / 2, frame.height / 2);
    let places = || (0..height).flat_map(|y| (0..width).map(move |x| 2 * (y * frame.width + x)));
    let near = |at: usize| [at, at + 1, at + frame.width, at + frame.width + 1];
    let eye = |pixels: &[u8]| -> Vec<u8> {
        let sum = |at: usize| near(at).map(|k| u16::from(pixels[k])).iter().sum::<u16>();
        places().map(|at| ((sum(at) + 2) / 4) as u8).collect()
    };
    Frame {
        name: format!("{} halved", frame.name),
        width,
        height,
        eyes: [eye(&frame.eyes[0]), eye(&frame.eyes[1])],
        truth: places().map(|at| 0.5 * frame.truth[at]).collect(),
        visible: places()
            .map(|at| near(at).iter().all(|k| frame.visible[*k]))
            .collect(),
        range: (frame.range / 2).next_multiple_of(16),
        geometry: Geometry {
            focal_px: 0.5 * frame.geometry.focal_px,
            center: frame.geometry.center.map(|at| 0.5 * (at - 0.5)),
            baseline_m: frame.geometry.baseline_m,
            offset_px: 0.5 * frame.geometry.offset_px,
        },
        world_from_left: frame.world_from_left,
    }
}

/// An image file as gray levels (BT.601), and its columns and rows.
pub(super) fn grey_png(path: &Path) -> Result<(Vec<u8>, [usize; 2])> {
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
    let pixels = data.chunks_exact(samples).map(luma).collect();
    Ok((pixels, [info.width, info.height].map(|side| side as usize)))
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

#[cfg(test)]
mod tests {
    use depth::evaluate::Scores;
    use depth::{Band, Config, DisparityMap, MatchStats, Matcher, Preset};

    use super::super::coverage::Coverage;
    use super::super::{motorcycle, race::BAD_2};
    use super::*;

    fn matched(frame: &Frame, config: Config) -> (DisparityMap, MatchStats, Scores) {
        let [left, right] = frame.images();
        let mut matcher = Matcher::new(config, frame.width, frame.height).unwrap();
        let band = Band::full(0, frame.range, frame.height).unwrap();
        let map = matcher.run(&left, &right, &band).unwrap().clone();
        let scores = Scores::of(&map, frame.truth()).unwrap();
        (map, matcher.stats().clone(), scores)
    }

    #[test]
    fn fine_texture_is_not_matched_as_noise() {
        let Some(frame) = motorcycle().unwrap() else {
            return;
        };
        let (_, stats, scores) = matched(&halved(&frame), Config::default());
        assert!(!stats.is_noisy, "{:?}", stats.noise);
        // Matched as a noisy pair.
        let mut noisy = Config::default();
        (noisy.min_noise, noisy.smoothed_noise) = (0.0, [0.0, 0.01]);
        let (_, _, worse) = matched(&halved(&frame), noisy);
        assert!(scores.bad_ratio(BAD_2) < 0.75 * worse.bad_ratio(BAD_2));
    }

    #[test]
    fn rows_of_a_real_pair_are_aligned() {
        let Some(frame) = motorcycle().unwrap() else {
            return;
        };
        let (_, stats, aligned) = matched(&frame, Config::default());
        // The set gives the row offsets: 0.23 px root mean square.
        assert!((0.13..0.35).contains(&stats.row_offset_px), "{stats:?}");
        let mut as_it_is = Config::default();
        as_it_is.min_row_offset_px = 9.0;
        let (_, stats, worse) = matched(&frame, as_it_is);
        assert_eq!(stats.row_offset_px, 0.0);
        assert!(aligned.bad_ratio(1) < 0.75 * worse.bad_ratio(1));
        assert!(aligned.density() > worse.density());
    }

    #[test]
    fn errors_are_within_the_stated_sigmas_in_every_quarter() {
        let Some(frame) = motorcycle().unwrap() else {
            return;
        };
        for frame in [halved(&frame), frame] {
            let (map, ..) = matched(&frame, Config::default());
            let mut coverage = Coverage::default();
            coverage.add(&map, &frame);
            let shares = coverage.shares();
            let least = shares.quarters.into_iter().fold(1.0, f64::min);
            assert!(least > 0.93, "{}: {:?}", frame.name, shares.quarters);
            // Sharp too: no larger than without a correction of the rows.
            let median = shares.median_sigma;
            assert!(median < 0.52, "{}: {median}", frame.name);
        }
    }

    #[test]
    fn accurate_has_smaller_errors_than_balanced() {
        let Some(frame) = motorcycle().unwrap() else {
            return;
        };
        for frame in [halved(&frame), frame] {
            let [balanced, accurate] = [Preset::Balanced, Preset::Accurate]
                .map(|preset| matched(&frame, Config::preset(preset)).2);
            assert!(accurate.mean_error_px() < balanced.mean_error_px());
            assert!(accurate.bad_ratio(BAD_2) < balanced.bad_ratio(BAD_2));
            assert_eq!(accurate.density(), balanced.density());
        }
    }
}
