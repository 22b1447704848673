//! A server of one page on this machine.
//!
//! Contract: it listens on the loopback interface only and answers requests that name it as
//! `localhost` or `127.0.0.1`, so that pages from elsewhere cannot use it. `GET /` is the page,
//! `POST /step` takes a [`Control`] and gives a [`View`]; the page decides when the next step is.
//! `GET /film.html` is a page with the film so far.

use std::cell::RefCell;
use std::convert::Infallible;
use std::net::{Ipv4Addr, SocketAddr};
use std::rc::Rc;

use anyhow::{Context, Result};
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{CACHE_CONTROL, CONTENT_TYPE, HOST};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use serde::{Deserialize, Serialize};
use tokio::net::TcpListener;
use tokio::task::LocalSet;

/// Longest body of a request, bytes.
const MAX_BODY: usize = 4096;

/// What the page wants the agent to do in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Control {
    /// Forward speed as part of the largest one, -1 to 1.
    pub(crate) forward: f64,
    /// Rate of turn to the left as part of the largest one, -1 to 1.
    pub(crate) turn: f64,
    /// Whether the agent walks to its goal by itself.
    pub(crate) autopilot: bool,
    /// Whether it is where the recorded wearer was.
    #[serde(default)]
    pub(crate) wearer: bool,
    /// Whether to begin at a new start first.
    pub(crate) reset: bool,
}

/// What the page shows after a step.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct View {
    /// What the agent sees, a JPEG file in base64.
    pub(crate) jpeg_base64: String,
    /// Position on the map, px.
    pub(crate) map_px: [f64; 2],
    /// Direction of view on the map, counterclockwise from the right, rad.
    pub(crate) heading_rad: f64,
    /// Start of the episode on the map, px.
    pub(crate) start_px: [f64; 2],
    /// Goal on the map, px.
    pub(crate) goal_px: Option<[f64; 2]>,
    /// What happens, in a few words.
    pub(crate) caption: String,
    /// Whether an episode begins here.
    pub(crate) is_start: bool,
    /// Time that a step takes, s.
    pub(crate) step_s: f64,
}

/// What the page shows.
pub(crate) trait Session {
    /// Advances the simulation.
    ///
    /// # Errors
    /// Files of the scene that changed, or an image that cannot be rendered.
    fn step(&mut self, control: Control) -> Result<View>;

    /// A page with the film so far.
    ///
    /// # Errors
    /// A map that cannot be encoded.
    fn film(&self) -> Result<String>;
}

/// Serves until the process ends. `ready` is called with the address once connections are accepted.
///
/// # Errors
/// The port is not free.
pub(crate) fn serve(
    port: u16,
    page: String,
    session: impl Session + 'static,
    ready: impl FnOnce(SocketAddr),
) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()
        .context("starting the server")?;
    let page = Bytes::from(page);
    let session = Rc::new(RefCell::new(session));
    LocalSet::new().block_on(&runtime, async move {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port));
        let listener = listener.await.with_context(|| {
            format!("listening on port {port}; --port names another, 0 any free one")
        })?;
        ready(listener.local_addr().context("reading the address")?);
        loop {
            let (stream, _) = listener.accept().await.context("accepting a connection")?;
            let (page, session) = (page.clone(), Rc::clone(&session));
            let service = service_fn(move |request| {
                let (page, session) = (page.clone(), Rc::clone(&session));
                async move { Ok::<_, Infallible>(answer(request, page, &session).await) }
            });
            tokio::task::spawn_local(async move {
                let connection =
                    http1::Builder::new().serve_connection(TokioIo::new(stream), service);
                if let Err(error) = connection.await {
                    log::debug!("a connection ended: {error}");
                }
            });
        }
    })
}

async fn answer(
    request: Request<Incoming>,
    page: Bytes,
    session: &RefCell<impl Session>,
) -> Response<Full<Bytes>> {
    let host = request
        .headers()
        .get(HOST)
        .and_then(|host| host.to_str().ok());
    let name = host.map(|host| host.rsplit_once(':').map_or(host, |(name, _)| name));
    if !matches!(name, Some("localhost" | "127.0.0.1")) {
        return plain(
            StatusCode::FORBIDDEN,
            "this server answers to localhost only",
        );
    }
    match (request.method(), request.uri().path()) {
        (&Method::GET, "/") => typed(StatusCode::OK, "text/html; charset=utf-8", page),
        (&Method::POST, "/step") => {
            let kind = request.headers().get(CONTENT_TYPE);
            if kind.is_none_or(|kind| kind != "application/json") {
                return plain(
                    StatusCode::UNSUPPORTED_MEDIA_TYPE,
                    "expected application/json",
                );
            }
            let body = Limited::new(request.into_body(), MAX_BODY).collect().await;
            let Ok(body) = body else {
                return plain(StatusCode::PAYLOAD_TOO_LARGE, "expected at most 4096 bytes");
            };
            let control: Control = match serde_json::from_slice(&body.to_bytes()) {
                Ok(control) => control,
                Err(error) => return plain(StatusCode::BAD_REQUEST, &error.to_string()),
            };
            // The runtime has one thread and the session does not wait: nothing else borrows it.
            let view = session.borrow_mut().step(control);
            match view.and_then(|view| Ok(serde_json::to_vec(&view)?)) {
                Ok(view) => typed(StatusCode::OK, "application/json", Bytes::from(view)),
                Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, &format!("{error:#}")),
            }
        }
        (&Method::GET, "/film.html") => match session.borrow().film() {
            Ok(film) => typed(
                StatusCode::OK,
                "text/html; charset=utf-8",
                Bytes::from(film),
            ),
            Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, &format!("{error:#}")),
        },
        _ => plain(
            StatusCode::NOT_FOUND,
            "expected GET /, GET /film.html or POST /step",
        ),
    }
}

fn plain(status: StatusCode, text: &str) -> Response<Full<Bytes>> {
    typed(
        status,
        "text/plain; charset=utf-8",
        Bytes::from(text.to_owned()),
    )
}

fn typed(status: StatusCode, kind: &'static str, body: Bytes) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(body));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, hyper::header::HeaderValue::from_static(kind));
    headers.insert(
        CACHE_CONTROL,
        hyper::header::HeaderValue::from_static("no-store"),
    );
    response
}
