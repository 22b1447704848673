//! Heights and edges of analytic stairs against the noise of depth: `stairs_accuracy [WALKS]`.

#[path = "../tests/scene/mod.rs"]
mod scene;

use scene::score::{noise, p95, score, total, walk};
use scene::surface::surface_of;
use scene::{HD720, Noise, VGA};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let walks = std::env::args().nth(1).map_or(Ok(2), |text| text.parse())?;
    println!(
        "{:<8} {:<5} {:>8} {:>9} {:>8} {:>6} {:>9} {:>10} {:>9} {:>9} {:>9}",
        "image",
        "going",
        "noise px",
        "common px",
        "patch px",
        "pose",
        "found",
        "height p95",
        "edge p95",
        "in 2 sigma",
        "invented"
    );
    for (name, camera, walks) in [("1280x720", HD720, walks), ("672x376", VGA, 2 * walks)] {
        for (disparity_px, common_px, patch_px, pose_m) in [
            (0.05, 0.0, 3, 0.001),
            (0.10, 0.0, 3, 0.002),
            (0.20, 0.0, 3, 0.002),
            (0.30, 0.0, 3, 0.002),
            (0.20, 0.0, 7, 0.002),
            (0.20, 0.1, 7, 0.002),
            (0.20, 0.0, 7, 0.010),
        ] {
            for up in [true, false] {
                let of = Noise {
                    common_px,
                    patch_px,
                    pose_m,
                    ..noise(disparity_px, 0)
                };
                let all = total((0..walks).map(|seed| {
                    let shots = walk(
                        camera,
                        4,
                        up,
                        Noise {
                            seed: seed + 1,
                            ..of
                        },
                    );
                    score(&surface_of(&shots).2, 4)
                }));
                let share = all.within as f64 / (2 * all.heights.len().max(1)) as f64;
                let [height, place] = [&all.heights, &all.places].map(|of| match of.is_empty() {
                    true => f64::NAN,
                    false => 1e3 * p95(of),
                });
                println!(
                    "{name:<8} {:<5} {disparity_px:>8.2} {common_px:>9.2} {patch_px:>8} {:>3.0} mm {:>6}/{:<2} {height:>7.1} mm {place:>6.1} mm {:>8.0} % {:>9}",
                    if up { "up" } else { "down" },
                    1e3 * pose_m,
                    all.found,
                    all.expected,
                    100.0 * share,
                    all.invented
                );
            }
        }
    }
    Ok(())
}
