//! Address of a rig.

use std::fmt;
use std::str::FromStr;

use super::LinkError;

/// Default port of a rig's server.
const PORT: u16 = 8077;

/// The address of a rig's server, as in `https://rig.local:8077`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Whether to use TLS.
    pub(super) tls: bool,
    /// Name or IP address, an IPv6 address without brackets.
    pub(super) host: String,
    pub(super) port: u16,
}

impl Address {
    /// Host and port as in an address.
    pub(super) fn authority(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.tls { "https" } else { "http" };
        write!(f, "{scheme}://{}", self.authority())
    }
}

impl FromStr for Address {
    type Err = LinkError;

    /// The port is 8077 unless given.
    fn from_str(text: &str) -> Result<Self, LinkError> {
        let wrong = |reason| LinkError::Address {
            found: text.chars().take(200).collect(),
            reason,
        };
        let (scheme, rest) = text
            .split_once("://")
            .ok_or_else(|| wrong("it does not begin with https://"))?;
        let tls = match scheme {
            "https" => true,
            "http" => false,
            _ => return Err(wrong("it does not begin with https://")),
        };
        let rest = rest.strip_suffix('/').unwrap_or(rest);
        if rest.contains(['/', '?', '#']) {
            return Err(wrong("unexpected text after host and port"));
        }
        if rest.contains('@') {
            return Err(wrong("it contains a user; the token is given separately"));
        }
        let (host, port) = match rest.strip_prefix('[') {
            Some(rest) => {
                let (host, port) = rest
                    .split_once(']')
                    .filter(|(host, _)| host.parse::<std::net::Ipv6Addr>().is_ok())
                    .ok_or_else(|| wrong("the text in brackets is not an IPv6 address"))?;
                (host, port)
            }
            None => rest.split_at(rest.find(':').unwrap_or(rest.len())),
        };
        let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._:".contains(&b);
        if host.is_empty() || !host.bytes().all(plain) {
            return Err(wrong("its host is neither a name nor an IP address"));
        }
        let port = match port.strip_prefix(':') {
            None if port.is_empty() => PORT,
            Some(digits) if digits.bytes().all(|b| b.is_ascii_digit()) => digits
                .parse()
                .ok()
                .filter(|port| *port > 0)
                .ok_or_else(|| wrong("its port is invalid"))?,
            _ => return Err(wrong("its port is invalid")),
        };
        Ok(Self {
            tls,
            host: host.to_owned(),
            port,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_parsed() {
        for (text, expected) in [
            ("https://rig.local:8077", "https://rig.local:8077"),
            ("https://rig", "https://rig:8077"),
            ("https://10.0.0.7:443/", "https://10.0.0.7:443"),
            ("http://127.0.0.1:8077", "http://127.0.0.1:8077"),
            ("https://[fe80::1]:9", "https://[fe80::1]:9"),
            ("https://[::1]", "https://[::1]:8077"),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), expected);
        }
        for bad in [
            "",
            "rig",
            "rig:8077",
            "ftp://rig",
            "https://",
            "https://:8077",
            "https://rig:",
            "https://rig:0",
            "https://rig:65536",
            "https://rig:+80",
            "https://rig:x",
            "https://u@rig",
            "https://rig/x",
            "https://rig?x",
            "https://rig#x",
            "https://[rig]",
            "https://[::1",
            "https://::1",
            "https://a b",
            "https://r\u{ef}g",
            "HTTPS://rig",
        ] {
            assert!(bad.parse::<Address>().is_err(), "{bad}");
        }
    }
}
