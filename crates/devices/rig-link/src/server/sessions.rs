//! Sessions for hosts, as specified in `docs/reference/rig-link.md`.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use hyper::body::Incoming;
use hyper::header::{
    ACCEPT_RANGES, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG,
    HeaderMap, HeaderValue, IF_RANGE, RANGE,
};
use hyper::http::request::Parts;
use hyper::{Response, StatusCode};
use tokio::runtime::Handle;
use tokio::sync::mpsc::Sender;
use tokio::time::sleep;

use super::actions::{blocking, read};
use super::body::Body;
use super::{Shared, response};
use crate::link::{self, Code, FORMAT, FileEntry, Line, Problem, Receipt, Sessions, VERSION};
use crate::range::{ByteRange, requested_range};
use crate::store::{ListedFile, Session, Store, problem};

/// Bytes read and sent at a time.
const PIECE_BYTES: usize = 256 << 10;
/// Interval of empty lines while a manifest is being computed.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(5);

async fn with_store<T: Send + 'static>(
    shared: &Arc<Shared>,
    work: impl FnOnce(&Store) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let own = shared.clone();
    blocking(&shared.reads, move || work(&own.store)).await?
}

/// The session with this name, unless it is being recorded.
async fn finished(shared: &Arc<Shared>, name: String) -> Result<Session, Problem> {
    let rig = shared.rig.clone();
    with_store(shared, move |store| {
        let session = store.session(&name)?;
        if rig.is_recording(&session.name) {
            return Err(problem(Code::Recording, "this session is being recorded"));
        }
        Ok(session)
    })
    .await
}

pub(super) async fn list(shared: &Arc<Shared>) -> Result<Response<Body>, Problem> {
    let rig = shared.rig.clone();
    let sessions = with_store(shared, move |store| {
        let failed = |e: io::Error| problem(Code::Io, &format!("listing the sessions: {e}"));
        let mut summaries = Vec::new();
        for session in store.sessions().map_err(failed)? {
            let recording = rig.is_recording(&session.name);
            match store.summary(&session, recording) {
                Ok(summary) => summaries.push(summary),
                // Discarded or freed meanwhile.
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(failed(e)),
            }
        }
        Ok(summaries)
    })
    .await?;
    let body = Sessions {
        format: FORMAT.to_owned(),
        version: VERSION,
        sessions,
    };
    Ok(response::json(StatusCode::OK, &body))
}

/// One line for each file as soon as it is hashed, and one at the end.
pub(super) async fn manifest(
    shared: &Arc<Shared>,
    name: String,
) -> Result<Response<Body>, Problem> {
    let session = finished(shared, name).await?;
    let own = session.clone();
    let files = with_store(shared, move |store| store.files(&own)).await?;
    let (body, lines) = Body::pieces(None);
    tokio::spawn(send_manifest(shared.clone(), session, files, lines));
    let mut response = Response::new(body);
    let content_type = HeaderValue::from_static("application/x-ndjson");
    response.headers_mut().insert(CONTENT_TYPE, content_type);
    Ok(response)
}

async fn send_manifest(
    shared: Arc<Shared>,
    session: Session,
    files: Vec<ListedFile>,
    lines: Sender<io::Result<Bytes>>,
) {
    let mut entries: Vec<FileEntry> = Vec::with_capacity(files.len());
    for file in files {
        let mut hashing = pin!(hash(&shared, session.clone(), file));
        let hashed = loop {
            tokio::select! {
                hashed = &mut hashing => break hashed,
                // A long file takes a while; the keepalive prevents the client's timeout.
                () = sleep(KEEPALIVE_INTERVAL) => {
                    if lines.send(Ok(Bytes::from_static(b"\n"))).await.is_err() {
                        return;
                    }
                }
            }
        };
        let (line, goes_on) = match hashed {
            Ok(entry) => {
                entries.push(entry.clone());
                (Line::File(entry), true)
            }
            Err(problem) => (Line::Error(problem), false),
        };
        if lines.send(written(&line)).await.is_err() || !goes_on {
            return;
        }
    }
    let total = Line::Total(link::total(&entries));
    let _ = lines.send(written(&total)).await;
}

fn written(line: &Line) -> io::Result<Bytes> {
    let mut text = serde_json::to_vec(line).map_err(io::Error::other)?;
    text.push(b'\n');
    Ok(text.into())
}

