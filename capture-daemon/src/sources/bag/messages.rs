//! Parsers of the three supported messages of `sensor_msgs`. Pure.
//!
//! The layouts are those of the package's `.msg` files: `Image`, `CompressedImage`, `Imu`, each
//! behind a `std_msgs/Header`.

use super::cdr::{CdrError, Reader};

/// Type of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Image,
    CompressedImage,
    Imu,
}

impl Kind {
    /// By the name of the schema, with or without `msg/`.
    pub(super) fn of(schema: &str) -> Option<Self> {
        match schema {
            "sensor_msgs/msg/Image" | "sensor_msgs/Image" => Some(Self::Image),
            "sensor_msgs/msg/CompressedImage" | "sensor_msgs/CompressedImage" => {
                Some(Self::CompressedImage)
            }
            "sensor_msgs/msg/Imu" | "sensor_msgs/Imu" => Some(Self::Imu),
            _ => None,
        }
    }

    pub(super) fn is_image(self) -> bool {
        self != Self::Imu
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Image => "sensor_msgs/Image",
            Self::CompressedImage => "sensor_msgs/CompressedImage",
            Self::Imu => "sensor_msgs/Imu",
        }
    }
}

/// An uncompressed image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Image<'a> {
    pub(super) height: u32,
    pub(super) width: u32,
    pub(super) encoding: &'a str,
    /// Bytes of a row.
    pub(super) step: u32,
    pub(super) data: &'a [u8],
}

/// An image as a compressed file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CompressedImage<'a> {
    /// The publisher's format text, `jpeg` or `rgb8; jpeg compressed bgr8` for example.
    pub(super) format: &'a str,
    pub(super) data: &'a [u8],
}

/// A measurement, rad/s and m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Imu {
    pub(super) gyro_rad_s: [f64; 3],
    pub(super) accel_m_s2: [f64; 3],
}

/// The time in a message's header, ns; `None` if it was never set.
pub(super) fn stamp(message: &[u8]) -> Result<Option<i64>, CdrError> {
    header(&mut Reader::new(message)?)
}

pub(super) fn image(message: &[u8]) -> Result<Image<'_>, CdrError> {
    let mut reader = Reader::new(message)?;
    header(&mut reader)?;
    let (height, width) = (reader.u32()?, reader.u32()?);
    let encoding = reader.text()?;
    reader.u8()?;
    Ok(Image {
        height,
        width,
        encoding,
        step: reader.u32()?,
        data: reader.bytes()?,
    })
}

pub(super) fn compressed_image(message: &[u8]) -> Result<CompressedImage<'_>, CdrError> {
    let mut reader = Reader::new(message)?;
    header(&mut reader)?;
    Ok(CompressedImage {
        format: reader.text()?,
        data: reader.bytes()?,
    })
}

pub(super) fn imu(message: &[u8]) -> Result<Imu, CdrError> {
    let mut reader = Reader::new(message)?;
    header(&mut reader)?;
    // Orientation and its covariance.
    reader.f64s::<13>()?;
    let gyro_rad_s = reader.f64s()?;
    let gyro_covariance = reader.f64s::<9>()?;
    let accel_m_s2 = reader.f64s()?;
    let accel_covariance = reader.f64s::<9>()?;
    // By the message's own definition.
    if gyro_covariance[0] == -1.0 || accel_covariance[0] == -1.0 {
        return Err(CdrError::Value(
            "it says that it has no rates or accelerations",
        ));
    }
    if !gyro_rad_s
        .iter()
        .chain(&accel_m_s2)
        .all(|v: &f64| v.is_finite())
    {
        return Err(CdrError::Value(
            "its rates and accelerations are no numbers",
        ));
    }
    Ok(Imu {
        gyro_rad_s,
        accel_m_s2,
    })
}

fn header(reader: &mut Reader<'_>) -> Result<Option<i64>, CdrError> {
    let (seconds, ns) = (reader.i32()?, reader.u32()?);
    reader.text()?;
    if ns >= 1_000_000_000 {
        return Err(CdrError::Value(
            "its time has a second or more of nanoseconds",
        ));
    }
    let time = i64::from(seconds) * 1_000_000_000 + i64::from(ns);
    Ok((time != 0).then_some(time))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Bytes as written by `ros2 bag record`, composed by hand from the layout.
    fn image_bytes() -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend(5_i32.to_le_bytes());
        bytes.extend(7_u32.to_le_bytes());
        bytes.extend(4_u32.to_le_bytes());
        bytes.extend(b"cam\0");
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend(6_u32.to_le_bytes());
        bytes.extend(b"mono8\0");
        // is_bigendian, then padding to a multiple of four.
        bytes.extend([0, 0xee]);
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend([10, 20]);
        bytes
    }

    fn imu_bytes(gyro_covariance: f64) -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend((-1_i32).to_le_bytes());
        bytes.extend(500_000_000_u32.to_le_bytes());
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend([0, 0xee, 0xee, 0xee]);
        let mut values = [0.0; 37];
        values[13..16].copy_from_slice(&[0.1, 0.2, 0.3]);
        values[16] = gyro_covariance;
        values[25..28].copy_from_slice(&[1.0, 2.0, 9.8]);
        bytes.extend(values.iter().flat_map(|v: &f64| v.to_le_bytes()));
        bytes
    }

    #[test]
    fn message_layouts_match_sensor_msgs() {
        let bytes = image_bytes();
        assert_eq!(stamp(&bytes), Ok(Some(5_000_000_007)));
        let expected = Image {
            height: 1,
            width: 2,
            encoding: "mono8",
            step: 2,
            data: &[10, 20],
        };
        assert_eq!(image(&bytes), Ok(expected));
        let bytes = imu_bytes(0.0);
        assert_eq!(stamp(&bytes), Ok(Some(-500_000_000)));
        let expected = Imu {
            gyro_rad_s: [0.1, 0.2, 0.3],
            accel_m_s2: [1.0, 2.0, 9.8],
        };
        assert_eq!(imu(&bytes), Ok(expected));
    }

    #[test]
    fn absent_values_are_errors() {
        let mut bytes = image_bytes();
        bytes[4..12].fill(0);
        assert_eq!(stamp(&bytes), Ok(None));
        assert!(matches!(imu(&imu_bytes(-1.0)), Err(CdrError::Value(_))));
        assert!(imu(&imu_bytes(f64::NAN)).is_ok());
        let whole = image_bytes();
        for length in 0..whole.len() {
            assert!(image(&whole[..length]).is_err(), "{length}");
        }
    }

    proptest! {
        /// Arbitrary bytes give a message or an error, and returned slices are within the input.
        #[test]
        fn never_panics_on_arbitrary_bytes(mut bytes in prop::collection::vec(any::<u8>(), 0..400), plain: bool) {
            if let (true, [a, b, ..]) = (plain, &mut bytes[..]) {
                (*a, *b) = (0, 1);
            }
            let _ = (stamp(&bytes), imu(&bytes), compressed_image(&bytes));
            if let Ok(image) = image(&bytes) {
                prop_assert!(image.data.len() < bytes.len());
            }
        }

        #[test]
        fn never_panics_on_damaged_messages(at in 0_usize..60, value: u8) {
            let mut bytes = image_bytes();
            let at = at % bytes.len();
            bytes[at] = value;
            let _ = (stamp(&bytes), image(&bytes), compressed_image(&bytes), imu(&bytes));
        }
    }
}
