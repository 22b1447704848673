//! The output `splats`: written and read, what it refuses, and its exports.

use std::fs;

use cad_transforms::RigidTransform;
use camera_models::Eye;
use gaussians::files::{dot_splat, glb, ply, spz};
use gaussians::{Plane, Splat, Splats};
use scene_bundle::export::{Format, Options, export};
use scene_bundle::outputs::splats::{self, *};
use scene_bundle::outputs::{self, SPLATS};
use scene_bundle::{Bundle, BundleError, Draft, OutputReader, Scene, layout};
use serde_json::{Value, json};

use crate::sample::{provenance, record};

/// Gaussians around a point, with harmonics of degree 1.
fn around(x: f32) -> Splats {
    let mut splats = Splats::empty(1).unwrap();
    for i in 0..5 {
        let at = i as f32;
        let mut splat = Splat::sphere(0.05, [0.1 * at, 0.5, 0.9]);
        splat.position_m = [x + 0.1 * at, 0.2 * at, 1.0 - 0.1 * at];
        splat.log_scale = [-3.0, -2.5 - 0.1 * at, -4.0];
        splat.rotation_wxyz = [1.0, 0.1 * at, -0.2, 0.3];
        splat.opacity_logit = 0.5 * at - 1.0;
        splat.harmonics[2] = [0.1, -0.2, 0.05 * at];
        splats.push(&splat).unwrap();
    }
    splats
}

fn sky() -> Vec<[f32; 3]> {
    (0..4).map(|i| [0.1 * i as f32, 0.5, 0.8]).collect()
}

fn sector(min_x: f64, views: Vec<usize>, other: usize) -> SplatSector {
    SplatSector {
        min_m: [min_x, -5.0, -5.0],
        max_m: [min_x + 10.0, 5.0, 5.0],
        count: 0,
        file: String::new(),
        blake3: String::new(),
        views,
        neighbors: vec![SplatNeighbor {
            sector: other,
            neighbor_from_sector: RigidTransform::identity(),
        }],
    }
}

fn view(frame: u64, held_out: Option<HeldOut>) -> SplatView {
    SplatView {
        camera: "feet".to_owned(),
        eye: if frame.is_multiple_of(2) {
            Eye::Left
        } else {
            Eye::Right
        },
        frame,
        set: frame + 1,
        time_ns: 1_000_000 * frame as i64,
        world_from_camera: RigidTransform::from_translation_m([0.5 * frame as f64, 0.0, 1.2])
            .unwrap(),
        shutter: (frame == 0).then_some(SplatShutter {
            line_s: 2e-5,
            velocity_m_s: [0.0, 0.1, 1.3],
            rate_rad_s: [0.01, 0.0, -0.2],
        }),
        reduction: 2,
        exposure: [
            [1.1, 0.0, 0.0, 0.0],
            [0.0, 1.2, 0.0, 0.0],
            [0.0, 0.0, 1.3, 0.01],
        ],
        held_out,
    }
}

/// Two sectors.
fn scene() -> SplatScene {
    let held_out = HeldOut {
        psnr_db: 24.5,
        ssim: 0.81,
        lpips: None,
    };
    SplatScene {
        degree: 1,
        compensated: true,
        background: SplatBackground::Sky { size: 2 },
        sectors: vec![sector(0.0, vec![0, 1], 1), sector(10.0, vec![1], 0)],
        views: vec![view(0, None), view(1, None), view(2, Some(held_out))],
        training: SplatTraining {
            preset: "fast".to_owned(),
            seed: 7,
            steps: 2000,
            start_count: 8,
            exposure_model: "none".to_owned(),
            depth_error: Some(0.012),
            checks: vec![SplatCheck {
                step: 400,
                counts: [8, 10],
                psnr_db: [23.9, 24.1],
                gain_db: 0.08,
                upper_gain_db: 0.1,
                continues: true,
            }],
        },
        coverage: Some(SplatCoverage {
            voxel_m: 0.25,
            range_m: 20.0,
            sky_texels: 2,
        }),
    }
}

