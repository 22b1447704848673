//! Malicious and broken clients. They get an error or are disconnected, and the next client is
//! served.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use rig_link::client::RetryPolicy;
use rig_link::fake::ManualClock;
use rig_link::identity::Identity;
use rig_link::rig::Action;
use rig_link::server::{Clock as _, Limits, ServeError, Settings, serve};
use rustix::fs::{CWD, FileType, Mode, mknodat};

use crate::support::{
    Options, Setup, TEST_TIMEOUT, TOKEN, bearer, connect_from, raw, read, read_one, start, status,
    token,
};

mod authorization;
mod exhaustion;

/// A timeout that is reached only where a test advances its clock so far.
const LONG: Duration = Duration::from_secs(3600);

/// The `Cookie` header of a fresh login.
fn login(setup: &Setup) -> String {
    let answer = setup.post(
        "/api/login",
        "X-Rig-Link: 1\r\n",
        &format!("{{\"token\":\"{TOKEN}\"}}"),
    );
    let cookie = answer.lines().find_map(|l| l.strip_prefix("set-cookie: "));
    let pair = cookie.and_then(|c| c.split(';').next());
    format!("Cookie: {}\r\n", pair.unwrap_or_else(|| panic!("{answer}")))
}

/// An error status, and no content of the file.
fn refused(setup: &Setup, what: &str, answer: &str) {
    let status = status(answer);
    assert!(matches!(status, 0 | 400..=499 | 505), "{what}: {answer}");
    assert!(
        !answer.contains("the secret") && !answer.contains("root:"),
        "{what}: {answer}"
    );
    setup.is_well();
}

#[test]
fn no_path_escapes_a_session() {
    let setup = start(Options::default());
    let good = setup.get("/api/sessions/walk-1/files/rig/rig.toml");
    assert_eq!(status(&good), 200);
    assert!(good.ends_with("revision = 1\n"), "{good}");
    let outside = [
        "../../secret",
        "..%2f..%2fsecret",
        "..%2F..%2Fsecret",
        "%2e%2e/%2e%2e/secret",
        "%2e%2e%2f%2e%2e%2fsecret",
        "%252e%252e%252f%252e%252e%252fsecret",
        "..%252f..%252fsecret",
        "....//....//secret",
        "..;/..;/secret",
        "..\\..\\secret",
        "..%5c..%5csecret",
        "%c0%ae%c0%ae/%c0%ae%c0%ae/secret",
        "%e0%80%ae%e0%80%ae/secret",
        "..%c0%af..%c0%afsecret",
        "%uff0e%uff0e/secret",
        "rig/../../../secret",
        "rig/..%2f..%2f..%2fsecret",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "//etc/passwd",
        "file:///etc/passwd",
        "rig/rig.toml%00",
        "%00",
        "rig%00/rig.toml",
        "rig/rig.toml/",
        "rig/./rig.toml",
        "./rig/rig.toml",
        "rig//rig.toml",
        "RIG/rig.toml",
        "rig",
        "",
        ".",
        "..",
        "~/secret",
        "rig/rig.toml%0d%0aX: y",
        "rig/rig.toml#x",
        "rig/rig.toml;x",
        "rig%2frig.toml%2f..",
        "index.bin",
        "%e2%80%a5/secret",
    ];
    for path in outside {
        for address in [
            format!("/api/sessions/walk-1/files/{path}"),
            format!("/api/sessions/{path}/manifest"),
            format!("/api/sessions/{path}/files/rig/rig.toml"),
            format!("/{path}"),
        ] {
            refused_or_page(&setup, &address);
        }
    }
}

/// Nothing outside the sessions; `/` and similar paths may be the page.
fn refused_or_page(setup: &Setup, address: &str) {
    let answer = setup.get(address);
    assert!(
        !answer.contains("the secret") && !answer.contains("root:"),
        "{address}: {answer}"
    );
    let page = ["/", "/#", "/."].contains(&address);
    let anchor = address.contains('#');
    assert!(
        page || anchor || matches!(status(&answer), 0 | 400..=499),
        "{address}: {answer}"
    );
}

