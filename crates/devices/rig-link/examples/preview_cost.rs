//! Benchmark of previews: `cargo run --release -p rig-link --example preview_cost`.

use std::time::Instant;

use rig_link::preview::{Eyes, Planes, jpeg};

#[expect(
    clippy::disallowed_methods,
    reason = "measures how long something takes on this machine"
)]
fn main() {
    println!("stereo image    shown  JPEG          time");
    for (width, height) in [(1344, 376), (2560, 720), (3840, 1200), (4416, 1242)] {
        let bytes = (width * height) as usize * 3 / 2;
        // A gradient with texture: neither flat nor noise.
        let pixel = |i: usize| ((i / 7) ^ (i / 4001)) as u8 / 2 + (i % 31) as u8;
        let data: Vec<u8> = (0..bytes).map(pixel).collect();
        let image = Planes {
            width,
            height,
            data: &data,
        };
        for eyes in [Eyes::Left, Eyes::Both] {
            let mut times = Vec::new();
            let mut size = 0;
            for _ in 0..50 {
                let start = Instant::now();
                size = jpeg(image, eyes, 320).map_or(0, |j| j.len());
                times.push(start.elapsed());
            }
            times.sort();
            println!(
                "{width:>5} x {height:<5}   {eyes:<5?}  {size:>6} bytes  {:.2} ms (best of 50; median {:.2} ms)",
                times[0].as_secs_f64() * 1e3,
                times[25].as_secs_f64() * 1e3
            );
        }
    }
}
