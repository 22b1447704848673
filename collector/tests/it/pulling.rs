//! `paws pull` from a rig server in this process, over connections that break.

#![expect(
    clippy::disallowed_methods,
    reason = "processes are killed and connections cut after real time"
)]

use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use collector::commands::pull::{self, Options};
use collector::library::Library;
use console_output::Outcome;
use rig_link::client::RetryPolicy;
use rig_link::fake::{FakeRig, ManualClock, Scene};
use rig_link::identity::Identity;
use rig_link::server::{Limits, Server, Settings, serve};
use rig_link::token::Token;

use crate::support::{ID, Session, capture, tree};

const OTHER: &str = "0192aa00-0000-7000-8000-000000000002";
const TOKEN: &str = "correct-horse-battery";

/// A rig with two sessions, and a folder for a library.
struct Rig {
    folder: tempfile::TempDir,
    rig: Arc<FakeRig>,
    server: Server,
}

impl Rig {
    fn new() -> Self {
        Self::with(Settings::default(), 20_000)
    }

    fn with(settings: Settings, unit_bytes: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let sessions = folder.path().join("rig");
        Session::with_units(2.0, unit_bytes).write(&sessions.join("walk-1"));
        let mut other = Session::good(1.0);
        other.spec.session_id = OTHER.to_owned();
        other.spec.name = "run".to_owned();
        other.write(&sessions.join("run-1"));
        let start = Instant::now();
        let rig = Arc::new(FakeRig::new(&sessions, Scene::Armed, move || {
            start.elapsed()
        }));
        let settings = Settings {
            bind: "127.0.0.1:0".parse().unwrap(),
            ..settings
        };
        let server = serve(settings, rig.clone()).unwrap();
        Self {
            folder,
            rig,
            server,
        }
    }

    fn sessions(&self) -> PathBuf {
        self.folder.path().join("rig")
    }

    fn library(&self) -> PathBuf {
        self.folder.path().join("library")
    }

    fn options(&self) -> Options {
        options(self.server.address())
    }

    /// Pulls; returns outcome and output.
    fn pull(&self, options: &Options) -> (Outcome, String) {
        let (result, text) = capture(|console| pull::run(options, &self.library(), console));
        (result.unwrap(), text)
    }

    /// Checks that the library has the session byte for byte, and that the rig's receipt matches.
    fn assert_pulled(&self, name: &str, key: &str) {
        let mut copy = tree(&self.library().join("sessions").join(key));
        assert!(copy.remove("import.json").is_some());
        assert!(copy == tree(&self.sessions().join(name)), "{name} differs");
        let library = Library::open(&self.library()).unwrap();
        assert!(library.rows().unwrap().iter().any(|row| row.key == key));
        assert_eq!(tree(&self.library().join(".incoming")).len(), 0);
        let receipt = fs::read_to_string(self.receipt(name)).unwrap();
        assert!(receipt.contains(key), "{receipt}");
    }

    fn receipt(&self, name: &str) -> PathBuf {
        self.sessions().join(format!("receipts/{name}.json"))
    }

    fn listed(&self) -> usize {
        match Library::open(&self.library()) {
            Ok(library) => library.rows().unwrap().len(),
            Err(_) => 0,
        }
    }

    fn paws(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_paws"));
        command
            .arg("pull")
            .args(arguments)
            .env("PAWS_LIBRARY", self.library());
        command
    }
}

fn options(address: SocketAddr) -> Options {
    Options {
        retry: RetryPolicy {
            connect_timeout: Duration::from_secs(60),
            read_timeout: Duration::from_secs(60),
            max_attempts: 5,
            first_pause: Duration::from_millis(10),
            max_pause: Duration::from_millis(100),
        },
        ..Options::parse(&format!("http://{address}"), None, None).unwrap()
    }
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|t| String::from_utf8_lossy(t));
    format!("{out}{err}")
}

/// Forwards a connection; cuts it after `cut` bytes of the server, and changes every `spoil`-th
/// byte of them.
fn proxy(to: SocketAddr, cut: usize, spoil: usize) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        while let Ok((client, _)) = listener.accept() {
            std::thread::spawn(move || carry(client, to, cut, spoil));
        }
    });
    address
}

