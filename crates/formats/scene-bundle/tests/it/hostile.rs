//! Bundles from strangers: nothing but a regular file is opened, and a file longer than written is
//! not read.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use scene_bundle::outputs::{CLOUD, cloud};
use scene_bundle::verify::verify;
use scene_bundle::{BundleError, Scene};

use crate::sample::Sample;

/// The error with all its causes.
fn chain(error: &BundleError) -> String {
    let mut text = error.to_string();
    let mut next = std::error::Error::source(error);
    while let Some(cause) = next {
        text.push_str(&format!(": {cause}"));
        next = cause.source();
    }
    text
}

/// The first file of the cloud.
fn a_file(scene: &Scene) -> PathBuf {
    let output = scene.output(CLOUD).unwrap();
    let path = output.output().files[0].path.clone();
    output.file_path(&path)
}

fn fifo(path: &Path) {
    let made = std::process::Command::new("mkfifo").arg(path).status();
    assert!(made.unwrap().success());
}

#[test]
fn anything_but_a_regular_file_is_refused_immediately() {
    let sample = Sample::new();
    let scene = sample.scene();
    let path = a_file(&scene);
    let aside = path.with_extension("aside");
    fs::rename(&path, &aside).unwrap();
    let expect = |kind: &str| {
        let output = scene.output(CLOUD).unwrap();
        let read = chain(&cloud::read(&output).unwrap_err());
        assert!(read.contains(kind), "{read}");
        // A report or an error that names it; never a wait.
        let _ = verify(&scene, |_| {});
    };
    fifo(&path);
    expect("a FIFO");
    fs::remove_file(&path).unwrap();
    symlink(&aside, &path).unwrap();
    expect("a symbolic link");
    fs::remove_file(&path).unwrap();

    let manifest = sample.path.join("scene.json");
    fs::remove_file(&manifest).unwrap();
    fifo(&manifest);
    let said = chain(&Scene::open(&sample.path).err().unwrap());
    assert!(said.contains("a FIFO"), "{said}");
}

#[test]
fn a_file_longer_than_written_is_not_read() {
    let sample = Sample::new();
    let scene = sample.scene();
    let file = fs::File::options()
        .write(true)
        .open(a_file(&scene))
        .unwrap();
    // Sparse: it takes no room on the disk, and would take more memory than there is.
    file.set_len(1 << 43).unwrap();
    let output = scene.output(CLOUD).unwrap();
    let said = cloud::read(&output).unwrap_err();
    assert!(matches!(said, BundleError::Changed { .. }), "{said}");
    assert!(said.to_string().contains("8796093022208 bytes"), "{said}");
    let manifest = fs::File::options()
        .write(true)
        .open(sample.path.join("scene.json"));
    manifest.unwrap().set_len(1 << 43).unwrap();
    let said = chain(&Scene::open(&sample.path).err().unwrap());
    assert!(said.contains("expected at most 67108864"), "{said}");
}
