//! Responses, with their common headers.

use std::time::Duration;

use hyper::header::{
    ALLOW, CACHE_CONTROL, CONNECTION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName,
    HeaderValue, REFERRER_POLICY, RETRY_AFTER, SERVER, WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use hyper::{Response, StatusCode};
use serde::Serialize;

use super::body::Body;
use super::guard::Rejection;
use super::route::NoRoute;
use crate::link::{Code, ErrorBody, Problem};
use crate::store::problem;

/// Only the page's own scripts and styles are allowed; images may also be blobs.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// Without HSTS: it would prevent accepting the self-signed certificate.
const HEADERS: [(HeaderName, &str); 8] = [
    (CONTENT_SECURITY_POLICY, POLICY),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (X_FRAME_OPTIONS, "DENY"),
    (REFERRER_POLICY, "no-referrer"),
    (CACHE_CONTROL, "no-store"),
    (SERVER, "rig-link"),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        "same-origin",
    ),
];

/// Adds the common headers.
pub(super) fn finish(mut response: Response<Body>) -> Response<Body> {
    for (name, value) in HEADERS {
        let value = HeaderValue::from_static(value);
        response.headers_mut().entry(name).or_insert(value);
    }
    response
}

/// A response without content.
pub(super) fn plain(status: StatusCode) -> Response<Body> {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = status;
    response
}

/// A response in JSON.
pub(super) fn json(status: StatusCode, value: &impl Serialize) -> Response<Body> {
    let text = match serde_json::to_vec(value) {
        Ok(text) => text,
        Err(e) => {
            log::error!("writing an answer: {e}");
            return plain(StatusCode::INTERNAL_SERVER_ERROR);
        }
    };
    let mut response = Response::new(Body::of(text));
    *response.status_mut() = status;
    let content_type = HeaderValue::from_static("application/json");
    response.headers_mut().insert(CONTENT_TYPE, content_type);
    response
}

/// An error response.
pub(super) fn error(problem: Problem) -> Response<Body> {
    let status = match problem.code {
        Code::BadRequest => StatusCode::BAD_REQUEST,
        Code::Unauthorised => StatusCode::UNAUTHORIZED,
        Code::Forbidden => StatusCode::FORBIDDEN,
        Code::NotFound => StatusCode::NOT_FOUND,
        Code::WrongMethod => StatusCode::METHOD_NOT_ALLOWED,
        Code::Recording
        | Code::NoReceipt
        | Code::ListDiffers
        | Code::ManifestFirst
        | Code::NotListed
        | Code::Refused => StatusCode::CONFLICT,
        Code::TooMany => StatusCode::TOO_MANY_REQUESTS,
        Code::Range => StatusCode::RANGE_NOT_SATISFIABLE,
        Code::Io | Code::Unknown => StatusCode::INTERNAL_SERVER_ERROR,
    };
    json(status, &ErrorBody { error: problem })
}

/// The response to a client without permission.
pub(super) fn rejection(rejection: &Rejection) -> Response<Body> {
    match rejection {
        Rejection::Malformed(why) => closing(error(problem(Code::BadRequest, why))),
        Rejection::Foreign(why) => error(problem(Code::Forbidden, why)),
        Rejection::Unauthorised(why) => {
            let mut response = error(problem(Code::Unauthorised, why));
            let how = HeaderValue::from_static("Bearer");
            response.headers_mut().insert(WWW_AUTHENTICATE, how);
            response
        }
        Rejection::TooMany(wait) => too_many(*wait),
    }
}

fn too_many(wait: Duration) -> Response<Body> {
    let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
    let why = format!("too many requests; retry in {seconds} s");
    let mut response = error(problem(Code::TooMany, &why));
    response.headers_mut().insert(RETRY_AFTER, seconds.into());
    response
}

/// The response for an unknown address or method.
pub(super) fn no_route(no_route: NoRoute) -> Response<Body> {
    match no_route {
        NoRoute::Unknown => error(problem(Code::NotFound, "no such resource")),
        NoRoute::Method(allowed) => {
            let why = format!("this is for {allowed}");
            let mut response = error(problem(Code::WrongMethod, &why));
            let allowed = HeaderValue::from_static(allowed);
            response.headers_mut().insert(ALLOW, allowed);
            response
        }
    }
}

/// Closes the connection after this response: further input is ignored.
pub(super) fn closing(mut response: Response<Body>) -> Response<Body> {
    let close = HeaderValue::from_static("close");
    response.headers_mut().insert(CONNECTION, close);
    response
}
