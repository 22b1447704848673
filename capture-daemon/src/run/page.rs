//! The phone's page and the host's access to the sessions: the recorder behind the interface of
//! [`rig_link`].

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, anyhow};
use rig_link::identity::Identity;
use rig_link::preview::{Eyes, Planes, jpeg};
use rig_link::rig::{
    Action, Battery, ClockStatus, PageStatus, Preview, Rig, State as PageState, StreamStatus,
};
use rig_link::server::{Server, Settings, serve as listen};
use rig_link::token::Token;
use session_archive::time::{HostTime, NS_PER_S};

use super::claim::is_claimed;
use super::real_time::{Running, Shared, send_request};
use crate::config;
use crate::preview::Newest;
use crate::status::{Request, Response, State, Status};

/// Source of its requests, in sessions.
const SOURCE: &str = "page";
/// Width of the previews, pixels.
const PREVIEW_WIDTH_PX: u32 = 320;

/// File beside the certificate that lists the ended logins.
const ENDED_LOGINS: &str = "ended-logins";
/// Delay between attempts to serve the page, ns.
const RETRY_NS: i64 = 10 * NS_PER_S;

/// Serves the page as soon as possible, until this is dropped. Nothing waits for it: an address of
/// a network that is not up yet must not keep the rig from recording.
pub(super) struct PageSupervisor<'a> {
    page: Option<&'a config::Page>,
    out: PathBuf,
    server: Option<Server>,
    next: HostTime,
    /// Last reported reason why it is not served.
    last_error: String,
}

impl<'a> PageSupervisor<'a> {
    /// Creates the supervisor of this page, if there is one, with the sessions in `out`.
    pub(super) fn new(page: Option<&'a config::Page>, out: &Path) -> Self {
        Self {
            page,
            out: out.to_owned(),
            server: None,
            next: HostTime::MIN,
            last_error: String::new(),
        }
    }

    /// Serves the page if it is not served and the next attempt is due.
    pub(super) fn supervise(&mut self, running: &Running) {
        let now = running.shared.now();
        let (Some(page), None) = (self.page, &self.server) else {
            return;
        };
        if now < self.next {
            return;
        }
        self.next = now + RETRY_NS;
        match serve(page, &self.out, running) {
            Ok(server) => self.server = Some(server),
            Err(error) => {
                let text = format!("no page, trying again: {error:#}");
                if text != self.last_error {
                    log::error!("{text}");
                    self.last_error = text;
                }
            }
        }
    }
}

/// Serves the page until the server is dropped.
///
/// # Errors
/// The certificate cannot be stored, the token cannot be read, or the address is in use.
fn serve(page: &config::Page, out: &Path, running: &Running) -> anyhow::Result<Server> {
    let is_loopback = page.listen.ip().is_loopback();
    let identity = match is_loopback {
        true => None,
        false => Some(Identity::load_or_create(&page.folder).context("making the certificate")?),
    };
    let token = page.token_file.as_deref().map(Token::read).transpose();
    let settings = Settings {
        bind: page.listen,
        identity,
        token: token.context("reading the token of the page")?,
        ended_logins: Some(page.folder.join(ENDED_LOGINS)),
        ..Settings::default()
    };
    let rig = PageRig {
        shared: running.shared.clone(),
        cameras: running.cameras.clone(),
        out: out.to_owned(),
    };
    let server = listen(settings, Arc::new(rig)).context("serving the page")?;
    match server.fingerprint() {
        Some(fingerprint) => log::info!(
            "the page is at {}, its certificate's fingerprint is {fingerprint}",
            server.url()
        ),
        None => log::info!("the page is at {}", server.url()),
    }
    Ok(server)
}

/// The recorder behind the page.
struct PageRig {
    shared: Arc<Shared>,
    /// Name and nominal rate of each camera.
    cameras: Vec<(String, f64)>,
    out: PathBuf,
}

impl Rig for PageRig {
    fn status(&self) -> PageStatus {
        match self.shared.latest() {
            Some(status) => page_status(&status, &self.cameras),
            None => PageStatus::new(PageState::Idle),
        }
    }

    fn act(&self, action: Action) -> Result<(), String> {
        let is_recording = self.shared.is_recording();
        let request = match action {
            Action::Start { name } => Request::Start { name },
            Action::Stop => Request::Stop,
            Action::Mark { text } => Request::Mark { text, at: None },
            Action::Discard if is_recording => Request::Discard,
            Action::Discard => Request::DiscardLast,
        };
        match send_request(&self.shared, request, SOURCE) {
            Response::Ok { .. } => Ok(()),
            Response::Error { message } => Err(message),
        }
    }

    fn preview(&self, camera: usize) -> Option<Preview> {
        let (sequence, newest) = self.shared.preview(camera)?;
        let image = match newest {
            Newest::Image(image) => image,
            Newest::Jpeg(bytes) => {
                return Some(Preview {
                    jpeg: bytes[..].into(),
                    sequence,
                });
            }
        };
        let planes = Planes {
            width: image.width,
            height: image.height,
            data: &image.data,
        };
        let small = jpeg(planes, Eyes::Left, PREVIEW_WIDTH_PX)
            .inspect_err(|error| log::debug!("encoding a preview: {error}"))
            .ok()?;
        Some(Preview {
            jpeg: small.into(),
            sequence,
        })
    }

