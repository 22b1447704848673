use std::time::Duration;

use super::*;
use crate::pipeline::wait_while;

fn frame(number: u64) -> NativeFrame {
    pipeline::init().unwrap();
    let caps: gst::Caps = "video/x-raw,format=NV12,width=640,height=320,framerate=30/1"
        .parse()
        .unwrap();
    let format = NativeFormat::new(&caps).unwrap();
    let mut buffer = gst::Buffer::from_mut_slice(vec![number as u8; format.bytes()]);
    let time = gst::ClockTime::from_nseconds(number * 33_333_333);
    buffer.get_mut().unwrap().set_pts(time);
    NativeFrame::new(buffer, format).unwrap()
}

const SETTINGS: PreviewSettings = PreviewSettings {
    width: 160,
    height: 80,
    rate_hz: 5.0,
    quality: 70,
};

/// Waits for a JPEG, without a clock in the code under test.
fn wait(preview: &Preview) -> Jpeg {
    let (never, gate) = (std::sync::Condvar::new(), Mutex::new(()));
    // Ten minutes: the encoder hangs.
    for _ in 0..60_000 {
        if let Some(jpeg) = preview.take() {
            return jpeg;
        }
        let _ = wait_while(&never, lock(&gate), Duration::from_millis(10), |_| true);
    }
    panic!("no JPEG: {:?}", preview.failure());
}

#[test]
fn frames_become_jpegs_at_a_low_rate() {
    let preview = Preview::start(&SETTINGS, frame(0).format()).unwrap();
    assert!(preview.offer(0, &frame(0)));
    let jpeg = wait(&preview);
    assert_eq!(jpeg.time_ns, 0);
    assert_eq!(jpeg.data[..3], [0xff, 0xd8, 0xff]);
    // Height and width, in the frame header.
    let header = jpeg
        .data
        .windows(2)
        .position(|two| two == [0xff, 0xc0])
        .unwrap();
    assert_eq!(jpeg.data[header + 5..header + 9], [0, 80, 0, 160]);
    // 30 frames a second: every sixth is due.
    let taken: Vec<u64> = (1..=18)
        .filter(|&number| {
            let taken = preview.offer(number as i64 * 33_333_333, &frame(number));
            if taken {
                assert_eq!(wait(&preview).time_ns, number as i64 * 33_333_333);
            }
            taken
        })
        .collect();
    assert_eq!(taken, [6, 12, 18]);
    assert_eq!(preview.take(), None);
    // A clock that was set back does not end the preview.
    assert!(preview.offer(5, &frame(19)));
    wait(&preview);
}

#[test]
fn a_frozen_camera_shows() {
    let preview = Preview::start(&SETTINGS, frame(0).format()).unwrap();
    let jpeg = |time_ns: i64, number: u64| {
        assert!(preview.offer(time_ns, &frame(number)));
        wait(&preview).data
    };
    let (first, again) = (jpeg(0, 90), jpeg(200_000_000, 90));
    assert_eq!(first, again);
    assert_ne!(first, jpeg(400_000_000, 120));
}

#[test]
fn a_preview_that_is_stuck_takes_nothing_and_holds_nobody_up() {
    let preview = Preview::start(&SETTINGS, frame(0).format()).unwrap();
    // The pipeline stands still while this lock is held.
    let pad = preview.source.static_pad("src").unwrap();
    let gate = Arc::new(Mutex::new(()));
    let held = gate.lock().unwrap();
    let waiting = gate.clone();
    pad.add_probe(gst::PadProbeType::BUFFER, move |_, _| {
        drop(lock(&waiting));
        gst::PadProbeReturn::Ok
    });
    // A caller that blocks here blocks for ever.
    let taken = (0..100)
        .filter(|&number| preview.offer(number as i64 * 200_000_000, &frame(number)))
        .count();
    assert_eq!(taken, 1);
    drop(held);
    wait(&preview);
    assert!(preview.offer(1 << 40, &frame(1000)));
}

#[test]
fn refusals() {
    let format = frame(0).format().clone();
    let refused = |settings: PreviewSettings| Preview::start(&settings, &format).unwrap_err();
    let rate_hz = 0.0;
    assert!(matches!(
        refused(PreviewSettings {
            rate_hz,
            ..SETTINGS
        }),
        PreviewError::Settings(_)
    ));
    let quality = 0;
    assert!(matches!(
        refused(PreviewSettings {
            quality,
            ..SETTINGS
        }),
        PreviewError::Settings(_)
    ));
    let width = 3;
    assert!(matches!(
        refused(PreviewSettings { width, ..SETTINGS }),
        PreviewError::Settings(_)
    ));
    // Without a Jetson's converter there is no way out of its memory.
    let caps: gst::Caps = "video/x-raw(memory:NVMM),format=NV12,width=64,height=32"
        .parse()
        .unwrap();
    if gst::ElementFactory::find("nvvidconv").is_none() {
        let error = Preview::start(&SETTINGS, &NativeFormat::new(&caps).unwrap()).unwrap_err();
        assert!(error.to_string().contains("nvvidconv"), "{error}");
    }
}
