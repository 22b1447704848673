//! The cookies of the page: one for each login, until its logout or until the token changes.
//!
//! A cookie is `ID_HEX_DIGITS.CODE`: an identifier of 128 random bits and a code over it (BLAKE3,
//! with a key derived from the token), so that no list of valid cookies is needed. A logout puts
//! the identifier on the list of ended ones; the list is in a file, if one is configured, and so
//! persists across restarts. After [`MAX_ENDED`] ended cookies the *generation*, which is also part
//! of the code, changes: then every cookie is invalid, and the list is cleared. The same happens if
//! the file exists and cannot be read.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use ring::rand::{SecureRandom as _, SystemRandom};

use crate::token::Token;

/// Maximum number of ended cookies in the list.
const MAX_ENDED: usize = 1000;
/// First line of the file.
const FILE_HEADER: &str = "rig-link-ended-cookies 1";
/// Length of an identifier and of a generation, hex digits.
const ID_HEX_DIGITS: usize = 32;

/// The valid cookies.
#[derive(Debug)]
pub(super) struct Cookies {
    key: [u8; 32],
    ended: Mutex<InvalidCookies>,
    /// File with the list.
    path: Option<PathBuf>,
    /// Locked while the file is written.
    writing: Mutex<()>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct InvalidCookies {
    /// Empty until the first change of generation.
    generation: String,
    ids: BTreeSet<String>,
}

impl Cookies {
    /// The cookies of this token; the list of ended ones is in the file `path`, which need not
    /// exist yet.
    pub(super) fn new(token: &Token, path: Option<&Path>) -> Self {
        let ended = path.map_or_else(InvalidCookies::default, InvalidCookies::read);
        Self {
            key: token.cookie_key(),
            ended: Mutex::new(ended),
            path: path.map(Path::to_owned),
            writing: Mutex::new(()),
        }
    }

    fn ended(&self) -> MutexGuard<'_, InvalidCookies> {
        self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn code(&self, generation: &str, id: &str) -> blake3::Hash {
        blake3::keyed_hash(&self.key, format!("{generation}.{id}").as_bytes())
    }

    /// A new cookie; `None` if the system provides no random numbers.
    pub(super) fn issue(&self) -> Option<String> {
        let id = random_id()?;
        let code = self.code(&self.ended().generation, &id);
        Some(format!("{id}.{}", code.to_hex()))
    }

    /// The identifier of a valid cookie.
    fn valid_id<'a>(&self, ended: &InvalidCookies, cookie: &'a str) -> Option<&'a str> {
        let (id, code) = cookie.split_once('.')?;
        let code = blake3::Hash::from_hex(code).ok()?;
        // Hashes are compared in constant time.
        let is_valid = is_id(id) && code == self.code(&ended.generation, id);
        (is_valid && !ended.ids.contains(id)).then_some(id)
    }

    /// Whether a cookie is valid.
    pub(super) fn is_valid(&self, cookie: &str) -> bool {
        self.valid_id(&self.ended(), cookie).is_some()
    }

    /// Ends a cookie; returns whether it was valid, so that [`Self::save`] is needed.
    pub(super) fn end(&self, cookie: &str) -> bool {
        let mut ended = self.ended();
        let Some(id) = self.valid_id(&ended, cookie).map(str::to_owned) else {
            return false;
        };
        match random_id() {
            Some(generation) if ended.ids.len() >= MAX_ENDED => {
                *ended = InvalidCookies {
                    generation,
                    ids: BTreeSet::new(),
                };
            }
            _ => _ = ended.ids.insert(id),
        }
        true
    }

    /// Writes and syncs the list, if a file is configured.
    ///
    /// # Errors
    /// An I/O error occurs; the list in memory remains valid until the server stops.
    pub(super) fn save(&self) -> io::Result<()> {
        let Some(path) = &self.path else {
            return Ok(());
        };
        let _one_at_a_time = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let text = self.ended().to_text();
        let folder = path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        let new = path.with_extension("new");
        let mut file = File::options()
            .write(true)
            .create(true)
            .truncate(true)
            .mode(0o600)
            .open(&new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, path)?;
        File::open(folder)?.sync_all()
    }
}

impl InvalidCookies {
    fn read(path: &Path) -> Self {
        let found = match plain_file::read_to_string(path, plain_file::TEXT_LIMIT) {
            Ok(text) => Self::parse(&text).ok_or("damaged".to_owned()),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(e) => Err(e.to_string()),
        };
        found.unwrap_or_else(|why| {
            log::warn!(
                "reading which logins have ended: {why}; all have now, log in again: {}",
                path.display()
            );
            Self {
                generation: random_id().unwrap_or_default(),
                ids: BTreeSet::new(),
            }
        })
    }

