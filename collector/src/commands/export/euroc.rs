//! ASL folders as in EuRoC (Burri et al. 2016), one per camera, as readers of such data sets
//! expect: `CAMERA/mav0/{cam0,cam1,imu0}`, `cam0` being the left eye.
//!
//! Image names are times, host-clock ns. The body frame is the camera's IMU if its extrinsics are
//! known, else the left eye. A camera without chroma gives 8-bit gray images, others 8-bit RGB.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::thread;

use anyhow::{Context, Result};
use console_output::{Console, Outcome, text};
use session_access::decode::visit_images;
use session_access::{Frames, read_or_build};
use session_archive::index::{Access, CameraIndex, FrameEntry, Index};
use session_archive::manifest::{Camera, Imu};
use session_archive::reader::SessionReader;
use session_input::imu::complete_samples;
use video::RawImage;
use video::raw_image::{i420_to_grey, i420_to_rgb, split};

use super::common::{damage, file_name};
use super::yaml;
use crate::session_stats::SessionStats;

const EYES: [(&str, &str); 2] = [("cam0", "left"), ("cam1", "right")];

pub(super) fn export(
    reader: &SessionReader,
    out: &Path,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let index = read_or_build(reader, console)?;
    let access = Access::open(&**reader.storage(), &index).context("opening the segments")?;
    let stats = SessionStats::gather(reader, |_| {})?;
    let transforms = stats.transforms.clone().unwrap_or_default();
    let export = Export {
        reader,
        index: &index,
        access: &access,
        stats: &stats,
        frames: Frames::of(&transforms),
        out,
    };
    let manifest = reader.manifest();
    let mut outcome = Outcome::Fine;
    for (camera, frames) in manifest.cameras.iter().zip(&index.cameras) {
        outcome = outcome.max(export.camera(camera, frames, console)?);
    }
    for imu in &manifest.imus {
        export.imu(imu, console)?;
    }
    Ok(outcome.max(damage(&index, console)?))
}

struct Export<'a> {
    reader: &'a SessionReader,
    index: &'a Index,
    access: &'a Access,
    stats: &'a SessionStats,
    frames: Frames,
    out: &'a Path,
}

