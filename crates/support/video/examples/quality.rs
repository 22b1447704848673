//! Measures what `gain_db` in the table of encoders says: luma PSNR, size and CPU time per frame
//! for every software encoder on this machine.
//!
//! `cargo run -p video --example quality [dB ...]`, with `PAWS_DATA` for the real frames.

#[path = "../tests/it/material.rs"]
mod material;

use std::fs;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use video::discover::trial;
use video::encoder::Preset;
use video::raw_image::{psnr, psnr_all};
use video::{AccessUnit, Decoder, Encoder, EncoderEvent, EncoderSettings, RawImage};

fn main() {
    let targets: Vec<f64> = std::env::args()
        .skip(1)
        .map(|text| text.parse().unwrap())
        .collect();
    let targets = if targets.is_empty() {
        vec![36.0, 39.0, 42.0, 45.0]
    } else {
        targets
    };
    let mut clips = vec![("texture", material::texture(1344, 376, 15))];
    clips.extend(material::recordings(15));
    println!(
        "element      preset     clip      target  QP  luma PSNR mean   min     all  kB/frame  CPU ms/frame  CPU ms/megapixel"
    );
    for element in video::encoder::known_elements() {
        if let Err(reason) = trial(element, 640, 360) {
            println!("{element:12} {reason}");
            continue;
        }
        let presets = match element {
            "x264enc" => &Preset::ALL[..],
            _ => &[Preset::Ultrafast],
        };
        for &preset in presets {
            for (name, clip) in &clips {
                for &target in &targets {
                    measure(element, preset, name, clip, target);
                }
            }
        }
    }
}

fn measure(element: &str, preset: Preset, name: &str, clip: &[RawImage], target: f64) {
    let settings = EncoderSettings {
        element: element.into(),
        width: clip[0].width,
        height: clip[0].height,
        rate_hz: 30.0,
        quality_db: target,
        threads: 1,
        max_key_interval_frames: 1000,
        preset,
    };
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let collecting = units.clone();
    let before = cpu_ms();
    let mut encoder = Encoder::start(
        &settings,
        Box::new(move |event| match event {
            EncoderEvent::AccessUnit(unit) => collecting.lock().unwrap().push(unit),
            EncoderEvent::Failed(reason) => panic!("{reason}"),
        }),
    )
    .unwrap();
    let quantiser = encoder.quantiser();
    for (number, image) in clip.iter().enumerate() {
        encoder
            .push(number as i64 * 33_333_333, image, false)
            .unwrap();
    }
    let codec = encoder.codec();
    encoder.finish(Duration::from_secs(60)).unwrap();
    let cpu = (cpu_ms() - before) / clip.len() as f64;
    let units = units.lock().unwrap();
    let decoded = Decoder::new(codec).decode(&units).unwrap();
    let each: Vec<f64> = clip
        .iter()
        .zip(&decoded)
        .map(|(a, b)| psnr(a, &b.1))
        .collect();
    let all: Vec<f64> = clip
        .iter()
        .zip(&decoded)
        .map(|(a, b)| psnr_all(a, &b.1))
        .collect();
    let megapixels = f64::from(clip[0].width) * f64::from(clip[0].height) * 1e-6;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let bytes = units.iter().map(|unit| unit.data.len()).sum::<usize>() as f64 / clip.len() as f64;
    println!(
        "{element:12} {:10} {name:9} {target:6.1} {quantiser:3} {:15.2} {:6.2} {:6.2} {:10.1} {cpu:10.1} {:10.1}",
        preset.name(),
        mean(&each),
        each.iter().copied().fold(f64::INFINITY, f64::min),
        mean(&all),
        bytes / 1e3,
        cpu / megapixels,
    );
}

/// CPU time of this process, to the kernel's tick of 10 ms.
fn cpu_ms() -> f64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = text
        .rsplit(')')
        .next()
        .unwrap()
        .split_whitespace()
        .collect();
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) * 10.0
}
