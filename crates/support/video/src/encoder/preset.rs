//! How hard x264 works on a frame, and how hard it may work on this many pixels per second.
//!
//! A slower preset makes smaller files of the same quality. The table says what each preset costs
//! at 42 dB: processor time per megapixel on one core of the build machine (AMD EPYC, 2026-11-25),
//! measured by `cargo run --release -p video --example quality 42` on the hardest of its four
//! clips, a texture without smooth areas. KITTI's street costs 7.3, 21.3 and 29.4 ms, EuRoC's room
//! 4.6, 7.4 and 12.9 ms. A preset is taken if all cameras together need at most a quarter of two
//! such cores: the other three quarters are for the sources, the disk, other programs and slower
//! machines. The choice is a function of the pixel rate alone. It depends neither on the number of
//! cores nor on their speed, so the same rig gives the same bytes everywhere; a load that proves
//! too high is reduced while recording.

/// How much of two cores all encoders together may need by the table: a head room of four.
const SHARE: f64 = 2.0 / 4.0;

/// x264's `speed-preset`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Preset {
    /// The cheapest: no deblocking, no CABAC, 16x16 motion blocks.
    #[default]
    Ultrafast,
    /// CABAC and smaller blocks.
    Superfast,
    /// More motion search.
    Veryfast,
}

/// One row of the table.
struct Cost {
    preset: Preset,
    name: &'static str,
    /// Processor time per megapixel of luma at 42 dB, ms; see the module.
    ms_per_megapixel: f64,
    /// See `gain_db` in the table of encoders.
    gain_db: f64,
}

/// Best first.
const COSTS: [Cost; 3] = [
    Cost {
        preset: Preset::Veryfast,
        name: "veryfast",
        ms_per_megapixel: 31.7,
        gain_db: -1.5,
    },
    Cost {
        preset: Preset::Superfast,
        name: "superfast",
        ms_per_megapixel: 25.1,
        gain_db: -1.5,
    },
    Cost {
        preset: Preset::Ultrafast,
        name: "ultrafast",
        ms_per_megapixel: 9.2,
        gain_db: -1.5,
    },
];

impl Preset {
    /// All of them, cheapest first.
    pub const ALL: [Preset; 3] = [Preset::Ultrafast, Preset::Superfast, Preset::Veryfast];

    /// The best preset for luma pixels per second of all cameras together; the cheapest if none has
    /// the head room.
    pub(crate) fn for_load(pixels_per_s: f64) -> Preset {
        let cores = |cost: &Cost| cost.ms_per_megapixel * 1e-3 * pixels_per_s * 1e-6;
        let fits = COSTS.iter().find(|cost| cores(cost) <= SHARE);
        fits.map_or(Preset::Ultrafast, |cost| cost.preset)
    }

    /// What x264 calls it.
    pub fn name(self) -> &'static str {
        self.cost().name
    }

    pub(super) fn gain_db(self) -> f64 {
        self.cost().gain_db
    }

    fn cost(self) -> &'static Cost {
        let row = COSTS.iter().find(|cost| cost.preset == self);
        row.expect("every preset has a row")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_pixels_never_get_a_slower_preset() {
        let mut before = Preset::Veryfast;
        for megapixels in 0..200 {
            let preset = Preset::for_load(f64::from(megapixels) * 1e6);
            assert!(preset <= before, "{megapixels}");
            before = preset;
        }
        assert_eq!(Preset::for_load(0.0), Preset::Veryfast);
        assert_eq!(before, Preset::Ultrafast);
        assert_eq!(Preset::for_load(f64::INFINITY), Preset::Ultrafast);
    }

    /// A head room of four on two cores: half a core at most.
    #[test]
    fn presets_change_where_the_table_says() {
        for (megapixels, expected) in [
            (15.7, Preset::Veryfast),
            (15.8, Preset::Superfast),
            (19.9, Preset::Superfast),
            (20.0, Preset::Ultrafast),
        ] {
            assert_eq!(Preset::for_load(megapixels * 1e6), expected, "{megapixels}");
        }
    }

    #[test]
    fn every_preset_has_a_row_and_a_name() {
        let names = Preset::ALL.map(Preset::name);
        assert_eq!(names, ["ultrafast", "superfast", "veryfast"]);
    }
}
