//! The elements of an encoding pipeline, from our frames to our access units.

use std::sync::Arc;
use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;

use super::EncoderSettings;
use super::delivery::Shared;
use super::kinds::{Force, Input, Kind, Need};
use crate::native::{NVMM, NativeFormat};
use crate::pipeline::{self, lock};
use crate::raw_image::coded_size;

/// Before a key frame is forced by signal, how long to wait for earlier frames to come out.
const SIGNAL_WAIT: Duration = Duration::from_millis(200);

/// Full-range BT.601 as in a JPEG file, so that a decoder that converts gives back the same luma.
const COLORIMETRY: &str = "1:4:7:1";

/// Thousandths of a hertz, at least one: never 0/1, with which x265enc hangs.
fn rate(settings: &EncoderSettings) -> gst::Fraction {
    gst::Fraction::new(((settings.rate_hz * 1000.0).round() as i32).max(1), 1000)
}

fn raw_caps(settings: &EncoderSettings, format: &str) -> gst::Caps {
    let (width, height) = coded_size(settings.width, settings.height);
    gst::Caps::builder("video/x-raw")
        .field("format", format)
        .field("width", width as i32)
        .field("height", height as i32)
        .field("framerate", rate(settings))
        .field("pixel-aspect-ratio", gst::Fraction::new(1, 1))
        .field("interlace-mode", "progressive")
        .field("colorimetry", COLORIMETRY)
        .field("chroma-site", "jpeg")
        .build()
}

/// What the source of the pipeline is going to give.
pub(super) fn input_caps(settings: &EncoderSettings, native: Option<&NativeFormat>) -> gst::Caps {
    let Some(format) = native else {
        return raw_caps(settings, "I420");
    };
    // The camera's own, with what it says of its colours.
    let mut caps = format.caps().clone();
    caps.make_mut().set("framerate", rate(settings));
    caps
}

/// Layout, size and memory alone: a converter keeps the colours as they are.
fn plain_caps(settings: &EncoderSettings, format: &str, memory: Option<&str>) -> gst::Caps {
    let (width, height) = coded_size(settings.width, settings.height);
    let mut caps = gst::Caps::builder("video/x-raw")
        .field("format", format)
        .field("width", width as i32)
        .field("height", height as i32)
        .build();
    let features = memory.map(|memory| gst::CapsFeatures::new([memory]));
    caps.make_mut().set_features_simple(features);
    caps
}

/// A pipeline's elements, ready to be linked.
pub(super) struct Chain {
    /// From the source to the sink.
    pub(super) elements: Vec<gst::Element>,
    /// The one that encodes.
    pub(super) encoder: gst::Element,
}

/// What has to stand between the source and the encoder.
fn converters(
    settings: &EncoderSettings,
    kind: &Kind,
    native: Option<&NativeFormat>,
    encoder: &gst::Element,
) -> Result<Vec<gst::Element>, String> {
    let (converter, caps) = match native {
        None => match kind.input {
            Input::I420 => return Ok(Vec::new()),
            Input::Nv12 => ("videoconvert", raw_caps(settings, "NV12")),
            Input::NvmmNv12 => ("nvvidconv", plain_caps(settings, "NV12", Some(NVMM))),
        },
        Some(format) => {
            let takes = encoder
                .static_pad("sink")
                .ok_or("the encoder has no input")?
                .pad_template_caps();
            if takes.can_intersect(&input_caps(settings, native)) {
                return Ok(Vec::new());
            }
            let in_nvmm = format.device_memory().is_some_and(|memory| memory == NVMM);
            let converter = if in_nvmm || kind.input == Input::NvmmNv12 {
                "nvvidconv"
            } else {
                "videoconvert"
            };
            let caps = match kind.input {
                Input::I420 => plain_caps(settings, "I420", None),
                Input::Nv12 => plain_caps(settings, "NV12", None),
                Input::NvmmNv12 => plain_caps(settings, "NV12", Some(NVMM)),
            };
            (converter, caps)
        }
    };
    Ok(vec![
        pipeline::make(converter)?,
        pipeline::caps_filter(&caps)?,
    ])
}

