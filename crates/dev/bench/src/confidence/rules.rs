//! Rules that flag a view: ours, and others beside it, each with limits from the walks of the fit.

use splats::MeasureConfig;

use super::samples::{Errors, Sample};

/// A view is bad below this PSNR (dB) or above this median relative error of depth.
pub(crate) const BAD_PSNR_DB: f64 = 18.0;
pub(crate) const BAD_DEPTH_ERROR: f64 = 0.1;

/// Limits of PAWS's rule that are tried: m and degrees.
const DISTANCES_M: [f64; 14] = [
    0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0,
];
const ANGLES_DEG: [f64; 10] = [2.0, 5.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 45.0, 180.0];

impl Errors {
    pub(crate) fn is_bad(&self) -> bool {
        self.psnr_db < BAD_PSNR_DB || self.depth_error > BAD_DEPTH_ERROR
    }
}

/// The verdict of a rule on each view.
#[derive(Clone, Debug)]
pub(crate) struct Verdicts {
    /// Larger where the rule expects more error.
    pub(crate) uncertainty: Vec<f64>,
    pub(crate) flagged: Vec<bool>,
}

/// Good and bad views, with flag and without.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) bad_flagged: usize,
    pub(crate) bad_unflagged: usize,
    pub(crate) good_flagged: usize,
    pub(crate) good_unflagged: usize,
}

/// Counts of a rule's flags.
pub(crate) fn counts(samples: &[Sample], flagged: &[bool]) -> Counts {
    let mut counts = Counts::default();
    for (sample, flagged) in samples.iter().zip(flagged) {
        *match (sample.errors.is_bad(), flagged) {
            (true, true) => &mut counts.bad_flagged,
            (true, false) => &mut counts.bad_unflagged,
            (false, true) => &mut counts.good_flagged,
            (false, false) => &mut counts.good_unflagged,
        } += 1;
    }
    counts
}

/// Our measure.
pub(crate) fn measure(samples: &[Sample], config: &MeasureConfig) -> Verdicts {
    let all = samples
        .iter()
        .map(|sample| sample.channels.confidence(config));
    let (uncertainty, flagged) = all
        .map(|of| (-f64::from(of.psnr_db), of.is_outside))
        .unzip();
    Verdicts {
        uncertainty,
        flagged,
    }
}

/// Limits of PAWS's rule: no pose of the training is nearer and at a smaller angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    pub(crate) distance_m: f64,
    pub(crate) angle_deg: f64,
}

impl Nearest {
    /// The limits that PAWS augments by.
    pub(crate) const PUBLISHED: Self = Self {
        distance_m: 3.0,
        angle_deg: 30.0,
    };

    /// Those of the tried ones that flag every bad sample, and the fewest good ones.
    pub(crate) fn fitted(samples: &[Sample]) -> Option<Self> {
        let all = DISTANCES_M.iter().flat_map(|distance_m| {
            ANGLES_DEG.iter().map(|angle_deg| Self {
                distance_m: *distance_m,
                angle_deg: *angle_deg,
            })
        });
        let counted = all.map(|rule| (counts(samples, &rule.verdicts(samples).flagged), rule));
        let whole = counted.filter(|(counts, _)| counts.bad_unflagged == 0);
        whole
            .min_by_key(|(counts, _)| counts.good_flagged)
            .map(|(_, rule)| rule)
    }

    pub(crate) fn verdicts(&self, samples: &[Sample]) -> Verdicts {
        let all = samples.iter().map(|sample| {
            let poses = sample.errors.poses.iter().map(|[distance_m, angle_deg]| {
                let distance = f64::from(*distance_m) / self.distance_m;
                distance.max(f64::from(*angle_deg) / self.angle_deg)
            });
            poses.fold(f64::INFINITY, f64::min)
        });
        let uncertainty: Vec<f64> = all.collect();
        Verdicts {
            flagged: uncertainty.iter().map(|of| *of > 1.0).collect(),
            uncertainty,
        }
    }
}

/// A rule of one number, flagged above a limit that lets no bad sample of the fit through.
pub(crate) fn above(fit: &[Sample], samples: &[Sample], of: impl Fn(&Sample) -> f64) -> Verdicts {
    let bad = fit.iter().filter(|sample| sample.errors.is_bad());
    let limit = bad.map(&of).fold(f64::INFINITY, f64::min);
    let uncertainty: Vec<f64> = samples.iter().map(of).collect();
    Verdicts {
        flagged: uncertainty.iter().map(|of| *of >= limit).collect(),
        uncertainty,
    }
}

/// Share of the image that no Gaussian gives.
pub(crate) fn transparency(sample: &Sample) -> f64 {
    let alpha = &sample.channels.alpha;
    1.0 - alpha.iter().map(|alpha| f64::from(*alpha)).sum::<f64>() / alpha.len() as f64
}
