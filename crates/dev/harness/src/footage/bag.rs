//! A walk as a rosbag2 recording: MCAP by the `mcap` crate, messages in plain CDR.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Result;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use super::Footage;

/// Begin of the walk, ns since 1970, as a camera driver would stamp it.
pub const BEGAN_NS: i64 = 1_700_000_000_123_456_789;

/// Encoding of the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Images {
    /// `sensor_msgs/Image`, `rgb8`, rows padded to a multiple of 64.
    Rgb,
    /// `sensor_msgs/Image`, `bgr8`.
    Bgr,
    /// `sensor_msgs/Image`, `mono8`.
    Mono,
    /// `sensor_msgs/CompressedImage`, JPEG files.
    Jpeg,
}

/// Writes the walk: topics `/left/image`, `/right/image` and `/imu`. Right timestamps are
/// `apart_ns` later than left ones.
///
/// # Errors
/// It cannot be written.
pub fn write(footage: &Footage, images: Images, apart_ns: i64, path: &Path) -> Result<()> {
    let options = WriteOptions::new().compression(None).profile("ros2");
    let mut writer = Writer::with_options(BufWriter::new(File::create(path)?), options)?;
    let mut channel = |topic: &str, schema: &str| -> Result<u16> {
        let schema = writer.add_schema(schema, "ros2msg", b"")?;
        Ok(writer.add_channel(schema, topic, "cdr", &BTreeMap::new())?)
    };
    let schema = match images {
        Images::Jpeg => "sensor_msgs/msg/CompressedImage",
        _ => "sensor_msgs/msg/Image",
    };
    let eyes = [
        channel("/left/image", schema)?,
        channel("/right/image", schema)?,
    ];
    let imu = channel("/imu", "sensor_msgs/msg/Imu")?;

    // By time of measurement, samples first.
    let mut messages: Vec<(i64, u16, Vec<u8>)> = Vec::new();
    for (time, gyro, accel) in &footage.samples {
        messages.push((*time, imu, sample(BEGAN_NS + time, gyro, accel)));
    }
    for (n, frame) in footage.frames.iter().enumerate() {
        for (eye, channel) in eyes.into_iter().enumerate() {
            let time = frame.time_ns + apart_ns * eye as i64;
            let data = image(footage, images, n, eye, BEGAN_NS + time)?;
            messages.push((time, channel, data));
        }
    }
    messages.sort_by_key(|(time, ..)| *time);
    for (sequence, (time, channel_id, data)) in (0..).zip(messages) {
        let log_time = (BEGAN_NS + time + 3_000_000) as u64;
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time: log_time,
        };
        writer.write_to_known_channel(&header, &data)?;
    }
    writer.finish()?;
    Ok(())
}

fn image(
    footage: &Footage,
    images: Images,
    n: usize,
    eye: usize,
    stamp_ns: i64,
) -> Result<Vec<u8>> {
    let [width, height] = footage.eye();
    let mut message = header(stamp_ns);
    let rgb = footage.rgb(n, eye)?;
    if images == Images::Jpeg {
        let mut file = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut file, 95);
        let size = (u16::try_from(width)?, u16::try_from(height)?);
        encoder.encode(&rgb, size.0, size.1, jpeg_encoder::ColorType::Rgb)?;
        text(&mut message, "rgb8; jpeg compressed bgr8");
        bytes(&mut message, &file);
        return Ok(message);
    }
    let (encoding, samples, pixels) = match images {
        Images::Mono => {
            let eye = footage.one_eye(n, eye)?;
            ("mono8", 1, eye.luma()?.to_vec())
        }
        Images::Bgr => {
            let pixels = rgb.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]);
            ("bgr8", 3, pixels.collect())
        }
        _ => ("rgb8", 3, rgb),
    };
    let row = samples * width as usize;
    let step = match images {
        Images::Rgb => row.next_multiple_of(64),
        _ => row,
    };
    let mut padded = Vec::with_capacity(step * height as usize);
    for pixels in pixels.chunks_exact(row) {
        padded.extend_from_slice(pixels);
        padded.resize(padded.len() + step - row, 0xee);
    }
    number(&mut message, &height.to_le_bytes());
    number(&mut message, &width.to_le_bytes());
    text(&mut message, encoding);
    number(&mut message, &[0]);
    number(&mut message, &u32::try_from(step)?.to_le_bytes());
    bytes(&mut message, &padded);
    Ok(message)
}

fn sample(stamp_ns: i64, gyro: &[f64; 3], accel: &[f64; 3]) -> Vec<u8> {
    let mut message = header(stamp_ns);
    // No orientation, as defined by the message.
    let orientation = [
        0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    ];
    let covariance = [0.0; 9];
    for part in [&orientation[..], gyro, &covariance, accel, &covariance] {
        for value in part {
            number(&mut message, &value.to_le_bytes());
        }
    }
    message
}

/// The CDR representation, and a header.
fn header(stamp_ns: i64) -> Vec<u8> {
    let mut message = vec![0, 1, 0, 0];
    let seconds = stamp_ns.div_euclid(1_000_000_000) as i32;
    let ns = stamp_ns.rem_euclid(1_000_000_000) as u32;
    number(&mut message, &seconds.to_le_bytes());
    number(&mut message, &ns.to_le_bytes());
    text(&mut message, "camera_optical_frame");
    message
}

/// A number, aligned to its size after the representation.
fn number(message: &mut Vec<u8>, value: &[u8]) {
    let at = message.len() - 4;
    message.resize(4 + at.next_multiple_of(value.len()), 0);
    message.extend_from_slice(value);
}

fn text(message: &mut Vec<u8>, text: &str) {
    number(message, &(text.len() as u32 + 1).to_le_bytes());
    message.extend_from_slice(text.as_bytes());
    message.push(0);
}

fn bytes(message: &mut Vec<u8>, data: &[u8]) {
    number(message, &(data.len() as u32).to_le_bytes());
    message.extend_from_slice(data);
}
