//! One run of a device clock without a step: its samples, the present line, and the vertices of
//! earlier lines.

use std::collections::VecDeque;

use session_archive::time::{HostTime, TickLength};

use super::config::{Config, VertexConfig};
use super::fit::{Fit, Line, Scratch, Terms, fit};
use super::hull::{Block, Point};
use super::map::{Model, Segment};

/// Maximum number of blocks, which bounds memory (40 KiB) and the longest window of one line.
const MAX_BLOCKS: usize = 256;
/// Maximum number of past vertices.
const MAX_VERTICES: usize = 512;

/// One pair of device time and arrival, ns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub device_ns: i64,
    pub arrival: i64,
}

/// A vertex of the map's polyline, with its sigma.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    x: f64,
    lag: f64,
    sigma: f64,
}

/// A run of the device clock. Device times must grow from sample to sample.
#[derive(Clone, Debug)]
pub(super) struct Epoch {
    origin: Sample,
    terms: Terms,
    blocks: VecDeque<Block>,
    samples: u64,
    fit: Fit,
    past: Vec<Vertex>,
    scratch: Scratch,
}

impl Epoch {
    /// Starts with one sample; the sigma of its offset is the expected jitter.
    pub(super) fn starting(origin: Sample, terms: Terms, config: &Config) -> Self {
        let mut epoch = Self {
            origin,
            terms,
            blocks: VecDeque::from([Block::starting(Point::default())]),
            samples: 1,
            fit: Fit::default(),
            past: Vec::new(),
            scratch: Scratch::default(),
        };
        epoch.refit(0.0, config);
        epoch
    }

    /// A sample in the epoch's own coordinates.
    pub(super) fn point(&self, sample: Sample) -> Point {
        let x = i128::from(sample.device_ns) - i128::from(self.origin.device_ns);
        let y = i128::from(sample.arrival) - i128::from(self.origin.arrival);
        Point {
            x: x as f64,
            lag: (y - x) as f64,
        }
    }

    /// Adds a sample beyond [`Epoch::newest_x`]; true if the line should be fitted again.
    pub(super) fn push(&mut self, p: Point, config: &Config) -> bool {
        let config = &config.blocks;
        self.samples += 1;
        let line = &self.fit.line;
        let much_lower = p.lag < line.lag(p.x) - config.refit_sigmas * line.sigma(p.x, 0.0);
        let open = self
            .blocks
            .back_mut()
            .expect("an epoch has a block from its start");
        let long_enough = open.count >= config.min_samples
            && p.x - open.first_x() >= config.min_duration_ns
            || open.is_full();
        if !long_enough {
            open.push(p);
            return much_lower || self.samples <= config.initial_samples;
        }
        if self.blocks.len() == MAX_BLOCKS {
            self.blocks.pop_front();
        }
        self.blocks.push_back(Block::starting(p));
        true
    }

    /// Fits the line to the present samples. At most some 1000 points are used.
    pub(super) fn refit(&mut self, min_sigma: f64, config: &Config) {
        self.terms.min_sigma = min_sigma;
        let old = self.fit.line;
        self.fit = fit(&self.blocks, &self.terms, &config.fit, &mut self.scratch);
        if self.samples > 1 {
            self.keep_past(&old, &config.vertices);
        }
    }

