//! A folder on a real disk. It may come from anybody: below it no symbolic link is followed, and
//! nothing but regular files is opened for reading.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::{Storage, StoredFile};

/// A folder on a real disk.
pub(crate) struct Disk {
    root: PathBuf,
}

impl Disk {
    pub(crate) fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Makes the folder and those above it, their names durable; existing ones are fine.
    pub(crate) fn make_root(&self) -> io::Result<()> {
        let missing = self.root.ancestors().take_while(|p| !p.exists()).count();
        fs::create_dir_all(&self.root)?;
        // The name of each new folder is an entry of its parent.
        for new in self.root.ancestors().take(missing) {
            let above = new.parent().filter(|p| !p.as_os_str().is_empty());
            File::open(above.unwrap_or(Path::new(".")))?.sync_all()?;
        }
        Ok(())
    }
}

impl Storage for Disk {
    fn root(&self) -> &Path {
        &self.root
    }

    fn create(&self, path: &str) -> io::Result<Box<dyn StoredFile>> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(self.root.join(path))?;
        Ok(Box::new(file))
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn Read + Send>> {
        let file = plain_file::open_below(&self.root, Path::new(path))?;
        Ok(Box::new(file))
    }

    fn length(&self, path: &str) -> io::Result<u64> {
        let file = plain_file::open_below(&self.root, Path::new(path))?;
        Ok(file.metadata()?.len())
    }

    fn list(&self, dir: &str) -> io::Result<Vec<(String, bool)>> {
        let mut found = Vec::new();
        plain_file::check_folder_below(&self.root, Path::new(dir))?;
        for entry in fs::read_dir(self.root.join(dir))? {
            let entry = entry?;
            // A name that is not UTF-8 is not ours.
            if let Ok(name) = entry.file_name().into_string() {
                found.push((name, entry.file_type()?.is_dir()));
            }
        }
        found.sort();
        Ok(found)
    }

    fn create_dir(&self, dir: &str) -> io::Result<()> {
        fs::create_dir(self.root.join(dir))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.root.join(from), self.root.join(to))
    }

    fn remove_file(&self, path: &str) -> io::Result<()> {
        fs::remove_file(self.root.join(path))
    }

    fn remove_dir(&self, dir: &str) -> io::Result<()> {
        fs::remove_dir(self.root.join(dir))
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        File::open(self.root.join(dir))?.sync_all()
    }
}

impl StoredFile for File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn overwrite_start(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all_at(bytes, 0)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}
