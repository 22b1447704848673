//! The view of the scene of Gaussians in a browser: it shows what the renderer on the processor
//! renders, flies, and has words where there is no WebGL2.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use browser::Browser;
use camera_models::{CameraModel, Distortion, Eye};
use scene_bundle::outputs::splats::{self as bundle, SplatBackground};
use scene_bundle::{Scene, outputs};
use serde_json::json;
use splats::{Background, Camera, Exposure, RenderConfig, Renderer, Sky};

use crate::walk::walk;

/// Size of the canvas, CSS pixels of two pixels each.
const SIZE: [u32; 2] = [400, 260];

/// The report, written once for all tests.
fn page() -> &'static Path {
    static PAGE: OnceLock<PathBuf> = OnceLock::new();
    PAGE.get_or_init(|| {
        let scene = &walk().scene;
        let page = scene.with_file_name("gaussians.html");
        let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
        command.arg("report").arg(scene).arg("--out").arg(&page);
        let output = command.output().expect("run");
        assert!(output.status.success(), "{output:?}");
        page
    })
}

/// A browser with the report; none where there is no WebGL2.
fn open() -> Option<Browser> {
    let mut browser = Browser::start_with_webgl(900, 700)?;
    browser.open_file(page());
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
    let scene = Scene::open(&walk().scene).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    let record = bundle::read(&reader).expect("a record");
    let SplatBackground::Sky { size } = record.background else {
        panic!("{:?}", record.background)
    };
    let sky = bundle::read_sky(&reader, &record).expect("a sky");
    let content = splats::Scene {
        splats: bundle::read_sector(&reader, &record, 0).expect("Gaussians"),
        background: Background::Sky(Sky::from_texels(size, sky).expect("a sky")),
    };
    let mut config = RenderConfig::default();
    config.compensate = record.compensated;
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
    let left: Vec<_> = (record.views.iter())
        .filter(|view| view.eye == Eye::Left)
        .collect();
    for view in left.iter().step_by(left.len() / 4) {
        let pose = &view.world_from_camera;
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
        let image = renderer.render(&content, &camera, &Exposure::NONE);
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
        println!("{}, frame {}: {psnr_db:.1} dB", view.camera, view.frame);
        assert!(psnr_db >= 30.0, "{}, frame {}", view.camera, view.frame);
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
    browser.open_file(page());
    let shown = |id: &str| format!("document.getElementById('{id}').checkVisibility()");
    assert_eq!(browser.value(&shown("gaussians-none")), json!(true));
    assert_eq!(browser.value(&shown("gaussians-canvas")), json!(false));
    let images = "[...document.images].filter((image) => image.alt.endsWith(', rendered')).length";
    assert_eq!(browser.value(images), json!(8));
    assert_eq!(browser.overflow(360), 0);
    assert_eq!(browser.exceptions(), [""; 0]);
}
