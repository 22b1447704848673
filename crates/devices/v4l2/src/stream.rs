//! A capture stream: frames as the driver wrote them into buffers that are mapped here.
//!
//! [`Stream::next`] waits for the next frame and for no longer than its time limit. The frame
//! remains in the driver's buffer and is lent out; when it is dropped, the buffer is queued again,
//! exactly once. While one is held the others fill, and when none is left the driver drops frames:
//! the sequence number shows how many ([`Sequence`]).
//!
//! - *Late*: nothing waits for a frame that is held; take it, use it, drop it.
//! - *Gap*: the driver's sequence number goes on. A USB camera's driver drops damaged frames by
//!   itself, and these show in the same way.
//! - *Damage*: a frame that the driver calls damaged, or that is shorter than a whole frame, is
//!   delivered and says so.
//! - *Failure*: [`StreamError::Interrupted`] means that the driver has stopped the stream;
//!   [`Stream::restart`] begins it again. [`StreamError::Gone`] is final: drop the stream *and* the
//!   camera, and open it when it is back.
//! - *End*: dropping the stream stops it, unmaps and gives back its buffers; the camera can then be
//!   set to another mode, without being opened again.

use std::fmt;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use rustix::io::Errno;

use crate::device::{Camera, CameraError};
use crate::mode::Format;
use crate::sys;
use crate::wait::{self, Remaining};

mod frame;
mod map;
mod sequence;

pub use frame::{Clock, FrameInfo, TimestampSource};
pub use sequence::{Sequence, Step};

use map::Map;

/// A running capture.
#[derive(Debug)]
pub struct Stream {
    camera: Camera,
    format: Format,
    maps: Vec<Map>,
    /// A buffer that could not be queued again.
    not_queued: Option<Errno>,
}

/// What came within the time limit.
#[derive(Debug)]
pub enum Next<'a> {
    /// A frame.
    Frame(Buffer<'a>),
    /// No frame.
    Nothing,
}

/// A frame in the driver's buffer, which is queued again when this is dropped.
pub struct Buffer<'a> {
    stream: &'a mut Stream,
    index: u32,
    info: FrameInfo,
}

