//! Pairing of two streams of one eye each, by time alone: for cameras with independent counters.
//!
//! Contract: each stream comes in its own order, with increasing times; pairs come out in that
//! order. Two images are a pair if their times are within a limit that is less than half a period
//! ([`limit_ns`]), so an image has at most one partner. Nothing is moved and nothing invented: an
//! image without a partner comes out unpaired, as soon as an image of the other eye is later than
//! it by more than the limit, at the latest when [`MAX_WAITING_IMAGES`] later images of its own eye
//! have arrived. Free-running cameras drift relative to each other; while their difference exceeds
//! the limit every image comes out unpaired.

use std::collections::VecDeque;

use video::capture::Eye;

/// Maximum number of images of one eye that wait for the other.
const MAX_WAITING_IMAGES: usize = 3;

/// An image of one eye.
#[derive(Debug)]
pub(super) struct TimedImage<T> {
    /// Capture time, ns; on one clock for both eyes.
    pub(super) time_ns: i64,
    /// The image.
    pub(super) of: T,
}

/// Output of the pairing.
#[derive(Debug)]
pub(super) enum PairingOutput<T> {
    /// Left and right.
    Both(TimedImage<T>, TimedImage<T>),
    /// An image of one eye without a partner.
    Unpaired(Eye, TimedImage<T>),
}

/// Pairs images. See the module.
#[derive(Debug)]
pub(super) struct ImagePairer<T> {
    within_ns: i64,
    left: VecDeque<TimedImage<T>>,
    right: VecDeque<TimedImage<T>>,
}

/// Maximum time difference of a pair: the configured one, else half a period less a tenth of one.
///
/// # Errors
/// The configured one is too large; the message contains the maximum.
pub(crate) fn limit_ns(rate_hz: f64, configured_ns: Option<i64>) -> Result<i64, String> {
    let max = (0.4e9 / rate_hz).round() as i64;
    match configured_ns {
        Some(configured) if configured > max => Err(format!(
            "pair_within_ms is {:.1}, expected at most {:.1}, which is half a period at {rate_hz:.1} Hz less a tenth \
             of one: with more, an image could belong to two others",
            configured as f64 * 1e-6,
            max as f64 * 1e-6
        )),
        Some(configured) => Ok(configured),
        None => Ok(max),
    }
}

/// Reason why an image of `eye` is not recorded: the same sentence for every image of the stream,
/// so that gap records can be merged.
pub(super) fn alone(eye: Eye, within_ns: i64) -> String {
    let (here, missing) = match eye {
        Eye::Left => ("left", "right"),
        Eye::Right => ("right", "left"),
    };
    format!(
        "no {missing} image was taken within {:.1} ms of the {here} one",
        within_ns as f64 * 1e-6
    )
}

impl<T> ImagePairer<T> {
    pub(super) fn new(within_ns: i64) -> Self {
        Self {
            within_ns,
            left: VecDeque::new(),
            right: VecDeque::new(),
        }
    }

    /// Maximum time difference of a pair, ns.
    pub(super) fn within_ns(&self) -> i64 {
        self.within_ns
    }

    /// Takes an image and outputs the decided ones.
    pub(super) fn push(
        &mut self,
        eye: Eye,
        image: TimedImage<T>,
        mut out: impl FnMut(PairingOutput<T>),
    ) {
        self.side(eye).push_back(image);
        while let (Some(left), Some(right)) = (self.left.front(), self.right.front()) {
            let later_ns = right.time_ns.saturating_sub(left.time_ns);
            if later_ns.saturating_abs() <= self.within_ns {
                if let (Some(left), Some(right)) = (self.left.pop_front(), self.right.pop_front()) {
                    out(PairingOutput::Both(left, right));
                }
                continue;
            }
            let eye = if later_ns > 0 { Eye::Left } else { Eye::Right };
            self.give_up(eye, &mut out);
        }
        for eye in [Eye::Left, Eye::Right] {
            while self.side(eye).len() > MAX_WAITING_IMAGES {
                self.give_up(eye, &mut out);
            }
        }
    }

    /// Outputs the waiting images.
    pub(super) fn finish(&mut self, mut out: impl FnMut(PairingOutput<T>)) {
        for eye in [Eye::Left, Eye::Right] {
            while !self.side(eye).is_empty() {
                self.give_up(eye, &mut out);
            }
        }
    }

