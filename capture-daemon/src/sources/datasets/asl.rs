//! ASL / EuRoC folders: `cam0` (left) and `cam1` (right) with `data.csv` and `data/`,
//! `imu0/data.csv`.
//!
//! Contract: `data.csv` assigns images to timestamps in ns. Images are paired if the timestamps are
//! equal, not if they are near. Rows whose image is not on disk are skipped and counted in a note
//! (excerpts of data sets contain the whole list); a timestamp with one image only is an error. IMU
//! values are parsed to the nearest `f64`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::text::{Text, check_rising, file_names, is_there};
use super::{DatasetError, DatasetKind, Extent, ImuSample, StereoDataset, StereoFrameRef, rate_of};

/// The folder with `cam0` and `cam1`: `path` itself or `mav0` in it.
pub(super) fn root_of(path: &Path) -> Option<PathBuf> {
    [path.to_owned(), path.join("mav0")]
        .into_iter()
        .find(|root| is_there(&root.join("cam0/data.csv")))
}

pub(super) fn open(
    path: &Path,
    rate_hz: Option<f64>,
    extent: Extent,
) -> Result<StereoDataset, DatasetError> {
    let root = root_of(path).unwrap_or_else(|| path.to_owned());
    let mut notes = Vec::new();
    let mut left = Camera::read(&root.join("cam0"), extent, &mut notes)?;
    let mut right = Camera::read(&root.join("cam1"), extent, &mut notes)?;
    // Two heads may end with different frames.
    let ends = [left.known_until, right.known_until].into_iter().flatten();
    let until = ends.min();
    if let Some(until) = until {
        for camera in [&mut left, &mut right] {
            camera.images.retain(|time_ns, _| *time_ns <= until);
        }
    }
    let frames = pair(&left, &right)?;
    let mut is_head = until.is_some();

    let imu_list = root.join("imu0/data.csv");
    let imu = if is_there(&imu_list) {
        let (samples, of_head) = read_imu(&imu_list, extent)?;
        is_head |= of_head;
        samples
    } else {
        Vec::new()
    };
    if imu.is_empty() {
        notes.push("no IMU samples: imu0/data.csv is absent or empty".to_owned());
    }
    if let Some(rate_hz) = rate_hz.filter(|_| frames.len() > 1) {
        notes.push(format!(
            "the rate of {rate_hz} Hz is ignored: the frames have stamps"
        ));
    }
    let calibration_files = [
        "body.yaml",
        "cam0/sensor.yaml",
        "cam1/sensor.yaml",
        "imu0/sensor.yaml",
    ]
    .iter()
    .map(|name| root.join(name))
    .filter(|file| is_there(file))
    .collect();
    Ok(StereoDataset {
        kind: DatasetKind::Asl,
        rate_hz: rate_of(&frames, rate_hz, path)?,
        root: path.to_owned(),
        frames,
        imu,
        calibration_files,
        notes,
        is_head,
    })
}

/// The images of one eye that are on disk, by timestamp in ns, with their row in the list.
struct Camera {
    folder: PathBuf,
    images: BTreeMap<i64, (u64, PathBuf)>,
    /// With a head, the timestamp of its last row, ns.
    known_until: Option<i64>,
}

impl Camera {
    fn read(folder: &Path, extent: Extent, notes: &mut Vec<String>) -> Result<Self, DatasetError> {
        let list = folder.join("data.csv");
        let text = Text::read(&list, extent)?;
        let data = folder.join("data");
        let on_disk = file_names(&data)?;
        let mut images = BTreeMap::new();
        let mut absent: Vec<&str> = Vec::new();
        let mut last_ns = None;
        let mut rows = 0;
        for line in text.lines() {
            let [stamp, name] = line.fields("timestamp_ns,filename")?;
            let time_ns = line.stamp_ns(stamp)?;
            check_rising(&mut last_ns, time_ns, &line)?;
            if name.is_empty() || name.contains(['/', '\\']) || name == ".." {
                return Err(line.malformed(name, "the name of a file in data/"));
            }
            match on_disk.contains(name) {
                true => {
                    images.insert(time_ns, (rows, data.join(name)));
                }
                false => absent.push(name),
            }
            rows += 1;
        }
        if let [first, ..] = absent.as_slice() {
            let camera = folder.file_name().unwrap_or_default().display();
            notes.push(format!(
                "{camera}/data.csv lists {rows} images, {} of them are not on disk and left out, the first is {first}",
                absent.len()
            ));
        }
        if images.is_empty() {
            return Err(match text.is_head {
                true => DatasetError::Head { path: list },
                false => DatasetError::Empty { path: list },
            });
        }
        Ok(Self {
            folder: folder.to_owned(),
            images,
            known_until: last_ns.filter(|_| text.is_head),
        })
    }
}

fn pair(left: &Camera, right: &Camera) -> Result<Vec<StereoFrameRef>, DatasetError> {
    let only = |a: &Camera, b: &Camera| -> Vec<i64> {
        a.images
            .keys()
            .filter(|stamp| !b.images.contains_key(stamp))
            .copied()
            .collect()
    };
    let (left_only, right_only) = (only(left, right), only(right, left));
    if let Some(first) = left_only
        .first()
        .into_iter()
        .chain(right_only.first())
        .min()
    {
        return Err(DatasetError::Unpaired {
            left_only: left_only.len(),
            right_only: right_only.len(),
            first: format!("{first} ns"),
            left: left.folder.clone(),
            right: right.folder.clone(),
        });
    }
    let both = left.images.iter().zip(right.images.values());
    Ok(both
        .map(|((stamp, (row, left)), (_, right))| StereoFrameRef {
            number: *row,
            device_time_ns: *stamp,
            left: left.clone(),
            right: right.clone(),
        })
        .collect())
}

/// The samples, and whether the list continues.
fn read_imu(list: &Path, extent: Extent) -> Result<(Vec<ImuSample>, bool), DatasetError> {
    let text = Text::read(list, extent)?;
    let mut samples = Vec::new();
    let mut last_ns = None;
    for line in text.lines() {
        let [stamp, wx, wy, wz, ax, ay, az] =
            line.fields("timestamp_ns, three angular rates in rad/s, three accelerations in m/s²")?;
        let device_time_ns = line.stamp_ns(stamp)?;
        check_rising(&mut last_ns, device_time_ns, &line)?;
        samples.push(ImuSample {
            device_time_ns,
            gyro_rad_s: [line.number(wx)?, line.number(wy)?, line.number(wz)?],
            accel_m_s2: [line.number(ax)?, line.number(ay)?, line.number(az)?],
        });
    }
    Ok((samples, text.is_head))
}
