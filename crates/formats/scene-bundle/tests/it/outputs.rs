//! Every output of the format, written and read.

use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};
use camera_models::{CameraModel, Distortion, Eye};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::depth::{
    DepthImage, DepthView, DepthWriter, SIGMA_UNIT_M, stored_depth, stored_sigma,
};
use scene_bundle::outputs::tag_detections::{SecondPose, TagDetection, TagDetectionsWriter};
use scene_bundle::outputs::trajectory::TrajectoryWriter;
use scene_bundle::outputs::{
    self, cloud, depth, keyframes, masks, rig, tag_detections, trajectory,
};
use scene_bundle::verify::verify;
use scene_bundle::{Bundle, BundleError, Draft};

use crate::sample::{self, Sample, provenance};

#[test]
fn all_outputs_read_back_unchanged() {
    let sample = Sample::new();
    let scene = sample.scene();
    let of = |name: &str| scene.output(name).unwrap();
    assert_eq!(rig::read(&of(outputs::RIG)).unwrap(), sample::rig_model());
    let poses = trajectory::read(&of(outputs::TRAJECTORY)).unwrap();
    assert_eq!(poses, sample::walk(0.0));
    assert_eq!(
        trajectory::read_spans(&of(outputs::TRAJECTORY)).unwrap(),
        poses.spans()
    );
    assert_eq!(
        trajectory::read(&of(outputs::TRAJECTORY_CAUSAL)).unwrap(),
        sample::walk(0.01)
    );
    let mut expected = sample::keyframe_table(&sample::rig_model());
    expected.sort_by_key(|k| (k.camera, k.time_ns));
    assert_eq!(keyframes::read(&of(outputs::KEYFRAMES)).unwrap(), expected);
    let mask = |camera, eye| masks::read(&of(outputs::MASKS), camera, eye).unwrap();
    assert_eq!(mask("feet", Eye::Left), Some(sample::mask()));
    assert_eq!(
        (mask("feet", Eye::Right), mask("left_shoulder", Eye::Left)),
        (None, None)
    );
    let first = &sample::keyframe_table(&sample::rig_model())[0];
    let camera = &sample::rig_model().cameras[usize::from(first.camera)].name;
    let moving = |frame| masks::read_dynamic(&of(outputs::MASKS), camera, frame).unwrap();
    assert_eq!(moving(first.frame), Some(sample::moving()));
    assert_eq!(moving(first.frame + 1), None);
    assert_eq!(cloud::read(&of(outputs::CLOUD)).unwrap(), sample::points());

    let reader = of(outputs::DEPTH);
    let index = depth::read_index(&reader).unwrap();
    assert_eq!(index.views, [sample::view()]);
    assert_eq!(index.images.len(), 3);
    assert!(index.images.is_sorted_by_key(|key| key.time_ns));
    for key in &index.images {
        assert_eq!(
            depth::read(&reader, &index, key).unwrap(),
            sample::depth_image(key.frame)
        );
    }
    // The manifest does not grow with the number of images, and all of them are verified.
    assert_eq!(reader.output().files.len(), 2);
    let checked = verify(&scene, |_| {}).unwrap();
    assert!(
        checked.is_whole() && checked.unnamed.is_empty(),
        "{checked:?}"
    );
    let of_depth = checked
        .outputs
        .iter()
        .find(|o| o.name == outputs::DEPTH)
        .unwrap();
    assert_eq!(of_depth.files, 2 + 6);
}

#[test]
fn the_same_outputs_are_the_same_bytes() {
    let (a, b) = (Sample::new(), Sample::new());
    assert_eq!(sample::files(&a.path), sample::files(&b.path));
}

#[test]
fn a_changed_depth_map_is_not_read() {
    let sample = Sample::new();
    let reader = sample.scene().output(outputs::DEPTH).unwrap();
    let index = depth::read_index(&reader).unwrap();
    let key = &index.images[1];
    let [_, path] = depth::paths("feet", key.frame);
    let place = reader.file_path(&path);
    let mut bytes = std::fs::read(&place).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&place, bytes).unwrap();
    let error = depth::read(&reader, &index, key).unwrap_err();
    assert!(matches!(error, BundleError::Changed { .. }), "{error}");
    assert!(error.to_string().ends_with(&path), "{error}");
    assert!(depth::read(&reader, &index, &index.images[0]).is_ok());
    let checked = verify(&sample.scene(), |_| {}).unwrap();
    assert!(!checked.is_whole());
}

#[test]
fn depth_is_rounded_to_half_a_unit() {
    for (metres, units) in [
        (1.0, 1000),
        (0.0004, 0),
        (0.0006, 1),
        (65.535, 65535),
        (65.536, 0),
        (0.0, 0),
        (-1.0, 0),
        (f32::NAN, 0),
        (f32::INFINITY, 0),
    ] {
        assert_eq!(stored_depth(metres), units, "{metres} m");
    }
    for (metres, units) in [
        (0.01, 100),
        (0.0, 1),
        (6.5535, 65535),
        (100.0, 65535),
        (f32::INFINITY, 65535),
        (f32::NAN, 65535),
        (-0.1, 65535),
    ] {
        assert_eq!(stored_sigma(metres), units, "{metres} m");
    }
    let image = DepthImage::from_metres(2, 1, &[2.0, f32::NAN], &[0.02, 0.02]);
    assert_eq!(
        (image.depth_m(0, 0), image.depth_m(1, 0)),
        (Some(2.0), None)
    );
    assert_eq!(
        (image.sigma_m(0, 0), image.sigma_m(1, 0)),
        (Some(200.0 * SIGMA_UNIT_M), None)
    );
}

