//! Identity of the rig: a self-signed certificate that is created once and pinned by its
//! fingerprint.
//!
//! No authority certifies it, so clients compare the fingerprint with the one that `pawsd` shows.
//! Key and certificate are in one file, `identity.pem`, readable by its owner only and written
//! atomically. An unusable file is an error: a new identity would look like an attack to every host
//! that knows the old one.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use ring::digest;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use subtle::ConstantTimeEq;

/// File name in the folder.
pub const FILE: &str = "identity.pem";
/// Name in the certificate. Hosts check the fingerprint and ignore it.
const NAME: &str = "paws-rig";

/// SHA-256 of a certificate (its DER form), written `AA:BB:…`, 32 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Fingerprint([u8; 32]);

impl Fingerprint {
    /// The fingerprint of a certificate.
    pub fn of(certificate: &CertificateDer<'_>) -> Self {
        let hash = digest::digest(&digest::SHA256, certificate);
        let mut bytes = [0; 32];
        bytes.copy_from_slice(hash.as_ref());
        Self(bytes)
    }

    /// Constant-time comparison.
    pub fn is(&self, other: &Self) -> bool {
        self.0.ct_eq(&other.0).into()
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, byte) in self.0.iter().enumerate() {
            let colon = if i > 0 { ":" } else { "" };
            write!(f, "{colon}{byte:02X}")?;
        }
        Ok(())
    }
}

impl fmt::Debug for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A text is not a fingerprint.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{found:?} is not a fingerprint; expected 32 bytes in hex, as in 0A:1B:…, as `pawsd` shows them"
)]
pub struct FingerprintError {
    /// The text.
    pub found: String,
}

impl FromStr for Fingerprint {
    type Err = FingerprintError;

    /// Accepts hex digits of either case, with or without colons or spaces between the bytes.
    fn from_str(text: &str) -> Result<Self, FingerprintError> {
        let wrong = || FingerprintError {
            found: text.chars().take(120).collect(),
        };
        let digits = text.chars().filter(|c| !matches!(c, ':' | ' '));
        let digits: Option<Vec<u32>> = digits.map(|c| c.to_digit(16)).collect();
        let digits = digits.filter(|d| d.len() == 64).ok_or_else(wrong)?;
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = (pair[0] * 16 + pair[1]) as u8;
        }
        Ok(Self(bytes))
    }
}

/// The identity cannot be loaded or created.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// The folder or the file cannot be read or written.
    #[error("{doing}: {}", .path.display())]
    Io {
        /// The attempted operation.
        doing: &'static str,
        /// What failed.
        #[source]
        source: io::Error,
        /// The file or folder.
        path: PathBuf,
    },
    /// Others could have read the key: remove the file; a new identity is created at the next
    /// start.
    #[error("the rig's key may be used by others than its owner: mode {found:04o}, expected 0600: {}", .path.display())]
    Open {
        /// Mode found.
        found: u32,
        /// The file.
        path: PathBuf,
    },
    /// Damaged: remove the file; hosts then need the new fingerprint.
    #[error("the rig's identity cannot be used: {reason}: {}", .path.display())]
    Damaged {
        /// What is wrong with it.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// The machine provides no random numbers.
    #[error("making a certificate: {reason}")]
    Make {
        /// Why.
        reason: String,
    },
}

/// A certificate and its key.
#[derive(Debug)]
pub struct Identity {
    certificate: CertificateDer<'static>,
    key: PrivateKeyDer<'static>,
}

impl Identity {
    /// The identity in `folder`; created, with the folder, if it does not exist.
    ///
    /// # Errors
    /// See [`IdentityError`].
    pub fn load_or_create(folder: &Path) -> Result<Self, IdentityError> {
        let path = folder.join(FILE);
        match plain_file::open(&path) {
            Ok(file) => Self::load(&file, &path),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Self::create(folder, &path),
            Err(e) => Err(failed("reading the rig's identity", &path)(e)),
        }
    }

    fn load(file: &File, path: &Path) -> Result<Self, IdentityError> {
        let reading = || failed("reading the rig's identity", path);
        let mode = file.metadata().map_err(reading())?.mode() & 0o7777;
        if mode & 0o077 != 0 {
            return Err(IdentityError::Open {
                found: mode,
                path: path.to_owned(),
            });
        }
        let pem = plain_file::read_file(file, plain_file::TEXT_LIMIT).map_err(reading())?;
        Self::from_pem(&pem).map_err(|reason| IdentityError::Damaged {
            reason,
            path: path.to_owned(),
        })
    }

    fn from_pem(pem: &[u8]) -> Result<Self, String> {
        let certificate = CertificateDer::from_pem_slice(pem)
            .map_err(|e| format!("no certificate in it ({e})"))?;
        let key = PrivateKeyDer::from_pem_slice(pem).map_err(|e| format!("no key in it ({e})"))?;
        let identity = Self { certificate, key };
        // Detects a key of another certificate.
        identity.server_config().map_err(|e| e.to_string())?;
        Ok(identity)
    }