/// Why no frame came.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// The camera was unplugged. Drop stream and camera, wait for its return
    /// (see [`hotplug`](crate::hotplug)), open it again.
    #[error("the camera is disconnected: {}", path.display())]
    Gone {
        /// The node.
        path: PathBuf,
    },
    /// The driver has stopped the stream after a failure. [`Stream::restart`] begins it again;
    /// sequence numbers then begin again, too.
    #[error("the driver has stopped the stream after a failure: {}", path.display())]
    Interrupted {
        /// The node.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Something else failed. A new stream can be tried.
    #[error("waiting for a frame: {}", path.display())]
    Io {
        /// The node.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

impl Stream {
    /// Starts capturing in the mode that the camera is set to, with `buffers` buffers or the number
    /// that the driver gives (see [`buffers`](Self::buffers)).
    ///
    /// # Errors
    /// [`Busy`](CameraError::Busy) when anyone streams from it, this program included;
    /// [`NoBandwidth`](CameraError::NoBandwidth), [`Gone`](CameraError::Gone), or
    /// [`Io`](CameraError::Io).
    pub fn start(camera: &Camera, buffers: u32) -> Result<Self, CameraError> {
        let format = camera.format()?;
        let given = request(camera, buffers.max(1))?;
        // Dropping this gives the buffers back, so it must not exist before they are ours: they may
        // be those of another stream of this camera.
        let mut stream = Self {
            camera: camera.clone(),
            format,
            maps: Vec::new(),
            not_queued: None,
        };
        for index in 0..given {
            let mut descriptor = buffer(index);
            sys::query_buffer(stream.camera.fd(), &mut descriptor)
                .map_err(|e| stream.failed("asking for a buffer's place", e))?;
            let map = Map::new(stream.camera.fd(), descriptor.offset, descriptor.length)
                .map_err(|e| stream.failed("mapping a buffer", e))?;
            stream.maps.push(map);
        }
        stream.begin()?;
        Ok(stream)
    }

    /// The next frame, or nothing once `timeout` is over. Never blocks for longer; signals do not
    /// shorten the wait.
    ///
    /// # Errors
    /// See [`StreamError`].
    pub fn next(&mut self, timeout: Duration) -> Result<Next<'_>, StreamError> {
        if let Some(errno) = self.not_queued.take() {
            return Err(self.broken(errno));
        }
        let mut remaining = Remaining::new(timeout);
        let descriptor = loop {
            let waited = wait::readable(self.camera.fd(), &mut remaining);
            let Some(ready) = waited.map_err(|e| self.broken(e))? else {
                return Ok(Next::Nothing);
            };
            if ready.hang_up {
                return Err(self.broken(Errno::NODEV));
            }
            let mut descriptor = buffer(0);
            match sys::dequeue(self.camera.fd(), &mut descriptor) {
                Ok(()) => break descriptor,
                // Nothing to wait for, and nothing there.
                Err(Errno::AGAIN) if ready.error => return Err(self.broken(Errno::PIPE)),
                Err(Errno::AGAIN) => {}
                Err(errno) => return Err(self.broken(errno)),
            }
        };
        let Some(map) = self.maps.get(descriptor.index as usize) else {
            return Err(self.broken(Errno::BADMSG));
        };
        let info = FrameInfo::of(&descriptor, map.len(), self.format.image_bytes());
        Ok(Next::Frame(Buffer {
            index: descriptor.index,
            info,
            stream: self,
        }))
    }

    /// Begins again after [`StreamError::Interrupted`], in the same mode and with the same buffers.
    /// Frames that were waiting are lost; sequence numbers begin again.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn restart(&mut self) -> Result<(), CameraError> {
        self.not_queued = None;
        self.end()
            .map_err(|e| self.failed("stopping the stream", e))?;
        self.begin()
    }

    /// Buffers that the driver has given.
    pub fn buffers(&self) -> usize {
        self.maps.len()
    }

    /// What the frames are.
    pub fn format(&self) -> &Format {
        &self.format
    }

    /// The camera, for its controls.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    fn begin(&mut self) -> Result<(), CameraError> {
        for index in 0..self.maps.len() as u32 {
            self.queue(index)
                .map_err(|e| self.failed("queueing a buffer", e))?;
        }
        sys::stream_on(self.camera.fd(), &mut { sys::CAPTURE }).map_err(|errno| match errno {
            // What the USB core says when no periodic transfer of that size fits.
            Errno::NOSPC => CameraError::NoBandwidth {
                path: self.camera.path().to_owned(),
            },
            _ => self.failed("starting the stream", errno),
        })
    }

    /// The driver lets go of all buffers.
    fn end(&self) -> Result<(), Errno> {
        sys::stream_off(self.camera.fd(), &mut { sys::CAPTURE })
    }

    fn queue(&self, index: u32) -> Result<(), Errno> {
        sys::queue(self.camera.fd(), &mut buffer(index))
    }

    fn failed(&self, doing: &'static str, errno: Errno) -> CameraError {
        CameraError::of(doing, errno, self.camera.path())
    }

    fn broken(&self, errno: Errno) -> StreamError {
        let path = self.camera.path().to_owned();
        let source = errno.into();
        match errno {
            Errno::NODEV | Errno::NXIO => StreamError::Gone { path },
            // `EIO` is how videobuf2 says that its queue has failed, until it is stopped; `EPIPE`
            // that there will be no more buffers; `EINVAL` that it does not stream.
            Errno::IO | Errno::PIPE | Errno::INVAL => StreamError::Interrupted { path, source },
            _ => StreamError::Io { path, source },
        }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let ended = self.end();
        // A buffer that is mapped cannot be given back.
        self.maps.clear();
        let given_back = request(&self.camera, 0);
        if let (Err(error), _) | (Ok(()), Err(CameraError::Io { source: error, .. })) =
            (ended.map_err(io::Error::from), given_back)
        {
            log::debug!(
                "ending a stream of {}: {error}",
                self.camera.path().display()
            );
        }
    }
}

impl Buffer<'_> {
    /// What the driver says of the frame.
    pub fn info(&self) -> &FrameInfo {
        &self.info
    }

    /// The frame, as far as the driver has written it.
    pub fn bytes(&self) -> &[u8] {
        &self.stream.maps[self.index as usize].bytes()[..self.info.bytes_used]
    }
}

impl fmt::Debug for Buffer<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Buffer")
            .field("index", &self.index)
            .field("info", &self.info)
            .finish_non_exhaustive()
    }
}

impl Drop for Buffer<'_> {
    fn drop(&mut self) {
        // Reported by the next call of `next`: `drop` cannot return an error.
        self.stream.not_queued = self.stream.queue(self.index).err();
    }
}

/// Requests buffers, 0 to release them; returns the number granted.
fn request(camera: &Camera, count: u32) -> Result<u32, CameraError> {
    let mut request = sys::RequestBuffers {
        count,
        kind: sys::CAPTURE,
        memory: sys::MMAP,
        ..Default::default()
    };
    sys::request_buffers(camera.fd(), &mut request)
        .map_err(|e| CameraError::of("asking for buffers", e, camera.path()))?;
    Ok(request.count)
}

/// A mapped capture buffer, as the calls expect it.
fn buffer(index: u32) -> sys::Buffer {
    sys::Buffer {
        index,
        kind: sys::CAPTURE,
        memory: sys::MMAP,
        ..Default::default()
    }
}
