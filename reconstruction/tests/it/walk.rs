//! A simulated walk through the whole program: every stage, its results against ground truth, and
//! that neither the number of threads nor a second run changes anything.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};

use browser::Browser;
use cad_transforms::{Rig, RigidTransform};
use camera_models::Lens;
use nalgebra::Vector3;
use reconstruction::evaluate::{Evaluation, Settings, evaluate, files};
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render_session};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{self, Simulation};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::{Scene, outputs};
use serde_json::{Value, json};
use session_archive::handoff::Verdict;

use crate::frame_set_reader::RIG;
use crate::session::{index, seal_session};

const STAGES: [&str; 10] = [
    "rig",
    "odometry",
    "bundle-adjustment",
    "depth",
    "cloud",
    "tags",
    "terrain",
    "feet",
    "maps",
    "splats",
];

/// Steps of the training: enough to see that it learns.
pub(crate) const SPLAT_STEPS: &str = "300";

pub(crate) struct Walk {
    simulation: Arc<Simulation>,
    pub(crate) session: PathBuf,
    /// The bundle written with one thread.
    pub(crate) scene: PathBuf,
    _folder: tempfile::TempDir,
}

/// Four seconds on a plaza where people walk about, reconstructed once for all tests.
pub(crate) fn walk() -> &'static Walk {
    static WALK: OnceLock<Walk> = OnceLock::new();
    WALK.get_or_init(|| {
        let folder = tempfile::tempdir().expect("folder");
        let settings = simulation::Settings {
            kind: Kind::Plaza,
            lighting: Lighting::Day,
            seed: 3,
            seconds: 4.0,
            rate_hz: 15.0,
            width: 480,
            height: 268,
            quality: Quality::FAST,
        };
        let rig = Rig::parse(RIG).expect("a rig file");
        let simulation = Arc::new(Simulation::new(&settings, &rig).expect("a walk"));
        let job = Job {
            rig: &rig,
            rig_text: RIG,
            faults: &Faults::default(),
            truth: false,
            session: true,
            threads: 2,
        };
        let session = folder.path().join("session");
        render_session(&simulation, &job, &session, &|| {}).expect("a session");
        index(&session);
        seal_session(&session, Verdict::Pass);
        let scene = folder.path().join("one.scene");
        let states = run(&session, &scene, "1");
        assert_eq!(
            states,
            STAGES.map(|stage| (stage.to_owned(), "ran".to_owned()))
        );
        Walk {
            simulation,
            session,
            scene,
            _folder: folder,
        }
    })
}

/// The session and its bundle, for copying.
pub(crate) fn made() -> (&'static Path, &'static Path) {
    (&walk().session, &walk().scene)
}

/// Runs all stages; gives each with its state.
fn run(session: &Path, scene: &Path, threads: &str) -> Vec<(String, String)> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.arg("run").arg(session).arg("--out").arg(scene);
    command.args(["--preset", "fast", "--json"]);
    command.args(["--splat-steps", SPLAT_STEPS]);
    let output = command.env("RAYON_NUM_THREADS", threads).output();
    let output = output.expect("run");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let lines = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"));
    let word = |value: &Value| value.as_str().expect("a word").to_owned();
    lines
        .map(|line: Value| (word(&line["stage"]), word(&line["state"])))
        .collect()
}

fn hashes(scene: &Path) -> BTreeMap<String, String> {
    let scene = Scene::open(scene).expect("a bundle");
    let outputs = scene.manifest().outputs.iter();
    outputs
        .map(|(name, output)| (name.clone(), output.hash.clone()))
        .collect()
}

pub(crate) fn truth(walk: &Walk) -> PathBuf {
    walk.session.join("rig/truth.left_shoulder.csv")
}

pub(crate) fn evaluation(walk: &Walk) -> Evaluation {
    let estimate = files::load(&walk.scene, Some("trajectory")).expect("a trajectory");
    let truth = files::load(&truth(walk), None).expect("the truth");
    evaluate(
        &estimate.trajectory,
        &truth.trajectory,
        &Settings::default(),
    )
}

#[test]
fn threads_and_second_runs_change_nothing() {
    let walk = walk();
    let two = walk.scene.with_file_name("two.scene");
    run(&walk.session, &two, "2");
    let expected = hashes(&walk.scene);
    assert_eq!(hashes(&two), expected);
    let again = run(&walk.session, &two, "2");
    assert_eq!(
        again,
        STAGES.map(|stage| (stage.to_owned(), "up_to_date".to_owned()))
    );
    assert_eq!(hashes(&two), expected);
}

