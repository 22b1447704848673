//! Imperfect walks: what real stereo cameras and scenes add to simulated pairs, made by the
//! simulator, in light and before the noise.

use rig_sim::scene::Scenery;
use rig_sim::simulation::{EyeDifference, Imaging};

/// What the simulator adds to a walk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Imperfection {
    /// Name.
    pub(super) name: &'static str,
    /// Difference of the eyes, and codec.
    pub(super) imaging: Imaging,
    /// Rotation of the right eye against its calibration, degrees: about x, y, z of its frame.
    pub(super) right_rotation_deg: [f64; 3],
    /// Fence and gloss.
    pub(super) scenery: Scenery,
}

const NO_SCENERY: Scenery = Scenery {
    fence_spacing_m: 0.0,
    gloss: 0.0,
};

/// A walk as it is.
pub(super) const NONE: Imperfection = Imperfection {
    name: "",
    imaging: Imaging::USUAL,
    right_rotation_deg: [0.0; 3],
    scenery: NO_SCENERY,
};

/// Walks to test with. With 672 columns the rotations are 0.4 px of rows, 0.1 px of disparity, and
/// up to 0.8 px of rows at the left and right border.
pub(super) const FOR_TEST: [Imperfection; 6] = [
    Imperfection {
        name: "eyes differ",
        imaging: Imaging {
            right_eye: EyeDifference {
                blur_px: 0.6,
                vignetting: 0.2,
                gain: 0.08,
            },
            ..Imaging::USUAL
        },
        ..NONE
    },
    Imperfection {
        name: "rectification",
        right_rotation_deg: [0.065, 0.016, 0.13],
        ..NONE
    },
    Imperfection {
        name: "codec",
        imaging: Imaging {
            codec_step: 6.0,
            ..Imaging::USUAL
        },
        ..NONE
    },
    Imperfection {
        name: "fence",
        scenery: Scenery {
            fence_spacing_m: 0.12,
            ..NO_SCENERY
        },
        ..NONE
    },
    Imperfection {
        name: "glossy ground",
        scenery: Scenery {
            gloss: 0.5,
            ..NO_SCENERY
        },
        ..NONE
    },
    Imperfection {
        name: "all at half strength",
        imaging: Imaging {
            right_eye: EyeDifference {
                blur_px: 0.3,
                vignetting: 0.1,
                gain: 0.04,
            },
            codec_step: 3.0,
            ..Imaging::USUAL
        },
        right_rotation_deg: [0.032, 0.008, 0.065],
        scenery: Scenery {
            fence_spacing_m: 0.24,
            gloss: 0.25,
        },
    },
];

#[cfg(test)]
mod tests {
    use depth::{Band, Config, Matcher};
    use rig_sim::camera::Quality;
    use rig_sim::scene::{Kind, Lighting};

    use super::super::coverage::Coverage;
    use super::super::frames::Walk;
    use super::super::peers::{Peers, SgbmConfig};
    use super::super::race::Race;
    use super::*;

    /// A pair of a walk that `bench depth` does not use, with each imperfection.
    #[test]
    fn bad_disparities_are_fewer_than_of_opencv_at_its_density() {
        let mut peers = match Peers::start() {
            Ok(peers) => peers,
            Err(reason) => return eprintln!("skipped: {reason:#}"),
        };
        let mut coverage = Coverage::default();
        for imperfection in &FOR_TEST {
            let size = [480, 272];
            let walk = Walk::new(
                Kind::Pavement,
                Lighting::Day,
                12,
                8.0,
                size,
                Quality::FAST,
                imperfection,
            );
            let walk = walk.expect("a walk");
            let frames = walk.frames(0, &[60]).expect("a pair");
            let [frame] = &frames[..] else {
                panic!("found {} pairs, expected 1", frames.len());
            };
            let race = Race::run(&mut peers, &SgbmConfig::few(), &[frame], 1).expect("matches");
            race.print(imperfection.name);
            let worse = race.less_accurate_than();
            assert!(worse.is_empty(), "{}: {worse:?}", imperfection.name);

            let [left, right] = frame.images();
            let mut matcher =
                Matcher::new(Config::default(), frame.width, frame.height).expect("a size");
            let band = Band::full(0, frame.range, frame.height).expect("a range");
            coverage.add(matcher.run(&left, &right, &band).expect("a map"), frame);
        }
        let shares = coverage.shares();
        println!("within two sigmas: {:?}", shares.quarters);
        let least = shares.quarters.into_iter().fold(1.0, f64::min);
        assert!(least > 0.90, "{:?}", shares.quarters);
        assert!(shares.median_sigma < 0.5, "{}", shares.median_sigma);
    }
}