    fn sessions_root(&self) -> PathBuf {
        self.out.clone()
    }

    fn is_recording(&self, session: &str) -> bool {
        // A session that was just requested has no name yet, so while one is being started or ended
        // all count as being recorded.
        let is_ours = self.shared.latest().is_none_or(|status| {
            let is_open = matches!(status.state, State::Recording | State::Stopping);
            (is_open || self.shared.is_recording())
                && status
                    .session
                    .as_deref()
                    .and_then(Path::file_name)
                    .is_none_or(|name| name == session || !is_open)
        });
        // `pawsd record` may write a session into the same folder, and an interrupted one may be
        // about to be closed.
        is_ours || is_claimed(&self.out.join(session))
    }
}

fn page_status(status: &Status, cameras: &[(String, f64)]) -> PageStatus {
    let machine = &status.machine;
    let nominal = |name: &str| cameras.iter().find(|(camera, _)| camera == name);
    PageStatus {
        state: match status.state {
            State::Idle => PageState::Idle,
            State::Armed => PageState::Armed,
            State::Recording => PageState::Recording,
            State::Stopping => PageState::Stopping,
            State::Fault => PageState::Fault,
        },
        session: status
            .session
            .as_deref()
            .and_then(Path::file_name)
            .map(|name| name.to_string_lossy().into_owned()),
        seconds: status.seconds,
        cameras: cameras.iter().map(|(name, _)| name.clone()).collect(),
        streams: status
            .streams
            .iter()
            .map(|stream| StreamStatus {
                name: stream.name.clone(),
                rate_hz: stream.rate_hz,
                nominal_hz: nominal(&stream.name).map(|(_, rate)| *rate),
                received: stream.received,
                stored: stream.stored,
                missing: stream.missing,
                silent: stream.silent,
                frozen: stream.frozen,
            })
            .collect(),
        free_bytes: status.free_bytes,
        seconds_left: status.seconds_left,
        temperature_c: machine.temperature_c,
        battery: machine.battery.as_ref().map(|battery| Battery {
            percent: battery.percent,
            charging: battery.charging,
            minutes_left: battery.minutes_left,
        }),
        clock: machine.clock.as_ref().map(|clock| ClockStatus {
            synchronised: clock.synchronised,
            offset_ns: Some(clock.offset_ns),
            source: clock.source.clone(),
        }),
        alarms: status.alarms.clone(),
        encoders: status.encoders.clone(),
    }
}

/// Fingerprint of the page's certificate, which is created if it does not exist.
///
/// # Errors
/// It cannot be stored, or the configuration has no page.
pub fn fingerprint(config: &config::Config) -> anyhow::Result<String> {
    let page = config
        .page
        .as_ref()
        .ok_or_else(|| anyhow!("the configuration has no [page]"))?;
    let identity = Identity::load_or_create(&page.folder).context("making the certificate")?;
    Ok(identity.fingerprint().to_string())
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::net::TcpListener;
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    /// Otherwise a daemon that starts before its network could not record.
    #[test]
    fn page_is_served_once_its_address_exists() {
        let taken = TcpListener::bind("127.0.0.1:0").expect("an address");
        let page = config::Page {
            listen: taken.local_addr().expect("address"),
            token_file: None,
            folder: PathBuf::new(),
        };
        let running = Running::idle();
        let folder = tempfile::tempdir().expect("folder");
        let mut supervisor = PageSupervisor::new(Some(&page), folder.path());
        supervisor.supervise(&running);
        assert!(
            supervisor.last_error.contains("listening on"),
            "{}",
            supervisor.last_error
        );
        drop(taken);
        supervisor.supervise(&running);
        assert!(supervisor.server.is_none(), "not yet");
        supervisor.next = HostTime::MIN;
        supervisor.supervise(&running);
        assert!(supervisor.server.is_some());
    }

    #[test]
    fn page_is_not_served_with_a_token_readable_by_others() {
        let folder = tempfile::tempdir().expect("folder");
        let token = folder.path().join("token");
        std::fs::write(&token, "0123456789abcdef").expect("token");
        let page = config::Page {
            listen: "127.0.0.1:0".parse().expect("address"),
            token_file: Some(token.clone()),
            folder: folder.path().to_owned(),
        };
        let running = Running::idle();
        let mut supervisor = PageSupervisor::new(Some(&page), folder.path());
        let mode = |mode| std::fs::set_permissions(&token, Permissions::from_mode(mode));
        mode(0o644).expect("mode");
        supervisor.supervise(&running);
        assert!(supervisor.server.is_none());
        let remedy = format!("fix it with chmod 600 {}", token.display());
        assert!(
            supervisor.last_error.contains("mode 0644"),
            "{}",
            supervisor.last_error
        );
        assert!(
            supervisor.last_error.ends_with(&remedy),
            "{}",
            supervisor.last_error
        );
        mode(0o600).expect("mode");
        supervisor.next = HostTime::MIN;
        supervisor.supervise(&running);
        assert!(supervisor.server.is_some());
    }
}
