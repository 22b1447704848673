//! Whether memory, files and threads of this process stay as they are over many calls.

use std::fs;

use anyhow::{Context, Result};
use harness::soak::memory;
use serde_json::{Value, json};

/// Share of the samples in which caches of the allocator fill.
const WARM_SHARE: usize = 10;

/// Samples at equal distances.
#[derive(Debug, Default)]
pub(crate) struct Samples(Vec<Sample>);

#[derive(Clone, Copy, Debug)]
struct Sample {
    resident_bytes: u64,
    files: usize,
    threads: usize,
}

impl Samples {
    /// Takes a sample of this process.
    ///
    /// # Errors
    /// The system does not report it.
    pub(crate) fn take(&mut self) -> Result<()> {
        self.0.push(Sample {
            resident_bytes: memory()?.resident,
            files: entries("fd")?,
            threads: entries("task")?,
        });
        Ok(())
    }

    /// Memory in the first and last sample, bytes.
    pub(crate) fn resident_bytes(&self) -> Option<[u64; 2]> {
        let bytes = |sample: &Sample| sample.resident_bytes;
        Some([bytes(self.0.first()?), bytes(self.0.last()?)])
    }

    /// Memory in all samples, MB.
    pub(crate) fn megabytes(&self) -> Vec<f64> {
        let samples = self.0.iter();
        samples
            .map(|own| own.resident_bytes as f64 * 1e-6)
            .collect()
    }

    /// Slope of the memory without the first tenth, bytes per unit, given the number of units
    /// between two samples.
    pub(crate) fn bytes_per_unit(&self, units_per_sample: f64) -> f64 {
        let points: Vec<(f64, f64)> = self
            .settled()
            .iter()
            .enumerate()
            .map(|(at, own)| (at as f64 * units_per_sample, own.resident_bytes as f64))
            .collect();
        slope(&points)
    }

    /// Least and most open files without the first tenth.
    pub(crate) fn files(&self) -> Value {
        self.range(|own| own.files)
    }

    /// Least and most threads without the first tenth.
    pub(crate) fn threads(&self) -> Value {
        self.range(|own| own.threads)
    }

    fn range(&self, of: fn(&Sample) -> usize) -> Value {
        let values = || self.settled().iter().map(of);
        json!([values().min(), values().max()])
    }

    fn settled(&self) -> &[Sample] {
        &self.0[self.0.len() / WARM_SHARE..]
    }
}

/// Slope of the line of least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let variance: f64 = points.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
    covariance / variance
}

/// Entries of a folder of `/proc/self`.
fn entries(folder: &str) -> Result<usize> {
    let path = format!("/proc/self/{folder}");
    let listed = fs::read_dir(&path).with_context(|| format!("reading {path}"))?;
    Ok(listed.count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_grows_has_its_slope_without_the_warm_up() {
        let sample = |resident_bytes: u64| Sample {
            resident_bytes,
            files: 3,
            threads: 2,
        };
        let growing = (0..40).map(|n| sample(if n < 4 { 1_000_000 } else { 5_000 + 70 * n }));
        let samples = Samples(growing.collect());
        assert!((samples.bytes_per_unit(7.0) - 10.0).abs() < 1e-6);
        assert_eq!(samples.resident_bytes(), Some([1_000_000, 7_730]));
        assert_eq!(samples.megabytes()[0], 1.0);
        assert_eq!(samples.files(), json!([3, 3]));
    }
}
