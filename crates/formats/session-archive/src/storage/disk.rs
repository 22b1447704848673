//! A folder on a real disk.
//!
//! The folder may come from an untrusted source. Below its root no symbolic link is followed, and
//! nothing but regular files is opened for reading, immediately and never waiting; the error names
//! what was found (see [`plain_file`]).

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::{ReadAt, Storage, WriteFile};

/// A folder on a real disk. Paths are taken below its root.
#[derive(Clone, Debug)]
pub struct DiskStorage {
    root: PathBuf,
}

impl DiskStorage {
    /// The storage whose root is `root`; nothing is created until something is written.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }
}

struct DiskFile(File);

impl Storage for DiskStorage {
    fn create(&self, path: &str) -> io::Result<Box<dyn WriteFile>> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(self.root.join(path))?;
        Ok(Box::new(DiskFile(file)))
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>> {
        let file = plain_file::open_below(&self.root, Path::new(path))?;
        Ok(Box::new(DiskFile(file)))
    }

    fn list(&self, dir: &str) -> io::Result<Vec<String>> {
        let folder = plain_file::check_folder_below(&self.root, Path::new(dir));
        let entries = match folder.and_then(|()| fs::read_dir(self.root.join(dir))) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            other => other?,
        };
        let mut names = Vec::new();
        for entry in entries {
            // Names of a session are UTF-8; other files are skipped.
            if let Ok(name) = entry?.file_name().into_string() {
                names.push(name);
            }
        }
        names.sort();
        Ok(names)
    }

    fn create_dir(&self, dir: &str) -> io::Result<()> {
        let path = self.root.join(dir);
        let missing = path.ancestors().take_while(|p| !p.exists()).count();
        fs::create_dir_all(&path)?;
        // The name of each new folder lies in the one above it, the root's too: nobody else
        // knows that it is new.
        for new in path.ancestors().take(missing) {
            let above = new.parent().filter(|p| !p.as_os_str().is_empty());
            File::open(above.unwrap_or(Path::new(".")))?.sync_all()?;
        }
        Ok(())
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.root.join(from), self.root.join(to))
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        fs::remove_file(self.root.join(path))
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        File::open(self.root.join(dir))?.sync_all()
    }
}

impl WriteFile for DiskFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn sync_data(&mut self) -> io::Result<()> {
        self.0.sync_data()
    }

    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.0.set_len(len)
    }
}

impl ReadAt for DiskFile {
    fn len(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        FileExt::read_at(&self.0, buf, offset)
    }
}
