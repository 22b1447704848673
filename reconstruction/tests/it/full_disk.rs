//! A disk without space: stages end with an error that names the file and the remedy, the bundle
//! keeps its last whole outputs, and the same command completes once there is space.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use scene_bundle::verify::verify;
use scene_bundle::{Scene, outputs};

use crate::frame_set_reader::RIG;
use crate::walk::made;

/// Folder of the mount point, for the process in a mount namespace of its own.
const FOLDER: &str = "PAWS_TEST_SMALL_DISK";
const SESSION: &str = "PAWS_TEST_SESSION";
const SCENE: &str = "PAWS_TEST_SCENE";
const DONE: &str = "all stages completed";

/// Stages of feet and ground, with their outputs.
const STAGES: [(&str, &[&str]); 4] = [
    ("tags", &["tag-detections"]),
    ("terrain", &["terrain"]),
    ("feet", &["feet", "contacts"]),
    ("maps", &["maps", "collision"]),
];

const REMEDY: &str = "make space there and run the same command again";

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b));
    format!("{out}{err}")
}

fn run(session: &Path, scene: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.arg("run").arg(session).arg("--out").arg(scene);
    command.args(["--preset", "fast"]).args(more);
    if !more.contains(&"--to") {
        command.args(["--to", "maps"]);
    }
    let output = command.output();
    output.expect("run")
}

/// Every byte of every output is as it was written. Hashes of the outputs.
fn whole_outputs(scene: &Path) -> BTreeMap<String, String> {
    let scene = Scene::open(scene).expect("a bundle");
    let checked = verify(&scene, |_| {}).expect("a bundle");
    assert!(checked.is_whole(), "{:?}", checked.outputs);
    let outputs = scene.manifest().outputs.iter();
    outputs
        .map(|(name, output)| (name.clone(), output.hash.clone()))
        .collect()
}

fn bytes_of(scene: &Path, names: &[&str]) -> u64 {
    let scene = Scene::open(scene).expect("a bundle");
    let outputs = names.iter().map(|name| &scene.manifest().outputs[*name]);
    outputs
        .flat_map(|output| &output.files)
        .map(|f| f.bytes)
        .sum()
}

pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder") {
        let (path, name) = entry.map(|e| (e.path(), e.file_name())).expect("an entry");
        match path.is_dir() {
            true => copy(&path, &to.join(name)),
            false => drop(fs::copy(&path, to.join(name)).expect("a copy")),
        }
    }
}

/// Fills a disk but for `leave` bytes.
fn fill(disk: &Path, leave: u64) {
    let mut file = File::create(disk.join("fill")).expect("a file");
    let state = rustix::fs::statvfs(disk).expect("a disk");
    let count = (state.f_bavail * state.f_frsize).saturating_sub(leave);
    file.write_all(&vec![0; count as usize]).expect("it fits");
}

/// Runs a stage that fails for want of space, and checks what is left.
fn check_failure(paths: [&Path; 2], stage: &str, part: &str) {
    let [session, scene] = paths;
    let before = whole_outputs(scene);
    let output = run(session, scene, &["--from", stage, "--to", stage]);
    let said = text(&output);
    assert_eq!(output.status.code(), Some(1), "{stage}: {said}");
    for part in [part, REMEDY, "No space left on device"] {
        assert!(said.contains(part), "{stage}: no {part:?} in {said}");
    }
    assert_eq!(whole_outputs(scene), before, "{stage}");
}

