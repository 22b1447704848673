//! A walk as video files, by GStreamer's own encoders and muxers.

use std::path::Path;

use anyhow::{Context as _, Result, anyhow, bail, ensure};
use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;
use video::RawImage;

/// Encoding and container of a film.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Film {
    /// H.264 in MP4.
    Mp4,
    /// H.264 in Matroska.
    Mkv,
    /// Motion-JPEG in AVI.
    MjpegAvi,
}

impl Film {
    fn chain(self) -> &'static str {
        match self {
            Self::Mp4 => "x264enc pass=qual quantizer=16 bframes=2 ! h264parse ! mp4mux",
            Self::Mkv => "x264enc pass=qual quantizer=16 bframes=2 ! h264parse ! matroskamux",
            Self::MjpegAvi => "jpegenc quality=95 ! avimux",
        }
    }
}

/// Writes images of one size at these times, ns from 0.
///
/// # Errors
/// An element is absent or fails.
pub fn write(
    film: Film,
    rate_hz: i32,
    images: impl IntoIterator<Item = (i64, RawImage)>,
    path: &Path,
) -> Result<()> {
    video::init()?;
    let description = format!(
        "appsrc name=in format=time ! queue ! {} ! filesink name=out",
        film.chain()
    );
    let pipeline = gst::parse::launch(&description)?;
    let pipeline = pipeline
        .downcast::<gst::Pipeline>()
        .map_err(|_| anyhow!("no pipeline"))?;
    let sink = pipeline.by_name("out").context("no sink")?;
    sink.set_property("location", path);
    let source = pipeline.by_name("in").context("no source")?;
    let source = source
        .downcast::<gst_app::AppSrc>()
        .map_err(|_| anyhow!("no appsrc"))?;
    source.set_max_bytes(0);
    let mut caps = None;
    let mut last = 0;
    pipeline.set_state(gst::State::Playing)?;
    for (time_ns, image) in images {
        // Otherwise GStreamer pads rows.
        ensure!(image.width.is_multiple_of(8), "{} columns", image.width);
        if caps.is_none() {
            let made = gst::Caps::builder("video/x-raw")
                .field("format", "I420")
                .field("width", i32::try_from(image.width)?)
                .field("height", i32::try_from(image.height)?)
                .field("framerate", gst::Fraction::new(rate_hz, 1))
                .field("colorimetry", "1:4:0:0")
                .build();
            source.set_caps(Some(&made));
            caps = Some(made);
        }
        let mut buffer = gst::Buffer::from_slice(image.data.clone());
        let of = buffer.get_mut().context("a buffer of our own")?;
        of.set_pts(gst::ClockTime::from_nseconds(u64::try_from(time_ns)?));
        of.set_duration(gst::ClockTime::from_nseconds(
            1_000_000_000 / u64::try_from(rate_hz)?,
        ));
        last = time_ns;
        source.push_buffer(buffer)?;
    }
    source.end_of_stream()?;
    let bus = pipeline.bus().context("no bus")?;
    let limit = gst::ClockTime::from_seconds(120);
    let kinds = [gst::MessageType::Eos, gst::MessageType::Error];
    let ended = bus.timed_pop_filtered(limit, &kinds);
    pipeline.set_state(gst::State::Null)?;
    match ended.as_ref().map(|message| message.view()) {
        Some(gst::MessageView::Eos(_)) => Ok(()),
        Some(gst::MessageView::Error(error)) => bail!("writing a film: {}", error.error()),
        _ => bail!("writing a film: nothing happened after the image at {last} ns"),
    }
}
