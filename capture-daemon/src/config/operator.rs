//! Settings of buttons, lights, beepers and the phone's page, and their syntax in the file.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use operator::spec::{BeeperSpec, ButtonSpec, LightSpec};

use super::section::Section;

/// `[operator]`: devices of an operator without a screen.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Operator {
    /// Any of them starts and stops.
    pub buttons: Vec<ButtonSpec>,
    /// All of them show the same state.
    pub lights: Vec<LightSpec>,
    /// All of them sound the same.
    pub beepers: Vec<BeeperSpec>,
}

/// `[page]`: the page for the phone, through which a host also fetches sessions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Page {
    /// Listening address.
    pub listen: SocketAddr,
    /// File with the access token; required everywhere but on loopback.
    pub token_file: Option<PathBuf>,
    /// Folder of the certificate.
    pub folder: PathBuf,
}

pub(super) fn operator(mut section: Section<'_>) -> Operator {
    let operator = Operator {
        buttons: section.parsed("buttons", "texts like \"gpio:/dev/gpiochip0:3\""),
        lights: section.parsed("lights", "texts like \"sysfs:status\""),
        beepers: section.parsed("beepers", "texts like \"gpio:beeper\""),
    };
    section.finish();
    operator
}

pub(super) fn page(mut section: Section<'_>, folder: &Path) -> Option<Page> {
    let an_address = "an address and a port, as in \"127.0.0.1:8077\" or \"0.0.0.0:8077\"";
    let is_address = |text: &str| text.parse::<SocketAddr>().is_ok();
    section.must_have("listen", an_address);
    let listen = section.text("listen", an_address, is_address);
    let listen = listen.and_then(|text| text.parse::<SocketAddr>().ok());
    let token_file = section.path("token_file", folder);
    let kept = section.path("folder", folder);
    if let Some(listen) = listen
        && !listen.ip().is_loopback()
        && token_file.is_none()
    {
        section.refuse(
            "listen",
            format_args!(
                "is {listen}, which is reachable from other machines, expected token_file beside it"
            ),
        );
    }
    section.finish();
    Some(Page {
        listen: listen?,
        token_file,
        folder: kept.unwrap_or_else(|| "/var/lib/paws/page".into()),
    })
}
