//! Links between crossings along borders.
//!
//! Contract: from each crossing the border between dark and bright is followed along each of its
//! four rays, pixel by pixel, so that it may be curved by a fisheye lens. If it reaches another
//! crossing whose own border returns to the first, with dark on the same side, the two are linked.
//! A border is never followed through a crossing: its dark side changes there. A link is accepted
//! if both ends found each other, or if one did and the other found nothing.

use super::config::LinkConfig;
use super::saddle::Saddle;
use super::smooth::Smooth;

/// The other end of a link: crossing and its returning ray.
pub(super) type End = (usize, usize);

/// Links of every crossing along its four rays.
pub(super) type Links = Vec<[Option<End>; 4]>;

/// Links crossings. Rays are refined at the same time: a border of some length has a better
/// direction than the circle gave.
pub(super) fn join(smooth: &Smooth, saddles: &[Saddle], config: &LinkConfig) -> Links {
    let buckets = Buckets::of(smooth, saddles, config.max_miss_px);
    let found: Links = (0..saddles.len())
        .map(|from| [0, 1, 2, 3].map(|ray| follow(smooth, saddles, &buckets, from, ray, config)))
        .collect();
    let mut links = vec![[None; 4]; saddles.len()];
    for (a, ends) in found.iter().enumerate() {
        for (k, end) in ends.iter().enumerate() {
            let Some((b, j)) = *end else { continue };
            match found[b][j] {
                Some(back) if back == (a, k) => links[a][k] = Some((b, j)),
                // The other end found nothing; another border must not have claimed it first.
                None if links[b][j].is_none() || links[b][j] == Some((a, k)) => {
                    links[a][k] = Some((b, j));
                    links[b][j] = Some((a, k));
                }
                _ => {}
            }
        }
    }
    // Two borders that reached the same ray: neither is accepted.
    for a in 0..links.len() {
        for k in 0..4 {
            if let Some((b, j)) = links[a][k]
                && links[b][j] != Some((a, k))
            {
                links[a][k] = None;
            }
        }
    }
    links
}

fn follow(
    smooth: &Smooth,
    saddles: &[Saddle],
    buckets: &Buckets,
    from: usize,
    ray: usize,
    config: &LinkConfig,
) -> Option<End> {
    let saddle = &saddles[from];
    // The dark side is clockwise (towards larger angles) of an even ray.
    let polarity = if ray.is_multiple_of(2) { 1.0 } else { -1.0 };
    let start = saddle.at.map(|v| v as f32);
    let (sin, cos) = libm::sincosf(saddle.rays[ray] as f32);
    let mut direction = [cos, sin];
    let mut at = [
        start[0] + config.start_px * cos,
        start[1] + config.start_px * sin,
    ];
    let mut travelled = config.start_px;
    let mut unsure = config.start_px;
    // The last reliable position on the border, and one well before it: they give the direction.
    let mut trail = [start; 6];
    let mut steps = 0usize;
    let longest = smooth.width.max(smooth.height) as f32;
    let least = config.min_contrast_ratio * saddle.contrast;
    loop {
        if let Some((to, distance)) = buckets.nearest(saddles, at, from)
            && distance < config.max_miss_px
        {
            let [dx, dy] = [
                saddles[to].at[0] - saddle.at[0],
                saddles[to].at[1] - saddle.at[1],
            ];
            // Not before it is clearly another one.
            if dx * dx + dy * dy > config.min_length_px * config.min_length_px {
                return arrive(saddles, to, ray, direction, config);
            }
        }
        let normal = [-direction[1], direction[0]];
        let sample = |o: f32| smooth.sample(at[0] + o * normal[0], at[1] + o * normal[1]);
        let values = [
            sample(-2.0)?,
            sample(-1.0)?,
            sample(0.0)?,
            sample(1.0)?,
            sample(2.0)?,
        ];
        // Decreases from the bright to the dark side, between neighbouring samples.
        let falls = [0, 1, 2, 3].map(|i| (polarity * (values[i] - values[i + 1])).max(0.0));
        let contrast = polarity * (values[0] - values[4]);
        if contrast > least {
            let sum: f32 = falls.iter().sum();
            let offset = (-1.5 * falls[0] - 0.5 * falls[1] + 0.5 * falls[2] + 1.5 * falls[3]) / sum;
            at = [at[0] + offset * normal[0], at[1] + offset * normal[1]];
            unsure = 0.0;
            // From the sixth last position, or the crossing itself.
            let back = trail[steps % trail.len()];
            trail[steps % trail.len()] = at;
            steps += 1;
            let [dx, dy] = [at[0] - back[0], at[1] - back[1]];
            let length = (dx * dx + dy * dy).sqrt();
            if length > config.min_direction_length_px {
                let turn = [dx / length, dy / length];
                if turn[0] * direction[0] + turn[1] * direction[1] < config.min_cosine {
                    return None;
                }
                direction = turn;
            }
        }
        let [short, long] = config.step_px;
        let pace = if travelled < config.slow_length_px {
            short
        } else {
            long
        };
        at = [at[0] + pace * direction[0], at[1] + pace * direction[1]];
        travelled += pace;
        unsure += pace;
        if unsure > config.max_unsupported_px || travelled > longest {
            return None;
        }
    }
}