    /// Keeps earlier lines as vertices, where the new line does not reach.
    fn keep_past(&mut self, old: &Line, config: &VertexConfig) {
        let new = &self.fit.line;
        if new.from_x <= 0.0 {
            self.past.clear();
            return;
        }
        let span = new.to_x - new.from_x;
        if self.past.is_empty() {
            self.past.push(vertex(old, 0.0));
        }
        // Vertices stay behind the middle of the window, where a line is best determined, and are
        // replaced where the new line is better: after a small step, for example.
        let refuted = |v: &Vertex| {
            let sigma = new.sigma(v.x, 0.0);
            let apart = (v.lag - new.lag(v.x)).abs();
            v.x > new.from_x
                && (v.sigma > config.max_sigma_ratio * sigma
                    || apart > config.max_error_sigmas * v.sigma.hypot(sigma))
        };
        let given_up = self.past.iter().position(refuted).unwrap_or(usize::MAX);
        let ahead = self
            .past
            .partition_point(|v| v.x <= new.x_ref - span * config.min_distance_ratio);
        self.past.truncate(given_up.min(ahead).max(1));
        let last_x = self.past[self.past.len() - 1].x;
        let next_x = new.x_ref - span * config.new_distance_ratio;
        if given_up < usize::MAX && new.from_x > last_x {
            self.past.push(vertex(new, new.from_x));
        } else if new.from_x > old.x_ref && new.from_x > last_x {
            // The rate changed; the old line holds up to here.
            self.past.push(vertex(old, new.from_x));
        } else if next_x - last_x > span * config.min_spacing_ratio {
            self.past.push(vertex(new, next_x));
        }
        if self.past.len() > MAX_VERTICES {
            self.past = simplify(&self.past);
            let excess = self.past.len().saturating_sub(MAX_VERTICES * 3 / 4);
            self.past.drain(..excess);
        }
    }

    /// Lag and its sigma at any device time, by present knowledge.
    pub(super) fn best(&self, x: f64) -> (f64, f64) {
        let line = &self.fit.line;
        let next = self.past.partition_point(|v| v.x <= x);
        let Some(before) = next.checked_sub(1).map(|i| self.past[i]) else {
            return (line.lag(x), line.sigma(x, 0.0));
        };
        let after = match self.past.get(next) {
            Some(&after) => after,
            None if x >= line.x_ref => return (line.lag(x), line.sigma(x, 0.0)),
            None => vertex(line, line.x_ref),
        };
        let sigma = before.sigma.max(after.sigma);
        if x >= line.from_x && line.sigma(x, 0.0) < sigma {
            return (line.lag(x), line.sigma(x, 0.0));
        }
        let along = (x - before.x) / (after.x - before.x);
        (before.lag + along * (after.lag - before.lag), sigma)
    }

    /// Last arrival that confirms a line: the last time samples were within `height` of it, up to
    /// device time `x`.
    pub(super) fn last_touch(&self, line: &Line, x: f64, height: f64) -> HostTime {
        let at_zero = line.lag(0.0);
        let touch = |b: &&Block| b.first_x() < x && b.lowest_above(at_zero, line.rate) < height;
        self.arrival(
            self.blocks
                .iter()
                .rev()
                .find(touch)
                .map_or(0.0, Block::first_x),
        )
    }

    /// The present line.
    pub(super) fn line(&self) -> &Line {
        &self.fit.line
    }

    /// Device time of the newest sample.
    pub(super) fn newest_x(&self) -> f64 {
        self.blocks.back().map_or(0.0, Block::last_x)
    }

    /// Whether there are enough samples that the line's sigma is measured and no longer assumed.
    pub(super) fn settled(&self, config: &Config) -> bool {
        self.blocks.len() > config.fit.min_blocks
    }

    /// Samples pushed.
    pub(super) fn samples(&self) -> u64 {
        self.samples
    }

    /// Mean host time between samples, ns.
    pub(super) fn period(&self) -> f64 {
        self.newest_x() / self.samples.saturating_sub(1).max(1) as f64
    }

    /// Terms for later epochs of this clock.
    pub(super) fn terms_for_next(&self, config: &Config) -> Terms {
        let mut terms = self.terms;
        if self.settled(config) {
            terms.prior.expected = self.fit.line.rate;
        }
        terms
    }

    /// Host time of the earliest possible arrival of device time `x`.
    pub(super) fn arrival(&self, x: f64) -> HostTime {
        HostTime(self.origin.arrival).saturating_add((x + self.fit.line.lag(x)).round() as i64)
    }