/// What was seen of five Gaussians in each of some sectors: nothing of the first one.
fn coverage(sectors: usize) -> SplatCoverageContent {
    let seen = (0..5).map(|i| SplatObservation {
        instants: 3 * i,
        directions: u64::from(i) << 40,
        finest_m: 0.01 * i as f32,
        color_error: 0.1,
        depth_error: 0.2,
    });
    let space = [[-3, 0, 7], [-2, -9, 0], [4, 1, 1]];
    SplatCoverageContent {
        gaussians: vec![seen.collect(); sectors],
        space: space
            .map(|index| SplatSpaceBlock {
                index,
                voxels: 1 << 63 | 5,
            })
            .to_vec(),
        sky: vec![true, false, false, true],
    }
}

pub(crate) fn write(draft: &Draft) {
    write_of(draft, &scene(), &[around(0.0), around(12.0)]).unwrap();
}

fn write_of(draft: &Draft, scene: &SplatScene, sectors: &[Splats]) -> Result<(), BundleError> {
    let coverage = coverage(sectors.len());
    let content = SplatContent {
        sectors,
        sky: &sky(),
        comparisons: &[(2, b"an image".to_vec())],
        coverage: scene.coverage.is_some().then_some(&coverage),
    };
    splats::write(draft, scene, &content)
}

/// A bundle with one output that a function writes.
fn bundle(write: impl Fn(&Draft)) -> (tempfile::TempDir, Scene) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.scene");
    let bundle = Bundle::create_or_open(&path, provenance()).unwrap();
    let draft = bundle.begin(outputs::SPLATS).unwrap();
    write(&draft);
    draft.commit(record(outputs::SPLATS)).unwrap();
    let scene = bundle.scene();
    (folder, scene)
}

fn reader(scene: &Scene) -> OutputReader {
    scene.output(outputs::SPLATS).unwrap()
}

#[test]
fn a_scene_of_two_sectors_reads_back_unchanged() {
    let (_folder, bundle) = bundle(write);
    let reader = reader(&bundle);
    let found = splats::read(&reader).unwrap();
    let mut expected = scene();
    for (number, sector) in expected.sectors.iter_mut().enumerate() {
        let file = fs::read(reader.file_path(&format!("00{number}.ply"))).unwrap();
        sector.count = 5;
        sector.file = format!("00{number}.ply");
        sector.blake3 = blake3::hash(&file).to_hex().to_string();
    }
    assert_eq!(found, expected);
    assert_eq!(found.count(), 10);
    assert_eq!(found.held_out().unwrap().psnr_db, 24.5);
    for (number, x) in [(0, 0.0), (1, 12.0)] {
        assert_eq!(
            splats::read_sector(&reader, &found, number).unwrap(),
            around(x)
        );
    }
    assert_eq!(splats::read_sky(&reader, &found).unwrap(), sky());
    let seen = splats::read_coverage(&reader, &found).unwrap();
    assert_eq!(seen, Some(coverage(2)));
    let comparison = |view| splats::read_comparison(&reader, view).unwrap();
    assert_eq!(
        (comparison(1), comparison(2)),
        (None, Some(b"an image".to_vec()))
    );
    let missing = splats::read_sector(&reader, &found, 2).unwrap_err();
    assert!(missing.to_string().contains("sector 2 of 2"), "{missing}");
}

#[test]
fn lpips_has_a_mean_where_all_held_out_images_have_one() {
    let (_folder, bundle) = bundle(|draft| {
        let mut scene = scene();
        for (view, lpips) in [(1, Some(0.25)), (2, Some(0.5))] {
            let (psnr_db, ssim) = (24.0, 0.8);
            scene.views[view].held_out = Some(HeldOut {
                psnr_db,
                ssim,
                lpips,
            });
        }
        write_of(draft, &scene, &[around(0.0), around(12.0)]).unwrap();
    });
    let mut found = splats::read(&reader(&bundle)).unwrap();
    assert_eq!(found.held_out().unwrap().lpips, Some(0.375));
    found.views[2].held_out.as_mut().unwrap().lpips = None;
    assert_eq!(found.held_out().unwrap().lpips, None);
    found.views[1].held_out.as_mut().unwrap().lpips = Some(f64::NAN);
    let folder = tempfile::tempdir().unwrap();
    let other = Bundle::create_or_open(&folder.path().join("b"), provenance()).unwrap();
    let draft = other.begin(outputs::SPLATS).unwrap();
    let refused = write_of(&draft, &found, &[around(0.0), around(12.0)]).unwrap_err();
    assert!(refused.to_string().contains("not finite"), "{refused}");
}

