use super::*;

const TOKEN: &str = "correct-horse-battery";
const PEER: &str = "10.0.0.9";

fn guard(tls: bool, token: bool, address: &str) -> Guard {
    let token = token.then(|| Token::new(TOKEN).unwrap());
    Guard::new(
        token,
        None,
        tls,
        address.parse().unwrap(),
        &Limits::default(),
    )
}

fn headers(all: &[(&'static str, &str)]) -> HeaderMap {
    let mut map = HeaderMap::new();
    for (name, value) in all {
        map.append(*name, value.parse().unwrap());
    }
    map
}

fn peer() -> IpAddr {
    PEER.parse().unwrap()
}

#[test]
fn loopback_accepts_only_local_hosts() {
    let local = guard(false, false, "127.0.0.1");
    let admit = |host: &str| local.admit(peer(), &headers(&[("host", host)]), Duration::ZERO);
    for host in [
        "localhost",
        "LOCALHOST:8077",
        "127.0.0.1:8077",
        "127.1.2.3",
        "[::1]",
        "[::1]:9",
    ] {
        assert_eq!(admit(host), Ok(()), "{host}");
    }
    for host in [
        "evil.example",
        "evil.example:8077",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "10.0.0.1",
        "[::2]",
        "0.0.0.0",
    ] {
        assert!(matches!(admit(host), Err(Rejection::Foreign(_))), "{host}");
    }
    for host in [
        "",
        "a b",
        "localhost:",
        "localhost:x",
        "localhost:+80",
        "localhost:99999",
        "a/b",
        "u@localhost",
        "[::1",
    ] {
        assert!(admit(host).is_err(), "{host}");
    }
    let twice = headers(&[("host", "localhost"), ("host", "localhost")]);
    assert!(matches!(
        local.admit(peer(), &twice, Duration::ZERO),
        Err(Rejection::Malformed(_))
    ));
    assert!(matches!(
        local.admit(peer(), &headers(&[]), Duration::ZERO),
        Err(Rejection::Malformed(_))
    ));
    let open = guard(true, true, "0.0.0.0");
    let other = headers(&[("host", "rig.local:8077")]);
    assert_eq!(open.admit(peer(), &other, Duration::ZERO), Ok(()));
}

#[test]
fn only_the_own_page_may_change_state() {
    let guard = guard(true, true, "10.0.0.1");
    let change = |more: &[(&'static str, &str)]| {
        let mut all = vec![("host", "10.0.0.1:8077")];
        all.extend(more);
        guard.change(&headers(&all))
    };
    let own = ("origin", "https://10.0.0.1:8077");
    for good in [
        &[own][..],
        &[own, ("sec-fetch-site", "same-origin")],
        &[("sec-fetch-site", "same-origin")],
        &[("x-rig-link", "1")],
    ] {
        assert_eq!(change(good), Ok(()), "{good:?}");
    }
    for bad in [
        &[][..],
        &[("origin", "https://evil.example")],
        &[("origin", "http://10.0.0.1:8077")],
        &[("origin", "https://10.0.0.1")],
        &[("origin", "null")],
        &[own, ("sec-fetch-site", "cross-site")],
        &[("sec-fetch-site", "same-site"), ("x-rig-link", "1")],
        &[("sec-fetch-site", "none")],
        &[("origin", "https://evil.example"), ("x-rig-link", "1")],
        &[own, own],
    ] {
        assert!(change(bad).is_err(), "{bad:?}");
    }
    for (site, ok) in [
        ("same-origin", true),
        ("none", true),
        ("cross-site", false),
        ("same-site", false),
    ] {
        assert_eq!(
            guard
                .check_read(&headers(&[("sec-fetch-site", site)]))
                .is_ok(),
            ok,
            "{site}"
        );
    }
    assert_eq!(guard.check_read(&headers(&[])), Ok(()));
}

#[test]
fn token_is_accepted_as_header_and_as_cookie() {
    let guard = guard(true, true, "10.0.0.1");
    let ask = |all: &[(&'static str, &str)], s| {
        guard.authenticate(peer(), &headers(all), Duration::from_secs(s))
    };
    let unauthorised = |result| matches!(result, Err(Rejection::Unauthorised(_)));
    assert_eq!(
        ask(&[("authorization", &format!("Bearer {TOKEN}"))], 0),
        Ok(())
    );
    assert_eq!(
        ask(&[("authorization", &format!("bearer {TOKEN}"))], 0),
        Ok(())
    );
    assert!(unauthorised(ask(&[], 0)));
    assert!(unauthorised(ask(&[("authorization", "Basic abc")], 0)));
    assert!(unauthorised(ask(&[("authorization", TOKEN)], 0)));

    let cookie = guard
        .login(peer(), TOKEN.as_bytes(), Duration::ZERO)
        .unwrap()
        .unwrap();
    for part in [
        "__Host-rig=",
        "; HttpOnly",
        "; Secure",
        "; SameSite=Strict",
        "; Path=/",
    ] {
        assert!(cookie.contains(part), "{cookie}");
    }
    assert!(!cookie.contains(TOKEN));
    let pair = cookie.split(';').next().unwrap();
    assert_eq!(ask(&[("cookie", &format!("a=b; {pair}"))], 0), Ok(()));
    assert!(unauthorised(ask(&[("cookie", &format!("{pair}0"))], 0)));
    assert!(unauthorised(ask(&[("cookie", "__Host-rig=")], 0)));
    // Wrong cookies are not penalized, a wrong token is, and then even the right one is not
    // checked.
    assert_eq!(ask(&[("cookie", pair)], 0), Ok(()));
    assert!(unauthorised(ask(
        &[("authorization", "Bearer wrong-wrong-wrong")],
        1
    )));
    let right = format!("Bearer {TOKEN}");
    assert!(matches!(
        ask(&[("authorization", &right)], 1),
        Err(Rejection::TooMany(_))
    ));
    assert_eq!(ask(&[("authorization", &right)], 2), Ok(()));

    // A logout ends its own cookie and no other.
    let login = || guard.login(peer(), TOKEN.as_bytes(), Duration::from_secs(9));
    let other = login().unwrap().unwrap();
    let other = other.split(';').next().unwrap();
    let (forget, ended) = guard.logout(&headers(&[("cookie", &format!("a=b; {pair}"))]));
    assert!(forget.contains("Max-Age=0") && ended, "{forget}");
    assert!(unauthorised(ask(&[("cookie", pair)], 9)));
    assert_eq!(ask(&[("cookie", other)], 9), Ok(()));
    assert!(!guard.logout(&headers(&[("cookie", pair)])).1);
    assert!(!guard.logout(&headers(&[])).1);
}

#[test]
fn addresses_are_known_after_token_or_cookie() {
    let guard = guard(true, true, "10.0.0.1");
    let [phone, host, stranger] = ["10.0.0.7", "10.0.0.8", "10.0.0.9"].map(|a| a.parse().unwrap());
    let now = Duration::from_secs(5);
    let cookie = guard.login(host, TOKEN.as_bytes(), now).unwrap().unwrap();
    let cookie = headers(&[("cookie", cookie.split(';').next().unwrap())]);
    assert!(guard.is_known(host, now) && !guard.is_known(phone, now));
    assert_eq!(guard.authenticate(phone, &cookie, now), Ok(()));
    assert!(guard.is_known(phone, now));
    assert!(guard.authenticate(stranger, &headers(&[]), now).is_err());
    assert!(!guard.is_known(stranger, now));
}

#[test]
fn server_without_token_needs_none() {
    let guard = guard(false, false, "::1");
    assert_eq!(
        guard.authenticate(peer(), &headers(&[]), Duration::ZERO),
        Ok(())
    );
    assert_eq!(guard.login(peer(), b"", Duration::ZERO), Ok(None));
}
