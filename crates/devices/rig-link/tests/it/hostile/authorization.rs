//! Who may do what: tokens, cookies, other sites' pages.

use super::*;

#[test]
fn server_off_loopback_needs_tls_and_token() {
    let setup = start(Options::default());
    let identity = || Some(Identity::load_or_create(&setup.identity).unwrap());
    for bind in [
        "0.0.0.0:0",
        "[::]:0",
        "10.1.2.3:0",
        "[2001:db8::1]:0",
        "[::ffff:10.0.0.1]:0",
    ] {
        let bind = bind.parse().unwrap();
        let start = |identity, token| {
            let settings = Settings {
                bind,
                identity,
                token,
                ..Settings::default()
            };
            serve(settings, setup.rig.clone())
        };
        let error = start(identity(), None).unwrap_err();
        assert!(matches!(error, ServeError::NoToken { .. }), "{error}");
        let error = start(None, Some(token())).unwrap_err();
        assert!(matches!(error, ServeError::NoIdentity { .. }), "{error}");
        assert!(start(None, None).is_err());
    }
    // On loopback neither is needed; the IPv4-mapped form is loopback, too.
    for bind in ["127.0.0.1:0", "[::ffff:127.0.0.1]:0"] {
        let settings = Settings {
            bind: bind.parse().unwrap(),
            ..Settings::default()
        };
        assert!(serve(settings, setup.rig.clone()).is_ok(), "{bind}");
    }
    let all = Settings {
        bind: "0.0.0.0:0".parse().unwrap(),
        identity: identity(),
        token: Some(token()),
        ..Settings::default()
    };
    assert!(
        serve(all, setup.rig.clone())
            .unwrap()
            .url()
            .starts_with("https://")
    );
}

#[test]
fn other_sites_pages_have_no_access() {
    let setup = start(Options::default());
    let host = setup.server.address();
    let stop = "{\"do\":\"stop\"}";
    for headers in [
        "",
        "Origin: https://evil.example\r\n",
        "Origin: https://evil.example\r\nX-Rig-Link: 1\r\n",
        "Origin: null\r\n",
        &format!("Origin: https://{host}\r\n"),
        &format!("Origin: http://{host}\r\nSec-Fetch-Site: cross-site\r\n"),
        "Sec-Fetch-Site: same-site\r\nX-Rig-Link: 1\r\n",
        "Sec-Fetch-Site: none\r\n",
    ] {
        let answer = setup.post("/api/act", headers, stop);
        assert_eq!(status(&answer), 403, "{headers}: {answer}");
    }
    assert_eq!(setup.rig.actions(), []);
    for path in [
        "/api/status",
        "/api/preview/0",
        "/api/sessions",
        "/api/sessions/walk-1/manifest",
    ] {
        for site in ["cross-site", "same-site"] {
            let answer = setup.request(
                &format!("GET {path}"),
                &format!("Sec-Fetch-Site: {site}\r\n"),
                "",
            );
            assert_eq!(status(&answer), 403, "{path}");
        }
        let answer = setup.get(path);
        assert_eq!(status(&answer), 200, "{path}");
        assert!(
            !answer.to_lowercase().contains("access-control-allow"),
            "{path}"
        );
    }
    let preflight = setup.request(
        "OPTIONS /api/act",
        "Origin: https://evil.example\r\nAccess-Control-Request-Method: POST\r\n",
        "",
    );
    assert_eq!(status(&preflight), 405);
    // Our own page may.
    let own = format!("Origin: http://{host}\r\nSec-Fetch-Site: same-origin\r\n");
    setup.post("/api/act", &own, stop);
    assert_eq!(setup.rig.actions(), [Action::Stop]);
}

#[test]
fn every_response_has_security_headers() {
    let setup = start(Options {
        token: true,
        ..Options::default()
    });
    for path in [
        "/",
        "/app.js",
        "/style.css",
        "/icon.svg",
        "/nothing",
        "/api/status",
        "/api/preview/0",
    ] {
        let answer = setup.get(path).to_lowercase();
        for header in [
            "content-security-policy: default-src 'none'; script-src 'self';",
            "frame-ancestors 'none'",
            "x-content-type-options: nosniff",
            "x-frame-options: deny",
            "referrer-policy: no-referrer",
            "cache-control: no-store",
            "cross-origin-resource-policy: same-origin",
            "cross-origin-opener-policy: same-origin",
        ] {
            assert!(answer.contains(header), "{path} lacks {header}: {answer}");
        }
    }
}