#[test]
fn malformed_and_oversized_heads_are_rejected() {
    let setup = start(Options::default());
    let host = setup.server.address();
    let line = |line: &str| format!("{line}\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    let many: String = (0..200).map(|i| format!("X-{i}: y\r\n")).collect();
    let cases: Vec<(&str, Vec<u8>)> = vec![
        ("HTTP/0.9", b"GET /\r\n".to_vec()),
        ("HTTP/0.9 without CR", b"GET /\n\n".to_vec()),
        ("HTTP/1.0", line("GET /api/status HTTP/1.0").into()),
        ("HTTP/2 preface", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec()),
        ("HTTP/9.9", line("GET / HTTP/9.9").into()),
        ("no Host", b"GET /api/status HTTP/1.1\r\n\r\n".to_vec()),
        ("two Hosts", format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\nHost: {host}\r\n\r\n").into()),
        ("another Host", b"GET /api/status HTTP/1.1\r\nHost: evil.example\r\n\r\n".to_vec()),
        ("Host of a neighbour", b"GET /api/status HTTP/1.1\r\nHost: 10.0.0.1:8077\r\n\r\n".to_vec()),
        ("a proxy", line("GET http://127.0.0.1/api/status HTTP/1.1").into()),
        ("a tunnel", line("CONNECT 127.0.0.1:22 HTTP/1.1").into()),
        ("the star", line("OPTIONS * HTTP/1.1").into()),
        ("TRACE", line("TRACE /api/status HTTP/1.1").into()),
        ("PUT", line("PUT /api/sessions HTTP/1.1").into()),
        ("DELETE", line("DELETE /api/sessions/walk-1 HTTP/1.1").into()),
        ("lower case", line("get /api/status HTTP/1.1").into()),
        ("a null in the path", line("GET /api/\0status HTTP/1.1").into()),
        ("a null in a header", format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\nX: a\0b\r\n\r\n").into()),
        ("a long path", line(&format!("GET /{} HTTP/1.1", "a".repeat(8000))).into()),
        ("a huge path", line(&format!("GET /{} HTTP/1.1", "a".repeat(1 << 20))).into()),
        ("a huge header", format!("GET / HTTP/1.1\r\nHost: {host}\r\nX: {}\r\n\r\n", "a".repeat(1 << 20)).into()),
        ("many headers", format!("GET / HTTP/1.1\r\nHost: {host}\r\n{many}\r\n").into()),
        ("a folded header", format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\nX: a\r\n b\r\n\r\n").into()),
        ("a space before the colon", format!("GET /api/status HTTP/1.1\r\nHost : {host}\r\n\r\n").into()),
        ("no header at all", b"GET /api/status HTTP/1.1\r\n\r\n\r\n\r\n".to_vec()),
        ("garbage", (0..=255).cycle().take(100_000).collect()),
        ("nulls", vec![0; 100_000]),
        ("TLS", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03".to_vec()),
        ("SSH", b"SSH-2.0-OpenSSH_9.2\r\n".to_vec()),
        ("a body with GET", format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\nContent-Length: 5\r\n\r\nhello").into()),
        (
            "smuggled lengths",
            format!("POST /api/act HTTP/1.1\r\nHost: {host}\r\nX-Rig-Link: 1\r\nContent-Type: application/json\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello").into(),
        ),
        (
            "two kinds of length",
            format!("POST /api/act HTTP/1.1\r\nHost: {host}\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n").into(),
        ),
        (
            "a negative length",
            format!("POST /api/act HTTP/1.1\r\nHost: {host}\r\nContent-Length: -1\r\n\r\n").into(),
        ),
        (
            "a bad chunk",
            format!("POST /api/act HTTP/1.1\r\nHost: {host}\r\nX-Rig-Link: 1\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffffff\r\nx").into(),
        ),
    ];
    for (what, bytes) in cases {
        refused(&setup, what, &setup.raw_and_done(&bytes));
    }
    assert_eq!(setup.rig.actions(), []);
}

#[test]
fn input_after_garbage_is_ignored() {
    let setup = start(Options::default());
    let host = setup.server.address();
    let stop = "{\"do\":\"stop\"}";
    let hidden = format!(
        "POST /api/act HTTP/1.1\r\nHost: {host}\r\nX-Rig-Link: 1\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{stop}",
        stop.len()
    );
    for first in [
        // An unexpected body must not be read as a request.
        format!(
            "GET /api/status HTTP/1.1\r\nHost: {host}\r\nContent-Length: {}\r\n\r\n",
            hidden.len()
        ),
        format!(
            "GET /nothing HTTP/1.1\r\nHost: {host}\r\nContent-Length: {}\r\n\r\n",
            hidden.len()
        ),
        format!(
            "GET /api/status HTTP/1.1\r\nHost: evil.example\r\nContent-Length: {}\r\n\r\n",
            hidden.len()
        ),
        "\0\0garbage\r\n\r\n".to_owned(),
        format!("BREW /api/status HTTP/1.1\r\nHost: {host}\r\n\r\n"),
    ] {
        setup.raw_and_done(format!("{first}{hidden}"));
        assert_eq!(setup.rig.actions(), [], "{first}");
    }
    // Pipelining itself is fine.
    let one = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n\r\n");
    let last = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    let answers = setup.raw(format!("{}{last}", one.repeat(20)));
    assert_eq!(answers.matches("HTTP/1.1 200").count(), 21);
}

#[test]
fn invalid_bodies_are_rejected() {
    let setup = start(Options::default());
    let link = "X-Rig-Link: 1\r\n";
    for body in [
        "",
        "{",
        "[]",
        "null",
        "{}",
        "{\"do\":\"explode\"}",
        "{\"do\":\"start\",\"name\":5}",
        "{\"do\":\"start\",\"name\":\"a\\u0000b\"}",
        "{\"do\":\"mark\",\"text\":\"a\\nb\"}",
        "{\"do\":\"mark\",\"text\":\"a\\u009b2Jb\"}",
        "{\"do\":\"start\",\"name\":\"a\\u202egnp.exe\"}",
        "{\"do\":\"start\",\"name\":\"a\\u2028b\"}",
        "\u{0}",
        "{\"do\":\"stop\"}{\"do\":\"stop\"}",
        &format!("{{\"do\":\"mark\",\"text\":\"{}\"}}", "x".repeat(201)),
        &format!("{{\"do\":\"mark\",\"text\":\"{}\"}}", "x".repeat(100_000)),
        &"[".repeat(10_000),
    ] {
        refused(&setup, body, &setup.post("/api/act", link, body));
    }
    let form =
        "X-Rig-Link: 1\r\nContent-Type: application/x-www-form-urlencoded\r\nContent-Length: 7\r\n";
    refused(
        &setup,
        "a form",
        &setup.request("POST /api/act", form, "do=stop"),
    );
    let endless =
        "X-Rig-Link: 1\r\nContent-Type: application/json\r\nContent-Length: 99999999999\r\n";
    refused(
        &setup,
        "endless",
        &setup.request("POST /api/act", endless, &" ".repeat(200_000)),
    );
    assert_eq!(setup.rig.actions(), []);
    let mark = setup.post(
        "/api/act",
        link,
        "{\"do\":\"mark\",\"text\":\"stairs \u{e4}\"}",
    );
    assert_eq!(status(&mark), 409, "{mark}");
    assert!(mark.contains("nothing is being recorded"), "{mark}");
    assert_eq!(
        setup.rig.actions(),
        [Action::Mark {
            text: "stairs \u{e4}".to_owned()
        }]
    );
}

#[test]
fn ranges_are_within_the_file_or_nothing() {
    let setup = start(Options::default());
    let path = "GET /api/sessions/walk-1/files/rig/rig.toml";
    let whole = "revision = 1\n";
    for (range, expected, body) in [
        ("bytes=0-", 206, whole),
        ("bytes=0-3", 206, "revi"),
        ("bytes=11-", 206, "1\n"),
        ("bytes=-2", 206, "1\n"),
        ("bytes=-999", 206, whole),
        ("bytes=5-99999999999999999999999", 206, "ion = 1\n"),
        ("bytes=13-", 416, ""),
        ("bytes=18446744073709551615-", 416, ""),
        ("bytes=-0", 416, ""),
        ("bytes=3-1", 200, whole),
        ("bytes=0-0,2-2,4-4", 200, whole),
        (&format!("bytes={}", "0-,".repeat(1000)), 200, whole),
        ("lines=1-2", 200, whole),
        ("bytes=0x1-0x2", 200, whole),
        ("bytes=-1-2", 200, whole),
    ] {
        let answer = setup.request(path, &format!("Range: {range}\r\n"), "");
        assert_eq!(status(&answer), expected, "{range}: {answer}");
        if expected != 416 {
            assert_eq!(answer.split("\r\n\r\n").nth(1), Some(body), "{range}");
        } else {
            assert!(
                answer.to_lowercase().contains("content-range: bytes */13"),
                "{answer}"
            );
        }
    }
    let answer = setup.request(path, "Range: bytes=3-\r\nIf-Range: \"old\"\r\n", "");
    assert_eq!(status(&answer), 200, "{answer}");
    let head = setup.request(&path.replace("GET", "HEAD"), "", "");
    assert!(head.to_lowercase().contains("content-length: 13"), "{head}");
    assert!(!head.contains("revision"), "{head}");
}

#[test]
fn session_being_recorded_is_listed_and_not_served() {
    let setup = start(Options::default());
    setup.rig.record(Some("walk-1"));
    let list = setup.get("/api/sessions");
    assert!(list.contains("\"state\":\"recording\""), "{list}");
    for path in [
        "manifest",
        "files/session.json",
        "files/segments/000000.mcap",
        "files/nothing",
    ] {
        let answer = setup.get(&format!("/api/sessions/walk-1/{path}"));
        assert_eq!(status(&answer), 409, "{path}");
        assert!(answer.contains("\"code\":\"recording\""), "{answer}");
    }
    for path in ["receipt", "free"] {
        let body = "{\"format\":\"rig-link-receipt\",\"version\":1,\"session_id\":\"x\",\"list\":\"x\",\"files\":1,\"bytes\":1,\"host\":\"x\",\"verified_ns\":1}";
        let answer = setup.post(
            &format!("/api/sessions/walk-1/{path}"),
            "X-Rig-Link: 1\r\n",
            body,
        );
        assert_eq!(status(&answer), 409, "{path}");
        assert!(answer.contains("\"code\":\"recording\""), "{answer}");
    }
    assert_eq!(status(&setup.get("/api/sessions/walk-2/manifest")), 200);
    setup.rig.record(None);
    assert_eq!(status(&setup.get("/api/sessions/walk-1/manifest")), 200);
}

#[test]
fn plain_client_of_a_tls_server_gets_nothing() {
    let limits = Limits {
        handshake_time: Duration::from_millis(500),
        ..Limits::default()
    };
    let setup = start(Options {
        tls: true,
        token: true,
        limits,
        ..Options::default()
    });
    for bytes in [
        &b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"[..],
        b"",
        b"\x16\x03\x01",
        &[0; 50_000],
    ] {
        let answer = setup.raw(bytes);
        assert!(
            !answer.contains("HTTP/1.1") && !answer.contains("html"),
            "{answer}"
        );
    }
    // A TLS client is served; on a busy machine that takes longer.
    let limits = Limits {
        handshake_time: LONG,
        ..Limits::default()
    };
    let setup = start(Options {
        tls: true,
        token: true,
        limits,
        ..Options::default()
    });
    assert_eq!(setup.client().sessions().unwrap().len(), 2);
}

#[test]
fn randomly_mutated_requests_are_harmless() {
    let limits = Limits {
        requests_per_s: 10_000,
        request_burst: 10_000,
        ..Limits::default()
    };
    let setup = start(Options {
        limits,
        ..Options::default()
    });
    let host = setup.server.address();
    let seeds = [
        format!(
            "GET /api/sessions/walk-1/files/rig/rig.toml HTTP/1.1\r\nHost: {host}\r\nRange: bytes=1-5\r\nConnection: close\r\n\r\n"
        ),
        format!(
            "GET /api/preview/1?have=3 HTTP/1.1\r\nHost: {host}\r\nCookie: rig=1; a=b\r\nConnection: close\r\n\r\n"
        ),
        format!(
            "POST /api/act HTTP/1.1\r\nHost: {host}\r\nX-Rig-Link: 1\r\nContent-Type: application/json\r\nContent-Length: 26\r\n\r\n{{\"do\":\"mark\",\"text\":\"abc\"}}"
        ),
        format!(
            "POST /api/login HTTP/1.1\r\nHost: {host}\r\nX-Rig-Link: 1\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n{{\"tok\r\n9\r\nen\":\"x\"}}  \r\n0\r\n\r\n"
        ),
    ];
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    let mut next = |below: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        (random % below as u64) as usize
    };
    for round in 0..1500 {
        let mut bytes = seeds[round % seeds.len()].clone().into_bytes();
        for _ in 0..1 + next(4) {
            let at = next(bytes.len());
            match next(5) {
                0 => bytes[at] = next(256) as u8,
                1 if bytes.len() > 1 => _ = bytes.remove(at),
                1 => {}
                2 => bytes.insert(at, next(256) as u8),
                3 => bytes.truncate(at.max(1)),
                _ => {
                    let piece: Vec<u8> = bytes[at..].iter().copied().take(1 + next(40)).collect();
                    let to = next(bytes.len());
                    bytes.splice(to..to, piece);
                }
            }
        }
        let mut stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        let _ = stream.write_all(&bytes);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let answer = String::from_utf8_lossy(&read(&mut stream)).into_owned();
        let known = [
            0, 200, 204, 206, 400, 401, 403, 404, 405, 409, 414, 416, 431, 501, 505,
        ];
        let sent = String::from_utf8_lossy(&bytes);
        assert!(known.contains(&status(&answer)), "{sent:?}: {answer}");
        assert!(!answer.contains("the secret"), "{sent:?}: {answer}");
    }
    setup.is_well();
}

/// A FIFO in place of a receipt does not block; it counts as no receipt.
#[test]
fn non_file_receipt_counts_as_missing() {
    let setup = start(Options::default());
    let receipts = setup.root.join("receipts");
    std::fs::create_dir_all(&receipts).unwrap();
    let path = receipts.join("walk-1.json");
    mknodat(CWD, &path, FileType::Fifo, Mode::from_raw_mode(0o600), 0).unwrap();
    let retry = RetryPolicy {
        read_timeout: Duration::from_secs(120),
        max_attempts: 1,
        ..RetryPolicy::default()
    };
    let sessions = setup.client_with(None, None, retry).sessions().unwrap();
    assert_eq!(sessions.len(), 2);
    assert!(sessions.iter().all(|session| session.receipt.is_none()));
}