/// Not a test: the process in a mount namespace of its own, started by the test below.
#[test]
fn on_a_small_disk() {
    let path = |name| std::env::var_os(name).map(PathBuf::from);
    let (Some(disk), Some(session), Some(made)) = (path(FOLDER), path(SESSION), path(SCENE)) else {
        return;
    };
    let mount = ["-t", "tmpfs", "-o", "size=256m", "none"];
    let mounted = Command::new("mount").args(mount).arg(&disk).output();
    match mounted {
        Ok(output) if output.status.success() => {}
        Ok(output) => return println!("no mount: {}", text(&output).trim()),
        Err(error) => return println!("no mount: {error}"),
    }
    let scene = disk.join("walk.scene");
    copy(&made, &scene);
    // A tag that is glued 3 mm higher: all stages are out of date. Those before them run now.
    let rig = disk.join("rig.toml");
    fs::write(&rig, RIG.replace("[0.08, 0, 0.075]", "[0.08, 0, 0.078]")).expect("a file");
    let rig = ["--rig", rig.to_str().expect("UTF-8")];
    let output = run(&session, &scene, &[&rig[..], &["--to", "cloud"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let outdated = |scene: &Path| -> Vec<String> {
        let scene = Scene::open(scene).expect("a bundle");
        let names = scene.manifest().outdated().into_keys();
        names.map(str::to_owned).collect()
    };
    for (stage, names) in STAGES {
        let paths = [&*session, &*scene];
        fill(&disk, 0);
        check_failure(paths, stage, "writing the manifest of a scene bundle");
        // Enough for the manifest, and for the first half of what the stage writes.
        let manifest = fs::metadata(scene.join("scene.json")).expect("a manifest");
        let leave = manifest.len() + 4096 + bytes_of(&scene, names) / 2;
        fill(&disk, leave);
        check_failure(paths, stage, &format!("stage {stage}: "));
        let named = |name: &&&str| outdated(&scene).iter().any(|own| own == **name);
        assert_eq!(names.iter().filter(named).count(), names.len(), "{stage}");
        fs::remove_file(disk.join("fill")).expect("a file");
        let output = run(&session, &scene, &["--from", stage, "--to", stage]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output));
        assert!(text(&output).contains(&format!("{stage}: ran in")));
        assert_eq!(names.iter().filter(named).count(), 0, "{stage}");
        let opened = Scene::open(&scene).expect("a bundle");
        let checked = verify(&opened, |_| {}).expect("a bundle");
        assert!(checked.is_whole());
    }
    let output = run(&session, &scene, &rig);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    assert!(text(&output).contains("0 stages run, 9 up to date"));
    println!("{DONE}");
}

#[test]
fn a_full_disk_keeps_the_last_whole_outputs_of_feet_and_ground() {
    let (session, scene) = made();
    let folder = tempfile::tempdir().expect("folder");
    let output = Command::new("unshare")
        .args(["--user", "--map-root-user", "--mount"])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", "full_disk::on_a_small_disk", "--nocapture"])
        .env(FOLDER, folder.path())
        .env(SESSION, session)
        .env(SCENE, scene)
        .output();
    let output = match output {
        Ok(output) => output,
        Err(error) => return eprintln!("skipped: unshare cannot be started: {error}"),
    };
    let said = text(&output);
    let reason = said.lines().find(|line| line.contains("no mount: "));
    let reason = reason.or_else(|| said.lines().find(|line| line.starts_with("unshare: ")));
    if let Some(reason) = reason {
        return eprintln!("skipped: this system lets no user mount a disk: {reason}");
    }
    assert!(output.status.success() && said.contains(DONE), "{said}");
}

/// Needs no mount: no file can become longer than a limit.
#[test]
fn a_file_that_cannot_grow_keeps_the_last_whole_mesh() {
    let (session, made) = made();
    let folder = tempfile::tempdir().expect("folder");
    let scene = folder.path().join("walk.scene");
    copy(made, &scene);
    let before = whole_outputs(&scene);
    // In units of 512 bytes, as POSIX has it: half of the mesh, and more than the manifest.
    let mesh = Scene::open(&scene).and_then(|scene| scene.output("terrain"));
    let mesh = mesh.expect("an output").file_path("mesh.ply");
    let limit = fs::metadata(mesh).expect("a mesh").len() / 1024;
    let limited = format!("trap '' XFSZ; ulimit -f {limit} && exec \"$0\" \"$@\"");
    let terrain = [
        "--preset", "fast", "--from", "terrain", "--to", "terrain", "--force",
    ];
    let mut command = Command::new("sh");
    command.args([
        "-c",
        &limited,
        env!("CARGO_BIN_EXE_paws-reconstruct"),
        "run",
    ]);
    command.arg(session).arg("--out").arg(&scene).args(terrain);
    let output = command.output().expect("run");
    let said = text(&output);
    if output.status.success() {
        return eprintln!("skipped: this system does not limit the length of files (ulimit -f)");
    }
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("stage terrain: ") && said.contains("mesh"),
        "{said}"
    );
    assert_eq!(whole_outputs(&scene), before);
    let output = run(session, &scene, &terrain[2..]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    assert_eq!(whole_outputs(&scene), before);
    let opened = Scene::open(&scene).expect("a bundle");
    outputs::terrain::read(&opened.output("terrain").expect("an output")).expect("a terrain");
}
