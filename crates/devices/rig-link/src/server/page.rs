//! The phone's page: files that are part of the program.

use bytes::Bytes;
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::{Response, StatusCode};

use super::body::Body;
use super::response;

/// One file of the page.
pub(super) struct File {
    path: &'static str,
    content_type: &'static str,
    content: &'static [u8],
}

/// The files of the page.
pub(super) const FILES: [File; 4] = [
    File {
        path: "/",
        content_type: "text/html; charset=utf-8",
        content: include_bytes!("../page/index.html"),
    },
    File {
        path: "/style.css",
        content_type: "text/css; charset=utf-8",
        content: include_bytes!("../page/style.css"),
    },
    File {
        path: "/app.js",
        content_type: "text/javascript; charset=utf-8",
        content: include_bytes!("../page/app.js"),
    },
    File {
        path: "/icon.svg",
        content_type: "image/svg+xml",
        content: include_bytes!("../page/icon.svg"),
    },
];

/// Position of the file with this path.
pub(super) fn position(path: &str) -> Option<usize> {
    FILES.iter().position(|file| file.path == path)
}

/// The file at a position.
pub(super) fn file(position: usize) -> Response<Body> {
    let Some(file) = FILES.get(position) else {
        return response::plain(StatusCode::NOT_FOUND);
    };
    let mut response = Response::new(Body::of(Bytes::from_static(file.content)));
    let content_type = HeaderValue::from_static(file.content_type);
    response.headers_mut().insert(CONTENT_TYPE, content_type);
    response
}
