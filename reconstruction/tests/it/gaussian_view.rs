//! The view of the scene of Gaussians in a browser: it shows what the renderer on the processor
//! renders, flies, and has words where there is no WebGL2.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use browser::Browser;
use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, Eye};
use scene_bundle::outputs::SPLATS;
use scene_bundle::outputs::splats::{
    self as bundle, SplatBackground, SplatContent, SplatScene, SplatSector, SplatTraining,
    SplatView,
};
use scene_bundle::{Bundle, Provenance, Record, RigRevision};
use serde_json::json;
use splats::{Background, Camera, Exposure, RenderConfig, Renderer, Scene, Sky, Splat, Splats};

/// Size of the canvas, CSS pixels of two pixels each.
const SIZE: [u32; 2] = [400, 260];
/// Edge of the sky, texels.
const SKY: usize = 8;

/// Gaussians of all shapes and opacities around a path, with harmonics of degree 1.
fn scene() -> Scene {
    let mut splats = Splats::empty(1).expect("a degree");
    for i in 0..3000_u64 {
        let uniform = |k: u64| counter_random::uniform(1, k, i) as f32;
        let bell = |k: u64| counter_random::bell(1, k, i) as f32;
        let mut splat = Splat::sphere(0.1, [uniform(0), uniform(1), uniform(2)]);
        splat.position_m = [20.0 * uniform(3) - 4.0, 6.0 * bell(4), 1.5 + 2.0 * bell(5)];
        splat.log_scale = [0, 1, 2].map(|k| -2.0 + 0.8 * bell(6 + k));
        splat.rotation_wxyz = [bell(9), bell(10), bell(11), 0.1 + bell(12)];
        splat.opacity_logit = 2.0 * bell(13);
        for (k, f) in splat.harmonics[1..4]
            .as_flattened_mut()
            .iter_mut()
            .enumerate()
        {
            *f = 0.3 * bell(20 + k as u64);
        }
        splats.push(&splat).expect("a Gaussian");
    }
    let texel = |i: usize| [0, 1, 2].map(|k| counter_random::uniform(2, k, i as u64) as f32);
    let sky = Sky::from_texels(SKY, (0..SKY * SKY).map(texel).collect());
    Scene {
        splats,
        background: Background::Sky(sky.expect("a sky")),
    }
}

/// Poses of a camera that goes along x and sways.
fn poses() -> Vec<RigidTransform> {
    let pose = |k: u32| {
        let along = f64::from(k);
        let sway = RigidTransform::from_rotation_vector(
            [0.1 * along.sin(), 0.05 * along.cos(), 0.02 * along],
            [0.3 * along, 0.0, 1.5],
        );
        // Camera axes in a rig with x forward, y left, z up.
        let rows = [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0];
        let level = RigidTransform::from_rotation_rows(rows, [0.0; 3]);
        sway.expect("a rotation") * level.expect("a rotation")
    };
    (0..40).map(pose).collect()
}

fn record() -> SplatScene {
    let view = |(k, pose): (usize, RigidTransform)| SplatView {
        camera: "front".to_owned(),
        eye: Eye::Left,
        frame: k as u64,
        set: k as u64,
        time_ns: 250_000_000 * k as i64,
        world_from_camera: pose,
        shutter: None,
        reduction: 1,
        exposure: [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
        held_out: None,
    };
    SplatScene {
        degree: 1,
        compensated: true,
        background: SplatBackground::Sky { size: SKY },
        sectors: vec![SplatSector {
            min_m: [-100.0; 3],
            max_m: [100.0; 3],
            count: 0,
            file: String::new(),
            blake3: String::new(),
            views: (0..40).collect(),
            neighbors: Vec::new(),
        }],
        views: poses().into_iter().enumerate().map(view).collect(),
        training: SplatTraining::default(),
        coverage: None,
    }
}

/// The report of a bundle that has nothing else, written once for all tests.
fn page() -> PathBuf {
    static PAGE: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, page) = PAGE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("walk.scene");
        let provenance = Provenance {
            session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
            handoff_blake3: "ab".repeat(32),
            judgement: None,
            rig: RigRevision {
                name: "chest".to_owned(),
                revision: "B".to_owned(),
            },
            program: "test".to_owned(),
            program_version: "1".to_owned(),
            started_civil_ns: 1_795_000_000_000_000_000,
            ended_civil_ns: None,
        };
        let new = Bundle::create_or_open(&path, provenance).expect("a bundle");
        let draft = new.begin(SPLATS).expect("a draft");
        let Scene { splats, background } = scene();
        let Background::Sky(sky) = background else {
            panic!("{background:?}")
        };
        let content = SplatContent {
            sectors: &[splats],
            sky: sky.texels(),
            comparisons: &[],
            coverage: None,
        };
        bundle::write(&draft, &record(), &content).expect("written");
        let stage = Record {
            stage: "splats".to_owned(),
            stage_version: 1,
            settings: json!({}),
            inputs: BTreeMap::new(),
        };
        draft.commit(stage).expect("committed");
        new.finish(1_795_000_000_000_000_001).expect("finished");
        let page = folder.path().join("page.html");
        let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
        command.arg("report").arg(&path).arg("--out").arg(&page);
        let output = command.output().expect("run");
        assert!(output.status.success(), "{output:?}");
        (folder, page)
    });
    page.clone()
}

