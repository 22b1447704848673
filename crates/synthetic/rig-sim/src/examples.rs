//! The examples at the end of each verb's help.

use command_line::examples::Table;

/// All verbs of `paws-rig-sim`.
pub(crate) const EXAMPLES: Table = &[
    (
        "render",
        &[
            (
                "paws-rig-sim render --scene pavement --session-only --out walk",
                "a session, for `paws import`",
            ),
            (
                "paws-rig-sim render --scene trail --seed 7 --seconds 20 --truth --session --out trail",
                "folders of images with all ground truth, and a session beside them",
            ),
            (
                "paws-rig-sim render --scene targets --seconds 75 --session-only --out targets",
                "a session for `paws calib cameras`",
            ),
            (
                "paws-rig-sim render --scene plaza --time-offset feet=12 --session-only --out late",
                "a camera with an unreported time offset",
            ),
        ],
    ),
    (
        "preview",
        &[
            (
                "paws-rig-sim preview --scene stairs --out stairs.png",
                "camera images, and a map of the path",
            ),
            (
                "paws-rig-sim preview --scene plaza --light low-sun --out plaza.png --film plaza.mp4",
                "with a film of the whole walk",
            ),
        ],
    ),
    (
        "completions",
        &[(
            "paws-rig-sim completions bash",
            "for `source <(paws-rig-sim completions bash)`",
        )],
    ),
    (
        "man",
        &[(
            "paws-rig-sim man --out man",
            "paws-rig-sim.1 and one page per verb",
        )],
    ),
];