fn carry(mut client: TcpStream, to: SocketAddr, cut: usize, spoil: usize) {
    let mut server = TcpStream::connect(to).unwrap();
    let (mut from, mut into) = (client.try_clone().unwrap(), server.try_clone().unwrap());
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut from, &mut into);
        let _ = into.shutdown(Shutdown::Both);
    });
    let (mut block, mut at) = ([0; 10_000], 0);
    while let Ok(n) = server.read(&mut block) {
        let n = n.min(cut - at);
        for (i, byte) in block[..n].iter_mut().enumerate() {
            if (at + i + 1) % spoil == 0 {
                *byte ^= 1;
            }
        }
        at += n;
        if n == 0 || client.write_all(&block[..n]).is_err() || at == cut {
            break;
        }
    }
    let _ = client.shutdown(Shutdown::Both);
    let _ = server.shutdown(Shutdown::Both);
}

/// What happened first.
#[derive(Debug, PartialEq)]
enum Report {
    /// The proxy has reached its limit.
    Limit,
    /// The program has ended.
    Ended,
}

/// Forwards connections until the server has sent this number of bytes over all of them; then they
/// are silent, but open.
fn limited_proxy(to: SocketAddr, bytes: usize, report: SyncSender<Report>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let left = Arc::new(Mutex::new(bytes));
    std::thread::spawn(move || {
        while let Ok((client, _)) = listener.accept() {
            let (left, report) = (left.clone(), report.clone());
            std::thread::spawn(move || carry_limited(client, to, &left, &report));
        }
    });
    address
}

fn carry_limited(
    mut client: TcpStream,
    to: SocketAddr,
    left: &Mutex<usize>,
    report: &SyncSender<Report>,
) {
    let mut server = TcpStream::connect(to).unwrap();
    let (mut from, mut into) = (client.try_clone().unwrap(), server.try_clone().unwrap());
    let requests = std::thread::spawn(move || {
        let _ = std::io::copy(&mut from, &mut into);
        let _ = into.shutdown(Shutdown::Both);
    });
    let mut block = [0; 10_000];
    while let Ok(n) = server.read(&mut block) {
        let allowed = {
            let mut left = left.lock().unwrap();
            let allowed = n.min(*left);
            *left -= allowed;
            allowed
        };
        if client.write_all(&block[..allowed]).is_err() {
            break;
        }
        if allowed < n {
            let _ = report.try_send(Report::Limit);
            // Until the client ends.
            let _ = requests.join();
            return;
        }
        if n == 0 {
            break;
        }
    }
    let _ = client.shutdown(Shutdown::Both);
    let _ = server.shutdown(Shutdown::Both);
}

#[test]
fn sessions_are_pulled_acknowledged_and_freed() {
    let rig = Rig::new();
    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine, "{text}");
    for line in [
        format!("walk-1 {ID}: imported, 2.0 s"),
        format!("run-1 {OTHER}: imported, 1.0 s"),
    ] {
        assert!(text.contains(&line), "{text}");
    }
    assert_eq!(text.matches("; receipt sent").count(), 2, "{text}");
    rig.assert_pulled("walk-1", ID);
    rig.assert_pulled("run-1", OTHER);

    // Repeated: nothing is downloaded. Then the rig may free them, one by one, even if it was
    // restarted and has no hashes any more.
    let sessions = tree(&rig.library().join("sessions"));
    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine);
    assert_eq!(text.matches("imported already").count(), 2, "{text}");
    let settings = Settings {
        bind: "127.0.0.1:0".parse().unwrap(),
        ..Settings::default()
    };
    let again = serve(settings, rig.rig.clone()).unwrap();
    let free = Options {
        free: true,
        sessions: vec!["walk".to_owned()],
        ..options(again.address())
    };
    let (outcome, text) = rig.pull(&free);
    assert_eq!(outcome, Outcome::Fine);
    assert!(text.ends_with("; freed on the rig\n"), "{text}");
    assert!(!rig.sessions().join("walk-1").exists());
    assert!(rig.sessions().join("run-1").exists());
    assert!(tree(&rig.library().join("sessions")) == sessions);
}

#[test]
fn parallel_pulls_survive_broken_connections() {
    let rig = Rig::new();
    let address = proxy(rig.server.address(), 400_000, usize::MAX);
    let options = Options {
        jobs: 4,
        ..options(address)
    };
    let (outcome, text) = rig.pull(&options);
    assert_eq!(outcome, Outcome::Fine, "{text}");
    rig.assert_pulled("walk-1", ID);
    rig.assert_pulled("run-1", OTHER);
}

