//! Authorization of requests.
//!
//! * On loopback the `Host` must be this machine's, against DNS rebinding by pages of other sites.
//! * Requests from other sites' pages are rejected: by `Sec-Fetch-Site` and `Origin` if a browser
//!   sends them; a client that sends neither must send [`HEADER`], which a page can send to its own
//!   site only.
//! * With a token, all requests except those for the page itself need it: as `Authorization:
//!   Bearer`, or as the cookie of a login with it, until its logout.
//!
//! This module uses no clock or socket; the file of ended logins is read at the start.

use std::net::IpAddr;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use hyper::header::{AUTHORIZATION, COOKIE, HOST, HeaderMap, HeaderName, ORIGIN};

use super::Limits;
use super::cookies::Cookies;
use super::limits::{Peers, Rate};
use crate::link::HEADER;
use crate::token::Token;

const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Access rules of one server.
#[derive(Debug)]
pub(super) struct Guard {
    token: Option<(Token, Cookies)>,
    tls: bool,
    loopback: bool,
    peers: Mutex<Peers>,
}

/// Reason for rejecting a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Rejection {
    /// The head is malformed.
    Malformed(&'static str),
    /// The request is for another host, or from another site.
    Foreign(&'static str),
    /// The token is missing or wrong.
    Unauthorised(&'static str),
    /// Too many requests; retry later.
    TooMany(Duration),
}

impl Guard {
    /// The rules for a server at this address; the file `ended` is for [`Cookies`].
    pub(super) fn new(
        token: Option<Token>,
        ended: Option<&Path>,
        tls: bool,
        address: IpAddr,
        limits: &Limits,
    ) -> Self {
        let token = token.map(|token| {
            let cookies = Cookies::new(&token, ended);
            (token, cookies)
        });
        let every = Duration::from_secs(1) / limits.requests_per_s.max(1);
        let requests = Rate::new(every, limits.request_burst.max(1));
        let peers = Peers::new(
            requests,
            limits.wrong_token_pause,
            limits.wrong_tokens.max(1),
        );
        Self {
            token,
            tls,
            loopback: address.to_canonical().is_loopback(),
            peers: Mutex::new(peers),
        }
    }

    fn peers<T>(&self, f: impl FnOnce(&mut Peers) -> Result<T, Duration>) -> Result<T, Rejection> {
        let mut peers = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        f(&mut peers).map_err(Rejection::TooMany)
    }

    /// Check of every request: rate limit and host.
    pub(super) fn admit(
        &self,
        peer: IpAddr,
        headers: &HeaderMap,
        now: Duration,
    ) -> Result<(), Rejection> {
        self.peers(|peers| peers.request(peer, now))?;
        let host = one(headers, &HOST).map_err(Rejection::Malformed)?;
        let host = host.ok_or(Rejection::Malformed("the request has no Host"))?;
        let name = host_name(host).ok_or(Rejection::Malformed("the Host is not a host name"))?;
        let here = || {
            let address = name.trim_matches(['[', ']']).parse::<IpAddr>();
            name.eq_ignore_ascii_case("localhost")
                || address.is_ok_and(|a| a.to_canonical().is_loopback())
        };
        if self.loopback && !here() {
            return Err(Rejection::Foreign("this server answers to localhost only"));
        }
        Ok(())
    }

    /// Check of every read request: not from another site's page.
    pub(super) fn check_read(&self, headers: &HeaderMap) -> Result<(), Rejection> {
        match one(headers, &FETCH_SITE).map_err(Rejection::Malformed)? {
            None | Some("same-origin" | "none") => Ok(()),
            Some(_) => Err(Rejection::Foreign("this is not for other sites' pages")),
        }
    }

    /// Check of every write request: from our own page, or from no page.
    pub(super) fn change(&self, headers: &HeaderMap) -> Result<(), Rejection> {
        let foreign = Rejection::Foreign("this comes from another site's page");
        let site = one(headers, &FETCH_SITE).map_err(Rejection::Malformed)?;
        let origin = one(headers, &ORIGIN).map_err(Rejection::Malformed)?;
        if site.is_some_and(|site| site != "same-origin") {
            return Err(foreign);
        }
        match origin {
            Some(origin) if Some(origin) == self.origin(headers).as_deref() => Ok(()),
            Some(_) => Err(foreign),
            None if site.is_some() || headers.contains_key(HEADER) => Ok(()),
            None => Err(Rejection::Foreign(
                "a program that changes something must send the header X-Rig-Link: 1",
            )),
        }
    }

    /// The `Origin` of our own page.
    fn origin(&self, headers: &HeaderMap) -> Option<String> {
        let host = one(headers, &HOST).ok()??;
        let scheme = if self.tls { "https" } else { "http" };
        Some(format!("{scheme}://{host}"))
    }

    /// Checks the token or cookie of a request, if the server has a token.
    pub(super) fn authenticate(
        &self,
        peer: IpAddr,
        headers: &HeaderMap,
        now: Duration,
    ) -> Result<(), Rejection> {
        let Some((token, cookies)) = &self.token else {
            return Ok(());
        };
        if let Some(given) = one(headers, &AUTHORIZATION).map_err(Rejection::Malformed)? {
            let given = given
                .split_once(' ')
                .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
                .map(|(_, given)| given.trim());
            let given = given.ok_or(Rejection::Unauthorised(
                "expected Authorization: Bearer TOKEN",
            ))?;
            return self.check(token, peer, given.as_bytes(), now);
        }
        // Guessing a cookie means guessing 256 bits, so wrong ones, as after a change of the token,
        // do not count against a peer.
        if !self.given_cookies(headers).any(|c| cookies.is_valid(c)) {
            return Err(Rejection::Unauthorised("the token is needed"));
        }
        self.peers(|peers| {
            peers.record_cookie(peer, now);
            Ok(())
        })
    }

    /// Our cookies in a request, valid or not.
    fn given_cookies<'a>(&self, headers: &'a HeaderMap) -> impl Iterator<Item = &'a str> {
        let name = self.cookie_name();
        let all = headers.get_all(COOKIE).iter();
        all.filter_map(|v| v.to_str().ok())
            .flat_map(|v| v.split(';'))
            .filter_map(|c| c.trim().split_once('='))
            .filter(move |(n, _)| *n == name)
            .map(|(_, value)| value)
    }

    /// Whether a client at this address authenticated recently.
    pub(super) fn is_known(&self, peer: IpAddr, now: Duration) -> bool {
        let peers = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        peers.is_known(peer, now)
    }

    /// The cookie of a login with the right token.
    pub(super) fn login(
        &self,
        peer: IpAddr,
        given: &[u8],
        now: Duration,
    ) -> Result<Option<String>, Rejection> {
        let Some((token, cookies)) = &self.token else {
            return Ok(None);
        };
        self.check(token, peer, given, now)?;
        let value = cookies.issue();
        let value = value.ok_or(Rejection::TooMany(Duration::from_secs(1)))?;
        Ok(Some(self.cookie(&value, 90 * 24 * 3600)))
    }

    /// Ends the logins of a request's cookies. Returns a cookie that clears the browser's, and
    /// whether [`Self::save`] is needed.
    pub(super) fn logout(&self, headers: &HeaderMap) -> (String, bool) {
        let mut ended = false;
        if let Some((_, cookies)) = &self.token {
            for cookie in self.given_cookies(headers) {
                ended |= cookies.end(cookie);
            }
        }
        (self.cookie("", 0), ended)
    }

    /// Syncs the list of ended logins to disk. May block.
    pub(super) fn save(&self) {
        if let Some((_, cookies)) = &self.token
            && let Err(e) = cookies.save()
        {
            log::error!("storing the ended logins; they are valid again after a restart: {e}");
        }
    }

    fn check(
        &self,
        token: &Token,
        peer: IpAddr,
        given: &[u8],
        now: Duration,
    ) -> Result<(), Rejection> {
        self.peers(|peers| peers.may_try(peer, now))?;
        let right = token.is(given);
        self.peers(|peers| {
            if right {
                peers.right(peer, now);
            } else {
                peers.wrong(peer, now);
            }
            Ok(())
        })?;
        if right {
            Ok(())
        } else {
            log::warn!("a wrong token from {peer}");
            Err(Rejection::Unauthorised("the token is wrong"))
        }
    }

    /// With TLS the name prefix makes browsers enforce the cookie's attributes (RFC 6265bis,
    /// section 4.1.3).
    fn cookie_name(&self) -> &'static str {
        if self.tls { "__Host-rig" } else { "rig" }
    }

    fn cookie(&self, value: &str, seconds: u32) -> String {
        let secure = if self.tls { "; Secure" } else { "" };
        format!(
            "{}={value}; Path=/; Max-Age={seconds}; HttpOnly; SameSite=Strict{secure}",
            self.cookie_name()
        )
    }
}

/// The only value of a header, if present.
fn one<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, &'static str> {
    let mut values = headers.get_all(name).iter();
    let first = values.next().map(|v| v.to_str());
    match (first, values.next()) {
        (None, _) => Ok(None),
        (Some(Ok(value)), None) => Ok(Some(value)),
        (Some(Err(_)), _) => Err("a header is not ASCII"),
        (Some(_), Some(_)) => Err("a header that may be there once is there twice"),
    }
}

/// The name in a `Host`, without the port; `None` if it is neither a name nor an address.
fn host_name(host: &str) -> Option<&str> {
    let (name, port) = match host.rfind(']') {
        Some(end) => host.split_at(end + 1),
        None => host.split_at(host.find(':').unwrap_or(host.len())),
    };
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._[]:".contains(&b);
    let port_ok = port.is_empty()
        || port
            .strip_prefix(':')
            .is_some_and(|p| p.parse::<u16>().is_ok() && p.bytes().all(|b| b.is_ascii_digit()));
    (!name.is_empty() && name.bytes().all(plain) && port_ok).then_some(name)
}

#[cfg(test)]
mod tests;
