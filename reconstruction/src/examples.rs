//! The examples at the end of each verb's help.

use command_line::examples::Table;

/// All verbs of `paws-reconstruct`.
pub(crate) const EXAMPLES: Table = &[
    (
        "info",
        &[(
            "paws-reconstruct info walk-7/handoff.json",
            "checks every byte first",
        )],
    ),
    (
        "frames",
        &[(
            "paws-reconstruct frames walk-7 --out frames --every 10 --from 5 --to 20",
            "each tenth frame set of 15 seconds",
        )],
    ),
    (
        "run",
        &[
            (
                "paws-reconstruct run walk-7 --out scene",
                "all stages; started again it resumes",
            ),
            (
                "paws-reconstruct run walk-7 --out scene --preset fast --to bundle-adjustment",
                "poses only, fast",
            ),
            (
                "paws-reconstruct run walk-7 --out scene --calibration feet=feet.yaml --json",
                "with your own intrinsics; a line of JSON per stage",
            ),
        ],
    ),
    (
        "evaluate",
        &[(
            "paws-reconstruct evaluate scene --truth truth.feet.csv --over 10m,5s",
            "error and drift against ground truth",
        )],
    ),
    (
        "evaluate-depth",
        &[(
            "paws-reconstruct evaluate-depth scene --truth simulated",
            "depth against the ground truth of a simulated walk",
        )],
    ),
    (
        "report",
        &[("paws-reconstruct report scene", "writes scene/report.html")],
    ),
    (
        "completions",
        &[(
            "paws-reconstruct completions bash",
            "for `source <(paws-reconstruct completions bash)`",
        )],
    ),
    (
        "man",
        &[(
            "paws-reconstruct man --out man",
            "paws-reconstruct.1 and one page per verb",
        )],
    ),
];