/// The ray of a crossing that matches a border which left along `ray`.
fn arrive(
    saddles: &[Saddle],
    to: usize,
    ray: usize,
    direction: [f32; 2],
    config: &LinkConfig,
) -> Option<End> {
    let best = (0..4)
        // The dark side is preserved: an even ray ends in an odd one.
        .filter(|j| (j + ray) % 2 == 1)
        .map(|j| {
            let (sin, cos) = libm::sincos(saddles[to].rays[j]);
            (
                j,
                -(cos * f64::from(direction[0]) + sin * f64::from(direction[1])),
            )
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (best.1 > config.min_arrival_cosine).then_some((to, best.0))
}

/// Crossings by position.
struct Buckets {
    /// Reach of a search, pixels.
    reach: f32,
    columns: usize,
    rows: usize,
    /// Start of each bucket in `members`; one more than there are buckets.
    begins: Vec<u32>,
    members: Vec<u32>,
}

/// Side of a bucket as a power of two, pixels.
const SHIFT: usize = 3;

impl Buckets {
    fn of(smooth: &Smooth, saddles: &[Saddle], reach: f32) -> Self {
        let columns = (smooth.width >> SHIFT) + 1;
        let rows = (smooth.height >> SHIFT) + 1;
        let bucket = |s: &Saddle| {
            let [x, y] = s.at.map(|v| v.max(0.0) as usize >> SHIFT);
            y.min(rows - 1) * columns + x.min(columns - 1)
        };
        let mut begins = vec![0u32; columns * rows + 1];
        for saddle in saddles {
            begins[bucket(saddle) + 1] += 1;
        }
        for i in 1..begins.len() {
            begins[i] += begins[i - 1];
        }
        let mut next = begins.clone();
        let mut members = vec![0; saddles.len()];
        for (i, saddle) in saddles.iter().enumerate() {
            let at = &mut next[bucket(saddle)];
            members[*at as usize] = i as u32;
            *at += 1;
        }
        Self {
            reach,
            columns,
            rows,
            begins,
            members,
        }
    }

    /// The nearest crossing other than `except` within a few pixels, and its distance.
    fn nearest(&self, saddles: &[Saddle], at: [f32; 2], except: usize) -> Option<(usize, f32)> {
        let low = at.map(|v| (v - self.reach).max(0.0) as usize >> SHIFT);
        let high = at.map(|v| (v + self.reach).max(0.0) as usize >> SHIFT);
        let mut best: Option<(usize, f32)> = None;
        for y in low[1]..=high[1].min(self.rows - 1) {
            for x in low[0]..=high[0].min(self.columns - 1) {
                let b = y * self.columns + x;
                for &i in &self.members[self.begins[b] as usize..self.begins[b + 1] as usize] {
                    let i = i as usize;
                    let [dx, dy] = [0, 1].map(|k| saddles[i].at[k] as f32 - at[k]);
                    let distance = (dx * dx + dy * dy).sqrt();
                    if i != except && best.is_none_or(|(_, d)| distance < d) {
                        best = Some((i, distance));
                    }
                }
            }
        }
        best
    }
}
