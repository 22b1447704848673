//! The examples at the end of each command's help.

use command_line::examples::Table;

/// Examples of all commands of `paws`.
pub(crate) const EXAMPLES: Table = &[
    (
        "import",
        &[
            ("paws import /media/rig", "every session on a mounted disk"),
            (
                "paws import --json walk-7",
                "one session, with its result as a line of JSON",
            ),
        ],
    ),
    (
        "pull",
        &[
            (
                "paws pull https://rig.local:8077 --fingerprint AA:BB:CC --token-file token latest",
                "the newest session of a rig; `pawsd fingerprint` shows the fingerprint",
            ),
            (
                "paws pull https://rig.local:8077 --fingerprint AA:BB:CC --token-file token --free",
                "all of them; the rig deletes what the library holds",
            ),
        ],
    ),
    (
        "validate",
        &[
            ("paws validate latest", "the newest session of the library"),
            (
                "paws validate walk-7 --deep --html report.html",
                "every frame decoded, with a page",
            ),
            (
                "paws validate walk-7 --limit camera.dropped=0.01,0.05",
                "warn from 1 % of dropped frames on, fail from 5 %",
            ),
        ],
    ),
    ("index", &[("paws index latest", "the newest session")]),
    (
        "handoff",
        &[
            ("paws handoff latest", "prints the path of handoff.json"),
            (
                "paws handoff latest --reconstruct frames",
                "and writes every frame as PNG to the folder frames",
            ),
        ],
    ),
    (
        "list",
        &[
            ("paws list", "a table"),
            (
                "paws list --json",
                "for programs; docs/reference/command-line.md lists the fields",
            ),
        ],
    ),
    (
        "show",
        &[
            ("paws show latest", "the newest session"),
            (
                "paws show 0192aa --json",
                "by the beginning of its identifier, for programs",
            ),
        ],
    ),
    (
        "recover",
        &[
            ("paws recover latest", "a copy beside it in the library"),
            (
                "paws recover /media/rig/walk-7 --out walk-7-sound",
                "one that is in no library",
            ),
        ],
    ),
    (
        "report",
        &[
            ("paws report latest", "report.html in the session's folder"),
            ("paws report walk-7 --out walk-7.html", "elsewhere"),
        ],
    ),
    (
        "export",
        &[
            (
                "paws export latest --format mp4 --out films",
                "one film per camera",
            ),
            (
                "paws export walk-7 --format euroc --out walk-7-euroc",
                "PNG frames, IMU and calibration",
            ),
        ],
    ),
    (
        "prune",
        &[
            ("paws prune", "derived files and what stopped imports left"),
            (
                "paws prune --session 0192aa00-0000-7000-8000-000000000001 --yes",
                "a recording; its whole identifier is required",
            ),
        ],
    ),
    (
        "rebuild",
        &[("paws rebuild", "after folders were copied by hand")],
    ),
    (
        "rig show",
        &[("paws rig show rig.toml --out drawing", "with drawings")],
    ),
    (
        "rig check",
        &[
            (
                "paws rig check rig.toml",
                "exit code 3: warnings; 1: not to be used",
            ),
            ("paws rig check rig.toml --json", "for programs"),
        ],
    ),
    (
        "rig diff",
        &[("paws rig diff before.toml after.toml", "in mm and degrees")],
    ),
    (
        "rig convert",
        &[
            (
                "paws rig convert plate.step --list",
                "the parts, to write a map by",
            ),
            (
                "paws rig convert plate.step --map map.toml --out rig.toml",
                "a rig file of them",
            ),
        ],
    ),
    (
        "completions",
        &[(
            "paws completions bash",
            "for `source <(paws completions bash)`",
        )],
    ),
    (
        "man",
        &[("paws man --out man", "paws.1 and one page per verb")],
    ),
];