#[test]
fn records_that_contradict_their_content_are_refused() {
    let (_folder, bundle) = bundle(write);
    let folder = tempfile::tempdir().unwrap();
    let other = Bundle::create_or_open(&folder.path().join("b"), provenance()).unwrap();
    drop(bundle);
    let refused = |change: &dyn Fn(&mut SplatScene), sectors: &[Splats]| {
        let draft = other.begin(outputs::SPLATS).unwrap();
        let mut scene = scene();
        change(&mut scene);
        write_of(&draft, &scene, sectors).unwrap_err().to_string()
    };
    let sectors = [around(0.0), around(12.0)];
    for (found, change) in [
        (
            "view 3 of 3",
            (|s| s.sectors[0].views[1] = 3) as fn(&mut SplatScene),
        ),
        ("neighbor 9 of 2", |s| s.sectors[1].neighbors[0].sector = 9),
        ("a reduction by 0", |s| s.views[0].reduction = 0),
        ("not finite", |s| s.views[1].exposure[0][0] = f32::NAN),
        ("not finite", |s| {
            s.training.checks[0].gain_db = f64::INFINITY
        }),
        ("Gaussian 0 beyond the box", |s| {
            s.sectors[1].min_m[0] = 12.5
        }),
        ("in order", |s| s.sectors[0].max_m[2] = f64::NAN),
        ("degree 1", |s| s.degree = 0),
        ("4 texels", |s| {
            s.background = SplatBackground::Sky { size: 3 }
        }),
        ("4 texels", |s| {
            s.background = SplatBackground::Constant([0.5; 3])
        }),
        ("a comparison of view 2", |s| {
            s.views.pop();
        }),
    ] {
        let error = refused(&change, &sectors);
        assert!(error.contains(found), "{found}: {error}");
    }
    let error = refused(&|_| {}, &sectors[..1]);
    assert!(error.contains("1 parts"), "{error}");
    let error = refused(&|s| s.coverage.as_mut().unwrap().voxel_m = 0.0, &sectors);
    assert!(error.contains("voxels of"), "{error}");
}

#[test]
fn coverage_that_contradicts_the_scene_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("b"), provenance()).unwrap();
    let sectors = [around(0.0), around(12.0)];
    let refused = |record: bool, seen: Option<&SplatCoverageContent>| {
        let draft = bundle.begin(outputs::SPLATS).unwrap();
        let mut scene = scene();
        scene.coverage = scene.coverage.filter(|_| record);
        let content = SplatContent {
            sectors: &sectors,
            sky: &sky(),
            comparisons: &[],
            coverage: seen,
        };
        splats::write(&draft, &scene, &content)
            .unwrap_err()
            .to_string()
    };
    assert!(refused(true, None).contains("both or none"));
    assert!(refused(false, Some(&coverage(2))).contains("both or none"));
    for (found, change) in [
        (
            "4 rows",
            (|c| c.gaussians[1].truncate(4)) as fn(&mut SplatCoverageContent),
        ),
        ("1 parts", |c| c.gaussians.truncate(1)),
        ("row 2", |c| c.gaussians[0][2].directions = 1 << 62),
        ("row 0", |c| c.gaussians[0][0].finest_m = 0.1),
        ("row 1", |c| c.gaussians[0][1].finest_m = f32::INFINITY),
        ("row 3", |c| c.gaussians[1][3].color_error = f32::NAN),
        ("row 3", |c| c.gaussians[1][3].depth_error = 1.5),
        ("another order", |c| c.space.swap(0, 1)),
        ("no voxel", |c| c.space[1].voxels = 0),
        ("3 texels", |c| c.sky.truncate(3)),
    ] {
        let mut seen = coverage(2);
        change(&mut seen);
        let error = refused(true, Some(&seen));
        assert!(error.contains(found), "{found}: {error}");
    }
}