#[test]
fn values_outside_the_format_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("a"), sample::provenance()).unwrap();
    let check = |what: &dyn Fn(&Draft) -> Result<(), BundleError>, expected: &str| {
        let draft = bundle.begin("x").unwrap();
        let error = what(&draft).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    let mut rig_model = sample::rig_model();
    rig_model.cameras[0].name = "feet".to_owned();
    check(
        &|d| rig::write(d, &rig_model),
        "found cameras called feet, feet",
    );
    rig_model.cameras[0].name = "../feet".to_owned();
    check(
        &|d| rig::write(d, &rig_model),
        "found a camera called \"../feet\"",
    );

    let walk = sample::walk(0.0);
    check(
        &|d| {
            let mut writer = TrajectoryWriter::new(d)?;
            writer.push(&walk.poses()[1])?;
            writer.push(&walk.poses()[0])
        },
        "expected later than the one before",
    );
    let mut twice = sample::keyframe_table(&sample::rig_model());
    twice.push(twice[0]);
    check(
        &|d| keyframes::write(d, &twice),
        "found frame 20 of camera 0 twice",
    );

    let mut mask = sample::mask();
    mask.pixels[7] = 128;
    check(
        &|d| masks::write(d, "feet", Eye::Left, &mask),
        "found a pixel of 128, expected 0 or 255",
    );
    mask.pixels.pop();
    check(
        &|d| masks::write(d, "feet", Eye::Left, &mask),
        "found 3071 pixels, expected 64x48",
    );

    let nowhere = CloudPoint {
        x_in_world: [0.0, f32::NAN, 0.0],
        ..sample::points()[0]
    };
    check(
        &|d| cloud::write(d, &[sample::points()[0], nowhere]),
        "found point 1 at [0.0, NaN, 0.0]",
    );

    let new = |d: &Draft, views: Vec<DepthView>| DepthWriter::new(d, views).map(|_| ());
    let view = sample::view;
    check(&|d| new(d, vec![view(), view()]), "found two views of feet");
    let distorted = DepthView {
        model: CameraModel {
            distortion: Distortion::Radial2 { k1: 0.1, k2: 0.0 },
            ..view().model
        },
        ..view()
    };
    check(
        &|d| new(d, vec![distorted.clone()]),
        "found a view of feet with distortion radial2",
    );
    let shifted = DepthView {
        view_from_left: cad_transforms::RigidTransform::from_translation_m([0.5, 0.0, 0.0])
            .unwrap(),
        ..view()
    };
    check(
        &|d| new(d, vec![shifted.clone()]),
        "0.5 m from its left image's center",
    );
    let small = DepthImage::from_metres(1, 1, &[1.0], &[1.0]);
    let key = sample::depth_keys()[0];
    check(
        &|d| DepthWriter::new(d, vec![view()])?.write(key, &small),
        "found an image of 1x1, expected 60x40",
    );
    check(
        &|d| {
            let writer = DepthWriter::new(d, vec![view()])?;
            writer.write(key, &sample::depth_image(1))?;
            writer.write(key, &sample::depth_image(1))
        },
        "expected each path once",
    );
}

#[test]
fn depth_can_be_written_from_several_threads() {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("a"), sample::provenance()).unwrap();
    let written = |threads: u64| {
        let draft = bundle.begin(outputs::DEPTH).unwrap();
        let writer = DepthWriter::new(&draft, vec![sample::view()]).unwrap();
        std::thread::scope(|scope| {
            for thread in 0..threads {
                let writer = &writer;
                scope.spawn(move || {
                    for frame in (thread..24).step_by(threads as usize) {
                        let key = scene_bundle::outputs::depth::DepthKey {
                            view: 0,
                            time_ns: frame as i64,
                            frame,
                            set: frame,
                        };
                        writer.write(key, &sample::depth_image(frame)).unwrap();
                    }
                });
            }
        });
        writer.finish().unwrap();
        let record = scene_bundle::Record {
            stage: "depth".to_owned(),
            stage_version: 1,
            settings: serde_json::Value::Null,
            inputs: Default::default(),
        };
        draft.commit(record).unwrap().hash
    };
    assert_eq!(written(1), written(4));
}

fn tag_detection(time_ns: i64, tag: u64) -> TagDetection {
    let pose = RigidTransform::from_rotation_vector([0.1, 0.2, 0.3], [0.1, 0.2, -1.1]).unwrap();
    TagDetection {
        time_ns,
        frame: 7,
        camera: 1,
        foot: if tag == 0 { Foot::Left } else { Foot::Right },
        tag,
        rig_from_tag: pose,
        covariance: Covariance::from_sigmas([1e-3, 2e-3, 3e-3], [0.01, 0.02, 0.03]).unwrap(),
        visible_share: [1.0, 0.5],
        rms_levels: 2.5,
        wrong_bits: 1,
        second: (tag == 0).then_some(SecondPose {
            rig_from_tag: pose.inverse(),
            excess_cost: 4.0,
        }),
    }
}

#[test]
fn tag_detections_read_back_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance()).unwrap();
    let draft = bundle.begin(outputs::TAG_DETECTIONS).unwrap();
    let mut writer = TagDetectionsWriter::new(&draft).unwrap();
    let detections = [(5, 0), (5, 1), (9, 0)].map(|(time_ns, tag)| tag_detection(time_ns, tag));
    for detection in &detections {
        writer.push(detection).unwrap();
    }
    let error = writer.push(&detections[1]).unwrap_err().to_string();
    assert!(
        error.contains("a detection at (5, 1, 1) behind one at (9, 1, 0)"),
        "{error}"
    );
    writer.finish().unwrap();
    draft
        .commit(sample::record(outputs::TAG_DETECTIONS))
        .unwrap();
    let reader = bundle.scene().output(outputs::TAG_DETECTIONS).unwrap();
    assert_eq!(tag_detections::read(&reader).unwrap(), detections);
}