#[test]
fn repeatedly_killed_pull_is_atomic_and_resumes() {
    let rig = Rig::with(Settings::default(), 30_000);
    let mut killed = 0;
    for n in 0_usize.. {
        assert!(n < 200, "it never came to an end");
        // Killed after a number of bytes, of which each attempt needs fewer.
        let (report, reports) = sync_channel(16);
        let address = limited_proxy(rig.server.address(), 3_000 + 97_000 * n, report.clone());
        let mut child = rig
            .paws(&[&format!("http://{address}")])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (mut out, mut err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
        let messages = std::thread::spawn(move || {
            let mut messages = Vec::new();
            out.read_to_end(&mut messages).unwrap();
            err.read_to_end(&mut messages).unwrap();
            let _ = report.try_send(Report::Ended);
            messages
        });
        let was_killed = reports.recv().unwrap() == Report::Limit;
        if was_killed {
            child.kill().unwrap();
        }
        let status = child.wait().unwrap();
        let messages = messages.join().unwrap();
        for (name, key) in [("walk-1", ID), ("run-1", OTHER)] {
            let there = rig.library().join("sessions").join(key);
            if there.exists() {
                let mut copy = tree(&there);
                assert!(copy.remove("import.json").is_some());
                assert!(copy == tree(&rig.sessions().join(name)));
            } else {
                assert!(
                    !rig.receipt(name).exists(),
                    "a receipt for what is not there"
                );
            }
        }
        // It may have ended just before the kill.
        if status.signal().is_none() {
            let messages = String::from_utf8_lossy(&messages);
            assert!(status.success(), "{messages}");
            break;
        }
        assert!(was_killed, "{status}");
        killed += 1;
    }
    assert!(killed >= 3, "{killed}");
    rig.assert_pulled("walk-1", ID);
    rig.assert_pulled("run-1", OTHER);
}

#[test]
fn bytes_changed_in_transit_are_detected() {
    let rig = Rig::new();
    let address = proxy(rig.server.address(), usize::MAX, 100_000);
    let (outcome, text) = rig.pull(&options(address));
    assert_eq!(outcome, Outcome::Failed);
    assert!(text.contains("not pulled: walk-1"), "{text}");
    assert!(!rig.receipt("walk-1").exists());
    assert!(!rig.library().join("sessions").join(ID).exists());
    // Over a good connection it resumes.
    let (outcome, _) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine);
    rig.assert_pulled("walk-1", ID);
}

#[test]
fn session_being_recorded_is_not_pulled() {
    let rig = Rig::new();
    rig.rig.record(Some("walk-1"));
    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine);
    assert!(text.contains("run-1") && !text.contains("walk-1"), "{text}");
    let named = Options {
        sessions: vec!["walk-1".to_owned()],
        ..rig.options()
    };
    assert_eq!(rig.pull(&named).0, Outcome::Failed);
    assert_eq!(rig.listed(), 1);
    rig.rig.record(None);
    assert_eq!(rig.pull(&named).0, Outcome::Fine);
    rig.assert_pulled("walk-1", ID);
}

/// `latest` on a rig is the last recorded session of those that have ended.
#[test]
fn latest_pulls_only_the_last_session() {
    const NEWEST: &str = "0192aa00-0000-7000-8000-000000000003";
    let rig = Rig::new();
    let mut newest = Session::good(1.0);
    newest.spec.session_id = NEWEST.to_owned();
    newest.spec.started_civil.0 += 1_000;
    newest.write(&rig.sessions().join("a-new-one"));
    let url = rig.server.url();
    let pull = |code: i32| {
        let output = rig.paws(&[&url, "latest"]).output().unwrap();
        let text = text(&output);
        assert_eq!(output.status.code(), Some(code), "{text}");
        text
    };
    let output = pull(0);
    assert!(
        output.contains(&format!("a-new-one {NEWEST}: imported, 1.0 s")),
        "{output}"
    );
    rig.assert_pulled("a-new-one", NEWEST);
    assert_eq!(rig.listed(), 1);
    // Of two recorded at one time it is the one whose name comes last.
    rig.rig.record(Some("a-new-one"));
    let output = pull(0);
    assert!(
        output.contains(&format!("walk-1 {ID}: imported")),
        "{output}"
    );
    assert_eq!(rig.listed(), 2);
    for name in ["walk-1", "run-1"] {
        fs::remove_dir_all(rig.sessions().join(name)).unwrap();
    }
    let output = pull(1);
    assert!(output.contains("no session that is ended"), "{output}");
    assert_eq!(rig.listed(), 2);
}

