//! Examples at the end of each command's help.

use command_line::examples::Table;

/// All commands of `pawsd`.
pub(crate) const EXAMPLES: Table = &[
    (
        "check",
        &[
            (
                "pawsd check --config pawsd.toml",
                "1: something would keep a recording from starting",
            ),
            (
                "pawsd check --json",
                "the configuration of the service, for programs",
            ),
        ],
    ),
    (
        "record",
        &[
            (
                "pawsd record --config pawsd.toml --out sessions --seconds 60 --name walk-7",
                "a minute; prints the session's folder",
            ),
            (
                "pawsd record --config pawsd.toml --out sessions --seconds 10 --virtual",
                "as fast as the machine can, dropping nothing",
            ),
        ],
    ),
    (
        "run",
        &[(
            "pawsd run --config pawsd.toml",
            "in this terminal; Ctrl-C ends it",
        )],
    ),
    (
        "start",
        &[
            ("pawsd start --name walk-7", "of the service"),
            (
                "pawsd start --config pawsd.toml",
                "of a daemon with this configuration",
            ),
        ],
    ),
    (
        "stop",
        &[("pawsd stop", "3: something is missing in the session")],
    ),
    (
        "mark",
        &[("pawsd mark 'the stairs'", "an event in the session")],
    ),
    (
        "discard",
        &[("pawsd discard", "immediately, without a prompt")],
    ),
    (
        "status",
        &[
            (
                "pawsd status --config pawsd.toml",
                "of a daemon with this configuration",
            ),
            ("pawsd status --json", "of the service, for programs"),
        ],
    ),
    (
        "devices",
        &[
            ("pawsd devices", "everything that is plugged in"),
            (
                "pawsd devices --config pawsd.toml",
                "and whether it fits on the USB controllers",
            ),
        ],
    ),
    (
        "selftest",
        &[(
            "pawsd selftest --config pawsd.toml --report report.txt",
            "takes half a minute",
        )],
    ),
    (
        "fingerprint",
        &[("pawsd fingerprint", "for `paws pull --fingerprint`")],
    ),
    (
        "encoders",
        &[(
            "pawsd encoders --size 2560x720",
            "at the size of two 720p eyes",
        )],
    ),
    (
        "completions",
        &[(
            "pawsd completions bash",
            "for `source <(pawsd completions bash)`",
        )],
    ),
    (
        "man",
        &[("pawsd man --out man", "pawsd.1 and one page per verb")],
    ),
];
