//! Messages to a device-mapper device, without starting `dmsetup` for each.
//!
//! Layout: `struct dm_ioctl` and `struct dm_target_msg` of include/uapi/linux/dm-ioctl.h.

use std::fs::File;
use std::io;
use std::os::fd::AsRawFd as _;

/// `_IOWR(0xfd, 14, struct dm_ioctl)`.
const DM_TARGET_MSG: libc::Ioctl = 0xc138_fd0e;
/// Bytes of `struct dm_ioctl`.
const HEAD: usize = 312;
/// Where it keeps the name, and for how many bytes.
const NAME: std::ops::Range<usize> = 48..176;

/// A device of the device mapper.
#[derive(Debug)]
pub struct Device {
    control: File,
    name: String,
}

impl Device {
    /// The device with this name.
    ///
    /// # Errors
    /// The name is too long, or the device mapper cannot be opened.
    pub fn open(name: &str) -> io::Result<Self> {
        if name.len() >= NAME.len() {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!(
                    "a device's name of {} bytes, expected less than {}",
                    name.len(),
                    NAME.len()
                ),
            ));
        }
        let control = File::options()
            .read(true)
            .write(true)
            .open("/dev/mapper/control")?;
        Ok(Self {
            control,
            name: name.to_owned(),
        })
    }

    /// Sends a message: words with blanks between.
    ///
    /// # Errors
    /// The device is not there, or does not understand it.
    pub fn send(&self, message: &str) -> io::Result<()> {
        let mut request = request(&self.name, message);
        // SAFETY: the request is as long as it says at its byte 12, and the kernel writes no
        // further.
        let done = unsafe {
            libc::ioctl(
                self.control.as_raw_fd(),
                DM_TARGET_MSG,
                request.as_mut_ptr(),
            )
        };
        if done < 0 {
            return Err(io::Error::last_os_error());
        }
        Ok(())
    }
}

fn request(name: &str, message: &str) -> Vec<u8> {
    // The number of a sector, then the message and a zero.
    let length = HEAD + 8 + message.len() + 1;
    let mut bytes = vec![0; length];
    bytes[0..4].copy_from_slice(&4u32.to_ne_bytes());
    bytes[12..16].copy_from_slice(&(length as u32).to_ne_bytes());
    bytes[16..20].copy_from_slice(&(HEAD as u32).to_ne_bytes());
    bytes[NAME.start..NAME.start + name.len()].copy_from_slice(name.as_bytes());
    bytes[HEAD + 8..length - 1].copy_from_slice(message.as_bytes());
    bytes
}