/// The system accepts connections for a program that never handles them.
#[test]
fn silent_rig_times_out() {
    let folder = tempfile::tempdir().unwrap();
    let library = folder.path().join("library");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    for (url, connect, why) in [
        // A handshake without response is not a connection.
        (
            format!("https://{address}"),
            Duration::from_millis(300),
            "no answer after 1 tries (no connection within ",
        ),
        (
            format!("http://{address}"),
            Duration::from_secs(60),
            "no answer after 2 tries (silent for 0.2 s)",
        ),
    ] {
        let options = Options {
            retry: RetryPolicy {
                connect_timeout: connect,
                read_timeout: Duration::from_millis(200),
                max_attempts: 2,
                ..options(address).retry
            },
            ..Options::parse(&url, None, None).unwrap()
        };
        let (result, _) = capture(|console| pull::run(&options, &library, console));
        let error = format!("{:#}", result.unwrap_err());
        assert!(
            error.starts_with("asking for the list of sessions: "),
            "{error}"
        );
        assert!(error.contains(why) && error.ends_with(&url), "{error}");
        assert!(!library.exists(), "nothing is made for it");
    }
}

#[test]
fn cut_off_session_is_pulled_and_damaged_one_is_kept_on_the_rig() {
    let rig = Rig::new();
    let mut cut = Session::good(2.0);
    cut.closed = false;
    let at = rig.sessions().join("walk-1");
    fs::remove_dir_all(&at).unwrap();
    cut.write(&at);
    let free = Options {
        free: true,
        ..rig.options()
    };
    let segment = rig.sessions().join("run-1/segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();

    let (outcome, text) = rig.pull(&free);
    assert_eq!(outcome, Outcome::Loss, "{text}");
    assert!(
        text.contains("unclosed") && text.contains("; freed on the rig"),
        "{text}"
    );
    assert!(
        text.contains("damaged") && text.contains("; no receipt, the rig keeps it"),
        "{text}"
    );
    assert!(!at.exists());
    assert!(rig.sessions().join("run-1").exists() && !rig.receipt("run-1").exists());
    assert_eq!(rig.listed(), 2);
}

#[test]
fn damaged_copy_in_the_library_is_replaced_by_the_complete_one_of_the_rig() {
    let rig = Rig::new();
    let from_disk = rig.folder.path().join("disk/walk-1");
    for (path, content) in tree(&rig.sessions().join("walk-1")) {
        let path = from_disk.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }
    let segment = from_disk.join("segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let sources = [from_disk.clone()];
    let import = |console: &mut console_output::Console<'_>| {
        collector::commands::import::run(&sources, &rig.library(), console)
    };
    assert_eq!(capture(import).0.unwrap(), Outcome::Loss);

    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine, "{text}");
    assert!(
        text.contains(&format!("was renamed to {ID}.damaged")),
        "{text}"
    );
    rig.assert_pulled("walk-1", ID);
    let mut aside = tree(&rig.library().join(format!("sessions/{ID}.damaged")));
    aside.remove("import.json");
    assert!(aside == tree(&from_disk));

    // Later damage on the library's disk is found before the rig frees the session.
    let copy = rig
        .library()
        .join(format!("sessions/{ID}/segments/000000.mcap"));
    fs::copy(&segment, copy).unwrap();
    fs::remove_file(rig.receipt("walk-1")).unwrap();
    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine, "{text}");
    rig.assert_pulled("walk-1", ID);
    assert!(
        text.contains(&format!("was renamed to {ID}.damaged-2")),
        "{text}"
    );
}

