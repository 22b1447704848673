//! Clients that take too much: requests, connections, time.

use super::*;

#[test]
fn excess_requests_are_rejected_and_later_served_again() {
    let limits = Limits {
        requests_per_s: 1,
        request_burst: 20,
        ..Limits::default()
    };
    let clock = ManualClock::new();
    let setup = start(Options {
        limits,
        clock: Arc::new(clock.clone()),
        ..Options::default()
    });
    let host = setup.server.address();
    let one = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n\r\n");
    let last = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    let answers = setup.raw(format!("{}{last}", one.repeat(100)));
    let (served, _) = answers.split_once("HTTP/1.1 429").expect("a refusal");
    assert_eq!(served.matches("HTTP/1.1 200").count(), 20, "{answers}");
    assert_eq!(status(&setup.get("/")), 429);
    clock.advance(Duration::from_secs(1));
    assert_eq!(status(&setup.get("/")), 200);
    assert_eq!(status(&setup.get("/")), 429);
}

#[test]
fn slow_heads_and_bodies_time_out_and_block_nobody() {
    let limits = Limits {
        head_time: LONG,
        connections_per_peer: 40,
        ..Limits::default()
    };
    let clock = ManualClock::new();
    let setup = start(Options {
        limits,
        clock: Arc::new(clock.clone()),
        ..Options::default()
    });
    let host = setup.server.address();
    let head = format!(
        "POST /api/act HTTP/1.1\r\nHost: {host}\r\nX-Rig-Link: 1\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n"
    );
    let mut slow: Vec<TcpStream> = Vec::new();
    for i in 0..30 {
        let mut stream = TcpStream::connect(host).unwrap();
        let begin = match i % 3 {
            0 => "",
            1 => "GET /api/status HTTP/1.1\r\nX-Slow: ",
            _ => head.as_str(),
        };
        stream.write_all(begin.as_bytes()).unwrap();
        slow.push(stream);
    }
    // Behind them, so that what they sent has been read.
    assert_eq!(status(&setup.get("/api/status")), 200);
    clock.wait_for_timers(slow.len());
    // More bytes extend no limit.
    for _ in 0..10 {
        for stream in &mut slow {
            // A request that begins with a space is rejected before its time.
            let _ = stream.write_all(b" ");
        }
        assert_eq!(status(&setup.get("/api/status")), 200);
        clock.advance(LONG / 11);
    }
    let mut begun = 0;
    for (i, stream) in slow.iter_mut().enumerate() {
        if i % 3 != 0 {
            assert!(is_open(stream), "closed before its time");
            begun += 1;
        }
    }
    clock.expire(begun);
    for mut stream in slow {
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        let text = String::from_utf8_lossy(&read(&mut stream)).into_owned();
        assert!(matches!(status(&text), 0 | 400 | 408), "{text}");
        assert!(is_closed(&mut stream), "{text}");
    }
    assert_eq!(clock.now(), LONG);
    assert_eq!(status(&setup.get("/api/status")), 200);
    assert_eq!(setup.rig.actions(), []);
}

#[test]
fn an_idle_connection_is_closed() {
    let limits = Limits {
        head_time: LONG,
        ..Limits::default()
    };
    let clock = ManualClock::new();
    let setup = start(Options {
        limits,
        clock: Arc::new(clock.clone()),
        ..Options::default()
    });
    let host = setup.server.address();
    let request = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n\r\n");
    let mut stream = TcpStream::connect(host).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    assert_eq!(status(&read_one(&mut stream)), 200);
    assert!(is_open(&mut stream));
    clock.expire(1);
    assert!(is_closed(&mut stream));
    assert_eq!(clock.now(), LONG);
}

/// Whether the connection is open and no data waits in it.
fn is_open(stream: &mut TcpStream) -> bool {
    stream.set_nonblocking(true).unwrap();
    let read = stream.read(&mut [0]);
    stream.set_nonblocking(false).unwrap();
    read.is_err_and(|e| e.kind() == ErrorKind::WouldBlock)
}

/// Whether the server has closed the connection, after reading all data.
fn is_closed(stream: &mut TcpStream) -> bool {
    match stream.read(&mut [0]) {
        Ok(n) => n == 0,
        Err(e) => !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
    }
}

