//! Public datasets as sequences.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use cad_transforms::RigidTransform;
use odometry::ImuSample;
use odometry::rig::{Imu, Rig, StereoCamera};

use super::{ImageSource, PlannedSet, Reader, Sequence, Truth};

/// Frame period of KITTI, ns.
const KITTI_PERIOD_NS: i64 = 100_000_000;
/// Range of the ADIS16448 of EuRoC's VI sensor (data sheet): 1000 deg/s, 18 g.
const ADIS_RANGE: [f64; 2] = [1000.0 * std::f64::consts::PI / 180.0, 18.0 * 9.806_65];
/// Rotation from optical to rig axes: forward is optical z, left is -x, up is -y. Rows.
const RIG_FROM_OPTICAL: [f64; 9] = [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0];

/// A folder with `calib.txt`, `poses.txt`, `image_l` and `image_r`, as in KITTI odometry:
/// rectified, 10 Hz, no IMU.
///
/// The rig frame has its origin in the left camera and faces forward with it; so does the world,
/// which is the first camera's frame with x forward and z up.
///
/// # Errors
/// Files that are absent or not in KITTI's format.
pub fn kitti(folder: &Path) -> Result<Sequence> {
    let named = |side: &str| images(&folder.join(side));
    let (left, right) = (named("image_l")?, named("image_r")?);
    let first = left.first().context("there is no image")?;
    let (width, height) = size(first)?;
    let (calibration, _) =
        calibration_files::read_stereo(&folder.join("calib.txt"), width, height)?;
    let rig_from_left = RigidTransform::from_rotation_rows(RIG_FROM_OPTICAL, [0.0; 3])?;
    let path = folder.join("poses.txt");
    let mut truth = Vec::new();
    for (n, row) in text(&path)?.lines().enumerate() {
        let pose = kitti_row(row).with_context(|| format!("row {n} of {}", path.display()))?;
        let pose = rig_from_left * pose * rig_from_left.inverse();
        truth.push((n as i64 * KITTI_PERIOD_NS, pose));
    }
    let (l, r, poses) = (left.len(), right.len(), truth.len());
    ensure!(
        l == r && l <= poses,
        "{l} left images, {r} right images and {poses} poses, expected equal numbers, or more poses, in {}",
        folder.display()
    );
    let sets = (truth.iter().take(l)).map(|(time_ns, _)| PlannedSet {
        time_ns: *time_ns,
        views: vec![Some(*time_ns)],
    });
    Ok(Sequence {
        name: name(folder),
        rig: Rig {
            cameras: vec![StereoCamera {
                name: "camera".to_owned(),
                left: calibration.left,
                right: calibration.right,
                rig_from_left,
                covariance: None,
                right_from_left: calibration.right_from_left,
                right_from_left_covariance: None,
                line_s: 0.0,
            }],
            imus: Vec::new(),
        },
        imu: Vec::new(),
        sets: sets.collect(),
        truth: Truth::Measured(truth),
        images: ImageSource::Files(vec![
            left.into_iter().zip(right).map(|(l, r)| [l, r]).collect(),
        ]),
    })
}

/// A folder with `mav0` as in EuRoC and a file of true states. The rig is the body, which is the
/// IMU.
///
/// The sequence has `seconds` from the first image on. After the last image, while the IMU still
/// measures, sets continue without images at the same rate; `None` ends with the images.
///
/// # Errors
/// Files that are absent or not in EuRoC's format.
pub fn euroc(folder: &Path, truth: &Path, seconds: Option<f64>) -> Result<Sequence> {
    let mav = folder.join("mav0");
    let lists = [
        euroc_images(&mav.join("cam0"))?,
        euroc_images(&mav.join("cam1"))?,
    ];
    let [left, right] = lists;
    let (_, first) = left.first().context("there is no image")?;
    let (width, height) = size(first)?;
    let (calibration, _) = calibration_files::read_stereo(&mav, width, height)?;
    let nominal = calibration.imu.context("there is no imu0/sensor.yaml")?;
    let noise = nominal.noise.context("imu0/sensor.yaml has no noise")?;
    let path = mav.join("imu0/data.csv");
    let mut imu = Vec::new();
    for row in rows(&path)? {
        let (time_ns, v) = row?;
        let [gx, gy, gz, ax, ay, az] = v.try_into().ok().context("a row has not six values")?;
        imu.push(ImuSample {
            time_ns,
            gyro: [gx, gy, gz],
            accel: [ax, ay, az],
        });
    }
    let (mut sets, mut files) = (Vec::new(), Vec::new());
    let mut other = right.into_iter().peekable();
    for (time_ns, left) in left {
        while other.next_if(|(t, _)| *t < time_ns).is_some() {}
        let pair = other.next_if(|(t, _)| *t == time_ns);
        sets.push(PlannedSet {
            time_ns,
            views: vec![pair.is_some().then_some(time_ns)],
        });
        files.extend(pair.map(|(_, right)| [left, right]));
    }
    if let Some(seconds) = seconds {
        let begin = sets[0].time_ns;
        let end = begin + (seconds * 1e9) as i64;
        sets.retain(|set| set.time_ns <= end);
        let end = end.min(imu.last().map_or(begin, |s| s.time_ns));
        let period = (imu.len() > 1 && sets.len() > 1).then(|| sets[1].time_ns - begin);
        let last = sets.last().map_or(begin, |set| set.time_ns);
        for time_ns in (last..=end).step_by(period.context("there is one image")? as usize) {
            if time_ns > last {
                let views = vec![None];
                sets.push(PlannedSet { time_ns, views });
            }
        }
    }
    let mut poses = Vec::new();
    for row in rows(truth)? {
        let (time_ns, v) = row?;
        ensure!(v.len() >= 7, "a row of {} has no pose", truth.display());
        let pose = RigidTransform::from_wxyz([v[3], v[4], v[5], v[6]], [v[0], v[1], v[2]])?;
        poses.push((time_ns, pose));
    }
    // The body is the IMU.
    let imu_from_left = nominal.imu_from_left;
    Ok(Sequence {
        name: name(folder),
        rig: Rig {
            cameras: vec![StereoCamera {
                name: "camera".to_owned(),
                left: calibration.left,
                right: calibration.right,
                rig_from_left: imu_from_left,
                covariance: None,
                right_from_left: calibration.right_from_left,
                right_from_left_covariance: None,
                line_s: 0.0,
            }],
            imus: vec![Imu {
                name: "imu".to_owned(),
                rig_from_imu: RigidTransform::identity(),
                noise,
                rate_hz: nominal.rate_hz,
                range: ADIS_RANGE,
            }],
        },
        imu: vec![imu],
        sets,
        truth: Truth::Measured(poses),
        images: ImageSource::Files(vec![files]),
    })
}