    fn to_text(&self) -> String {
        let ids = self.ids.iter().map(|id| format!("{id}\n"));
        format!(
            "{FILE_HEADER}\n{}\n{}",
            self.generation,
            ids.collect::<String>()
        )
    }

    fn parse(text: &str) -> Option<Self> {
        let mut lines = text.strip_suffix('\n')?.split('\n');
        if lines.next() != Some(FILE_HEADER) {
            return None;
        }
        let generation = lines.next()?.to_owned();
        let ids: BTreeSet<String> = lines.map(str::to_owned).collect();
        let sound = (generation.is_empty() || is_id(&generation)) && ids.iter().all(|id| is_id(id));
        sound.then_some(Self { generation, ids })
    }
}

fn is_id(text: &str) -> bool {
    let digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    text.len() == ID_HEX_DIGITS && text.bytes().all(digit)
}

fn random_id() -> Option<String> {
    let mut bytes = [0; ID_HEX_DIGITS / 2];
    if let Err(e) = SystemRandom::new().fill(&mut bytes) {
        log::error!("asking the system for random numbers: {e}");
        return None;
    }
    Some(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;
    use std::time::Duration;

    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    fn token(text: &str) -> Token {
        Token::new(text).unwrap()
    }

    fn cookies(path: Option<&Path>) -> Cookies {
        Cookies::new(&token("correct-horse-battery"), path)
    }

    #[test]
    fn logout_ends_only_its_cookie() {
        let cookies = cookies(None);
        let [one, other] = [(); 2].map(|()| cookies.issue().unwrap());
        assert_ne!(one, other);
        assert!(cookies.is_valid(&one) && cookies.is_valid(&other));
        assert!(cookies.end(&one));
        assert!(!cookies.is_valid(&one), "a replay");
        assert!(cookies.is_valid(&other));
        assert!(!cookies.end(&one), "it has ended already");
        for forged in [
            String::new(),
            ".".to_owned(),
            one.replace('.', ""),
            other.to_uppercase(),
            format!("{other}0"),
            format!("{}{}", &one[..ID_HEX_DIGITS], &other[ID_HEX_DIGITS..]),
            other.replace(char::is_alphanumeric, "0"),
        ] {
            assert!(
                !cookies.is_valid(&forged) && !cookies.end(&forged),
                "{forged}"
            );
        }
        let of_another_token = Cookies::new(&token("another-token-than-that"), None);
        assert!(!of_another_token.is_valid(&other));
    }

    #[test]
    fn logout_persists_across_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page/ended-cookies");
        let before = cookies(Some(&path));
        let [one, other] = [(); 2].map(|()| before.issue().unwrap());
        assert!(
            cookies(Some(&path)).is_valid(&one),
            "a login outlives it, too"
        );
        before.end(&one);
        before.save().unwrap();
        let after = cookies(Some(&path));
        assert!(!after.is_valid(&one) && after.is_valid(&other));
        fs::write(&path, "damaged").unwrap();
        let after = cookies(Some(&path));
        assert!(!after.is_valid(&one) && !after.is_valid(&other));
        let new = after.issue().unwrap();
        assert!(after.is_valid(&new));
    }

    /// A FIFO without writer counts as a damaged list: all logins have ended, and the server
    /// starts.
    #[test]
    fn non_file_does_not_block() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ended-cookies");
        let before = cookies(None).issue().unwrap();
        mknodat(CWD, &path, FileType::Fifo, Mode::from_raw_mode(0o600), 0).unwrap();
        let (sender, answers) = sync_channel(1);
        std::thread::spawn(move || {
            let after = cookies(Some(&path));
            let new = after.issue().unwrap();
            sender
                .send((after.is_valid(&before), after.is_valid(&new)))
                .unwrap();
        });
        let held = answers.recv_timeout(Duration::from_secs(120)).unwrap();
        assert_eq!(held, (false, true));
    }

    #[test]
    fn list_is_bounded_and_ended_cookies_remain_invalid() {
        let cookies = cookies(None);
        let kept = cookies.issue().unwrap();
        let mut last = String::new();
        for _ in 0..=MAX_ENDED {
            last = cookies.issue().unwrap();
            cookies.end(&last);
        }
        assert!(cookies.ended().ids.len() <= MAX_ENDED);
        assert!(!cookies.is_valid(&last));
        assert!(!cookies.is_valid(&kept), "all have ended");
        assert!(cookies.is_valid(&cookies.issue().unwrap()));
        let text = cookies.ended().to_text();
        assert_eq!(InvalidCookies::parse(&text).unwrap(), *cookies.ended());
    }
}