#[test]
fn hostile_coverage_is_an_error_with_its_place() {
    let (_folder, original) = bundle(write);
    let from = reader(&original);
    let record = splats::read(&from).unwrap();
    for path in ["000-coverage.npy", "free-space.npy", "sky-coverage.npy"] {
        let file = from.read(path).unwrap();
        // Cut, with a wrong byte in the header, and with rows of ones.
        let short = file[..file.len() - 1].to_vec();
        let mut header = file.clone();
        header[12] = b'!';
        let mut ones = file.clone();
        let data = ones.len().min(128);
        ones[data..].fill(0xff);
        for bytes in [&b"PK"[..], &short, &header, &ones] {
            let (_folder, scene) = forged(path, bytes);
            let error = splats::read_coverage(&reader(&scene), &record);
            let error = error.unwrap_err().to_string();
            assert!(error.contains(path), "{path}: {error}");
        }
        assert!(splats::read_coverage(&from, &record).is_ok());
    }
    // Bundles of before have none.
    let json = String::from_utf8(from.read("splats.json").unwrap()).unwrap();
    let at = json.find(",\"coverage\"").unwrap();
    let older = format!("{}}}", &json[..at]);
    let (_folder, scene) = forged("splats.json", older.as_bytes());
    let scene_record = splats::read(&reader(&scene)).unwrap();
    assert_eq!(
        splats::read_coverage(&reader(&scene), &scene_record).unwrap(),
        None
    );
}

/// The output with a file replaced, hashes of the manifest included: what a stranger can write.
fn forged(path: &str, bytes: &[u8]) -> (tempfile::TempDir, Scene) {
    let (_folder, original) = bundle(write);
    let from = reader(&original);
    bundle(|draft| {
        for name in from.paths() {
            let bytes = if name == path {
                bytes.to_vec()
            } else {
                from.read(name).unwrap()
            };
            draft.write(name, &bytes).unwrap();
        }
    })
}

#[test]
fn hostile_files_are_errors_with_their_place() {
    let (_folder, original) = bundle(write);
    let from = reader(&original);
    let json = String::from_utf8(from.read("splats.json").unwrap()).unwrap();
    for (old, new, expected) in [
        ("\"degree\":1", "\"degree\":9", "degree 9"),
        ("\"degree\":1", "\"degree\":1,\"x\":1", "unknown field"),
        ("000.ply", "../000.ply", "a file"),
        ("000.ply", "001.ply", "a file of its own"),
        ("\"size\":2", "\"size\":100000", "100000 texels"),
        (
            "\"psnr_db\":24.5",
            "\"psnr_db\":1e999",
            "number out of range",
        ),
        ("\"views\":[0,1]", "\"views\":[0,77]", "view 77 of 3"),
        ("\"left\"", "\"middle\"", "unknown variant"),
    ] {
        let changed = json.replacen(old, new, 1);
        assert_ne!(changed, json, "{old}");
        let (_folder, scene) = forged("splats.json", changed.as_bytes());
        let error = splats::read(&reader(&scene)).unwrap_err().to_string();
        assert!(
            error.contains(expected) && error.contains("splats.json"),
            "{error}"
        );
    }
    // A count that no file has is no allocation, and Gaussians beside the record no result.
    let record = splats::read(&from).unwrap();
    let file = from.read("000.ply").unwrap();
    let mut nan = file.clone();
    let end = nan.len();
    nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    let header = String::from_utf8_lossy(&file[..200]).into_owned();
    assert!(header.contains("element vertex 5"), "{header}");
    let many = {
        let at = file
            .windows(16)
            .position(|w| w == b"element vertex 5")
            .unwrap();
        [&file[..at], b"element vertex 4000000000", &file[at + 16..]].concat()
    };
    for bytes in [&file[..file.len() - 1], &nan[..], &many[..], b"ply\n"] {
        // With the hash of the record.
        let mut record = record.clone();
        record.sectors[0].blake3 = blake3::hash(bytes).to_hex().to_string();
        let (_folder, scene) = forged("000.ply", bytes);
        let reader = reader(&scene);
        let error = splats::read_sector(&reader, &record, 0)
            .unwrap_err()
            .to_string();
        assert!(error.contains("000.ply"), "{error}");
        record.sectors[0].count = 4_000_000_000;
        assert!(splats::read_sector(&reader, &record, 0).is_err());
        record.sectors[0].blake3 = "0".repeat(64);
        let error = splats::read_sector(&reader, &record, 0)
            .unwrap_err()
            .to_string();
        assert!(error.contains("hash of the record"), "{error}");
    }
    let (_folder, scene) = forged("sky.npy", &from.read("sky.npy").unwrap()[..100]);
    assert!(splats::read_sky(&reader(&scene), &record).is_err());
}

