//! Exports, read back by this project's own readers and by small ones defined here.

use std::collections::BTreeMap;
use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::{Distortion, Lens};
use scene_bundle::export::{Format, Options, export};
use scene_bundle::formats::{euroc, kitti, tum};
use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::{Pose, Trajectory};
use serde_json::Value;

use crate::sample::{self, Sample};

fn bare(trajectory: &Trajectory) -> Trajectory {
    let poses = trajectory
        .usable()
        .map(|p| Pose::new(p.time_ns, p.world_from_rig));
    Trajectory::new(poses.collect()).unwrap()
}

pub(crate) fn near(a: &RigidTransform, b: &RigidTransform) -> bool {
    let off = a.inverse() * *b;
    // Of a product of two rotations and the cancellation in it.
    off.angle_rad() < 1e-12 && off.distance_m() < 1e-12
}

#[test]
fn trajectories_read_back() {
    let sample = Sample::new();
    let scene = sample.scene();
    let offline = Options::default();
    let causal = Options {
        causal: true,
        ..Options::default()
    };
    let out = sample.out("walk.txt");
    let summary = export(&scene, Format::Tum, &offline, &out).unwrap();
    assert_eq!(tum::read(&out).unwrap(), bare(&sample::walk(0.0)));
    assert_eq!(summary.description, "30 poses of the rig");
    assert_eq!(
        summary.notes,
        [
            "tum cannot represent covariances, velocities, statuses",
            "10 poses where the rig was lost are left out"
        ]
    );
    let out = sample.out("causal.txt");
    export(&scene, Format::Tum, &causal, &out).unwrap();
    assert_eq!(tum::read(&out).unwrap(), bare(&sample::walk(0.01)));

    let out = sample.out("walk.csv");
    export(&scene, Format::Euroc, &offline, &out).unwrap();
    assert_eq!(
        euroc::read(&out).unwrap().trajectory,
        bare(&sample::walk(0.0))
    );

    let out = sample.out("kitti");
    export(&scene, Format::Kitti, &offline, &out).unwrap();
    let found = kitti::read(&out.join("poses.txt"), &out.join("times.txt")).unwrap();
    for (found, expected) in found.poses().iter().zip(bare(&sample::walk(0.0)).poses()) {
        assert_eq!(found.time_ns, expected.time_ns);
        assert!(near(&found.world_from_rig, &expected.world_from_rig));
    }
}

#[test]
fn nothing_is_overwritten_and_no_partial_output_is_left() {
    let sample = Sample::new();
    let scene = sample.scene();
    for format in Format::ALL {
        let out = sample.out("mine");
        std::fs::write(&out, "mine").unwrap();
        let error = export(&scene, format, &Options::default(), &out).unwrap_err();
        assert!(error.to_string().contains("not overwritten"), "{error}");
        assert_eq!(std::fs::read(&out).unwrap(), b"mine");
        std::fs::remove_file(&out).unwrap();
        std::fs::create_dir(&out).unwrap();
        assert!(export(&scene, format, &Options::default(), &out).is_err());
        std::fs::remove_dir(&out).unwrap();
    }
    // A damaged bundle is not exported.
    let cloud = scene.output("cloud").unwrap().file_path("cloud.ply");
    std::fs::write(cloud, "ply").unwrap();
    for format in [
        Format::Ply,
        Format::Las,
        Format::Nerfstudio,
        Format::ColmapText,
    ] {
        let out = sample.out("broken");
        assert!(export(&scene, format, &Options::default(), &out).is_err());
        assert!(
            !out.exists() && !sample.out("broken.partial").exists(),
            "{}",
            format.name()
        );
    }
    // Remains of another run are not touched.
    let left = sample.out("kitti.partial");
    std::fs::create_dir(&left).unwrap();
    let error = export(
        &scene,
        Format::Kitti,
        &Options::default(),
        &sample.out("kitti"),
    )
    .unwrap_err();
    assert!(error.to_string().contains("delete it"), "{error}");
    assert!(left.exists());
}