#[test]
fn stalled_reader_is_disconnected() {
    let limits = Limits {
        head_time: LONG,
        ..Limits::default()
    };
    let clock = ManualClock::new();
    let setup = start(Options {
        limits,
        clock: Arc::new(clock.clone()),
        ..Options::default()
    });
    let path = setup.root.join("walk-2/rig/large.bin");
    std::fs::write(&path, vec![7; 64 << 20]).unwrap();
    let host = setup.server.address();
    let request =
        format!("GET /api/sessions/walk-2/files/rig/large.bin HTTP/1.1\r\nHost: {host}\r\n\r\n");
    let streams: Vec<TcpStream> = (0..8)
        .map(|_| {
            let mut stream = TcpStream::connect(host).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
            stream
        })
        .collect();
    setup.is_well();
    // The only timers that end before `LONG` are those of full connections, one each.
    clock.expire(streams.len());
    assert!(clock.now() < LONG, "{:?}", clock.now());
    setup.is_well();
    for mut stream in streams {
        let length = read(&mut stream).len();
        assert!(length < 64 << 20, "everything came");
    }
}

/// Sixteen connections from each of three addresses, which is all slots; each has sent `first`, and
/// its response has been read if there is one.
fn fill_slots(setup: &Setup, first: &str) -> Vec<TcpStream> {
    let from = [2, 3, 4].iter().cycle().take(48);
    from.map(|last| {
        let mut stream = connect_from([127, 0, 0, *last], setup.server.address());
        stream.write_all(first.as_bytes()).unwrap();
        if !first.is_empty() {
            let answer = read_one(&mut stream);
            assert_eq!(status(&answer), 200, "{answer}");
        }
        stream
    })
    .collect()
}

#[test]
fn unfinished_handshakes_of_three_addresses_exclude_nobody() {
    let limits = Limits {
        handshake_time: LONG,
        head_time: LONG,
        ..Limits::default()
    };
    let setup = start(Options {
        tls: true,
        token: true,
        limits,
        ..Options::default()
    });
    let _held = fill_slots(&setup, "");
    assert_eq!(setup.client().sessions().unwrap().len(), 2);
    let _held = fill_slots(&setup, "");
    assert_eq!(setup.client().sessions().unwrap().len(), 2);
}

#[test]
fn unauthenticated_clients_do_not_affect_the_phone() {
    let limits = Limits {
        head_time: LONG,
        requests_per_s: 10_000,
        request_burst: 10_000,
        ..Limits::default()
    };
    let setup = start(Options {
        token: true,
        limits,
        ..Options::default()
    });
    let host = setup.server.address();
    let page = format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n");
    // They may load the page, as the phone does before its login.
    let _held = fill_slots(&setup, &page);
    let cookie = login(&setup);
    let request = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n{cookie}\r\n");
    let mut phone = TcpStream::connect(host).unwrap();
    phone.write_all(request.as_bytes()).unwrap();
    assert_eq!(status(&read_one(&mut phone)), 200);
    let _more = fill_slots(&setup, &page);
    phone.write_all(request.as_bytes()).unwrap();
    assert_eq!(
        status(&read_one(&mut phone)),
        200,
        "the connection is still there"
    );
    assert_eq!(status(&setup.request("GET /api/status", &cookie, "")), 200);
}

#[test]
fn handshake_times_out_after_three_seconds() {
    assert_eq!(Limits::default().handshake_time, Duration::from_secs(3));
    let limits = Limits {
        handshake_time: Duration::from_millis(100),
        head_time: LONG,
        ..Limits::default()
    };
    let setup = start(Options {
        tls: true,
        token: true,
        limits,
        ..Options::default()
    });
    for begin in [&b""[..], b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"] {
        let mut stream = TcpStream::connect(setup.server.address()).unwrap();
        stream.write_all(begin).unwrap();
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        assert!(is_closed(&mut stream));
    }
}

#[test]
fn silent_connections_are_evicted_and_authenticated_ones_are_not() {
    let limits = Limits {
        connections: 12,
        connections_per_peer: 12,
        head_time: LONG,
        ..Limits::default()
    };
    let setup = start(Options {
        limits,
        ..Options::default()
    });
    let host = setup.server.address();
    let _silent: Vec<TcpStream> = (0..200)
        .filter_map(|_| TcpStream::connect(host).ok())
        .collect();
    assert_eq!(status(&setup.get("/api/status")), 200);

    let request = format!("GET /api/status HTTP/1.1\r\nHost: {host}\r\n\r\n");
    let mut used: Vec<TcpStream> = (0..12)
        .map(|_| {
            let mut stream = TcpStream::connect(host).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            assert_eq!(status(&read_one(&mut stream)), 200);
            stream
        })
        .collect();
    // Rejected, not left waiting.
    assert_eq!(status(&setup.get("/api/status")), 0);
    let mut left = used.pop().unwrap();
    left.shutdown(Shutdown::Write).unwrap();
    assert!(is_closed(&mut left));
    assert_eq!(status(&setup.get("/api/status")), 200);
}