    fn create(folder: &Path, path: &Path) -> Result<Self, IdentityError> {
        let pem = make()?;
        let identity =
            Self::from_pem(pem.as_bytes()).map_err(|reason| IdentityError::Make { reason })?;
        fs::create_dir_all(folder).map_err(failed("making the folder", folder))?;
        let new = folder.join(format!("{FILE}.new"));
        let write = || {
            let _ = fs::remove_file(&new);
            let mut file = OpenOptions::new()
                .write(true)
                .create_new(true)
                .mode(0o600)
                .open(&new)?;
            file.write_all(pem.as_bytes())?;
            file.sync_all()?;
            fs::rename(&new, path)?;
            File::open(folder)?.sync_all()
        };
        write().map_err(failed("writing the rig's identity", path))?;
        Ok(identity)
    }

    /// The fingerprint that hosts and phones must find.
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.certificate)
    }

    /// TLS 1.3 with this identity.
    pub(crate) fn server_config(&self) -> Result<rustls::ServerConfig, rustls::Error> {
        let provider = std::sync::Arc::new(rustls::crypto::ring::default_provider());
        let mut config = rustls::ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&rustls::version::TLS13])?
            .with_no_client_auth()
            .with_single_cert(vec![self.certificate.clone()], self.key.clone_key())?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(config)
    }
}

/// Generates key and certificate as PEM text.
fn make() -> Result<String, IdentityError> {
    let failed = |e: rcgen::Error| IdentityError::Make {
        reason: e.to_string(),
    };
    let mut params = rcgen::CertificateParams::new(vec![NAME.to_owned(), format!("{NAME}.local")])
        .map_err(failed)?;
    params.distinguished_name = rcgen::DistinguishedName::new();
    params
        .distinguished_name
        .push(rcgen::DnType::CommonName, NAME);
    // Fixed dates, because a rig without a real-time clock may not know the year.
    params.not_before = rcgen::date_time_ymd(2020, 1, 1);
    params.not_after = rcgen::date_time_ymd(2120, 1, 1);
    params.extended_key_usages = vec![rcgen::ExtendedKeyUsagePurpose::ServerAuth];
    let key = rcgen::KeyPair::generate().map_err(failed)?;
    let certificate = params.self_signed(&key).map_err(failed)?;
    Ok(format!("{}{}", key.serialize_pem(), certificate.pem()))
}

fn failed<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> IdentityError + 'a {
    move |source| IdentityError::Io {
        doing,
        source,
        path: path.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::error::Error as _;
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    use std::sync::mpsc::sync_channel;
    use std::time::Duration;

    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    #[test]
    fn identity_is_created_once_and_private() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("state/identity");
        let first = Identity::load_or_create(&folder).unwrap().fingerprint();
        let again = Identity::load_or_create(&folder).unwrap().fingerprint();
        assert_eq!(first, again);
        let path = folder.join(FILE);
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o600);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);

        let text = first.to_string();
        assert_eq!(text.len(), 32 * 3 - 1);
        assert_eq!(text.parse(), Ok(first));
        assert_eq!(text.to_lowercase().replace(':', "").parse(), Ok(first));
        for bad in [
            "",
            "AA",
            &text[3..],
            &format!("{text}:00"),
            &text.replace(':', "x"),
        ] {
            assert!(bad.parse::<Fingerprint>().is_err(), "{bad}");
        }

        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        let error = Identity::load_or_create(&folder).unwrap_err().to_string();
        assert!(error.contains("mode 0640, expected 0600"), "{error}");
    }

    /// A FIFO without writer must not block the start, and is not replaced.
    #[test]
    fn non_file_is_rejected_without_blocking() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let mode = Mode::from_raw_mode(0o600);
        mknodat(CWD, &path, FileType::Fifo, mode, 0).unwrap();
        let place = folder.path().to_owned();
        let (sender, answers) = sync_channel(1);
        std::thread::spawn(move || {
            let error = Identity::load_or_create(&place).unwrap_err();
            let why = error.source().map_or(String::new(), |e| e.to_string());
            sender.send(format!("{error}: {why}")).unwrap();
        });
        let error = answers.recv_timeout(Duration::from_secs(120)).unwrap();
        assert!(error.contains("found a FIFO"), "{error}");
        let kind = fs::symlink_metadata(&path).unwrap().file_type();
        assert!(kind.is_fifo());
    }

    #[test]
    fn damaged_identity_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        Identity::load_or_create(folder.path()).unwrap();
        let path = folder.path().join(FILE);
        let whole = fs::read_to_string(&path).unwrap();
        let other = make().unwrap();
        let at = |text: &str| text.find("-----BEGIN CERTIFICATE").unwrap();
        let mixed = format!("{}{}", &whole[..at(&whole)], &other[at(&other)..]);
        for (text, part) in [
            ("", "no certificate"),
            (&whole[..at(&whole)], "no certificate"),
            (&whole[at(&whole)..], "no key"),
            (&mixed, "cannot be used"),
        ] {
            fs::write(&path, text).unwrap();
            let error = Identity::load_or_create(folder.path())
                .unwrap_err()
                .to_string();
            assert!(error.contains(part), "{error}");
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
    }
}