#[test]
fn poses_are_near_ground_truth() {
    let evaluation = evaluation(walk());
    let absolute = evaluation.absolute.expect("something to compare");
    assert!(absolute.translation_m.rmse < 0.03, "{absolute:?}");
    assert_eq!(evaluation.completion.share, 1.0);
}

/// Distance of points from the true surface, m: from the plane of the pixels that show it, for each
/// the minimum over all views that could have seen it; and the sigma of the point, m.
fn off_surface(
    walk: &Walk,
    points: &[CloudPoint],
    true_from_estimated: RigidTransform,
) -> Vec<[f64; 2]> {
    let mut off = vec![f64::INFINITY; points.len()];
    let settings = walk.simulation.settings();
    let [width, height] = [settings.width as usize, settings.height as usize];
    // Cameras with a global shutter.
    for camera in ["left_shoulder", "right_shoulder"] {
        let cameras = walk.simulation.cameras();
        let number = cameras
            .iter()
            .position(|c| c.name == camera)
            .expect("a camera");
        let lens = Lens::new(&walk.simulation.calibration(number).left);
        let mut truths = walk.simulation.ground_truth(number);
        for frame in (0..settings.frame_count()).step_by(6) {
            let time_ns = settings.frame_ns(frame);
            let rig = walk.simulation.walker().rig(time_ns as f64 * 1e-9);
            let (place, turn) = cameras[number].world_from_eye(0, &rig, None);
            let q = turn.quaternion();
            let world_from_eye = RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], place.into());
            let eye_from_estimated =
                world_from_eye.expect("a pose").inverse() * true_from_estimated;
            let depth = truths.render(0, time_ns).depth;
            let seen = |x: usize, y: usize| {
                let z = f64::from(depth[y * width + x]);
                let ray = Vector3::from(lens.unproject([x as f64, y as f64])?);
                z.is_finite().then(|| ray * (z / ray.z))
            };
            for (off, point) in off.iter_mut().zip(points) {
                let x = Vector3::from(eye_from_estimated.apply(point.x_in_world.map(f64::from)));
                let Some([u, v]) = lens.project(x.into()).filter(|_| x.z > 0.0) else {
                    continue;
                };
                let inside = |c: f64, n: usize| c >= 0.0 && c.round() < (n - 1) as f64;
                if !(inside(u, width) && inside(v, height)) {
                    continue;
                }
                let (u, v) = (u.round() as usize, v.round() as usize);
                let (Some(a), Some(b), Some(c)) = (seen(u, v), seen(u + 1, v), seen(u, v + 1))
                else {
                    continue;
                };
                // Beyond an edge is another surface.
                if (a.z - b.z).abs().max((a.z - c.z).abs()) < 0.2 * a.z {
                    let normal = (b - a).cross(&(c - a)).normalize();
                    *off = off.min(normal.dot(&(x - a)).abs());
                }
            }
        }
    }
    let both = off
        .iter()
        .zip(points)
        .map(|(off, p)| [*off, f64::from(p.sigma_m)]);
    both.filter(|[off, _]| off.is_finite()).collect()
}

#[test]
fn the_cloud_is_on_the_true_surfaces() {
    let walk = walk();
    let scene = Scene::open(&walk.scene).expect("a bundle");
    let points = outputs::cloud::read(&scene.output("cloud").expect("a cloud")).expect("points");
    assert!(points.len() > 10_000, "{}", points.len());
    // In color.
    let is_coloured = |p: &&CloudPoint| p.color[0].abs_diff(p.color[2]) > 8;
    assert!(points.iter().filter(is_coloured).count() > points.len() / 20);
    let fit = evaluation(walk).true_from_estimated.expect("an alignment");
    let mut off = off_surface(walk, &points, fit.rigid);
    assert!(
        off.len() > points.len() / 2,
        "{} of {}",
        off.len(),
        points.len()
    );
    off.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let share = |part: f64| off[(part * off.len() as f64) as usize][0];
    let inside = off
        .iter()
        .filter(|[off, sigma]| off <= &(2.0 * sigma))
        .count() as f64;
    let inside = inside / off.len() as f64;
    let [half, most] = [share(0.5), share(0.95)];
    println!(
        "{} points, error {half:.3} m (median), {most:.3} m (95 %), {inside:.3} inside",
        points.len()
    );
    assert!(half < 0.05 && most < 0.2, "{half} m, {most} m");
    assert!(inside > 0.9, "{inside}");
}

