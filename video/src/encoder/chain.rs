//! The elements of an encoding pipeline, from our pictures to our access units.

use std::sync::Arc;
use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app as gst_app;

use super::EncoderSettings;
use super::delivery::Shared;
use super::kinds::{Force, Input, Kind, Need};
use crate::pipeline::{self, lock};

/// Before a key frame is forced by signal, how long to wait for earlier pictures to come out.
const SIGNAL_WAIT: Duration = Duration::from_millis(200);

/// Full-range BT.601 as in a JPEG file, so that a decoder that converts gives back the same luma.
const COLORIMETRY: &str = "1:4:7:1";

fn raw_caps(settings: &EncoderSettings, format: &str) -> gst::Caps {
    // Thousandths of a hertz, at least one: never 0/1.
    let rate = ((settings.rate_hz * 1000.0).round() as i32).max(1);
    gst::Caps::builder("video/x-raw")
        .field("format", format)
        .field("width", settings.width as i32)
        .field("height", settings.height as i32)
        .field("framerate", gst::Fraction::new(rate, 1000))
        .field("pixel-aspect-ratio", gst::Fraction::new(1, 1))
        .field("interlace-mode", "progressive")
        .field("colorimetry", COLORIMETRY)
        .field("chroma-site", "jpeg")
        .build()
}

pub(super) fn input_caps(settings: &EncoderSettings) -> gst::Caps {
    raw_caps(settings, "I420")
}

/// All elements from the source to the sink, ready to be linked.
pub(super) fn chain(
    settings: &EncoderSettings,
    kind: &Kind,
    quantiser: u32,
    source: &gst_app::AppSrc,
    shared: &Arc<Shared>,
) -> Result<Vec<gst::Element>, String> {
    let encoder = pipeline::make(kind.element)?;
    set_properties(&encoder, settings, kind, quantiser)?;
    let mut elements = vec![source.clone().upcast()];
    match kind.input {
        Input::I420 => {}
        Input::Nv12 => {
            elements.push(pipeline::make("videoconvert")?);
            elements.push(pipeline::caps_filter(&raw_caps(settings, "NV12"))?);
        }
        Input::NvmmNv12 => {
            elements.push(pipeline::make("nvvidconv")?);
            let mut caps = gst::Caps::builder("video/x-raw")
                .field("format", "NV12")
                .field("width", settings.width as i32)
                .field("height", settings.height as i32)
                .build();
            caps.make_mut()
                .set_features_simple(Some(gst::CapsFeatures::new(["memory:NVMM"])));
            elements.push(pipeline::caps_filter(&caps)?);
        }
    }
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
    elements.push(encoder);
    let parser = pipeline::make(kind.codec.parser())?;
    // -1: parameter sets in front of every IDR picture.
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
    Ok(elements)
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
