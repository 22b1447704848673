//! The examples at the end of each verb's help.

use command_line::examples::Table;

/// Examples of all verbs of `paws-calib`.
pub(crate) const EXAMPLES: Table = &[
    (
        "camera-imu",
        &[(
            "paws-calib camera-imu walk-7",
            "with the boards and lenses of the session",
        )],
    ),
    (
        "cameras",
        &[
            (
                "paws-calib cameras walk-7",
                "with the boards of the session",
            ),
            (
                "paws-calib cameras walk-7 --target board.toml --out calibration",
                "with a board of your own",
            ),
        ],
    ),
    (
        "convert",
        &[(
            "paws-calib convert SN12345678.conf --to kalibr --out feet.yaml --model rad_tan4",
            "a factory file for Kalibr",
        )],
    ),
    (
        "verify",
        &[(
            "paws-calib verify walk-7",
            "does the calibration still hold?",
        )],
    ),
    (
        "imu",
        &[(
            "paws-calib imu still --imu feet/imu",
            "from a session with the rig at rest",
        )],
    ),
    (
        "targets",
        &[
            ("paws-calib targets --out board.pdf", "an AprilGrid on A4"),
            (
                "paws-calib targets --kind charuco --paper A2 --out board.pdf",
                "a ChArUco board on A2",
            ),
        ],
    ),
    (
        "measure",
        &[("paws-calib measure walk-7", "one line of JSON")],
    ),
    (
        "completions",
        &[(
            "paws-calib completions bash",
            "for `source <(paws-calib completions bash)`",
        )],
    ),
    ("man", &[("paws-calib man --out man", "one page per verb")]),
];