#[test]
fn differing_session_is_rejected_by_library_and_rig() {
    let rig = Rig::new();
    rig.pull(&rig.options());
    let before = tree(&rig.library().join("sessions"));
    // The rig has more files than were pulled: no receipt, and nothing is freed.
    fs::write(rig.sessions().join("run-1/notes.txt"), "rain").unwrap();
    fs::remove_file(rig.receipt("run-1")).unwrap();
    let free = Options {
        free: true,
        sessions: vec!["run-1".to_owned()],
        ..rig.options()
    };
    let (outcome, text) = rig.pull(&free);
    assert_eq!(outcome, Outcome::Failed);
    assert!(text.contains("not pulled: run-1"), "{text}");
    // With the old receipt the rig itself detects that it does not match.
    fs::remove_file(rig.sessions().join("run-1/notes.txt")).unwrap();
    assert_eq!(rig.pull(&rig.options()).0, Outcome::Fine);
    fs::write(rig.sessions().join("run-1/notes.txt"), "rain").unwrap();
    let (outcome, text) = rig.pull(&free);
    assert_eq!(outcome, Outcome::Failed);
    assert!(text.contains("; the rig keeps it"), "{text}");
    assert!(rig.sessions().join("run-1/notes.txt").exists());
    assert!(tree(&rig.library().join("sessions")) == before);
}

#[test]
fn session_missing_in_the_library_is_pulled_again_before_a_receipt() {
    let rig = Rig::new();
    rig.pull(&rig.options());
    fs::remove_file(rig.receipt("run-1")).unwrap();
    let segment = rig
        .library()
        .join(format!("sessions/{OTHER}/segments/000000.mcap"));
    let mut bytes = fs::read(&segment).unwrap();
    bytes[5000] ^= 1;
    fs::write(&segment, &bytes).unwrap();
    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine, "{text}");
    rig.assert_pulled("run-1", OTHER);
    let aside = format!("sessions/{OTHER}.damaged/segments/000000.mcap");
    assert!(fs::read(rig.library().join(aside)).unwrap() == bytes);
}

/// The rig has a receipt for the session all the time.
#[test]
fn session_corrupted_in_the_library_is_pulled_again_before_freeing() {
    for is_validated in [true, false] {
        let rig = Rig::new();
        rig.pull(&rig.options());
        let good = tree(&rig.sessions().join("run-1"));
        let there = rig.library().join("sessions").join(OTHER);
        let segment = there.join("segments/000000.mcap");
        let mut bytes = fs::read(&segment).unwrap();
        bytes[5000] ^= 1;
        fs::write(&segment, &bytes).unwrap();
        if is_validated {
            let target = collector::target::Target::find(OTHER, Some(&rig.library())).unwrap();
            let options = collector::commands::validate::Options::default();
            let validate = |console: &mut console_output::Console<'_>| {
                collector::commands::validate::run(&[target], &options, console)
            };
            capture(validate).0.unwrap();
        }
        assert!(rig.receipt("run-1").exists());
        let free = Options {
            free: !is_validated,
            sessions: vec!["run-1".to_owned()],
            ..rig.options()
        };
        let (outcome, text) = rig.pull(&free);
        assert_eq!(outcome, Outcome::Fine, "{text}");
        assert!(
            text.contains(&format!("was renamed to {OTHER}.damaged")),
            "{text}"
        );
        let mut copy = tree(&there);
        assert!(copy.remove("import.json").is_some());
        assert!(copy == good, "validated: {is_validated}");
        assert_eq!(
            rig.sessions().join("run-1").exists(),
            is_validated,
            "{text}"
        );
    }
}

/// A rig that closes a session after it was pulled has the better copy from then on, whatever the
/// receipt states.
#[test]
fn cut_off_session_is_replaced_after_the_rig_closed_it() {
    let rig = Rig::new();
    let at = rig.sessions().join("walk-1");
    fs::remove_dir_all(&at).unwrap();
    let mut cut = Session::good(2.0);
    cut.closed = false;
    cut.write(&at);
    let named = Options {
        sessions: vec!["walk-1".to_owned()],
        ..rig.options()
    };
    let (outcome, text) = rig.pull(&named);
    assert_eq!(outcome, Outcome::Loss, "{text}");
    assert!(rig.receipt("walk-1").exists());
    let storage = session_archive::storage::DiskStorage::new(&at);
    let closed = session_archive::recover::close_cut_off(Arc::new(storage)).unwrap();
    assert!(closed.is_some());
    let good = tree(&at);
    let free = Options {
        free: true,
        ..named
    };
    let (outcome, text) = rig.pull(&free);
    assert_eq!(outcome, Outcome::Fine, "{text}");
    assert!(text.contains("; freed on the rig"), "{text}");
    let mut copy = tree(&rig.library().join("sessions").join(ID));
    assert!(copy.remove("import.json").is_some());
    assert!(copy == good && !at.exists());
}

