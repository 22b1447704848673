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

impl Verdicts {
    /// Those of some of the views.
    pub(crate) fn of(&self, views: std::ops::Range<usize>) -> Self {
        Self {
            uncertainty: self.uncertainty[views.clone()].to_vec(),
            flagged: self.flagged[views].to_vec(),
        }
    }
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

#[cfg(test)]
pub(super) mod tests {
    use splats::CoverageImage;

    use super::*;

    /// A view at a distance and angle to the only pose of a training, all pixels alike.
    pub(crate) fn sample(psnr_db: f64, depth_error: f64, pose: [f32; 2], alpha: f32) -> Sample {
        let plane = |value: f32| vec![value; 4];
        Sample {
            errors: Errors {
                offset_m: f64::from(pose[0]),
                angle_deg: f64::from(pose[1]),
                psnr_db,
                depth_error,
                poses: vec![pose],
                pixel_errors: plane(0.1),
            },
            channels: CoverageImage {
                width: 2,
                height: 2,
                alpha: plane(alpha),
                median_depth_m: plane(2.0),
                uncovered: plane(1.0 - alpha),
                angle_rad: plane(0.0),
                few: plane(0.0),
                magnification: plane(0.0),
                space: plane(0.0),
                spread: plane(0.0),
                squared_error: plane(0.001),
                depth_error: plane(0.01),
            },
        }
    }

    #[test]
    fn limits_flag_every_bad_view_and_few_good_ones() {
        let samples = [
            sample(25.0, 0.02, [0.1, 0.0], 1.0),
            sample(22.0, 0.02, [0.3, 10.0], 0.98),
            sample(17.0, 0.02, [1.0, 0.0], 0.8),
            sample(20.0, 0.20, [0.1, 30.0], 0.9),
        ];
        let nearest = Nearest::fitted(&samples).unwrap();
        let found = counts(&samples, &nearest.verdicts(&samples).flagged);
        let expected = Counts {
            bad_flagged: 2,
            bad_unflagged: 0,
            good_flagged: 0,
            good_unflagged: 2,
        };
        assert_eq!(found, expected);
        let published = Nearest::PUBLISHED.verdicts(&samples);
        assert_eq!(counts(&samples, &published.flagged).bad_unflagged, 2);
        let by_alpha = above(&samples, &samples, transparency);
        assert_eq!(counts(&samples, &by_alpha.flagged), expected);
    }
}
