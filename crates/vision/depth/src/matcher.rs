//! The whole way from two pictures to a disparity map.

use rayon::prelude::*;

use crate::aggregate::{Aggregation, NONE, Range, Weights};
use crate::band::Band;
use crate::cells::{Alike, Surroundings};
use crate::error::DepthError;
use crate::halved::Halved;
use crate::lanes::Level;
use crate::map::DisparityMap;
use crate::median::median;
use crate::noise;
use crate::picture::Picture;
use crate::settings::Settings;
use crate::settle::Winners;
use crate::sigma::{Evidence, Model};
use crate::speckle::Islands;

/// Matches pairs of one size; keeps its buffers from pair to pair.
///
/// The same pair gives the same map, whatever was matched before, on any number of threads.
#[derive(Debug)]
pub struct Matcher {
    settings: Settings,
    level: Level,
    /// What matches instead, if pictures are made smaller.
    halved: Option<Box<Halved>>,
    model: Model,
    aggregation: Aggregation,
    smoothed: [Vec<u8>; 2],
    settled: Vec<f32>,
    islands: Islands,
    surroundings: Surroundings,
    alike: Alike,
    evidence: Vec<Evidence>,
    keeps_evidence: bool,
    map: DisparityMap,
    seen: Seen,
}

/// What was noticed on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Standard deviation of the noise, grey levels; none in the dark.
    pub noise: Option<f64>,
    /// Whether the settings for noisy pictures were used.
    pub is_noisy: bool,
    /// Pixels of each row whose best disparity is the least or the greatest of the row's band.
    pub at_end: Vec<[u32; 2]>,
}

impl Matcher {
    /// For pictures of `width` x `height` pixels.
    ///
    /// # Errors
    /// [`DepthError::Settings`].
    pub fn new(settings: Settings, width: usize, height: usize) -> Result<Self, DepthError> {
        settings.check()?;
        if width == 0 || height == 0 {
            return Err(DepthError::Settings {
                what: "the size of pictures",
                found: format!("{width} x {height}"),
                expected: "at least 1 x 1".to_owned(),
            });
        }
        let halved = settings
            .half
            .map(|half| Halved::new(settings, half, width, height));
        Ok(Self {
            halved: halved.transpose()?.map(Box::new),
            settings,
            level: settings.level.unwrap_or_else(Level::best),
            model: *Model::of(settings.paths),
            aggregation: Aggregation::default(),
            smoothed: [Vec::new(), Vec::new()],
            settled: Vec::new(),
            islands: Islands::default(),
            surroundings: Surroundings::default(),
            alike: Alike::default(),
            evidence: Vec::new(),
            keeps_evidence: false,
            map: DisparityMap {
                width,
                height,
                disparity: vec![f32::NAN; width * height],
                sigma: vec![f32::NAN; width * height],
            },
            seen: Seen::default(),
        })
    }

    /// With another model of sigma than that of the settings.
    #[must_use]
    pub fn with_model(mut self, model: Model) -> Self {
        self.model = model;
        if let Some(halved) = &mut self.halved {
            halved.matcher.model = model;
        }
        self
    }

    /// Keeps the evidence of each pixel, for who fits a model, and leaves out no disparity for its sigma.
    #[must_use]
    pub fn with_evidence(mut self) -> Self {
        self.keeps_evidence = true;
        if let Some(halved) = &mut self.halved {
            halved.matcher.keeps_evidence = true;
        }
        self
    }

    /// The evidence of each pixel of the last map, of the smaller one where pictures are made smaller; empty unless asked for.
    pub fn evidence(&self) -> &[Evidence] {
        match &self.halved {
            Some(halved) => halved.matcher.evidence(),
            None => &self.evidence,
        }
    }

    /// The last map; nothing is in it before the first pair.
    pub fn map(&self) -> &DisparityMap {
        &self.map
    }