    /// Device time whose earliest possible arrival is `arrival`, ns.
    pub(super) fn device_ns_at(&self, arrival: i64) -> i64 {
        let since = arrival.saturating_sub(self.origin.arrival);
        let lag = self.fit.line.lag(since as f64);
        let lag = self.fit.line.lag(since as f64 - lag);
        self.origin
            .device_ns
            .saturating_add(since)
            .saturating_sub(lag.round() as i64)
    }

    /// Model that the samples support.
    pub(super) fn model(&self) -> Model {
        match (self.past.is_empty(), self.fit.constant) {
            (false, _) => Model::Piecewise,
            (true, true) => Model::Constant,
            (true, false) => Model::Affine,
        }
    }

    /// The map as segments, no more of them than the sigmas justify.
    pub(super) fn segments(&self, tick: TickLength, config: &Config) -> Vec<Segment> {
        let line = &self.fit.line;
        let now = vertex(line, line.x_ref);
        let mut vertices = self.past.clone();
        let min_length = (line.to_x - line.from_x) * config.vertices.min_segment_ratio;
        vertices.retain(|v| v.x < now.x - min_length);
        let from = vertices.first().map_or(0.0, |v| v.x);
        vertices.push(now);
        let vertices = simplify(&vertices);
        let mut segments: Vec<Segment> = vertices
            .windows(2)
            .map(|pair| {
                let rate = (pair[1].lag - pair[0].lag) / (pair[1].x - pair[0].x);
                let sigma = pair[0].sigma.max(pair[1].sigma);
                self.segment(tick, pair[0].x, Vertex { sigma, ..pair[0] }, rate, 0.0)
            })
            .collect();
        let live_from = if segments.is_empty() { from } else { now.x };
        segments.push(self.segment(tick, live_from, now, line.rate, line.sigma_rate));
        segments
    }

    fn segment(
        &self,
        tick: TickLength,
        from_x: f64,
        at: Vertex,
        rate: f64,
        sigma_rate: f64,
    ) -> Segment {
        let ticks = |x: f64| ticks_at(tick, self.origin.device_ns.saturating_add(x.round() as i64));
        let ticks_ref = ticks(at.x);
        let device_ns = tick.ns(ticks_ref).unwrap_or(self.origin.device_ns);
        let since = device_ns.saturating_sub(self.origin.device_ns);
        let lag = at.lag + rate * (since as f64 - at.x);
        Segment {
            ticks_from: ticks(from_x),
            ticks_ref,
            host_ref: HostTime(self.origin.arrival)
                .saturating_add(since)
                .saturating_add(lag.round() as i64),
            rate_ppb: rate * 1e9,
            sigma_ns: at.sigma.ceil() as u64,
            rate_sigma_ppb: sigma_rate * 1e9,
        }
    }
}

fn vertex(line: &Line, x: f64) -> Vertex {
    Vertex {
        x,
        lag: line.lag(x),
        sigma: line.sigma(x, 0.0),
    }
}

/// The tick at a device time, rounded down.
pub(super) fn ticks_at(tick: TickLength, device_ns: i64) -> i64 {
    let ticks = (i128::from(device_ns) * i128::from(tick.den)).div_euclid(i128::from(tick.num));
    ticks.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}

/// Removes every vertex that a straight line between its neighbors replaces within its sigma.
///
/// From a kept vertex the next one is the farthest that all vertices between permit: each narrows
/// the cone of slopes to its own sigma. One pass.
fn simplify(vertices: &[Vertex]) -> Vec<Vertex> {
    let mut kept = Vec::with_capacity(vertices.len());
    let mut next = 0;
    while next < vertices.len() {
        let start = vertices[next];
        kept.push(start);
        let (mut lowest, mut highest) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut farthest = next + 1;
        for (i, v) in vertices.iter().enumerate().skip(next + 1) {
            let run = v.x - start.x;
            let slope = (v.lag - start.lag) / run;
            if (lowest..=highest).contains(&slope) {
                farthest = i;
            }
            lowest = lowest.max(slope - v.sigma / run);
            highest = highest.min(slope + v.sigma / run);
            if lowest > highest {
                break;
            }
        }
        next = farthest;
    }
    kept
}
