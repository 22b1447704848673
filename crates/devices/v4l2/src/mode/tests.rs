use proptest::prelude::*;

use super::*;

fn mode(fourcc: &str, width: u32, height: u32, rate_hz: u32) -> Mode {
    Mode {
        fourcc: fourcc.parse().unwrap(),
        width,
        height,
        interval: Interval::of_rate(rate_hz),
    }
}

#[test]
fn four_characters() {
    let yuyv: Fourcc = "YUYV".parse().unwrap();
    assert_eq!(yuyv.code(), 0x5659_5559);
    assert_eq!(Fourcc::from_code(yuyv.code()), yuyv);
    assert_eq!("Y10".parse::<Fourcc>().unwrap().to_string(), "Y10 ");
    assert_eq!(
        Fourcc::from_code(0x8000_0000 | "Y16 ".parse::<Fourcc>().unwrap().code()).to_string(),
        "Y16 -BE"
    );
    for bad in ["", "YUYV2", "Yäy", "a\nb"] {
        assert_eq!(
            bad.parse::<Fourcc>().unwrap_err(),
            NoFourcc { found: bad.into() }
        );
    }
}

#[test]
fn rates_that_are_the_same() {
    let at = |numerator, denominator| Interval {
        numerator,
        denominator,
    };
    assert!(at(333_333, 10_000_000).is_about(at(1, 30)));
    assert!(at(1, 30).is_about(at(333_333, 10_000_000)));
    assert!(at(66_666, 10_000_000).is_about(at(1, 150)));
    assert!(!at(1001, 30_000).is_about(at(1, 30)));
    assert!(!at(1, 60).is_about(at(1, 30)));
    assert!(!at(0, 0).is_about(at(1, 30)));
    assert!(!at(1, 30).is_about(at(0, 0)));
    assert!(!at(0, 1).is_about(at(0, 1)));
    assert_eq!(at(333_333, 10_000_000).to_string(), "30 fps");
    assert_eq!(at(1001, 30_000).to_string(), "29.970 fps");
    assert_eq!(at(0, 7).to_string(), "0 fps");
}

#[test]
fn bytes_of_an_image() {
    let format = |fourcc: &str, bytes_per_line, size_image| Format {
        fourcc: fourcc.parse().unwrap(),
        width: 2560,
        height: 720,
        bytes_per_line,
        size_image,
        interval: None,
    };
    assert_eq!(
        format("YUYV", 5120, 3_686_400).image_bytes(),
        Some(3_686_400)
    );
    // Lines with padding, and a buffer with room behind the frame.
    assert_eq!(
        format("YUYV", 5376, 4_000_000).image_bytes(),
        Some(3_870_720)
    );
    assert_eq!(format("YUYV", 0, 4_000_000).image_bytes(), Some(3_686_400));
    assert_eq!(
        format("NV12", 2560, 4_000_000).image_bytes(),
        Some(2_764_800)
    );
    assert_eq!(
        format("YUYV", u32::MAX, 4_000_000).image_bytes(),
        Some(4_000_000)
    );
    assert_eq!(format("MJPG", 0, 4_000_000).image_bytes(), None);
    assert_eq!(format("ABCD", 0, 4_000_000).image_bytes(), None);
}

#[test]
fn what_is_offered() {
    let modes = |sizes| Modes {
        fourcc: "YUYV".parse().unwrap(),
        description: String::new(),
        compressed: false,
        emulated: false,
        sizes,
    };
    let discrete = modes(vec![SizeModes {
        sizes: Sizes::Discrete {
            width: 2560,
            height: 720,
        },
        intervals: vec![
            Intervals::Discrete(Interval::of_rate(60)),
            Intervals::Discrete(Interval {
                numerator: 333_333,
                denominator: 10_000_000,
            }),
        ],
    }]);
    assert!(discrete.offers(&mode("YUYV", 2560, 720, 30)));
    assert!(!discrete.offers(&mode("YUYV", 2560, 720, 15)));
    assert!(!discrete.offers(&mode("YUYV", 2560, 722, 30)));
    assert!(!discrete.offers(&mode("NV12", 2560, 720, 30)));

    let stepwise = modes(vec![SizeModes {
        sizes: Sizes::Stepwise {
            width: [16, 3840, 16],
            height: [9, 2160, 1],
        },
        intervals: vec![Intervals::Discrete(Interval::of_rate(5))],
    }]);
    assert!(stepwise.offers(&mode("YUYV", 1344, 376, 100)));
    assert!(!stepwise.offers(&mode("YUYV", 1350, 376, 100)));
    assert!(!stepwise.offers(&mode("YUYV", 8, 376, 100)));

    let continuous = modes(vec![SizeModes {
        sizes: Sizes::Discrete {
            width: 640,
            height: 480,
        },
        intervals: vec![Intervals::Range {
            least: Interval::of_rate(60),
            greatest: Interval::of_rate(5),
            step: None,
        }],
    }]);
    for (rate, offered) in [(4, false), (5, true), (30, true), (60, true), (61, false)] {
        assert_eq!(
            continuous.offers(&mode("YUYV", 640, 480, rate)),
            offered,
            "{rate}"
        );
    }
    assert!(modes(vec![]).offers(&mode("YUYV", 1, 1, 1)));
}

proptest! {
    #[test]
    fn no_number_of_a_driver_harms(
        code: u32, numbers: [u32; 8], width: [u32; 3], height: [u32; 3],
    ) {
        let interval = Interval { numerator: numbers[0], denominator: numbers[1] };
        let other = Interval { numerator: numbers[2], denominator: numbers[3] };
        let fourcc = if code % 2 == 0 { Fourcc(*b"NV16") } else { Fourcc::from_code(code) };
        let format = Format {
            fourcc, width: numbers[4], height: numbers[5], bytes_per_line: numbers[6],
            size_image: numbers[7], interval: Some(interval),
        };
        prop_assert!(format.image_bytes().is_none_or(|b| b <= numbers[7] as usize));
        let _ = format!("{format} {interval}");
        let mode = Mode { fourcc, width: numbers[4], height: numbers[5], interval };
        for sizes in [Sizes::Stepwise { width, height }, Sizes::Discrete { width: numbers[4], height: numbers[5] }] {
            let intervals = vec![Intervals::Range { least: other, greatest: interval, step: Some(other) }];
            let modes = Modes {
                fourcc, description: String::new(), compressed: false, emulated: false,
                sizes: vec![SizeModes { sizes, intervals }],
            };
            let _ = modes.offers(&mode);
        }
    }
}