#[test]
fn every_export_is_the_same_twice() {
    let sample = Sample::new();
    let scene = sample.scene();
    for format in Format::ALL {
        let outs = ["one", "two"].map(|name| sample.out(&format!("{}-{name}", format.name())));
        let bytes = outs.each_ref().map(|out| {
            export(&scene, format, &Options::default(), out).unwrap();
            if out.is_dir() {
                sample::files(out)
            } else {
                BTreeMap::from([(String::new(), std::fs::read(out).unwrap())])
            }
        });
        assert_eq!(bytes[0], bytes[1], "{}", format.name());
    }
}

pub(crate) fn keyframes() -> Vec<Keyframe> {
    let mut keyframes = sample::keyframe_table(&sample::rig_model());
    keyframes.sort_by_key(|k| (k.camera, k.time_ns));
    keyframes
}

#[test]
fn nerfstudio_reads_back() {
    let sample = Sample::new();
    let images = sample.images("left_shoulder/left/000010.png");
    let out = sample.out("deep/nerf");
    let options = Options {
        images: Some(images.clone()),
        ..Options::default()
    };
    let summary = export(&sample.scene(), Format::Nerfstudio, &options, &out).unwrap();
    assert_eq!(summary.lost.len(), 1);
    assert!(
        summary.lost[0].contains("no image of keyframe 10 of left_shoulder/left"),
        "{:?}",
        summary.lost
    );
    assert!(
        summary.notes[0].contains("2 of 5 images have no depth"),
        "{:?}",
        summary.notes
    );

    // The lenses, by the reader of the crate that knows the format.
    let path = out.join("transforms.json");
    let (set, _) = calibration_files::read_cameras(&path, None).unwrap();
    let expected = sample::rig_model().cameras;
    assert_eq!(set.cameras.len(), 2);
    for (found, expected) in set.cameras.iter().zip(&expected) {
        assert_eq!(found.model, expected.left);
    }

    // The poses, by hand.
    let json: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(json["camera_model"], "OPENCV");
    assert_eq!(json["ply_file_path"], "points.ply");
    let cloud = sample.scene().output("cloud").unwrap();
    assert_eq!(
        std::fs::read(out.join("points.ply")).unwrap(),
        cloud.read("cloud.ply").unwrap()
    );
    let frames = json["frames"].as_array().unwrap();
    let wanted: Vec<Keyframe> = keyframes()
        .into_iter()
        .filter(|k| (k.camera, k.frame) != (0, 10))
        .collect();
    assert_eq!(frames.len(), wanted.len());
    for (frame, keyframe) in frames.iter().zip(&wanted) {
        let name = &expected[usize::from(keyframe.camera)].name;
        let file = frame["file_path"].as_str().unwrap();
        // The path is relative and leads to the image.
        assert!(
            file.starts_with("../") && out.join(file).is_file(),
            "{file}"
        );
        assert!(
            file.ends_with(&format!("{name}/left/{:06}.png", keyframe.frame)),
            "{file}"
        );
        assert!(frame.get("depth_file_path").is_none());
        let entry = |i: usize, j: usize| frame["transform_matrix"][i][j].as_f64().unwrap();
        // One metre in front of the camera is at z = -1 in OpenGL's axes, one metre below it at y =
        // -1.
        for (x_in_left, x_in_gl) in [
            ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0]),
            ([0.0, 1.0, 0.0], [0.0, -1.0, 0.0]),
        ] {
            let expected = keyframe.world_from_left.apply(x_in_left);
            for (i, expected) in expected.into_iter().enumerate() {
                let found: f64 =
                    (0..3).map(|j| entry(i, j) * x_in_gl[j]).sum::<f64>() + entry(i, 3);
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
        assert_eq!((entry(3, 0), entry(3, 3)), (0.0, 1.0));
        let mask = out.join(frame["mask_path"].as_str().unwrap());
        assert!(mask.is_file());
    }
    // Dynamic pixels of one image are masked there, together with the camera's mask.
    let paths = frames.iter().map(|f| f["mask_path"].as_str().unwrap());
    let own: Vec<&str> = paths.filter(|p| p.contains("/left/")).collect();
    let [own] = own[..] else { panic!("{own:?}") };
    let both = sample::moving()
        .pixels
        .into_iter()
        .zip(match own.contains("feet") {
            true => sample::mask().pixels,
            false => vec![255; 64 * 48],
        });
    let both: Vec<u8> = both.map(|(a, b)| a & b).collect();
    assert_eq!(png_grey8(&out.join(own)), both);
    // A camera without a mask gets a white one.
    let white = png_grey8(&out.join("masks/left_shoulder/left.png"));
    assert!(white.iter().all(|p| *p == 255) && white.len() == 64 * 48);
    assert_eq!(
        png_grey8(&out.join("masks/feet/left.png")),
        sample::mask().pixels
    );
}

