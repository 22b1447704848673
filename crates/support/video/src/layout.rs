//! Between our tightly packed planes and GStreamer's padded rows.
//!
//! Contract: an image that needs no padding goes in without a copy; everything else costs one
//! copy. A buffer is trusted to be no larger than its caps and its own metadata say.

use gstreamer as gst;
use gstreamer_video as gst_video;
use gstreamer_video::prelude::*;

use crate::raw_image::rows::{self, Layout as Source, PlaneView, Window};
use crate::raw_image::{Plane, coded_size};
use crate::{PixelFormat, RawImage};

/// GStreamer's names of the layouts that can be made into a [`RawImage`].
pub(crate) const READABLE: [&str; 5] = ["I420", "NV12", "YUY2", "UYVY", "GRAY8"];

/// An I420 image as a buffer of raw video of its [`coded_size`], with GStreamer's default strides.
/// An odd last row or column is repeated once.
pub(crate) fn to_buffer(image: &RawImage) -> Result<gst::Buffer, String> {
    let (width, height) = coded_size(image.width, image.height);
    let info = gst_video::VideoInfo::builder(gst_video::VideoFormat::I420, width, height)
        .build()
        .map_err(|error| error.to_string())?;
    let planes = image.planes().map_err(|error| error.to_string())?;
    let rows = info.offset().iter().zip(info.stride());
    let is_packed = |(plane, (_, &stride)): (&Plane<'_>, (_, &i32))| stride as usize == plane.width;
    if info.size() == image.data.len() && planes.iter().zip(rows.clone()).all(is_packed) {
        return Ok(gst::Buffer::from_slice(image.data.clone()));
    }
    // Written once, in order: only what lies between the rows is filled.
    let mut padded = Vec::with_capacity(info.size());
    let sizes = [
        (width, height),
        (width / 2, height / 2),
        (width / 2, height / 2),
    ];
    for ((plane, (&offset, &stride)), (width, height)) in planes.iter().zip(rows).zip(sizes) {
        padded.resize(offset, 0);
        let rows = plane.data.chunks_exact(plane.width);
        let repeated = rows.clone().last();
        for row in rows.chain(repeated).take(height as usize) {
            let end = padded.len() + stride as usize;
            padded.extend_from_slice(row);
            padded.extend(row.last().filter(|_| row.len() < width as usize));
            padded.resize(end, 0);
        }
    }
    padded.resize(info.size(), 0);
    Ok(gst::Buffer::from_mut_slice(padded))
}

/// A decoded sample as an I420 image. NV12 and grey, which some decoders give, are converted.
pub(crate) fn from_sample(sample: &gst::Sample) -> Result<RawImage, String> {
    let caps = sample.caps().ok_or("decoded image without caps")?;
    let info = gst_video::VideoInfo::from_caps(caps).map_err(|error| error.to_string())?;
    let buffer = sample.buffer().ok_or("decoded image without data")?;
    to_image(buffer, &info)
}

/// A buffer of raw video in system memory as an I420 image, with one copy.
pub(crate) fn to_image(
    buffer: &gst::BufferRef,
    info: &gst_video::VideoInfo,
) -> Result<RawImage, String> {
    let (width, height) = (info.width(), info.height());
    let mut data = blank(width, height)?;
    copy_into(buffer, info, Window::whole(&mut data, width, height))?;
    RawImage::new(width, height, PixelFormat::I420, data).map_err(|error| error.to_string())
}

/// Two buffers of the same size beside each other as one I420 image, with one copy of each.
pub(crate) fn to_side_by_side(
    left: (&gst::BufferRef, &gst_video::VideoInfo),
    right: (&gst::BufferRef, &gst_video::VideoInfo),
) -> Result<RawImage, String> {
    let size = |info: &gst_video::VideoInfo| (info.width(), info.height());
    if size(left.1) != size(right.1) {
        let (left, right) = (size(left.1), size(right.1));
        return Err(format!(
            "the left eye is {}x{} and the right {}x{}, expected the same",
            left.0, left.1, right.0, right.1
        ));
    }
    let (columns, height) = size(left.1);
    let width = columns.checked_mul(2).ok_or("two eyes that are too wide")?;
    let mut data = blank(width, height)?;
    for ((buffer, info), x) in [(left, 0), (right, columns)] {
        let window = Window {
            data: &mut data,
            width,
            height,
            x,
            columns,
        };
        copy_into(buffer, info, window)?;
    }
    RawImage::new(width, height, PixelFormat::I420, data).map_err(|error| error.to_string())
}

fn blank(width: u32, height: u32) -> Result<Vec<u8>, String> {
    let length = PixelFormat::I420.bytes(width, height);
    Ok(vec![0; length.map_err(|error| error.to_string())?])
}

/// Writes a buffer into a window of an I420 image. The positions of its rows are in its own
/// metadata, if it has any, else in the caps.
fn copy_into(
    buffer: &gst::BufferRef,
    info: &gst_video::VideoInfo,
    window: Window<'_>,
) -> Result<(), String> {
    let frame = gst_video::VideoFrameRef::from_buffer_ref_readable(buffer, info)
        .map_err(|error| format!("reading an image of {}: {error}", info.format()))?;
    let plane = |number: u32| -> Result<PlaneView<'_>, String> {
        let data = frame
            .plane_data(number)
            .map_err(|error| error.to_string())?;
        let stride = usize::try_from(frame.plane_stride()[number as usize])
            .map_err(|_| "an image that is stored upside down")?;
        Ok(PlaneView { data, stride })
    };
    let source = match frame.format() {
        gst_video::VideoFormat::I420 => Source::I420([plane(0)?, plane(1)?, plane(2)?]),
        gst_video::VideoFormat::Nv12 => Source::Nv12([plane(0)?, plane(1)?]),
        gst_video::VideoFormat::Gray8 => Source::Grey(plane(0)?),
        gst_video::VideoFormat::Yuy2 => Source::Yuyv(plane(0)?),
        gst_video::VideoFormat::Uyvy => Source::Uyvy(plane(0)?),
        other => {
            return Err(format!(
                "images are {other}, expected one of {}",
                READABLE.join(", ")
            ));
        }
    };
    rows::write(source, window).map_err(|error| error.to_string())
}
