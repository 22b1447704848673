//! The rig is authenticated by its fingerprint only.

use rig_link::client::LinkError;
use rig_link::identity::{Fingerprint, Identity};
use rig_link::link::Code;
use rig_link::token::Token;

use crate::support::{Options, short_retry, start, token};

#[test]
fn only_the_expected_fingerprint_is_accepted() {
    let setup = start(Options {
        tls: true,
        token: true,
        ..Options::default()
    });
    let right = setup.server.fingerprint().unwrap();
    let ask = |fingerprint: Option<Fingerprint>, token: Option<Token>| {
        setup
            .client_with(fingerprint, token, short_retry())
            .sessions()
    };
    assert_eq!(ask(Some(right), Some(token())).unwrap().len(), 2);

    let folder = tempfile::tempdir().unwrap();
    let other = Identity::load_or_create(folder.path())
        .unwrap()
        .fingerprint();
    match ask(Some(other), Some(token())).unwrap_err() {
        LinkError::WrongFingerprint {
            found, expected, ..
        } => {
            assert_eq!((found, expected), (right, other));
        }
        error => panic!("{error}"),
    }
    let error = ask(None, Some(token())).unwrap_err();
    assert!(
        matches!(&error, LinkError::NoFingerprint { found, .. } if *found == right),
        "{error}"
    );
    assert!(error.to_string().contains(&right.to_string()), "{error}");

    for token in [None, Some(Token::new("another-token-than-that").unwrap())] {
        match ask(Some(right), token).unwrap_err() {
            LinkError::Rejected { problem, .. } => assert_eq!(problem.code, Code::Unauthorised),
            error => panic!("{error}"),
        }
    }
}

#[test]
fn plain_http_is_local_only() {
    let setup = start(Options::default());
    assert_eq!(setup.client().sessions().unwrap().len(), 2);
    let address = "http://192.0.2.1:8077".parse().unwrap();
    let mut client =
        rig_link::client::Client::new(address, None, Some(token()), short_retry()).unwrap();
    let error = client.sessions().unwrap_err();
    assert!(matches!(error, LinkError::PlainText { .. }), "{error}");
}

#[test]
fn unresponsive_server_times_out() {
    // A port without listener.
    let address = {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        format!("http://{}", listener.local_addr().unwrap())
    };
    let mut client =
        rig_link::client::Client::new(address.parse().unwrap(), None, None, short_retry()).unwrap();
    let error = client.sessions().unwrap_err();
    assert!(
        matches!(error, LinkError::NoResponse { tries: 4, .. }),
        "{error}"
    );
    assert!(error.to_string().contains("refused"), "{error}");
}