impl Export<'_> {
    /// `OUT/CAMERA/mav0`, which an IMU shares with the camera that it is in.
    fn folder(&self, stream: &str) -> PathBuf {
        let camera = stream.strip_suffix("/imu").unwrap_or(stream);
        self.out.join(file_name(camera)).join("mav0")
    }

    /// The body frame of a camera's data set.
    fn body(&self, camera: &str) -> String {
        let (imu, left) = (format!("{camera}/imu"), format!("{camera}/left"));
        let manifest = self.reader.manifest();
        let there = manifest.imus.iter().any(|i| i.name == imu);
        if there && self.frames.transform(&imu, &left).is_some() {
            imu
        } else {
            left
        }
    }

    fn camera(
        &self,
        camera: &Camera,
        frames: &CameraIndex,
        console: &mut Console<'_>,
    ) -> Result<Outcome> {
        let folder = self.folder(&camera.name);
        let body = self.body(&camera.name);
        let mut unknown = Vec::new();
        for (cam, eye) in EYES {
            let folder = folder.join(cam);
            fs::create_dir_all(folder.join("data"))
                .with_context(|| format!("making {}", folder.display()))?;
            let frame = format!("{}/{eye}", camera.name);
            let calibration = self.stats.calibrations.get(&frame);
            let body_from_eye = self.frames.transform(&body, &frame);
            if calibration.is_none() || body_from_eye.is_none() {
                unknown.push(eye);
            }
            let text = yaml::camera(camera, &frame, &body, calibration, body_from_eye.as_ref());
            write(&folder.join("sensor.yaml"), &text)?;
        }

        // Two frames of one time would have the same name.
        let mut times: Vec<i64> = frames.frames.iter().map(|f| f.time_ns).collect();
        times.sort_unstable();
        let same = times.windows(2).filter(|w| w[0] == w[1]).count();
        let bytes = frames.frames.iter().map(|f| u64::from(f.bytes)).sum();
        let threads = thread::available_parallelism().map_or(1, usize::from);
        let decoded = {
            let progress = console.progress(&camera.name, bytes);
            let color = camera.colour != "grey";
            let save = |frame: &FrameEntry, image: &RawImage| save(&folder, frame, image, color);
            visit_images(camera, frames, self.access, threads, &progress, &save)?
        };
        for (cam, _) in EYES {
            let folder = folder.join(cam);
            let mut list = "#timestamp [ns],filename\n".to_owned();
            let mut listed = BTreeSet::new();
            for frame in &frames.frames {
                let name = image_name(frame);
                // An image that was not decoded has no file.
                if folder.join("data").join(&name).is_file() && listed.insert(frame.time_ns) {
                    list.push_str(&format!("{},{name}\n", frame.time_ns));
                }
            }
            write(&folder.join("data.csv"), &list)?;
        }

        let mut line = format!(
            "{}: {} left and right in {}",
            camera.name,
            text::count(decoded.images, "image"),
            folder.display()
        );
        let mut outcome = Outcome::Fine;
        if decoded.missing > 0 || same > 0 {
            let not_exported = decoded.missing + same as u64;
            line.push_str(&format!("; {not_exported} not exported"));
            if let Some(problem) = decoded.first_problem {
                line.push_str(&format!(" ({problem})"));
            }
            outcome = Outcome::Loss;
        }
        if !unknown.is_empty() {
            let eyes = unknown.join(" and ");
            line.push_str(&format!("; without intrinsics or extrinsics: {eyes}"));
        }
        console.line(line)?;
        Ok(outcome)
    }

    fn imu(&self, imu: &Imu, console: &mut Console<'_>) -> Result<()> {
        let folder = self.folder(&imu.name).join("imu0");
        fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
        let body = imu
            .name
            .strip_suffix("/imu")
            .map(|camera| self.body(camera));
        let body = body.unwrap_or_else(|| imu.name.clone());
        let body_from_imu = self.frames.transform(&body, &imu.name);
        write(
            &folder.join("sensor.yaml"),
            &yaml::imu(imu, &body, body_from_imu.as_ref()),
        )?;
        let path = folder.join("data.csv");
        let writing = || format!("writing {}", path.display());
        let mut out = BufWriter::new(File::create(&path).with_context(writing)?);
        writeln!(
            out,
            "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
             a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
        )
        .with_context(writing)?;
        let mut rows = 0;
        let batches = self.index.imu(&imu.name).map_or(&[][..], |i| &i.batches);
        for batch in batches {
            let batch = self.access.batch(batch)?;
            for (_, sample) in complete_samples(&batch) {
                let ([gx, gy, gz], [ax, ay, az]) = (sample.gyro_rad_s, sample.accel_m_s2);
                writeln!(out, "{},{gx},{gy},{gz},{ax},{ay},{az}", sample.time_ns)
                    .with_context(writing)?;
                rows += 1;
            }
        }
        out.flush().with_context(writing)?;
        let samples = text::count(rows, "sample");
        console.line(format!("{}: {samples} in {}", imu.name, path.display()))?;
        Ok(())
    }
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

fn image_name(frame: &FrameEntry) -> String {
    format!("{}.png", frame.time_ns)
}

/// Writes both halves of a side-by-side image as PNG.
fn save(folder: &Path, frame: &FrameEntry, image: &RawImage, color: bool) -> Result<()> {
    let (left, right) = split(image)?;
    for ((cam, _), half) in EYES.into_iter().zip([left, right]) {
        let path = folder.join(cam).join("data").join(image_name(frame));
        let writing = || format!("writing {}", path.display());
        let (pixels, kind) = if color {
            (i420_to_rgb(&half)?.into(), png::ColorType::Rgb)
        } else {
            (i420_to_grey(&half)?.data, png::ColorType::Grayscale)
        };
        let file = BufWriter::new(File::create(&path).with_context(writing)?);
        let mut encoder = png::Encoder::new(file, half.width, half.height);
        encoder.set_color(kind);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header().with_context(writing)?;
        writer.write_image_data(&pixels).with_context(writing)?;
        writer.finish().with_context(writing)?;
    }
    Ok(())
}