    /// What was noticed in the last pair.
    pub fn seen(&self) -> &Seen {
        &self.seen
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Matches a rectified pair.
    ///
    /// # Errors
    /// [`DepthError::Size`] for pictures of another size; [`DepthError::Band`] for a band with another number of rows.
    pub fn run(
        &mut self,
        left: &Picture<'_>,
        right: &Picture<'_>,
        band: &Band,
    ) -> Result<&DisparityMap, DepthError> {
        let expected = [self.map.width, self.map.height];
        for (eye, picture) in [("left", left), ("right", right)] {
            let found = [picture.width(), picture.height()];
            if found != expected {
                return Err(DepthError::Size {
                    eye,
                    found,
                    expected,
                });
            }
        }
        if band.height() != left.height() {
            return Err(DepthError::Band {
                found: format!("{} rows", band.height()),
                expected: format!("{}, as the pictures have", left.height()),
            });
        }
        let noise = noise::estimate(left);
        match &mut self.halved {
            None => self.run_through(left, right, band, noise)?,
            Some(halved) => {
                let to = (&mut self.map, &mut self.seen);
                halved.run(left, right, band, noise, to)?;
            }
        }
        Ok(&self.map)
    }

    /// Matches a pair of the right size, with so much noise.
    pub(crate) fn run_through(
        &mut self,
        left: &Picture<'_>,
        right: &Picture<'_>,
        band: &Band,
        noise: Option<f64>,
    ) -> Result<(), DepthError> {
        self.seen.noise = noise;
        self.aggregate(left, right, band)?;
        self.settle(band);
        self.judge(left, right);
        Ok(())
    }

    fn aggregate(
        &mut self,
        left: &Picture<'_>,
        right: &Picture<'_>,
        band: &Band,
    ) -> Result<(), DepthError> {
        let settings = &self.settings;
        self.seen.is_noisy = self.seen.noise.is_some_and(|noise| noise >= settings.noise);
        let matching = match self.seen.is_noisy {
            true => settings.noisy,
            false => settings.clear,
        };
        let weights = Weights {
            census: matching.census,
            grey: matching.grey,
            paths: settings.paths,
            penalties: matching.penalties,
        };
        let range = Range {
            first: band.first(),
            count: band.count(),
            rows: band.lanes(),
        };
        if !matching.smooth {
            self.aggregation
                .run(self.level, weights, [left, right], range);
            return Ok(());
        }
        let [of_left, of_right] = &mut self.smoothed;
        rayon::join(
            || noise::smooth(left, of_left),
            || noise::smooth(right, of_right),
        );
        let (width, height) = (self.map.width, self.map.height);
        let left = Picture::new(width, height, of_left)?;
        let right = Picture::new(width, height, of_right)?;
        self.aggregation
            .run(self.level, weights, [&left, &right], range);
        Ok(())
    }

    /// Winners to disparities; and how many of them are at an end of the band.
    fn settle(&mut self, band: &Band) {
        let width = self.map.width;
        let winners = &self.aggregation.winners;
        let winners_of_both = Winners {
            width,
            first: band.first(),
            left: winners,
            right: &self.aggregation.right,
            apart: self.settings.apart,
            unique: self.settings.unique,
        };
        winners_of_both.settle(&mut self.settled);
        if self.settings.median {
            median(self.level, width, &self.settled, &mut self.map.disparity);
        } else {
            self.map.disparity.clone_from(&self.settled);
        }
        let (step, least) = (self.settings.island_step, self.settings.island);
        self.islands
            .remove(width, &mut self.map.disparity, step, least);
        let rows = band.lanes().par_iter().zip(winners.par_chunks_exact(width));
        let kept = self.map.disparity.par_chunks_exact(width);
        let at_end = rows.zip(kept).map(|(([low, high], winners), kept)| {
            let mut count = [0; 2];
            for (winner, kept) in winners.iter().zip(kept) {
                if winner.lane != NONE && !kept.is_nan() {
                    count[0] += u32::from(winner.lane == *low);
                    count[1] += u32::from(winner.lane + 1 == *high);
                }
            }
            count
        });
        self.seen.at_end.clear();
        self.seen.at_end.par_extend(at_end);
    }

    /// Gives each disparity its sigma, and takes out what nobody can tell.
    fn judge(&mut self, left: &Picture<'_>, right: &Picture<'_>) {
        let width = self.map.width;
        self.surroundings.look(width, &self.map.disparity);
        self.alike.look(left, right, &self.map.disparity);
        let settings = &self.settings;
        let keeps = self.keeps_evidence;
        let rows = self.map.disparity.par_chunks_exact_mut(width);
        let rows = rows.zip(self.map.sigma.par_chunks_exact_mut(width));
        let rows = rows.zip(self.aggregation.winners.par_chunks_exact(width));
        let (near, alike, model) = (&self.surroundings.near, &self.alike.near, &self.model);
        rows.enumerate()
            .for_each(|(y, ((disparities, sigmas), winners))| {
                for x in 0..width {
                    sigmas[x] = f32::NAN;
                    if disparities[x].is_nan() {
                        continue;
                    }
                    let evidence = Evidence::new(settings.paths, &winners[x], near.at(x, y));
                    let sigma = model.sigma_px(&evidence);
                    let is_alike = alike.at(x, y) >= settings.least_alike;
                    if !is_alike || (sigma > settings.largest_sigma && !keeps) {
                        disparities[x] = f32::NAN;
                    } else {
                        sigmas[x] = sigma;
                    }
                }
            });
        self.evidence.clear();
        if keeps {
            let winners = self.aggregation.winners.iter().enumerate();
            let of =
                |(i, winner)| Evidence::new(settings.paths, winner, near.at(i % width, i / width));
            self.evidence.extend(winners.map(of));
        }
    }
}
