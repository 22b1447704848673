//! Requests of the page to the recorder, login and logout.

use std::net::IpAddr;
use std::sync::Arc;

use bytes::Bytes;
use http_body_util::{BodyExt, LengthLimitError, Limited};
use hyper::body::Incoming;
use hyper::header::{CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue, SET_COOKIE};
use hyper::http::request::Parts;
use hyper::{Response, StatusCode};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use session_archive::text::check_note;
use tokio::sync::Semaphore;

use super::body::Body;
use super::{Shared, response};
use crate::clock::timeout;
use crate::link::{Code, Problem};
use crate::rig::{Action, Rig};
use crate::store::problem;

const SEQUENCE: HeaderName = HeaderName::from_static("x-sequence");

/// Runs blocking work on another thread. A panic in it is an error.
pub(super) async fn blocking<T: Send + 'static>(
    permits: &Semaphore,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let failed = || problem(Code::Io, "the rig cannot respond; see its log");
    let _permit = permits.acquire().await.map_err(|_| failed())?;
    tokio::task::spawn_blocking(work).await.map_err(|e| {
        log::error!("answering a request: {e}");
        failed()
    })
}

async fn ask<T: Send + 'static>(
    shared: &Shared,
    work: impl FnOnce(&dyn Rig) -> T + Send + 'static,
) -> Result<T, Problem> {
    let rig = shared.rig.clone();
    blocking(&shared.asks, move || work(&*rig)).await
}

pub(super) async fn status(shared: &Arc<Shared>) -> Result<Response<Body>, Problem> {
    let status = ask(shared, |rig| rig.status()).await?;
    Ok(response::json(StatusCode::OK, &status))
}

/// A preview; 204 if the page has it already, as stated by `?have=SEQUENCE`.
pub(super) async fn preview(
    shared: &Arc<Shared>,
    camera: usize,
    query: Option<&str>,
) -> Result<Response<Body>, Problem> {
    let have = query.and_then(|q| q.strip_prefix("have="));
    let have = have.and_then(|n| n.parse::<u64>().ok());
    let preview = ask(shared, move |rig| rig.preview(camera)).await?;
    let preview = preview.ok_or_else(|| problem(Code::NotFound, "there is no image"))?;
    if have == Some(preview.sequence) {
        return Ok(response::plain(StatusCode::NO_CONTENT));
    }
    let mut response = Response::new(Body::of(Bytes::from_owner(preview.jpeg)));
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static("image/jpeg"));
    headers.insert(SEQUENCE, preview.sequence.into());
    Ok(response)
}

pub(super) async fn act(
    shared: &Arc<Shared>,
    head: &Parts,
    body: Incoming,
) -> Result<Response<Body>, Problem> {
    let action: Action = read(shared, head, body).await?;
    let text = match &action {
        Action::Start { name } => name,
        Action::Mark { text } => text,
        Action::Stop | Action::Discard => "",
    };
    check_note(text).map_err(|e| problem(Code::BadRequest, &e.to_string()))?;
    let done = ask(shared, move |rig| rig.act(action).map(|()| rig.status())).await?;
    let status = done.map_err(|why| problem(Code::Refused, &why))?;
    Ok(response::json(StatusCode::OK, &status))
}

#[derive(Deserialize)]
struct Login {
    token: String,
}

pub(super) async fn login(
    shared: &Arc<Shared>,
    peer: IpAddr,
    head: &Parts,
    body: Incoming,
) -> Result<Response<Body>, Problem> {
    let login: Login = read(shared, head, body).await?;
    let given = login.token.trim().as_bytes();
    match shared.guard.login(peer, given, shared.now()) {
        Ok(cookie) => Ok(with_cookie(cookie)),
        Err(rejection) => Ok(response::rejection(&rejection)),
    }
}

/// The login has ended when the response is sent; this is also synced to disk, if possible.
pub(super) async fn logout(
    shared: &Arc<Shared>,
    headers: &HeaderMap,
) -> Result<Response<Body>, Problem> {
    let (forget, ended) = shared.guard.logout(headers);
    if ended {
        let of_disk = shared.clone();
        blocking(&shared.reads, move || of_disk.guard.save()).await?;
    }
    Ok(with_cookie(Some(forget)))
}

fn with_cookie(cookie: Option<String>) -> Response<Body> {
    let mut response = response::plain(StatusCode::NO_CONTENT);
    if let Some(cookie) = cookie.and_then(|c| HeaderValue::from_str(&c).ok()) {
        response.headers_mut().insert(SET_COOKIE, cookie);
    }
    response
}

/// The body of a request as JSON.
pub(super) async fn read<T: DeserializeOwned>(
    shared: &Shared,
    head: &Parts,
    body: Incoming,
) -> Result<T, Problem> {
    let bad = |why: &str| problem(Code::BadRequest, why);
    let content_type = head.headers.get(CONTENT_TYPE).and_then(|v| v.to_str().ok());
    let content_type = content_type.map(|t| t.split(';').next().unwrap_or(t).trim());
    if content_type != Some("application/json") {
        return Err(bad("the body must be application/json"));
    }
    let limit = shared.limits.body_bytes;
    let body = Limited::new(body, limit).collect();
    let body = match timeout(&*shared.clock, shared.limits.head_time, body).await {
        Err(_) => return Err(bad("the body took too long")),
        Ok(Err(e)) if e.is::<LengthLimitError>() => {
            return Err(bad(&format!("the body is longer than {limit} bytes")));
        }
        Ok(Err(_)) => return Err(bad("the body could not be read")),
        Ok(Ok(body)) => body.to_bytes(),
    };
    serde_json::from_slice(&body).map_err(|e| bad(&format!("reading the body: {e}")))
}
