//! Tests that change buffers inside the chain.

use gstreamer::prelude::*;

use super::*;

const CHAIN: &str =
    "videotestsrc name=camera is-live=true num-buffers=4 ! video/x-raw,framerate=25/1";
/// Reached only when something hangs.
const LONG: Duration = Duration::from_secs(600);

/// Captures with every buffer changed as it leaves the camera.
fn changed(
    settings: &CaptureSettings,
    change: impl Fn(u64, &mut gst::Buffer) + Send + Sync + Clone + 'static,
) -> Vec<CaptureEvent> {
    let look = |camera: &gst::Bin| {
        let pad = camera.by_name("camera").unwrap().static_pad("src").unwrap();
        let change = change.clone();
        pad.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
            let buffer = info.buffer_mut().unwrap();
            change(buffer.offset(), buffer);
            gst::PadProbeReturn::Ok
        });
    };
    let mut capture = Capture::start_with(settings, Arc::new(|| 5), look).unwrap();
    let mut events = Vec::new();
    loop {
        let event = capture.next(LONG).unwrap();
        let last = !matches!(event, CaptureEvent::Frame(_) | CaptureEvent::Lost(_));
        events.push(event);
        if last {
            return events;
        }
    }
}

fn settings() -> CaptureSettings {
    CaptureSettings::new(CHAIN, 64, 32, 100.0)
}

#[test]
fn times_of_other_clocks_come_along() {
    let events = changed(&settings(), |number, buffer| {
        let caps: gst::Caps = "timestamp/x-unix".parse().unwrap();
        let time = gst::ClockTime::from_nseconds(1_700_000_000_000_000_001 + number);
        gst::ReferenceTimestampMeta::add(buffer.make_mut(), &caps, time, None);
    });
    let CaptureEvent::Frame(frame) = &events[2] else {
        panic!("{events:?}");
    };
    let expected = Reference {
        clock: "timestamp/x-unix".into(),
        time_ns: 1_700_000_000_000_000_003,
    };
    assert_eq!(frame.references, [expected]);
    assert_eq!(frame.host_time_ns, 5);
}

#[test]
fn repeated_times_are_marked_and_missing_ones_end_it() {
    let events = changed(&settings(), |number, buffer| {
        if number == 2 {
            buffer.make_mut().set_pts(gst::ClockTime::from_mseconds(40));
        }
    });
    let repeated: Vec<bool> = events
        .iter()
        .filter_map(|event| match event {
            CaptureEvent::Frame(frame) => Some(frame.repeated),
            _ => None,
        })
        .collect();
    assert_eq!(repeated, [false, false, true, false]);
    // An encoder that is given the buffers does not mind.
    let native = CaptureSettings {
        delivery: Delivery::Native,
        ..settings()
    };
    let stamps: Vec<i64> = changed(&native, |_, buffer| {
        buffer.make_mut().set_pts(gst::ClockTime::from_mseconds(40));
    })
    .iter()
    .filter_map(|event| match event {
        CaptureEvent::Frame(frame) => match &frame.content {
            Content::Native(native) => Some(native.stamp_ns() - frame.clock_time_ns),
            Content::RawImage(_) => None,
        },
        _ => None,
    })
    .collect();
    assert_eq!(stamps, [0, 1, 2, 3]);
    let events = changed(&settings(), |number, buffer| {
        if number == 2 {
            buffer.make_mut().set_pts(gst::ClockTime::NONE);
        }
    });
    let (end, frames) = events.split_last().unwrap();
    assert_eq!(frames.len(), 2);
    assert!(
        matches!(end, CaptureEvent::Failed { reason, .. } if reason.contains("do-timestamp")),
        "{end:?}"
    );
}

#[test]
fn a_source_without_numbers_is_counted_by_time() {
    let events = changed(&settings(), |number, buffer| {
        let buffer = buffer.make_mut();
        buffer.set_offset(u64::MAX);
        // The third one comes two periods late.
        let late = if number >= 2 { 20 } else { 0 };
        buffer.set_pts(gst::ClockTime::from_mseconds(number * 10 + late));
    });
    let numbers: Vec<u64> = events
        .iter()
        .filter_map(|event| match event {
            CaptureEvent::Frame(frame) => Some(frame.number),
            _ => None,
        })
        .collect();
    assert_eq!(numbers, [0, 1, 4, 5]);
}

/// As NVIDIA's cameras: memory that must not be shared between buffers, and an element that keeps a
/// reference.
#[test]
fn memory_that_must_not_be_shared_is_not_copied_silently() {
    let kept: Arc<Mutex<Vec<gst::Buffer>>> = Arc::default();
    let native = CaptureSettings {
        delivery: Delivery::Native,
        ..settings()
    };
    let run = |keep: bool, no_share: bool| {
        let kept = kept.clone();
        changed(&native, move |_, buffer| {
            if no_share {
                // The flag can be set only where a memory is made.
                let bytes = buffer.size();
                let flags = gst::MemoryFlags::NO_SHARE;
                let params = gst::AllocationParams::new(flags, 0, 0, 0);
                let memory = gst::Allocator::find(None)
                    .unwrap()
                    .alloc(bytes, Some(&params))
                    .unwrap();
                let buffer = buffer.make_mut();
                buffer.remove_all_memory();
                buffer.append_memory(memory);
            }
            if keep {
                kept.lock().unwrap().push(buffer.clone());
            }
        })
    };
    for (keep, no_share) in [(false, false), (false, true), (true, false)] {
        let events = run(keep, no_share);
        assert_eq!(events.len(), 5, "{keep} {no_share} {events:?}");
    }
    let events = run(true, true);
    assert!(
        matches!(&events[..], [CaptureEvent::Failed { reason, .. }] if reason.contains("shared")),
        "{events:?}"
    );
}