/// Writes the true depth of the frames that have depth, as `paws-rig-sim render --truth` does for
/// all frames.
fn write_true_depth(walk: &Walk, scene: &Scene, folder: &Path) {
    let settings = walk.simulation.settings();
    let reader = scene.output("depth").expect("depth");
    let index = outputs::depth::read_index(&reader).expect("an index");
    for (number, camera) in walk.simulation.cameras().iter().enumerate() {
        let view = index.views.iter().position(|v| v.camera == camera.name);
        let keys = index.images.iter().filter(|key| Some(key.view) == view);
        let mut truths = walk.simulation.ground_truth(number);
        let root = folder.join(&camera.name).join("mav0");
        for eye in 0..2 {
            fs::create_dir_all(root.join(format!("depth{eye}/data"))).expect("a folder");
        }
        let names = (0..settings.frame_count()).map(|frame| settings.frame_ns(frame));
        let list: String = names.map(|ns| format!("{ns},{ns}.png\n")).collect();
        fs::write(
            root.join("depth0/data.csv"),
            format!("#timestamp [ns],filename\n{list}"),
        )
        .expect("a list");
        for key in keys {
            let time_ns = settings.frame_ns(key.frame);
            for eye in 0..2 {
                let truth = truths.render(eye, time_ns);
                let millimetres = |depth: &f32| match (1e3 * depth).round() {
                    mm if mm <= 65535.0 => mm as u16,
                    _ => 0,
                };
                let samples = truth.depth.iter().map(millimetres);
                let bytes: Vec<u8> = samples.flat_map(u16::to_be_bytes).collect();
                let path = root.join(format!("depth{eye}/data/{time_ns}.png"));
                let file = fs::File::create(path).expect("a file");
                let mut encoder = png::Encoder::new(file, settings.width, settings.height);
                encoder.set_color(png::ColorType::Grayscale);
                encoder.set_depth(png::BitDepth::Sixteen);
                let mut writer = encoder.write_header().expect("a header");
                writer.write_image_data(&bytes).expect("an image");
            }
        }
    }
}

#[test]
fn depth_is_near_ground_truth_within_its_sigma() {
    let walk = walk();
    let scene = Scene::open(&walk.scene).expect("a bundle");
    let folder = walk.scene.with_file_name("truth");
    write_true_depth(walk, &scene, &folder);
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command
        .arg("evaluate-depth")
        .arg(&walk.scene)
        .arg("--truth")
        .arg(&folder);
    let output = command.arg("--json").output().expect("run");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let rows: Vec<Value> = serde_json::from_slice(&output.stdout).expect("JSON");
    let names: Vec<&str> = rows
        .iter()
        .filter_map(|row| row["camera"].as_str())
        .collect();
    assert_eq!(names, ["feet", "left_shoulder", "right_shoulder", "all"]);
    let all = rows.last().expect("a row");
    let number = |name: &str| all[name].as_f64().expect("a number");
    println!("{all}");
    assert!(number("density") > 0.5, "{all}");
    assert!(all["bad"][1].as_f64().expect("a number") < 0.05, "{all}");
    assert!(number("mean_error_px") < 0.6, "{all}");
    assert!(number("within_2_sigma") > 0.9, "{all}");

    // Without ground truth it names the missing file.
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command
        .arg("evaluate-depth")
        .arg(&walk.scene)
        .arg("--truth")
        .arg(&walk.session);
    let output = command.output().expect("run");
    assert_eq!(output.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("reading the truth of depth: "), "{errors}");
}

