//! Tags by kornia-apriltag: JSON in, JSON out, as `april_tag.py` of the benchmark
//! `tag_detectors`. Its decimation is that before quadrilaterals are looked for; everything else is
//! as its defaults. Times are of this process; `RAYON_NUM_THREADS` limits its threads.

use std::error::Error;
use std::fs;
use std::io::Read;

use kornia_apriltag::family::TagFamilyKind;
use kornia_apriltag::{AprilTagDecoder, DecodeTagsConfig};
use kornia_image::{Image, ImageSize};
use rustix::time::{ClockId, clock_gettime};
use serde::Deserialize;
use serde_json::json;

#[derive(Deserialize)]
struct Question {
    images: Vec<String>,
    size: [usize; 2],
    decimations: Vec<usize>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    let question: Question = serde_json::from_str(&text)?;
    let [width, height] = question.size;
    let size = ImageSize { width, height };
    let mut images = Vec::new();
    for path in &question.images {
        images.push(Image::<u8, 1>::new(size, fs::read(path)?)?);
    }
    let mut methods = Vec::new();
    for decimation in question.decimations {
        let mut config = DecodeTagsConfig::new(vec![TagFamilyKind::Tag36H11])?;
        config.downscale_factor = decimation;
        let mut decoder = AprilTagDecoder::new(config, size)?;
        let mut answers = Vec::new();
        for image in &images {
            let begin = cpu_s();
            let found = decoder.decode(image)?;
            decoder.clear();
            let ms = 1e3 * (cpu_s() - begin);
            // Its corners: top right, bottom right, bottom left, top left of the image; pixel
            // centers at halves.
            let tags = found.iter().map(|tag| {
                let corners = [2, 1, 0, 3].map(|k: usize| {
                    let corner = &tag.quad.corners[k];
                    [corner.x, corner.y].map(|v| f64::from(v) - 0.5)
                });
                json!({ "id": tag.id, "corners": corners })
            });
            let tags: Vec<_> = tags.collect();
            answers.push(json!({ "ms": ms, "tags": tags }));
        }
        methods.push(json!({
            "name": format!("kornia-apriltag, decimation {decimation}"),
            "images": answers,
        }));
    }
    println!(
        "{}",
        json!({ "version": "kornia-apriltag 0.2.0", "methods": methods })
    );
    Ok(())
}

/// Processor time of this process so far, s.
fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
