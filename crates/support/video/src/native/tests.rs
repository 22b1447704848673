use super::*;
use crate::pipeline;

fn frame(caps: &str, size: usize, fill: impl Fn(usize) -> u8) -> NativeFrame {
    pipeline::init().unwrap();
    let caps: gst::Caps = caps.parse().unwrap();
    let data: Vec<u8> = (0..size).map(fill).collect();
    let mut buffer = gst::Buffer::from_mut_slice(data);
    buffer
        .get_mut()
        .unwrap()
        .set_pts(gst::ClockTime::from_nseconds(7));
    NativeFrame::new(buffer, NativeFormat::new(&caps).unwrap()).unwrap()
}

const NV12: &str = "video/x-raw,format=NV12,width=64,height=16,framerate=30/1";

#[test]
fn digests_tell_frames_apart() {
    let digest = |fill: fn(usize) -> u8| frame(NV12, 64 * 24, fill).digest().unwrap();
    let ramp = digest(|at| at as u8);
    assert_eq!(ramp, digest(|at| at as u8));
    // One bit in one byte of a row that is looked at, the first and the last of them.
    assert_ne!(ramp, digest(|at| at as u8 ^ u8::from(at == 0)));
    assert_ne!(ramp, digest(|at| at as u8 ^ u8::from(at == 12 * 64 + 63)));
    // Two rows that changed places.
    assert_ne!(
        digest(|at| (at / 64) as u8),
        digest(|at| (at / 64) as u8 ^ 4)
    );
}

#[test]
fn device_memory_is_not_looked_at() {
    let caps = NV12.replace("x-raw", "x-raw(memory:NVMM)");
    // The buffer is a handle, far smaller than the pixels.
    let frame = frame(&caps, 64, |_| 0);
    assert_eq!(frame.format().device_memory().as_deref(), Some(NVMM));
    assert_eq!(frame.format().to_string(), "64x16 NV12 in memory:NVMM");
    assert_eq!(frame.bytes(), 64 * 24);
    assert_eq!(frame.digest(), None);
    assert_eq!(
        frame.to_image(),
        Err(NativeError::DeviceMemory(NVMM.into()))
    );
}

#[test]
fn a_buffer_that_is_not_what_its_caps_say_is_an_error() {
    let frame = frame(NV12, 64 * 23, |_| 0);
    assert_eq!(frame.digest(), None);
    assert!(matches!(frame.to_image(), Err(NativeError::Unreadable(_))));
    let compressed: gst::Caps = "image/jpeg".parse().unwrap();
    assert!(NativeFormat::new(&compressed).is_err());
}

#[test]
fn every_layout_becomes_the_same_image() {
    // Rows of 12 pixels: GStreamer pads them.
    pipeline::init().unwrap();
    let planes = |format: &str| -> RawImage {
        let caps: gst::Caps = format!("video/x-raw,format={format},width=12,height=6")
            .parse()
            .unwrap();
        let format = NativeFormat::new(&caps).unwrap();
        let mut buffer = gst::Buffer::with_size(format.bytes()).unwrap();
        {
            let buffer = buffer.get_mut().unwrap();
            buffer.set_pts(gst::ClockTime::ZERO);
            let mut frame =
                gst_video::VideoFrameRef::from_buffer_ref_writable(buffer, format.info()).unwrap();
            let components = format.info().n_components();
            for component in 0..components {
                let plane = frame.comp_plane(component);
                let (stride, step) = (
                    frame.plane_stride()[plane as usize] as usize,
                    frame.comp_pstride(component) as usize,
                );
                let offset = frame.comp_poffset(component) as usize;
                let (width, height) = (frame.comp_width(component), frame.comp_height(component));
                // Chroma that is the same in both rows of a block, so that its mean is exact.
                let rows_per = if component > 0 {
                    6 / height as usize
                } else {
                    1
                };
                let data = frame.plane_data_mut(plane).unwrap();
                for y in 0..height as usize {
                    let value_row = if component > 0 { y * rows_per / 2 } else { y };
                    for x in 0..width as usize {
                        data[y * stride + offset + x * step] =
                            (component as usize * 80 + value_row * 12 + x) as u8;
                    }
                }
            }
        }
        let frame = NativeFrame::new(buffer, format).unwrap();
        frame.to_image().unwrap()
    };
    let expected = planes("I420");
    assert_eq!(expected.data[..3], [0, 1, 2]);
    assert_eq!(expected.data[12 * 6 + 6], 80 + 12);
    for format in ["NV12", "YUY2", "UYVY"] {
        assert_eq!(planes(format), expected, "{format}");
    }
    let grey = planes("GRAY8");
    assert_eq!(grey.data[..72], expected.data[..72]);
    assert!(grey.data[72..].iter().all(|&chroma| chroma == 128));
}
