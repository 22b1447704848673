//! The phone's page with a fake rig: `cargo run -p rig-link --example demo -- recording`, then open
//! <http://127.0.0.1:8077> in a browser. The scenes are idle, armed, recording, stopping, warning
//! and fault; the second argument is the address to listen on; off loopback an identity is created
//! and the token of the variable `RIG_TOKEN` is required.

use std::io::Read;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use rig_link::fake::{FakeRig, Scene, write_session};
use rig_link::identity::Identity;
use rig_link::server::{DEFAULT_BIND, Settings, serve};
use rig_link::token::Token;

type Error = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("demo: {e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Error> {
    let mut arguments = std::env::args().skip(1);
    let word = arguments.next().unwrap_or_else(|| "armed".to_owned());
    let scene = Scene::ALL.into_iter().find(|s| s.word() == word);
    let scene = scene.ok_or_else(|| format!("{word:?} is not a scene"))?;
    let bind: SocketAddr = match arguments.next() {
        Some(address) => address.parse()?,
        None => DEFAULT_BIND,
    };
    let folder = std::env::temp_dir().join("rig-link-demo");
    let sessions = folder.join("sessions");
    for (i, name) in [
        "2026-05-04T09-31-07Z_1a2b3c4d",
        "2026-05-03T16-02-44Z_77aa01fe",
    ]
    .into_iter()
    .enumerate()
    {
        if !sessions.join(name).exists() {
            write_session(&sessions, name, 1 + i as u64, 20);
        }
    }
    let mut settings = Settings {
        bind,
        ..Settings::default()
    };
    if !bind.ip().is_loopback() {
        settings.identity = Some(Identity::load_or_create(&folder)?);
        settings.token = Some(Token::new(&std::env::var("RIG_TOKEN").unwrap_or_default())?);
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "a demonstration for people has a real clock"
    )]
    let start = Instant::now();
    let rig = Arc::new(FakeRig::new(sessions, scene, move || start.elapsed()));
    let server = serve(settings, rig)?;
    println!("{}", server.url());
    if let Some(fingerprint) = server.fingerprint() {
        println!("fingerprint {fingerprint}");
    }
    println!("Press Enter to stop.");
    let _ = std::io::stdin().read(&mut [0]);
    Ok(())
}