#[test]
fn import_and_pull_resume_each_other() {
    let rig = Rig::new();
    // Pulled as far as the connection carries, then imported from the rig's disk.
    let address = proxy(rig.server.address(), 1_000_000, usize::MAX);
    let hopeless = Options {
        sessions: vec!["walk-1".to_owned()],
        retry: RetryPolicy {
            max_attempts: 1,
            ..rig.options().retry
        },
        ..options(address)
    };
    assert_eq!(rig.pull(&hopeless).0, Outcome::Failed);
    let incoming = rig.library().join(".incoming").join(ID);
    let left: usize = tree(&incoming).values().map(Vec::len).sum();
    assert!(left > 500_000, "{left}");
    let disk = rig.sessions().join("walk-1");
    let library = rig.library();
    let import = |source: &Path| {
        let sources = [source.to_owned()];
        capture(|console| collector::commands::import::run(&sources, &library, console)).0
    };
    assert_eq!(import(&disk).unwrap(), Outcome::Fine);
    let (outcome, text) = rig.pull(&rig.options());
    assert_eq!(outcome, Outcome::Fine);
    assert!(
        text.contains(&format!("walk-1 {ID}: imported already")),
        "{text}"
    );
    rig.assert_pulled("walk-1", ID);
}

#[test]
fn rig_is_authenticated_by_fingerprint_over_tls() {
    let folder = tempfile::tempdir().unwrap();
    let clock = ManualClock::new();
    let identity = Identity::load_or_create(folder.path()).unwrap();
    let right = identity.fingerprint().to_string();
    let settings = Settings {
        identity: Some(identity),
        token: Some(Token::new(TOKEN).unwrap()),
        clock: Arc::new(clock.clone()),
        ..Settings::default()
    };
    let rig = Rig::with(settings, 200);
    let url = rig.server.url();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (token, wrong, short) = (
        file("token", &format!("{TOKEN}\n")),
        file("wrong", "another-token-than-that"),
        file("short", "short"),
    );
    let check = |arguments: &[&str], code: i32, part: &str| {
        let output = rig.paws(arguments).output().unwrap();
        let text = text(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
        assert!(
            text.contains(part),
            "{arguments:?}: {part:?} is not in {text}"
        );
    };
    let other = format!("{}00", &right[..right.len() - 2]);
    check(
        &[&url, "--token-file", &token],
        1,
        &format!("has the fingerprint {right}"),
    );
    check(
        &[&url, "--fingerprint", &other, "--token-file", &token],
        1,
        &format!("expected {other}"),
    );
    check(&[&url, "--fingerprint", &right], 1, "the token is needed");
    check(
        &[&url, "--fingerprint", &right, "--token-file", &wrong],
        1,
        "the token is wrong",
    );
    check(
        &[&url, "--fingerprint", "AA:BB", "--token-file", &token],
        2,
        "not a fingerprint",
    );
    check(
        &[&url, "--fingerprint", &right, "--token-file", &short],
        1,
        "5 characters",
    );
    check(&["rig:8077"], 2, "not a rig address");
    check(&["http://192.0.2.1:8077"], 1, "only https is allowed");
    check(&[&url, "--jobs", "0"], 2, "jobs");
    assert_eq!(rig.listed(), 0);
    // The pause after the wrong token.
    clock.advance(Limits::default().wrong_token_pause);
    let good = [
        &url,
        "--fingerprint",
        &right,
        "--token-file",
        &token,
        "--jobs",
        "2",
    ];
    check(&good, 0, "; receipt sent");
    rig.assert_pulled("walk-1", ID);
    rig.assert_pulled("run-1", OTHER);
    check(
        &[&good[..], &["jog"]].concat(),
        1,
        "none of the 2 on the rig",
    );
    check(
        &[&good[..], &["run-1", "--free"]].concat(),
        0,
        "freed on the rig",
    );
}

#[test]
fn derived_file_names_agree_on_both_ends() {
    for name in collector::library::DERIVED {
        assert!(rig_link::link::DERIVED.contains(&name), "{name}");
    }
}
