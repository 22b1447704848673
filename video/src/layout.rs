//! Between our tightly packed planes and GStreamer's padded rows.
//!
//! Contract: a picture that needs no padding goes in without a copy; everything else costs one
//! copy. A buffer is trusted to be no larger than its caps and its own metadata say.

use gstreamer as gst;
use gstreamer_video as gst_video;
use gstreamer_video::prelude::*;

use crate::picture::nv12_to_i420;
use crate::{Picture, PixelFormat};

/// Where a plane begins, the distance between its rows, and how much of a row is picture.
struct Rows {
    offset: usize,
    stride: usize,
    width: usize,
}

/// An I420 picture as a buffer of raw video with GStreamer's default strides.
pub(crate) fn to_buffer(picture: &Picture) -> Result<gst::Buffer, String> {
    let (width, height) = (picture.width, picture.height);
    let info = gst_video::VideoInfo::builder(gst_video::VideoFormat::I420, width, height)
        .build()
        .map_err(|error| error.to_string())?;
    let planes = picture.planes().map_err(|error| error.to_string())?;
    let rows: Vec<Rows> = planes
        .iter()
        .zip(info.offset().iter().zip(info.stride()))
        .map(|(plane, (&offset, &stride))| Rows {
            offset,
            stride: stride as usize,
            width: plane.width,
        })
        .collect();
    if info.size() == picture.data.len() && rows.iter().all(|rows| rows.stride == rows.width) {
        return Ok(gst::Buffer::from_slice(picture.data.clone()));
    }
    let mut padded = vec![0; info.size()];
    for (plane, rows) in planes.iter().zip(&rows) {
        let target = padded[rows.offset..].chunks_mut(rows.stride);
        for (source, target) in plane.data.chunks_exact(rows.width).zip(target) {
            target[..rows.width].copy_from_slice(source);
        }
    }
    Ok(gst::Buffer::from_mut_slice(padded))
}

/// A decoded sample as an I420 picture. NV12 and grey, which some decoders give, are converted.
pub(crate) fn from_sample(sample: &gst::Sample) -> Result<Picture, String> {
    let caps = sample.caps().ok_or("decoded picture without caps")?;
    let info = gst_video::VideoInfo::from_caps(caps).map_err(|error| error.to_string())?;
    let buffer = sample.buffer().ok_or("decoded picture without data")?;
    let frame = gst_video::VideoFrameRef::from_buffer_ref_readable(buffer, &info)
        .map_err(|error| format!("reading a decoded picture: {error}"))?;
    let (width, height) = (frame.width(), frame.height());
    let length = PixelFormat::I420
        .bytes(width, height)
        .map_err(|error| error.to_string())?;
    let luma = (width as usize, height as usize);
    let half = (luma.0 / 2, luma.1 / 2);
    let sizes = match frame.format() {
        gst_video::VideoFormat::I420 => vec![luma, half, half],
        gst_video::VideoFormat::Nv12 => vec![luma, (luma.0, half.1)],
        gst_video::VideoFormat::Gray8 => vec![luma],
        other => {
            return Err(format!(
                "decoder gave {other} pictures, expected I420 or NV12"
            ));
        }
    };
    let mut data = Vec::with_capacity(length);
    for (plane, (width, height)) in sizes.into_iter().enumerate() {
        let bytes = frame
            .plane_data(plane as u32)
            .map_err(|error| error.to_string())?;
        let stride = frame.plane_stride()[plane] as usize;
        for row in bytes.chunks(stride.max(1)).take(height) {
            data.extend_from_slice(row.get(..width).ok_or("decoded picture with short rows")?);
        }
    }
    match frame.format() {
        gst_video::VideoFormat::Nv12 => nv12_to_i420(width, height, &data),
        _ => {
            data.resize(length, 128);
            Picture::new(width, height, PixelFormat::I420, data)
        }
    }
    .map_err(|error| error.to_string())
}
