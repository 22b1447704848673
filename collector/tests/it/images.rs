//! Real access units for synthetic sessions: a moving gray ramp, encoded by x264.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings, PixelFormat, RawImage};

use crate::support::Session;

/// Reached only on a hang.
const TEST_TIMEOUT: Duration = Duration::from_secs(120);

/// Image of camera `camera` in its `n`-th frame: in the left half brightness rises to the right, in
/// the right half to the bottom, and both move.
pub(crate) fn image(camera: usize, n: usize, width: u32, height: u32) -> RawImage {
    let half = width / 2;
    let mut data = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let ramp = if x < half { x * 2 } else { y * 3 };
            data.push((ramp + 3 * n as u32 + 20 * camera as u32) as u8 / 2 + 60);
        }
    }
    data.resize(data.len() * 3 / 2, 128);
    RawImage::new(width, height, PixelFormat::I420, data).unwrap()
}

impl Session {
    /// A session without fault with decodable images.
    pub(crate) fn decodable(seconds: f64) -> Self {
        let mut session = Self::good(seconds);
        for camera in 0..session.spec.cameras.len() {
            let (width, height) = {
                let c = &session.spec.cameras[camera];
                (c.width, c.height)
            };
            let of = |p: &&mut crate::support::StereoFrame| p.camera == camera;
            let keys: Vec<bool> = session
                .stereo_frames
                .iter_mut()
                .filter(of)
                .map(|p| p.key)
                .collect();
            let units = encode(camera, width, height, &keys);
            for (p, unit) in session.stereo_frames.iter_mut().filter(of).zip(units) {
                p.unit = unit.data.to_vec();
                assert_eq!(p.key, unit.key);
            }
        }
        session
    }
}

fn encode(camera: usize, width: u32, height: u32, keys: &[bool]) -> Vec<AccessUnit> {
    let settings = EncoderSettings {
        element: "x264enc".to_owned(),
        width,
        height,
        rate_hz: 30.0,
        quality_db: 50.0,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    };
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let collecting = units.clone();
    let on_output = move |event| match event {
        EncoderEvent::AccessUnit(unit) => collecting.lock().unwrap().push(unit),
        EncoderEvent::Failed(reason) => panic!("{reason}"),
    };
    let mut encoder = Encoder::start(&settings, Box::new(on_output)).unwrap();
    for (n, key) in keys.iter().enumerate() {
        let image = image(camera, n, width, height);
        encoder.push(n as i64 * 33_000_000, &image, *key).unwrap();
    }
    encoder.finish(TEST_TIMEOUT).unwrap();
    std::mem::take(&mut units.lock().unwrap())
}
