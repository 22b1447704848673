//! The kernel's structures and calls, as in `linux/videodev2.h` and `linux/uvcvideo.h` (Linux 6.1).
//!
//! Unions are laid out as the one member that is used here, padded to the kernel's size. Every size
//! and call number is asserted at compile time against the numbers that a C compiler gives for the
//! headers.

use std::os::fd::BorrowedFd;

use rustix::io::{Errno, retry_on_intr};
use rustix::ioctl::{Opcode, Updater, opcode};

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`: single-planar capture.
pub(crate) const CAPTURE: u32 = 1;
/// `V4L2_MEMORY_MMAP`.
pub(crate) const MMAP: u32 = 1;
/// `V4L2_FIELD_NONE`: progressive.
pub(crate) const PROGRESSIVE: u32 = 1;

/// `V4L2_CAP_VIDEO_CAPTURE`.
pub(crate) const CAP_CAPTURE: u32 = 0x1;
/// `V4L2_CAP_VIDEO_CAPTURE_MPLANE`.
pub(crate) const CAP_CAPTURE_MPLANE: u32 = 0x1000;
/// `V4L2_CAP_STREAMING`.
pub(crate) const CAP_STREAMING: u32 = 0x0400_0000;
/// `V4L2_CAP_DEVICE_CAPS`: `device_caps` is filled in.
pub(crate) const CAP_DEVICE_CAPS: u32 = 0x8000_0000;

/// `V4L2_FMT_FLAG_COMPRESSED`.
pub(crate) const FORMAT_COMPRESSED: u32 = 0x1;
/// `V4L2_FMT_FLAG_EMULATED`.
pub(crate) const FORMAT_EMULATED: u32 = 0x2;
/// Discrete value of `v4l2_frmsizetypes` and `v4l2_frmivaltypes`.
pub(crate) const DISCRETE: u32 = 1;
/// `V4L2_CAP_TIMEPERFRAME`: the rate can be set.
pub(crate) const PARM_TIME_PER_FRAME: u32 = 0x1000;

/// `V4L2_CTRL_FLAG_NEXT_CTRL`.
pub(crate) const NEXT_CONTROL: u32 = 0x8000_0000;
/// `V4L2_CTRL_WHICH_CUR_VAL`.
pub(crate) const CURRENT_VALUE: u32 = 0;

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct Capability {
    pub(crate) driver: [u8; 16],
    pub(crate) card: [u8; 32],
    pub(crate) bus_info: [u8; 32],
    pub(crate) version: u32,
    pub(crate) capabilities: u32,
    pub(crate) device_caps: u32,
    pub(crate) reserved: [u32; 3],
}

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct FormatDescription {
    pub(crate) index: u32,
    pub(crate) kind: u32,
    pub(crate) flags: u32,
    pub(crate) description: [u8; 32],
    pub(crate) pixel_format: u32,
    pub(crate) mbus_code: u32,
    pub(crate) reserved: [u32; 3],
}

/// `v4l2_frmsizeenum`; a discrete size is the first two of `size`.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct FrameSize {
    pub(crate) index: u32,
    pub(crate) pixel_format: u32,
    pub(crate) kind: u32,
    /// Least, greatest, step of the width; then of the height.
    pub(crate) size: [u32; 6],
    pub(crate) reserved: [u32; 2],
}

/// `v4l2_frmivalenum`; a discrete interval is the first of `interval`.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct FrameInterval {
    pub(crate) index: u32,
    pub(crate) pixel_format: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) kind: u32,
    /// Least, greatest, step: numerator and denominator of seconds.
    pub(crate) interval: [[u32; 2]; 3],
    pub(crate) reserved: [u32; 2],
}

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct PixFormat {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) pixel_format: u32,
    pub(crate) field: u32,
    pub(crate) bytes_per_line: u32,
    pub(crate) size_image: u32,
    pub(crate) colorspace: u32,
    pub(crate) private: u32,
    pub(crate) flags: u32,
    pub(crate) ycbcr_encoding: u32,
    pub(crate) quantization: u32,
    pub(crate) transfer: u32,
}

#[derive(Clone, Copy, Default)]
#[repr(C, align(8))]
pub(crate) struct Format {
    pub(crate) kind: u32,
    pub(crate) padding: u32,
    pub(crate) pix: PixFormat,
    pub(crate) rest: [u64; 19],
}

/// `v4l2_streamparm` with `v4l2_captureparm`.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct StreamParameters {
    pub(crate) kind: u32,
    pub(crate) capability: u32,
    pub(crate) capture_mode: u32,
    pub(crate) time_per_frame: [u32; 2],
    pub(crate) extended_mode: u32,
    pub(crate) read_buffers: u32,
    pub(crate) reserved: [u32; 4],
    pub(crate) rest: [[u32; 20]; 2],
}

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct RequestBuffers {
    pub(crate) count: u32,
    pub(crate) kind: u32,
    pub(crate) memory: u32,
    pub(crate) capabilities: u32,
    pub(crate) flags: u32,
}

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct Buffer {
    pub(crate) index: u32,
    pub(crate) kind: u32,
    pub(crate) bytes_used: u32,
    pub(crate) flags: u32,
    pub(crate) field: u32,
    pub(crate) padding: u32,
    pub(crate) seconds: i64,
    pub(crate) microseconds: i64,
    pub(crate) timecode: [u32; 4],
    pub(crate) sequence: u32,
    pub(crate) memory: u32,
    /// The place to map, in the low half of the union.
    pub(crate) offset: u32,
    pub(crate) offset_high: u32,
    pub(crate) length: u32,
    pub(crate) reserved: [u32; 2],
    pub(crate) padding_end: u32,
}

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct QueryControl {
    pub(crate) id: u32,
    pub(crate) kind: u32,
    pub(crate) name: [u8; 32],
    pub(crate) minimum: i64,
    pub(crate) maximum: i64,
    pub(crate) step: u64,
    pub(crate) default: i64,
    pub(crate) flags: u32,
    pub(crate) element_size: u32,
    pub(crate) elements: u32,
    pub(crate) dimensions: u32,
    pub(crate) dimension: [u32; 4],
    pub(crate) reserved: [u32; 32],
}

/// `v4l2_querymenu`; the value of an integer menu is in the first eight bytes of `name`.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(crate) struct QueryMenu {
    pub(crate) id: u32,
    pub(crate) index: u32,
    pub(crate) name: [u8; 32],
    pub(crate) reserved: u32,
}

/// `v4l2_ext_control`; packed in the kernel, so the value is two halves.
#[derive(Clone, Copy, Default)]
#[repr(C)]
struct ExtControl {
    id: u32,
    size: u32,
    reserved: u32,
    value: [u32; 2],
}

#[repr(C)]
struct ExtControls {
    which: u32,
    count: u32,
    error_index: u32,
    request_fd: i32,
    reserved: u32,
    controls: *mut ExtControl,
}

/// `uvc_xu_control_query`.
#[repr(C)]
struct ExtensionQuery {
    unit: u8,
    selector: u8,
    query: u8,
    size: u16,
    data: *mut u8,
}

const _: () = {
    assert!(size_of::<Capability>() == 104);
    assert!(size_of::<FormatDescription>() == 64);
    assert!(size_of::<FrameSize>() == 44);
    assert!(size_of::<FrameInterval>() == 52);
    assert!(size_of::<PixFormat>() == 48);
    assert!(size_of::<Format>() == 208);
    assert!(size_of::<StreamParameters>() == 204);
    assert!(size_of::<RequestBuffers>() == 20);
    assert!(size_of::<Buffer>() == 88);
    assert!(std::mem::offset_of!(Buffer, seconds) == 24);
    assert!(std::mem::offset_of!(Buffer, sequence) == 56);
    assert!(std::mem::offset_of!(Buffer, offset) == 64);
    assert!(std::mem::offset_of!(Buffer, length) == 72);
    assert!(size_of::<QueryControl>() == 232);
    assert!(size_of::<QueryMenu>() == 44);
    assert!(size_of::<ExtControl>() == 20);
    assert!(size_of::<ExtControls>() == 32);
    assert!(size_of::<ExtensionQuery>() == 16);
};

/// A call whose argument is a structure without pointers.
macro_rules! calls {
    ($($(#[$doc:meta])* $name:ident, $direction:ident $number:literal = $expected:literal, $argument:ty;)*) => {$(
        $(#[$doc])*
        pub(crate) fn $name(fd: BorrowedFd<'_>, argument: &mut $argument) -> Result<(), Errno> {
            const OPCODE: Opcode = opcode::$direction::<$argument>(b'V', $number);
            const _: () = assert!(OPCODE == $expected);
            // SAFETY: under this number the kernel reads and writes the number of bytes that the
            // argument has, and the number itself carries that length (asserted). Another driver
            // than V4L2 behind `fd` does not know the number.
            unsafe { call::<OPCODE, _>(fd, argument) }
        }
    )*};
}

calls! {
    /// `VIDIOC_QUERYCAP`
    query_capability, read 0 = 0x8068_5600, Capability;
    /// `VIDIOC_ENUM_FMT`
    next_format, read_write 2 = 0xC040_5602, FormatDescription;
    /// `VIDIOC_ENUM_FRAMESIZES`
    next_size, read_write 74 = 0xC02C_564A, FrameSize;
    /// `VIDIOC_ENUM_FRAMEINTERVALS`
    next_interval, read_write 75 = 0xC034_564B, FrameInterval;
    /// `VIDIOC_G_FMT`
    get_format, read_write 4 = 0xC0D0_5604, Format;
    /// `VIDIOC_S_FMT`
    set_format, read_write 5 = 0xC0D0_5605, Format;
    /// `VIDIOC_G_PARM`
    get_parameters, read_write 21 = 0xC0CC_5615, StreamParameters;
    /// `VIDIOC_S_PARM`
    set_parameters, read_write 22 = 0xC0CC_5616, StreamParameters;
    /// `VIDIOC_REQBUFS`
    request_buffers, read_write 8 = 0xC014_5608, RequestBuffers;
    /// `VIDIOC_QUERYBUF`
    query_buffer, read_write 9 = 0xC058_5609, Buffer;
    /// `VIDIOC_QBUF`
    queue, read_write 15 = 0xC058_560F, Buffer;
    /// `VIDIOC_DQBUF`
    dequeue, read_write 17 = 0xC058_5611, Buffer;
    /// `VIDIOC_STREAMON`, of a kind of buffer
    stream_on, write 18 = 0x4004_5612, u32;
    /// `VIDIOC_STREAMOFF`, of a kind of buffer
    stream_off, write 19 = 0x4004_5613, u32;
    /// `VIDIOC_QUERY_EXT_CTRL`
    query_control, read_write 103 = 0xC0E8_5667, QueryControl;
    /// `VIDIOC_QUERYMENU`
    query_menu, read_write 37 = 0xC02C_5625, QueryMenu;
}

/// `VIDIOC_G_EXT_CTRLS` for one control. Of a control of 32 bits only the lower half means
/// anything.
pub(crate) fn get_control(fd: BorrowedFd<'_>, id: u32) -> Result<i64, Errno> {
    const OPCODE: Opcode = opcode::read_write::<ExtControls>(b'V', 71);
    const _: () = assert!(OPCODE == 0xC020_5647);
    one_control::<OPCODE>(fd, id, 0)
}

/// `VIDIOC_S_EXT_CTRLS` for one control. The kernel takes the same number of bits as the control
/// has.
pub(crate) fn set_control(fd: BorrowedFd<'_>, id: u32, value: i64) -> Result<(), Errno> {
    const OPCODE: Opcode = opcode::read_write::<ExtControls>(b'V', 72);
    const _: () = assert!(OPCODE == 0xC020_5648);
    one_control::<OPCODE>(fd, id, value).map(drop)
}

fn one_control<const OPCODE: Opcode>(
    fd: BorrowedFd<'_>,
    id: u32,
    value: i64,
) -> Result<i64, Errno> {
    let mut control = ExtControl {
        id,
        value: [value as u32, (value >> 32) as u32],
        ..ExtControl::default()
    };
    let mut controls = ExtControls {
        which: CURRENT_VALUE,
        count: 1,
        error_index: 0,
        request_fd: 0,
        reserved: 0,
        controls: &raw mut control,
    };
    // SAFETY: the structure points to one control, which outlives the call. A control that has a
    // payload behind a pointer is refused by the kernel, because its size is given as 0.
    unsafe { call::<OPCODE, _>(fd, &mut controls) }?;
    Ok(i64::from(control.value[0]) | i64::from(control.value[1]) << 32)
}

/// `UVCIOC_CTRL_QUERY`: one request of a UVC extension unit. The driver accepts only the exact
/// length.
pub(crate) fn extension(
    fd: BorrowedFd<'_>,
    unit: u8,
    selector: u8,
    query: u8,
    data: &mut [u8],
) -> Result<(), Errno> {
    const OPCODE: Opcode = opcode::read_write::<ExtensionQuery>(b'u', 0x21);
    const _: () = assert!(OPCODE == 0xC010_7521);
    let mut argument = ExtensionQuery {
        unit,
        selector,
        query,
        size: u16::try_from(data.len()).map_err(|_| Errno::NOBUFS)?,
        data: data.as_mut_ptr(),
    };
    // SAFETY: the structure points to `size` bytes that are ours alone for the length of the call.
    unsafe { call::<OPCODE, _>(fd, &mut argument) }
}

/// One call, begun again after a signal.
///
/// # Safety
/// Under `OPCODE` the kernel must take a pointer to a `T`, and what `T` points to must be as the
/// kernel expects it.
unsafe fn call<const OPCODE: Opcode, T>(fd: BorrowedFd<'_>, argument: &mut T) -> Result<(), Errno> {
    retry_on_intr(|| {
        // SAFETY: as the caller promises.
        unsafe { rustix::ioctl::ioctl(fd, Updater::<OPCODE, T>::new(argument)) }
    })
}

/// Text of a fixed-size field, up to its first zero.
pub(crate) fn text(field: &[u8]) -> String {
    let end = field.iter().position(|b| *b == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}