async fn hash(
    shared: &Arc<Shared>,
    session: Session,
    file: ListedFile,
) -> Result<FileEntry, Problem> {
    let own = shared.clone();
    let runtime = Handle::current();
    blocking(&shared.hashes, move || {
        let read_rate = |bytes| runtime.block_on(own.read_rate.after(bytes, &*own.rig));
        own.store.hash(&session, &file, &read_rate)
    })
    .await?
}

/// A file, or the requested part of it.
pub(super) async fn file(
    shared: &Arc<Shared>,
    name: String,
    path: String,
    headers: &HeaderMap,
    empty: bool,
) -> Result<Response<Body>, Problem> {
    let session = finished(shared, name).await?;
    let (file, listed) = with_store(shared, move |store| store.open(&session, &path)).await?;
    let length = listed.stamp.bytes;
    let tag = listed.stamp.tag();
    let text = |name| {
        headers
            .get(name)
            .and_then(|v: &HeaderValue| v.to_str().ok())
    };
    // A part of a changed file is useless.
    let range = text(RANGE).filter(|_| text(IF_RANGE).is_none_or(|t| t == tag));
    let (status, first, end) = match requested_range(range, length) {
        ByteRange::All => (StatusCode::OK, 0, length),
        ByteRange::Part { first, end } => (StatusCode::PARTIAL_CONTENT, first, end),
        ByteRange::Nothing => {
            let why = format!("the file has {length} bytes");
            let mut response = response::error(problem(Code::Range, &why));
            insert(
                response.headers_mut(),
                CONTENT_RANGE,
                &format!("bytes */{length}"),
            );
            return Ok(response);
        }
    };
    let mut response = if empty {
        Response::new(Body::empty())
    } else {
        let (body, pieces) = Body::pieces(Some(end - first));
        tokio::spawn(send_file(shared.clone(), file, first, end, pieces));
        Response::new(body)
    };
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_LENGTH, (end - first).into());
    if status == StatusCode::PARTIAL_CONTENT {
        let range = format!("bytes {first}-{}/{length}", end - 1);
        insert(headers, CONTENT_RANGE, &range);
    }
    insert(headers, ETAG, &tag);
    insert(headers, ACCEPT_RANGES, "bytes");
    insert(headers, CONTENT_TYPE, "application/octet-stream");
    insert(headers, CONTENT_DISPOSITION, "attachment");
    Ok(response)
}

fn insert(headers: &mut HeaderMap, name: hyper::header::HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        headers.insert(name, value);
    }
}

async fn send_file(
    shared: Arc<Shared>,
    mut file: File,
    first: u64,
    end: u64,
    pieces: Sender<io::Result<Bytes>>,
) {
    let mut at = first;
    while at < end {
        let requested_range = usize::try_from(end - at)
            .unwrap_or(PIECE_BYTES)
            .min(PIECE_BYTES);
        let seek = at == first && first > 0;
        let reading = move || {
            if seek {
                file.seek(SeekFrom::Start(first))?;
            }
            let mut piece = BytesMut::zeroed(requested_range);
            file.read_exact(&mut piece)?;
            Ok::<_, io::Error>((file, piece.freeze()))
        };
        let piece = match blocking(&shared.reads, reading).await {
            Ok(Ok((back, piece))) => {
                file = back;
                piece
            }
            Ok(Err(e)) => {
                log::warn!("sending a file: {e}");
                let _ = pieces.send(Err(e)).await;
                return;
            }
            Err(problem) => {
                let _ = pieces.send(Err(io::Error::other(problem.message))).await;
                return;
            }
        };
        at += piece.len() as u64;
        shared.read_rate.after(piece.len(), &*shared.rig).await;
        if pieces.send(Ok(piece)).await.is_err() {
            return;
        }
    }
}

pub(super) async fn receipt(
    shared: &Arc<Shared>,
    name: String,
    head: &Parts,
    body: Incoming,
) -> Result<Response<Body>, Problem> {
    let receipt: Receipt = read(shared, head, body).await?;
    let session = finished(shared, name).await?;
    with_store(shared, move |store| store.put_receipt(&session, &receipt)).await?;
    Ok(response::plain(StatusCode::NO_CONTENT))
}

pub(super) async fn free(shared: &Arc<Shared>, name: String) -> Result<Response<Body>, Problem> {
    let session = finished(shared, name).await?;
    with_store(shared, move |store| store.free(&session)).await?;
    Ok(response::plain(StatusCode::NO_CONTENT))
}