#[test]
fn nerfstudio_gets_depth_when_all_images_have_it() {
    let sample = Sample::new();
    let out = sample.out("nerf");
    let options = Options {
        cameras: vec!["feet".to_owned()],
        ..Options::default()
    };
    let summary = export(&sample.scene(), Format::Nerfstudio, &options, &out).unwrap();
    assert!(
        summary.notes.is_empty() && summary.lost.is_empty(),
        "{summary:?}"
    );
    let json: Value =
        serde_json::from_slice(&std::fs::read(out.join("transforms.json")).unwrap()).unwrap();
    let frames = json["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 3);
    let feet = &sample::rig_model().cameras[1];
    let (lens, view) = (Lens::new(&feet.left), sample::view());
    for frame in frames {
        assert!(
            frame["file_path"]
                .as_str()
                .unwrap()
                .starts_with("images/feet/left/")
        );
        let path = out.join(frame["depth_file_path"].as_str().unwrap());
        let (width, height, depth) = png_grey16(&path);
        assert_eq!((width, height), (64, 48));
        let number: u64 = path.file_stem().unwrap().to_str().unwrap().parse().unwrap();
        let stored = sample::depth_image(number);
        let mut there = 0;
        for (i, found) in (0_u32..).zip(depth) {
            // Reference implementation: pixel of the view that corresponds to this pixel.
            let ray = lens
                .unproject([f64::from(i % 64), f64::from(i / 64)])
                .unwrap();
            let [x, y, z] = view.view_from_left.rotate(ray.map(|v| v / ray[2]));
            let at = [50.0 * x / z + 30.0, 50.0 * y / z + 20.0].map(f64::round);
            if !(0.0..60.0).contains(&at[0]) || !(0.0..40.0).contains(&at[1]) {
                assert_eq!(found, 0, "the view is narrower than the image");
                continue;
            }
            there += 1;
            // The point at this depth must have the depth that was stored there, but for rounding
            // to a millimetre.
            let expected = stored.depth_m(at[0] as u32, at[1] as u32).unwrap();
            let in_view = f64::from(found) * 1e-3 * z;
            assert!((in_view - expected).abs() < 0.0011, "{in_view} {expected}");
        }
        assert!(there > 2000 && there < 64 * 48, "{there}");
    }
}

#[test]
fn an_unsupported_lens_model_is_fitted_and_reported_for_nerfstudio() {
    let mut rig = sample::rig_model();
    let rational = Distortion::Rational8 {
        k1: 0.1,
        k2: 0.01,
        p1: 0.0005,
        p2: 0.0,
        k3: 0.001,
        k4: 0.2,
        k5: 0.02,
        k6: 0.0,
    };
    rig.cameras[0].left.distortion = rational;
    let sample = Sample::with(&rig);
    let out = sample.out("nerf");
    let summary = export(
        &sample.scene(),
        Format::Nerfstudio,
        &Options::default(),
        &out,
    )
    .unwrap();
    let reported: Vec<&String> = summary.notes.iter().chain(&summary.lost).collect();
    assert!(
        reported
            .iter()
            .any(|t| t.contains("the lens rational8 of left_shoulder/left is written as rad_tan5")),
        "{reported:?}"
    );
    // COLMAP has it.
    let out = sample.out("colmap");
    let summary = export(
        &sample.scene(),
        Format::ColmapText,
        &Options::default(),
        &out,
    )
    .unwrap();
    let left_out = ["which pixels to mask", "depth", "sigma of points"]
        .map(|what| format!("{what} cannot be represented in COLMAP's model and is left out"));
    assert_eq!((summary.notes, summary.lost), (left_out.to_vec(), vec![]));
    let (set, _) = calibration_files::read_cameras(&out.join("cameras.txt"), None).unwrap();
    assert_eq!(set.cameras[0].model, rig.cameras[0].left);

    // nerfstudio requires one kind of lens for all.
    rig.cameras[1].left.distortion = Distortion::KannalaBrandt4 {
        k1: 0.01,
        k2: 0.0,
        k3: 0.0,
        k4: 0.0,
    };
    let sample = Sample::with(&rig);
    let error = export(
        &sample.scene(),
        Format::Nerfstudio,
        &Options::default(),
        &sample.out("n"),
    )
    .unwrap_err();
    assert!(
        error.to_string().contains("a fisheye lens of feet/left"),
        "{error}"
    );
    let options = Options {
        cameras: vec!["feet".to_owned()],
        ..Options::default()
    };
    export(
        &sample.scene(),
        Format::Nerfstudio,
        &options,
        &sample.out("n"),
    )
    .unwrap();
    let (set, _) =
        calibration_files::read_cameras(&sample.out("n").join("transforms.json"), None).unwrap();
    assert_eq!(set.cameras[0].model, rig.cameras[1].left);
}

#[test]
fn points_read_back_from_las_and_laz() {
    let sample = Sample::new();
    let mut sizes = Vec::new();
    for format in [Format::Las, Format::Laz] {
        let out = sample.out(&format!("cloud.{}", format.name()));
        export(&sample.scene(), format, &Options::default(), &out).unwrap();
        let mut reader = las::Reader::from_path(&out).unwrap();
        assert_eq!(reader.header().date(), None);
        let points = reader.read_all().unwrap();
        let points: Vec<las::Point> = points.points().map(|p| p.unwrap()).collect();
        assert_eq!(points.len(), 500);
        for (found, expected) in points.iter().zip(sample::points()) {
            let place = expected.x_in_world.map(f64::from);
            for (found, expected) in [found.x, found.y, found.z].into_iter().zip(place) {
                // Half a step, and the last bits of 60 m.
                assert!(
                    (found - expected).abs() <= 0.5e-4 + 1e-12,
                    "{found} {expected}"
                );
            }
            let color = found.color.unwrap();
            let [r, g, b] = expected.color.map(|c| u16::from(c) << 8 | u16::from(c));
            assert_eq!((color.red, color.green, color.blue), (r, g, b));
        }
        sizes.push(std::fs::metadata(&out).unwrap().len());
    }
    assert!(sizes[1] < sizes[0], "{sizes:?}");
}

#[test]
fn missing_inputs_are_named_in_the_error() {
    let sample = Sample::new();
    let options = Options {
        cameras: vec!["head".to_owned()],
        ..Options::default()
    };
    let error = export(
        &sample.scene(),
        Format::ColmapText,
        &options,
        &sample.out("x"),
    )
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "writing colmap-text: found no camera head, expected one of left_shoulder, feet"
    );
    let options = Options {
        images: Some(sample.out("nowhere")),
        ..Options::default()
    };
    let error = export(
        &sample.scene(),
        Format::ColmapText,
        &options,
        &sample.out("x"),
    )
    .unwrap_err();
    assert!(
        error.to_string().contains("no image of keyframe"),
        "{error}"
    );
}

fn png_grey8(path: &Path) -> Vec<u8> {
    let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()))
        .read_info()
        .unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut data).unwrap();
    data
}

fn png_grey16(path: &Path) -> (u32, u32, Vec<u16>) {
    let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()))
        .read_info()
        .unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    let samples = data
        .chunks_exact(2)
        .map(|p| u16::from_be_bytes([p[0], p[1]]));
    (info.width, info.height, samples.collect())
}
