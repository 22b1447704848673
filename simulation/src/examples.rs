//! The examples at the end of each verb's help.

use command_line::examples::Table;

/// All verbs of `paws-sim`.
pub(crate) const EXAMPLES: Table = &[
    (
        "info",
        &[
            ("paws-sim info walk.scene", "ground, cameras, Gaussians"),
            ("paws-sim info walk.scene --json", "for programs"),
        ],
    ),
    (
        "film",
        &[
            (
                "paws-sim film walk.scene",
                "30 s; `paws-reconstruct report` shows it",
            ),
            (
                "paws-sim film walk.scene --seconds 60 --seed 7 --page film.html",
                "another walk, also as a page of its own",
            ),
            (
                "paws-sim film walk.scene --min-support 15",
                "only where a PSNR of 15 dB is predicted",
            ),
        ],
    ),
    (
        "view",
        &[
            (
                "paws-sim view walk.scene",
                "then open the address that it prints",
            ),
            ("paws-sim view walk.scene --port 0", "at any free port"),
        ],
    ),
    (
        "import",
        &[(
            "paws-sim import gaussian_splat_data --out yard",
            "then `paws-sim view yard`",
        )],
    ),
    (
        "completions",
        &[(
            "paws-sim completions bash",
            "for `source <(paws-sim completions bash)`",
        )],
    ),
    (
        "man",
        &[("paws-sim man --out man", "paws-sim.1 and one page per verb")],
    ),
];
