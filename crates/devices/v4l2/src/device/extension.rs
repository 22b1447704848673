//! Extension units of USB cameras: what a vendor has put beside the standard, as bytes. Never run
//! on a camera: the kernel's test drivers have none.

use rustix::io::Errno;

use super::{Camera, CameraError};
use crate::sys;

/// Requests of the USB Video Class 1.5, table A-8.
const SET_CUR: u8 = 0x01;
const GET_CUR: u8 = 0x81;
const GET_LEN: u8 = 0x85;

impl Camera {
    /// Length of a control of an extension unit, bytes.
    ///
    /// # Errors
    /// [`NotACamera`](CameraError::NotACamera) when the driver or the camera has no such unit or
    /// control, [`Gone`](CameraError::Gone) or [`Io`](CameraError::Io).
    pub fn extension_length(&self, unit: u8, selector: u8) -> Result<usize, CameraError> {
        let mut length = [0; 2];
        self.extension(unit, selector, GET_LEN, &mut length)?;
        Ok(usize::from(u16::from_le_bytes(length)))
    }

    /// Reads a control of an extension unit, as long as the camera says that it is.
    ///
    /// # Errors
    /// See [`extension_length`](Self::extension_length).
    pub fn extension_get(&self, unit: u8, selector: u8) -> Result<Vec<u8>, CameraError> {
        let mut data = vec![0; self.extension_length(unit, selector)?];
        self.extension(unit, selector, GET_CUR, &mut data)?;
        Ok(data)
    }

    /// Writes a control of an extension unit.
    ///
    /// # Errors
    /// See [`extension_length`](Self::extension_length); [`Io`](CameraError::Io) also when `data`
    /// is not exactly as long as the control.
    pub fn extension_set(&self, unit: u8, selector: u8, data: &[u8]) -> Result<(), CameraError> {
        // The kernel takes a pointer that it may write to.
        self.extension(unit, selector, SET_CUR, &mut data.to_vec())
    }

    fn extension(
        &self,
        unit: u8,
        selector: u8,
        query: u8,
        data: &mut [u8],
    ) -> Result<(), CameraError> {
        let what = || format!("control {selector:#04x} of extension unit {unit:#04x}");
        let path = || self.path().to_owned();
        sys::extension(self.fd(), unit, selector, query, data).map_err(|errno| match errno {
            Errno::NOTTY | Errno::NOENT => CameraError::NotACamera {
                why: format!("{} has no {}", self.capability().card, what()),
                path: path(),
            },
            Errno::NODEV | Errno::NXIO => CameraError::Gone { path: path() },
            _ => CameraError::Io {
                doing: format!(
                    "{} {} with {} bytes",
                    if query == SET_CUR {
                        "writing"
                    } else {
                        "reading"
                    },
                    what(),
                    data.len()
                ),
                path: path(),
                source: errno.into(),
            },
        })
    }
}