#[test]
fn exports_keep_the_gaussians_and_state_what_they_change() {
    let (folder, bundle) = bundle(write);
    let mut all = around(0.0);
    for i in 0..5 {
        all.push(&around(12.0).get(i)).unwrap();
    }
    let exported = |format: Format| {
        let out = folder.path().join(format.name());
        let summary = export(&bundle, format, &Options::default(), &out).unwrap();
        assert_eq!(summary.description, "10 Gaussians");
        assert!(summary.notes.iter().any(|note| note.contains("the sky")));
        (fs::read(out).unwrap(), summary.notes.join("\n"))
    };
    let (bytes, notes) = exported(Format::SplatPly);
    let file = ply::read(&bytes, 10).unwrap();
    assert!(file.compensated && file.splats == all);
    assert!(notes.contains("z is up"), "{notes}");

    let (bytes, notes) = exported(Format::Spz);
    let file = spz::read(&bytes, 10).unwrap();
    assert!(
        file.compensated && notes.contains("written as x, z, -y"),
        "{notes}"
    );
    for i in 0..10 {
        let (found, expected) = (file.splats.get(i).position_m, all.get(i).position_m);
        let [x, y, z] = expected;
        for (found, expected) in found.into_iter().zip([x, z, -y]) {
            assert!((found - expected).abs() < 0.001, "{found} {expected}");
        }
    }
    let back = file.splats.transformed(&spz::rub_from_z_up().inverse());
    for k in 0..3 {
        // Of the second harmonic.
        let plane = Plane::HARMONICS + 6 + k;
        let both = back.planes()[plane].iter().zip(&all.planes()[plane]);
        both.for_each(|(a, b)| assert!((a - b).abs() < 0.07, "{a} {b}"));
    }

    let (bytes, notes) = exported(Format::Splat);
    assert!(
        notes.contains("harmonics") && notes.contains("compensated"),
        "{notes}"
    );
    let (bytes_of_glb, notes) = exported(Format::SplatGlb);
    assert!(
        notes.contains("written as x, z, -y") && notes.contains("compensated"),
        "{notes}"
    );
    let rotated = all.transformed(&spz::rub_from_z_up());
    let generator = concat!("paws-scene ", env!("CARGO_PKG_VERSION"));
    assert!(bytes_of_glb == glb::write(&rotated, generator).unwrap());

    let found = dot_splat::read(&bytes, 10).unwrap().splats;
    let highest = |splats: &Splats| splats.planes()[2].iter().copied().fold(0.0, f32::max);
    assert_eq!(highest(&found), highest(&all));
}

#[test]
fn one_sector_is_exported_byte_by_byte() {
    let (folder, bundle) = bundle(|draft| {
        let mut scene = scene();
        scene.sectors.truncate(1);
        scene.sectors[0].neighbors.clear();
        write_of(draft, &scene, &[around(0.0)]).unwrap();
    });
    let out = folder.path().join("walk.ply");
    export(&bundle, Format::SplatPly, &Options::default(), &out).unwrap();
    let stored = reader(&bundle).read("000.ply").unwrap();
    assert!(fs::read(out).unwrap() == stored);
}

#[test]
fn a_bundle_without_gaussians_has_none_to_export() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.scene");
    let bundle = Bundle::create_or_open(&path, provenance()).unwrap();
    let out = folder.path().join("walk.ply");
    let error = export(&bundle.scene(), Format::SplatPly, &Options::default(), &out);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("no output splats"), "{error}");
}