/// A browser with the report; none where there is no WebGL2.
fn open() -> Option<Browser> {
    let mut browser = Browser::start_with_webgl(900, 700)?;
    browser.open_file(&page());
    if browser.value("document.getElementById('gaussians').hasAttribute('data-none')")
        == json!(true)
    {
        println!("skipped: no WebGL2 in this browser, so the view is not looked at");
        return None;
    }
    Some(browser)
}

/// Waits until a change of the pose is drawn.
fn drawn(browser: &mut Browser) {
    let frames =
        "requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done)))";
    browser.value(&format!("new Promise((done) => {frames}).then(() => 0)"));
}

fn pixels(png: &[u8]) -> (usize, Vec<u8>) {
    let mut reader = png::Decoder::new(Cursor::new(png))
        .read_info()
        .expect("png");
    let mut pixels = vec![0; reader.output_buffer_size().expect("size")];
    let info = reader.next_frame(&mut pixels).expect("png");
    let samples = info.color_type.samples();
    let rgb = pixels.chunks_exact(samples).flat_map(|pixel| &pixel[..3]);
    (info.width as usize, rgb.copied().collect())
}

#[test]
fn the_view_shows_what_the_renderer_renders() {
    let Some(mut browser) = open() else { return };
    let scene = scene();
    let mut config = RenderConfig::default();
    config.compensate = true;
    let renderer = Renderer::new(config).expect("a configuration");
    let [width, height] = SIZE.map(|edge| 2 * edge);
    let focal = 1.5 * f64::from(width.min(height)) / 2.0;
    let center = [width, height].map(|edge| (f64::from(edge) - 1.0) / 2.0);
    let model = CameraModel::new(
        (width, height),
        [focal, focal, center[0], center[1]],
        Distortion::None,
    );
    // At a place that does not depend on the text above it.
    browser.value(&format!(
        "document.getElementById('gaussians-canvas').style.cssText =
            'position: fixed; left: 0; top: 0; z-index: 9; width: {}px; height: {}px'",
        SIZE[0], SIZE[1]
    ));
    for (frame, pose) in poses().into_iter().enumerate().step_by(9) {
        let [x, y, z] = pose.translation_m();
        let q = pose.rotation();
        browser.value(&format!(
            "location.hash = 'gaussians={x},{y},{z},{},{},{},{}'",
            q.w, q.i, q.j, q.k
        ));
        browser.until(&format!(
            "document.getElementById('gaussians-canvas').width === {width}"
        ));
        drawn(&mut browser);
        let (columns, found) = pixels(&browser.screenshot(false));
        let camera = Camera::new(model, pose.inverse()).expect("a camera");
        let image = renderer.render(&scene, &camera, &Exposure::NONE);
        let mut sum = 0.0;
        for pixel in 0..camera.pixels() {
            let (row, column) = (pixel / width as usize, pixel % width as usize);
            for c in 0..3 {
                let found = f64::from(found[3 * (row * columns + column) + c]) / 255.0;
                let expected = f64::from(image.rgb[c][pixel].clamp(0.0, 1.0));
                sum += (found - expected).powi(2);
            }
        }
        let psnr_db = -10.0 * (sum / (3 * camera.pixels()) as f64).log10();
        println!("frame {frame}: {psnr_db:.1} dB");
        assert!(psnr_db >= 40.0, "frame {frame}: {psnr_db} dB");
    }
    assert_eq!(browser.exceptions(), [""; 0]);
}

#[test]
fn the_flight_starts_stops_and_steps_where_motion_is_not_wanted() {
    let Some(mut browser) = open() else { return };
    let value = "Number(document.getElementById('gaussians-place').value)";
    browser.tap("#gaussians-fly");
    browser.until(&format!("{value} > 0 && {value} % 1 !== 0"));
    let label = "document.getElementById('gaussians-fly').textContent";
    assert_eq!(browser.value(label), json!("Stop"));
    // A key on the canvas takes over.
    browser.value("document.getElementById('gaussians-canvas').focus()");
    for kind in ["keyDown", "keyUp"] {
        browser.call(
            "Input.dispatchKeyEvent",
            json!({"type": kind, "key": "ArrowLeft", "code": "ArrowLeft"}),
        );
    }
    assert_eq!(browser.value(label), json!("Fly along the path"));
    let stopped = browser.value(value);
    drawn(&mut browser);
    assert_eq!(browser.value(value), stopped);

    let calm = json!([{"name": "prefers-reduced-motion", "value": "reduce"}]);
    browser.call("Emulation.setEmulatedMedia", json!({"features": calm}));
    browser.tap("#gaussians-fly");
    browser.until(&format!("{value} !== {stopped}"));
    assert_eq!(browser.value(&format!("{value} % 1")), json!(0));
    assert_eq!(browser.exceptions(), [""; 0]);
}

#[test]
fn without_webgl2_words_stand_in_place_of_the_view() {
    let Some(mut browser) = Browser::start(360, 780) else {
        return;
    };
    let none = "HTMLCanvasElement.prototype.getContext = () => null";
    browser.call(
        "Page.addScriptToEvaluateOnNewDocument",
        json!({"source": none}),
    );
    browser.open_file(&page());
    let shown = |id: &str| format!("document.getElementById('{id}').checkVisibility()");
    assert_eq!(browser.value(&shown("gaussians-none")), json!(true));
    assert_eq!(browser.value(&shown("gaussians-canvas")), json!(false));
    let images = "[...document.images].filter((image) => image.alt.endsWith(', rendered')).length";
    assert_eq!(browser.value(images), json!(8));
    assert_eq!(browser.overflow(360), 0);
    assert_eq!(browser.exceptions(), [""; 0]);
}
