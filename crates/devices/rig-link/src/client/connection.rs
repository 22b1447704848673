//! One connection to a rig.

use std::error::Error;
use std::io;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::Full;
use hyper::body::Incoming;
use hyper::client::conn::http1::{self, SendRequest};
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderValue, RANGE};
use hyper::{Method, Request, Response};
use hyper_util::rt::TokioIo;
use rustls::pki_types::ServerName;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::pin::Tls;
use super::{Address, Failure, LinkError};
use crate::link::{HEADER, VERSION};
use crate::token::Token;

/// An open connection. It is driven only while its client waits.
pub(super) struct Connection {
    sender: SendRequest<Full<Bytes>>,
}

/// Connects; with TLS checks the rig's certificate.
pub(super) async fn connect(
    address: &Address,
    tls: Option<&Tls>,
    limit: Duration,
) -> Result<Connection, Failure> {
    match timeout(limit, connect_unhurried(address, tls)).await {
        Ok(connected) => connected,
        Err(_) => {
            let reason = format!("no connection within {:.1} s", limit.as_secs_f64());
            Err(Failure::Retry(reason, None))
        }
    }
}

async fn connect_unhurried(address: &Address, tls: Option<&Tls>) -> Result<Connection, Failure> {
    let retry_or_fail = |e: io::Error| Failure::Retry(describe(&e), None);
    let found = tokio::net::lookup_host((address.host.as_str(), address.port)).await;
    let found: Vec<_> = found.map_err(retry_or_fail)?.collect();
    if tls.is_none() && !found.iter().all(|a| a.ip().to_canonical().is_loopback()) {
        let address = address.clone();
        return Err(LinkError::PlainText { address }.into());
    }
    let stream = TcpStream::connect(&found[..])
        .await
        .map_err(retry_or_fail)?;
    stream.set_nodelay(true).map_err(retry_or_fail)?;
    let Some(tls) = tls else {
        return handshake(stream).await;
    };
    let name = ServerName::try_from(address.host.clone());
    let name = name.map_err(|_| LinkError::Address {
        found: address.to_string(),
        reason: "its host is neither a name nor an IP address",
    })?;
    match tls.connector.connect(name, stream).await {
        Ok(stream) => handshake(stream).await,
        Err(e) => Err(match (tls.pin.wrong(), tls.pin.expected) {
            (Some(found), Some(expected)) => LinkError::WrongFingerprint {
                found,
                expected,
                address: address.clone(),
            }
            .into(),
            (Some(found), None) => LinkError::NoFingerprint {
                found,
                address: address.clone(),
            }
            .into(),
            (None, _) => retry_or_fail(e),
        }),
    }
}

async fn handshake(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
) -> Result<Connection, Failure> {
    let (sender, connection) = http1::handshake(TokioIo::new(stream))
        .await
        .map_err(|e| Failure::Retry(describe(&e), None))?;
    tokio::spawn(async move {
        if let Err(e) = connection.await {
            log::debug!("a connection to the rig ended: {}", describe(&e));
        }
    });
    Ok(Connection { sender })
}

impl Connection {
    pub(super) fn is_open(&self) -> bool {
        !self.sender.is_closed()
    }

    pub(super) async fn send(
        &mut self,
        address: &Address,
        token: Option<&Token>,
        method: Method,
        path: &str,
        body: Option<Bytes>,
        range: Option<&str>,
    ) -> Result<Response<Incoming>, Box<dyn Error + Send + Sync>> {
        let mut request = Request::builder()
            .method(method)
            .uri(path)
            .header(HOST, address.authority())
            .header(HEADER, VERSION);
        if let Some(token) = token {
            let mut value = HeaderValue::from_str(&format!("Bearer {}", token.secret()))?;
            value.set_sensitive(true);
            request = request.header(AUTHORIZATION, value);
        }
        if let Some(range) = range {
            request = request.header(RANGE, range);
        }
        if body.is_some() {
            request = request.header(CONTENT_TYPE, "application/json");
        }
        let request = request.body(Full::new(body.unwrap_or_default()))?;
        self.sender.ready().await?;
        Ok(self.sender.send_request(request).await?)
    }
}

/// An error with all its causes on one line.
pub(super) fn describe(error: &(dyn Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.ends_with(&more) {
            text.push_str(": ");
            text.push_str(&more);
        }
        cause = error.source();
    }
    text
}
