//! The examples at the end of each verb's help.

use command_line::examples::Table;

/// All verbs of `paws-scene`.
pub(crate) const EXAMPLES: Table = &[
    (
        "show",
        &[
            ("paws-scene show scene", "its provenance and content"),
            ("paws-scene show scene --json", "for programs"),
        ],
    ),
    (
        "verify",
        &[(
            "paws-scene verify scene",
            "checks every byte against its hash",
        )],
    ),
    (
        "export",
        &[
            (
                "paws-scene export scene --format ply --out cloud.ply",
                "the cloud",
            ),
            (
                "paws-scene export scene --format tum --out poses.txt",
                "the trajectory",
            ),
            (
                "paws-scene export scene --format nerfstudio --images frames --out nerf",
                "with the images that `paws-reconstruct frames` wrote",
            ),
            (
                "paws-scene export scene --format mjcf --out ground",
                "the ground for MuJoCo",
            ),
            (
                "paws-scene export scene --format splat-ply --out walk.ply",
                "the Gaussians for viewers",
            ),
        ],
    ),
    (
        "completions",
        &[(
            "paws-scene completions bash",
            "for `source <(paws-scene completions bash)`",
        )],
    ),
    (
        "man",
        &[(
            "paws-scene man --out man",
            "paws-scene.1 and one page per verb",
        )],
    ),
];