/// All elements from the source to the sink.
pub(super) fn chain(
    settings: &EncoderSettings,
    kind: &Kind,
    quantiser: u32,
    native: Option<&NativeFormat>,
    source: &gst_app::AppSrc,
    shared: &Arc<Shared>,
) -> Result<Chain, String> {
    let encoder = pipeline::make(kind.element)?;
    set_properties(&encoder, settings, kind, quantiser)?;
    let mut elements = vec![source.clone().upcast()];
    elements.extend(converters(settings, kind, native, &encoder)?);
    if let Force::Signal(signal) = kind.force {
        if !pipeline::has_action(&encoder, signal) {
            return Err(format!("it has no signal {signal}"));
        }
        let pad = encoder
            .static_pad("sink")
            .ok_or("the encoder has no input")?;
        let (shared, element) = (Arc::downgrade(shared), encoder.downgrade());
        pad.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
            if let (Some(shared), Some(element)) = (shared.upgrade(), element.upgrade()) {
                let time = info.buffer().and_then(|buffer| buffer.pts());
                shared.force_by_signal(&element, signal, time, SIGNAL_WAIT);
            }
            gst::PadProbeReturn::Ok
        });
    }
    elements.push(encoder.clone());
    let parser = pipeline::make(kind.codec.parser())?;
    // -1: parameter sets in front of every IDR frame.
    pipeline::set_property(&parser, "config-interval", "-1")?;
    elements.push(parser);
    let (delivering, ending) = (shared.clone(), shared.clone());
    let sink = gst_app::AppSink::builder()
        .caps(
            &gst::Caps::builder(kind.codec.media_type())
                .field("stream-format", "byte-stream")
                .field("alignment", "au")
                .build(),
        )
        .sync(false)
        .async_(false)
        .max_buffers(1)
        .callbacks(
            gst_app::AppSinkCallbacks::builder()
                .new_sample(move |sink| {
                    let sample = sink.pull_sample().map_err(|_| gst::FlowError::Eos)?;
                    delivering.deliver(&sample)
                })
                .eos(move |_| {
                    lock(&ending.state).ended = true;
                    ending.changed.notify_all();
                })
                .build(),
        )
        .build();
    elements.push(sink.upcast());
    Ok(Chain { elements, encoder })
}

/// Gives a running encoder another quantiser. `false` if it cannot take one now.
pub(super) fn adjust(encoder: &gst::Element, kind: &Kind, quantiser: u32) -> Result<bool, String> {
    let properties = kind.properties.iter();
    let of_quantiser: Vec<&str> = properties
        .filter(|property| property.value == "{qp}")
        .filter_map(|property| {
            let mut names = property.names.iter().copied();
            names.find(|name| encoder.has_property(name))
        })
        .collect();
    let mutable = |name: &&str| {
        let spec = encoder.find_property(name);
        spec.is_some_and(|spec| spec.flags().contains(gst::PARAM_FLAG_MUTABLE_PLAYING))
    };
    if of_quantiser.is_empty() || !of_quantiser.iter().all(mutable) {
        return Ok(false);
    }
    for name in of_quantiser {
        pipeline::set_property(encoder, name, &quantiser.to_string())?;
    }
    Ok(true)
}

fn set_properties(
    encoder: &gst::Element,
    settings: &EncoderSettings,
    kind: &Kind,
    quantiser: u32,
) -> Result<(), String> {
    let threads = settings.threads;
    for property in kind.properties {
        let text = property
            .value
            .replace("{qp}", &quantiser.to_string())
            .replace("{gop}", &settings.max_key_interval_frames.to_string())
            .replace("{preset}", settings.preset.name())
            .replace("{threads}", &threads.to_string())
            .replace(
                "{pools}",
                &if threads == 1 {
                    "none".into()
                } else {
                    threads.to_string()
                },
            )
            .replace("{sliced}", if threads == 1 { "false" } else { "true" });
        let mut found = false;
        for name in property.names {
            if pipeline::set_property(encoder, name, &text)? {
                found = true;
                break;
            }
        }
        if !found && property.need == Need::Must {
            return Err(format!(
                "it has no property {}",
                property.names.join(" or ")
            ));
        }
    }
    Ok(())
}