    fn side(&mut self, eye: Eye) -> &mut VecDeque<TimedImage<T>> {
        match eye {
            Eye::Left => &mut self.left,
            Eye::Right => &mut self.right,
        }
    }

    /// Outputs the oldest image of `eye` as unpaired.
    fn give_up(&mut self, eye: Eye, out: &mut impl FnMut(PairingOutput<T>)) {
        if let Some(image) = self.side(eye).pop_front() {
            out(PairingOutput::Unpaired(eye, image));
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Times of pairs, and of unpaired images, in output order.
    type PairingTimes = (Vec<(i64, i64)>, Vec<(Eye, i64)>);

    fn pair(within_ns: i64, images: &[(Eye, i64)]) -> PairingTimes {
        let mut pairs = ImagePairer::new(within_ns);
        let (mut both, mut alone) = (Vec::new(), Vec::new());
        let mut out = |paired: PairingOutput<()>| match paired {
            PairingOutput::Both(left, right) => both.push((left.time_ns, right.time_ns)),
            PairingOutput::Unpaired(eye, image) => alone.push((eye, image.time_ns)),
        };
        for &(eye, time_ns) in images {
            pairs.push(eye, TimedImage { time_ns, of: () }, &mut out);
        }
        pairs.finish(&mut out);
        (both, alone)
    }

    #[test]
    fn limits_are_less_than_half_a_period() {
        assert_eq!(limit_ns(30.0, None), Ok(13_333_333));
        assert_eq!(limit_ns(30.0, Some(2_000_000)), Ok(2_000_000));
        let error = limit_ns(30.0, Some(20_000_000)).expect_err("too much");
        assert!(error.contains("is 20.0, expected at most 13.3"), "{error}");
    }

    #[test]
    fn image_lost_on_one_side_leaves_the_other_unpaired() {
        let images: Vec<(Eye, i64)> = (0..30)
            .flat_map(|n| [(Eye::Left, n * 100), (Eye::Right, n * 100 + 7)])
            .filter(|image| !matches!(image, (Eye::Left, 300) | (Eye::Right, 507 | 607)))
            .collect();
        let (both, alone) = pair(40, &images);
        assert_eq!(both.len(), 27);
        assert!(both.iter().all(|(left, right)| right - left == 7));
        assert_eq!(
            alone,
            [(Eye::Right, 307), (Eye::Left, 500), (Eye::Left, 600)]
        );
    }

    #[test]
    fn cameras_that_run_freely_pair_while_they_are_close() {
        // 1 % difference of the periods: they drift through each other once in a hundred images.
        let mut images: Vec<(Eye, i64)> = (0..300).map(|n| (Eye::Left, n * 1000)).collect();
        images.extend((0..300).map(|n| (Eye::Right, n * 1010)));
        images.sort_by_key(|image| image.1);
        let (both, alone) = pair(400, &images);
        assert!(
            both.iter()
                .all(|(left, right)| left.abs_diff(*right) <= 400)
        );
        // Four fifths of a cycle are within the limit.
        assert!((220..=260).contains(&both.len()), "{}", both.len());
        assert_eq!(2 * both.len() + alone.len(), 600);
    }

    #[test]
    fn few_images_wait_for_a_silent_eye() {
        let mut pairs = ImagePairer::new(40);
        let mut alone = 0;
        for n in 0..10 {
            let image = TimedImage {
                time_ns: n * 100,
                of: (),
            };
            pairs.push(Eye::Left, image, |_| alone += 1);
            assert_eq!(alone, (n as usize + 1).saturating_sub(MAX_WAITING_IMAGES));
        }
    }

    proptest! {
        /// For any input, every image comes out once, and pairs are within the limit and in order.
        #[test]
        fn every_image_comes_out_once(steps in prop::collection::vec((any::<bool>(), 1_i64..150), 0..200)) {
            let mut times = [0, 0];
            let images: Vec<(Eye, i64)> = steps.iter().map(|(left, step)| {
                let side = usize::from(!left);
                times[side] += step;
                (if *left { Eye::Left } else { Eye::Right }, times[side])
            }).collect();
            let (both, alone) = pair(40, &images);
            prop_assert_eq!(2 * both.len() + alone.len(), images.len());
            prop_assert!(both.iter().all(|(left, right)| left.abs_diff(*right) <= 40));
            prop_assert!(both.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 < w[1].1));
        }
    }
}