#[test]
fn without_token_only_the_page_is_served() {
    let limits = Limits {
        wrong_token_pause: LONG,
        ..Limits::default()
    };
    let setup = start(Options {
        token: true,
        limits,
        ..Options::default()
    });
    for path in ["/", "/app.js", "/style.css", "/icon.svg"] {
        assert_eq!(status(&setup.get(path)), 200, "{path}");
    }
    for path in [
        "/api/status",
        "/api/preview/0",
        "/api/sessions",
        "/api/sessions/walk-1/manifest",
        "/api/sessions/walk-1/files/session.json",
        "/api/sessions/none/manifest",
    ] {
        let answer = setup.get(path);
        assert_eq!(status(&answer), 401, "{path}");
        assert!(answer.to_lowercase().contains("www-authenticate: bearer"));
    }
    for path in [
        "/api/act",
        "/api/sessions/walk-1/receipt",
        "/api/sessions/walk-1/free",
    ] {
        let answer = setup.post(path, "X-Rig-Link: 1\r\n", "{\"do\":\"stop\"}");
        assert_eq!(status(&answer), 401, "{path}");
    }
    assert_eq!(setup.rig.actions(), []);

    let login = |token: &str| {
        setup.post(
            "/api/login",
            "X-Rig-Link: 1\r\n",
            &format!("{{\"token\":\"{token}\"}}"),
        )
    };
    let answer = login(TOKEN);
    assert_eq!(status(&answer), 204, "{answer}");
    let cookie = answer
        .lines()
        .find_map(|l| l.strip_prefix("set-cookie: "))
        .unwrap();
    assert!(
        cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"),
        "{cookie}"
    );
    let cookie = format!("Cookie: {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(status(&setup.request("GET /api/status", &cookie, "")), 200);
    // The cookie alone does not let another site's page in.
    let answer = setup.post(
        "/api/act",
        &format!("{cookie}Origin: https://evil.example\r\n"),
        "{\"do\":\"stop\"}",
    );
    assert_eq!(status(&answer), 403);

    // A wrong token causes a pause; meanwhile not even the right one is checked.
    assert_eq!(status(&login("wrong-wrong-wrong-wrong")), 401);
    let answer = login(TOKEN);
    assert_eq!(status(&answer), 429, "{answer}");
    assert!(answer.to_lowercase().contains("retry-after: "), "{answer}");
    assert_eq!(
        status(&setup.request("GET /api/status", &bearer(TOKEN), "")),
        429
    );
    // A client with the cookie is not affected.
    assert_eq!(status(&setup.request("GET /api/status", &cookie, "")), 200);
}

#[test]
fn right_token_is_accepted_after_a_wrong_one() {
    let clock = ManualClock::new();
    let setup = start(Options {
        token: true,
        clock: Arc::new(clock.clone()),
        ..Options::default()
    });
    let ask = |token: &str| status(&setup.request("GET /api/status", &bearer(token), ""));
    assert_eq!(ask("wrong-wrong-wrong-wrong"), 401);
    assert_eq!(ask(TOKEN), 429);
    clock.advance(Limits::default().wrong_token_pause);
    assert_eq!(ask(TOKEN), 200);
}

#[test]
fn cookie_is_rejected_after_its_logout() {
    let setup = start(Options {
        token: true,
        ..Options::default()
    });
    let [phone, other] = [(); 2].map(|()| login(&setup));
    let look = |cookie: &str| status(&setup.request("GET /api/status", cookie, ""));
    assert_eq!((look(&phone), look(&other)), (200, 200));
    // Another site's page cannot end a login.
    let foreign = format!("{phone}Origin: https://evil.example\r\n");
    assert_eq!(status(&setup.post("/api/logout", &foreign, "")), 403);
    assert_eq!(look(&phone), 200);
    let out = setup.post("/api/logout", &format!("{phone}X-Rig-Link: 1\r\n"), "");
    assert!(status(&out) == 204 && out.contains("Max-Age=0"), "{out}");
    assert_eq!((look(&phone), look(&other)), (401, 200));
    let act = setup.post(
        "/api/act",
        &format!("{phone}X-Rig-Link: 1\r\n"),
        "{\"do\":\"stop\"}",
    );
    assert_eq!(status(&act), 401, "{act}");
    // The list of ended logins is synced before the response to the logout.
    let again = setup.again();
    let look = |cookie: &str| {
        let host = again.address();
        let request = format!(
            "GET /api/status HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{cookie}\r\n"
        );
        status(&raw(host, request.as_bytes()))
    };
    assert_eq!((look(&phone), look(&other)), (401, 200));
}

#[test]
fn token_guessing_is_slowed_down() {
    let pause = Duration::from_millis(50);
    let limits = Limits {
        wrong_token_pause: pause,
        ..Limits::default()
    };
    let clock = ManualClock::new();
    let setup = start(Options {
        token: true,
        limits,
        clock: Arc::new(clock.clone()),
        ..Options::default()
    });
    let guess = || {
        let headers = bearer("wrong-wrong-wrong-wrong");
        status(&setup.request("GET /api/status", &headers, ""))
    };
    let shortest = Duration::from_nanos(1);
    // Pauses of 50, 100, 200, 400 and 800 ms.
    for doubled in (0..5).map(|n| pause * (1 << n)) {
        assert_eq!(guess(), 401);
        assert_eq!(guess(), 429);
        clock.advance(doubled - shortest);
        assert_eq!(guess(), 429, "before the end of {doubled:?}");
        clock.advance(shortest);
    }
    assert_eq!(guess(), 401);
}