/// A file with up to three edits; half of the edits of a text change a number.
fn edited(original: &[u8], case: u64) -> Vec<u8> {
    let mut bytes = original.to_vec();
    let random = |k: u64| counter_random::bits(9, k, case) as usize;
    for k in (1..2 + random(0) as u64 % 3).map(|k| 8 * k) {
        let at = random(k + 1) % bytes.len().max(1);
        let end = (at + random(k + 2) % 30).min(bytes.len());
        match random(k + 3) % 8 {
            0 => drop(bytes.drain(at..end)),
            1 => bytes.truncate(at),
            2 => drop(bytes.splice(at..at, [random(k + 4) as u8; 2])),
            3 => bytes[at..end].fill(0),
            _ => {
                let digit = bytes[at..].iter().position(u8::is_ascii_digit);
                let numbers = [
                    "4294967295",
                    "99999999999999999999",
                    "-1",
                    "0",
                    "1e300",
                    "7",
                ];
                let text = numbers[random(k + 4) % 6].bytes();
                if let Some(digit) = digit {
                    drop(bytes.splice(at + digit..at + digit + 1, text));
                }
            }
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

/// With the right hashes, so that what lies behind them is reached: what a stranger can write.
#[test]
fn edited_outputs_are_read_or_refused() {
    let (_folder, original) = bundle(write);
    let from = reader(&original);
    let names = ["splats.json", "000.ply", "sky.npy"];
    let contents = names.map(|name| from.read(name).unwrap());
    let manifest_path = original.path().join("scene.json");
    let manifest: Value = serde_json::from_slice(&fs::read(&manifest_path).unwrap()).unwrap();
    let mut folder = original.path().join(from.folder());
    let hash_of_sector = blake3::hash(&contents[1]).to_hex();
    let mut refused = [0; 3];
    for case in 0..900_u64 {
        let which = case as usize % 3;
        let mut files = contents.clone();
        files[which] = edited(&contents[which], case);
        if which == 1 {
            let hash = blake3::hash(&files[1]).to_hex();
            let text = String::from_utf8(files[0].clone()).unwrap();
            files[0] = text.replace(hash_of_sector.as_str(), &hash).into_bytes();
        }
        let mut manifest = manifest.clone();
        let output = &mut manifest["outputs"]["splats"];
        for entry in output["files"].as_array_mut().unwrap() {
            let Some(k) = names.iter().position(|name| entry["path"] == *name) else {
                continue;
            };
            entry["bytes"] = json!(files[k].len());
            entry["blake3"] = json!(blake3::hash(&files[k]).to_hex().as_str());
            fs::write(folder.join(names[k]), &files[k]).unwrap();
        }
        let hash = hash_of_output(&output["files"]);
        output["hash"] = json!(hash);
        let renamed = original.path().join(layout::folder(SPLATS, &hash));
        fs::rename(&folder, &renamed).unwrap();
        folder = renamed;
        fs::write(&manifest_path, manifest.to_string()).unwrap();
        let scene = Scene::open(&original.path()).unwrap();
        match read_all(&reader(&scene)) {
            Ok(()) => {}
            Err(error) => {
                let error = error.to_string();
                let ends = ["splats.json", ".ply", "sky.npy"];
                assert!(ends.iter().any(|end| error.ends_with(end)), "{error}");
                refused[which] += 1;
            }
        }
    }
    println!("{refused:?} of 300 each refused");
    assert!(refused.iter().all(|count| *count > 60), "{refused:?}");
}

/// As FORMAT.md has it; the writer lists files in order.
fn hash_of_output(files: &Value) -> String {
    let line = |file: &Value| {
        let text = |key: &str| file[key].as_str().unwrap().to_owned();
        format!("{} {} {}\n", text("blake3"), file["bytes"], text("path"))
    };
    let lines: String = files.as_array().unwrap().iter().map(line).collect();
    blake3::hash(lines.as_bytes()).to_hex().to_string()
}

fn read_all(reader: &OutputReader) -> Result<(), BundleError> {
    let record = splats::read(reader)?;
    for (number, sector) in record.sectors.iter().enumerate() {
        let found = splats::read_sector(reader, &record, number)?;
        assert_eq!(found.len(), sector.count);
        let mut values = found.planes().iter().flatten();
        assert!(values.all(|value| value.is_finite()));
    }
    let texels = splats::read_sky(reader, &record)?;
    assert!(texels.as_flattened().iter().all(|value| value.is_finite()));
    for view in 0..record.views.len() {
        splats::read_comparison(reader, view)?;
    }
    Ok(())
}