/// Reads pairs of image files.
pub(super) fn reader(files: Vec<[PathBuf; 2]>) -> Reader {
    let mut files = files.into_iter();
    Box::new(move || {
        let [left, right] = files.next().context("there is no further image")?;
        Ok([gray(&left)?, gray(&right)?])
    })
}

fn name(folder: &Path) -> String {
    let name = folder.file_name().unwrap_or(folder.as_os_str());
    name.to_string_lossy().into_owned()
}

fn text(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))
}

fn kitti_row(row: &str) -> Result<RigidTransform> {
    let numbers: Vec<f64> = (row.split_whitespace())
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    let found = numbers.len();
    let rows = numbers.try_into().ok();
    let rows = rows.with_context(|| format!("found {found} numbers, expected 12"))?;
    Ok(RigidTransform::from_rows_3x4(rows)?)
}

/// Times and values of a CSV table with comments that begin with `#`.
fn rows(path: &Path) -> Result<impl Iterator<Item = Result<(i64, Vec<f64>)>>> {
    let text = text(path)?;
    let lines: Vec<String> = (text.lines())
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(str::to_owned)
        .collect();
    let path = path.to_owned();
    Ok(lines.into_iter().map(move |line| {
        let row = || {
            let (time, rest) = line.split_once(',')?;
            let values = rest.split(',').map(|v| v.trim().parse().ok());
            Some((time.trim().parse().ok()?, values.collect::<Option<_>>()?))
        };
        row().with_context(|| format!("found {line:?}, expected numbers in {}", path.display()))
    }))
}

/// Times and files of a camera.
fn euroc_images(camera: &Path) -> Result<Vec<(i64, PathBuf)>> {
    let path = camera.join("data.csv");
    let mut list = Vec::new();
    for line in text(&path)?.lines().filter(|line| !line.starts_with('#')) {
        let row = line.split_once(',');
        let row = row.and_then(|(time, file)| Some((time.trim().parse().ok()?, file.trim())));
        let (time_ns, file) = row.with_context(|| {
            let path = path.display();
            format!("found {line:?}, expected a time and a file in {path}")
        })?;
        list.push((time_ns, camera.join("data").join(file)));
    }
    // An excerpt has the list of the whole recording.
    list.retain(|(_, file)| file.exists());
    Ok(list)
}

/// The files of a folder by name.
fn images(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("searching images in {}", folder.display()))?;
    let mut files =
        (entries.map(|entry| entry.map(|e| e.path()))).collect::<Result<Vec<_>, _>>()?;
    files.retain(|path| path.extension().is_some_and(|e| e == "png"));
    files.sort();
    Ok(files)
}

fn open(path: &Path) -> Result<png::Reader<BufReader<File>>> {
    let file = File::open(path).with_context(|| format!("opening {}", path.display()))?;
    let decoder = png::Decoder::new(BufReader::new(file));
    let reader = decoder.read_info();
    reader.with_context(|| format!("reading {}", path.display()))
}

fn size(path: &Path) -> Result<(u32, u32)> {
    Ok(open(path)?.info().size())
}

/// Pixels of a gray image.
fn gray(path: &Path) -> Result<Vec<u8>> {
    let mut reader = open(path)?;
    let found = reader.output_color_type();
    ensure!(
        found == (png::ColorType::Grayscale, png::BitDepth::Eight),
        "found {found:?}, expected 8-bit grey: {}",
        path.display()
    );
    let size = reader
        .output_buffer_size()
        .context("an image that is too large")?;
    let mut pixels = vec![0; size];
    let info = reader.next_frame(&mut pixels);
    let info = info.with_context(|| format!("reading {}", path.display()))?;
    pixels.truncate(info.buffer_size());
    Ok(pixels)
}
