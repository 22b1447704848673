use std::collections::HashSet;

use super::*;

const STREAMS: [Stream; 9] = [
    Stream::Start,
    Stream::Goal,
    Stream::Camera,
    Stream::Dynamics,
    Stream::Noise,
    Stream::Mount,
    Stream::Latency,
    Stream::Exposure,
    Stream::Intrinsics,
];

#[test]
fn seeds_episodes_streams_and_indices_differ() {
    let mut numbers = HashSet::new();
    for seed in 0..10 {
        for episode in 0..10 {
            for stream in STREAMS {
                let random = RandomStream::new(seed, episode, stream);
                numbers.extend((0..10).map(|index| random.bits(index)));
            }
        }
    }
    assert_eq!(numbers.len(), 10 * 10 * STREAMS.len() * 10);
}

#[test]
fn integers_below_a_count_are_uniform() {
    let random = RandomStream::new(3, 1, Stream::Goal);
    let mut counts = [0_u32; 7];
    for index in 0..70_000 {
        counts[random.below(index, 7)] += 1;
    }
    let chi_square: f64 = counts
        .iter()
        .map(|&n| (f64::from(n) - 10_000.0).powi(2) / 10_000.0)
        .sum();
    // The 99.9 % quantile with 6 degrees of freedom.
    assert!(chi_square < 22.46, "{chi_square}");
    assert_eq!(random.below(0, 0), 0);
}

#[test]
fn streams_are_uncorrelated() {
    let count = 20_000_u64;
    for (i, a) in STREAMS.iter().enumerate() {
        for b in &STREAMS[i + 1..] {
            let [a, b] = [a, b].map(|stream| RandomStream::new(11, 4, *stream));
            let sum: f64 = (0..count)
                .map(|index| (a.uniform(index) - 0.5) * (b.uniform(index) - 0.5))
                .sum();
            let correlation = sum / count as f64 * 12.0;
            // Five standard deviations of the correlation of independent numbers.
            assert!(
                correlation.abs() < 5.0 / (count as f64).sqrt(),
                "{correlation}"
            );
        }
    }
}