#[test]
fn the_report_states_whether_it_has_ground_truth() {
    let walk = walk();
    let report = |arguments: &[&Path]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
        let out = walk.scene.with_file_name("page.html");
        command
            .arg("report")
            .arg(&walk.scene)
            .arg("--out")
            .arg(&out);
        let output = command.args(arguments).output().expect("run");
        assert!(output.status.success(), "{output:?}");
        let line = String::from_utf8(output.stdout).expect("UTF-8");
        (line, fs::read_to_string(out).expect("a page"))
    };
    let (line, page) = report(&[]);
    assert!(line.starts_with("no ground truth, "), "{line}");
    assert!(
        page.contains("No ground truth was given"),
        "no word of ground truth"
    );
    let truth = truth(walk);
    let (line, page) = report(&[Path::new("--truth"), &truth]);
    assert!(
        line.contains(" mm (root mean square), ") && line.contains("100.0 % complete"),
        "{line}"
    );
    for expected in [
        "distance from ground truth",
        "<h2>Stages</h2>",
        "% of their pixels have depth",
    ] {
        assert!(page.contains(expected), "{expected}");
    }
    // Two images of the cloud, one of the mesh and one of each camera with its rendered twin, eight
    // of the Gaussians along the path, the view in three dimensions, and images of each camera, in
    // the page itself.
    assert_eq!(charts::inspect(&page), Ok(()));
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 14);
    for expected in [
        "id=\"viewer-data\"",
        " (100.0 %) are in this view",
        "needs JavaScript and WebGL2",
    ] {
        assert!(page.contains(expected), "{expected}");
    }
    let images = page.matches("src=\"data:image/jpeg;base64,/9j/").count();
    assert!(
        (9..=12).contains(&images),
        "{images} images of three cameras"
    );
    for name in ["left_shoulder", "right_shoulder", "feet"] {
        assert!(page.contains(&format!("<h3>{name}</h3>")), "{name}");
    }
    assert!(page.len() < 25_000_000, "{}", page.len());
    assert!(
        page == report(&[Path::new("--truth"), &truth]).1,
        "another page"
    );
    // An older bundle has no such images and is valid.
    let seen = walk.scene.join("seen.jsonl");
    let kept = walk.scene.with_file_name("seen.kept");
    fs::rename(&seen, &kept).expect("moved");
    let (_, page) = report(&[]);
    fs::rename(&kept, &seen).expect("moved");
    assert!(page.contains("There is no image beside the bundle"));
    assert_eq!(charts::inspect(&page), Ok(()));
}

/// In a browser, on a phone and on a screen; without WebGL2 the message is shown instead of the
/// view.
#[test]
fn the_report_fits_and_its_view_draws() {
    let Some(mut browser) = Browser::start_with_webgl(360, 780) else {
        return;
    };
    let walk = walk();
    let page = walk.scene.with_file_name("browser.html");
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.arg("report").arg(&walk.scene);
    let output = command.arg("--out").arg(&page).output().expect("run");
    assert!(output.status.success(), "{output:?}");
    browser.open_file(&page);
    for width in [360, 1400] {
        browser.resize(width, 780);
        assert_eq!(browser.overflow(width), 0, "at {width}");
        let none = browser.value("document.getElementById('viewer').hasAttribute('data-none')");
        let words = browser.value("document.getElementById('viewer-none').checkVisibility()");
        assert_eq!(words, none, "the message or the view");
        if none == json!(true) {
            println!("skipped: no WebGL2 in this browser, so the view is not checked");
            let words = browser.value("document.getElementById('viewer-none').innerText");
            assert!(words.to_string().contains("needs JavaScript and WebGL2"));
        } else {
            draws(&mut browser);
        }
    }
    assert_eq!(browser.exceptions(), [""; 0]);
}

/// Waits until the view shows more than its background.
fn draws(browser: &mut Browser) {
    for _ in 0..400 {
        let place = browser.value(
            "(() => { const e = document.getElementById('viewer-canvas'); e.scrollIntoView({block: 'center'}); \
             const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; })()",
        );
        if colors(&browser.screenshot(false), &place) > 1 {
            return;
        }
        browser.value("new Promise((done) => setTimeout(done, 250))");
    }
    panic!("the view remains empty");
}

/// Number of colors of a screenshot within an area of the page, with two pixels for each of the
/// page's.
fn colors(image: &[u8], place: &Value) -> usize {
    let decoder = png::Decoder::new(Cursor::new(image));
    let mut reader = decoder.read_info().expect("png");
    let mut pixels = vec![0; reader.output_buffer_size().expect("size")];
    let info = reader.next_frame(&mut pixels).expect("png");
    let samples = info.color_type.samples();
    assert!(samples >= 3, "{info:?}");
    // Without its edge.
    let [left, top, right, bottom] =
        [(0_usize, 4.0), (1, 4.0), (2, -4.0), (3, -4.0)].map(|(k, by)| {
            let at: f64 = place[k].as_f64().expect("a place") + by;
            (2.0 * at).max(0.0) as usize
        });
    let mut found = BTreeSet::new();
    let rows = pixels.chunks_exact(info.line_size);
    for row in rows.take(bottom).skip(top) {
        let row = row.chunks_exact(samples).take(right).skip(left);
        found.extend(row.map(|pixel| &pixel[..3]));
    }
    found.len()
}
