//! A scene bundle as one page of HTML that opens without a network.
//!
//! Contract: the page shows images of the cameras; the path from above, colored by its distance
//! from the ground truth after the best rigid fit, or without ground truth by the stated sigma,
//! with a caption; the status of the rig over time; cloud and path in three dimensions and from two
//! sides; footsteps on the height map and feet over time; the mesh of the ground; a flight through
//! the scene of Gaussians, and held-out images beside those that it renders; the film of a
//! simulated agent; each stage with time and memory; and all notes and losses of stages. Missing
//! outputs are named and left out. It is one file of less than 25 MB. Its text is a function of the
//! bundle, of the ground truth, of the stage timings and of the images beside the bundle.

use charts::{Axis, Cell, Chart, Image, Page, Series, Span, Table, Timeline, si};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::{self, CLOUD, TRAJECTORY, TRAJECTORY_CAUSAL};
use scene_bundle::{BundleError, Scene, Status, Trajectory};

use crate::camera_images;
use crate::evaluate::ground_truth::GroundTruth;
use crate::evaluate::{self, Alignment, Evaluation, Settings, align, associate};
use crate::pipeline::{self, stage_timings, stages};
use colors::{UNKNOWN, ramp};
use gaussians::Gaussians;
use ground::Ground;
use png_file::png;
use trajectory_map::Step;

mod agent_film;
mod colors;
mod error;
mod facts;
mod fly_path;
mod footstep_map;
mod gaussian_packing;
mod gaussian_stills;
mod gaussian_viewer;
mod gaussians;
mod ground;
mod judgement;
mod png_file;
mod point_raster;
mod trajectory_map;
mod viewer;
mod viewer_page;
mod views;

pub use error::ReportError;

/// A page with its summary line.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// The file.
    pub html: String,
    /// Summary of the page.
    pub summary: String,
}

/// Renders the page of a bundle. `truth` is the ground-truth trajectory, on the same clock; its
/// poses before and after the session are ignored. `feet` is the ground truth of feet.
///
/// # Errors
/// [`ReportError`].
pub fn report(
    scene: &Scene,
    truth: Option<&Trajectory>,
    feet: Option<&GroundTruth>,
) -> Result<Report, ReportError> {
    let shown = match scene.has(TRAJECTORY) {
        true => TRAJECTORY,
        false => TRAJECTORY_CAUSAL,
    };
    let read = |name: &str| -> Result<Option<Trajectory>, BundleError> {
        let output = scene.has(name).then(|| scene.output(name)).transpose()?;
        output.map(|o| outputs::trajectory::read(&o)).transpose()
    };
    let trajectory = read(shown)?.unwrap_or_default();
    let adjusted = (shown == TRAJECTORY).then_some(&trajectory);
    let causal = read(TRAJECTORY_CAUSAL)?;
    let mut cloud = match scene.has(CLOUD) {
        true => Some(outputs::cloud::read(&scene.output(CLOUD)?)?),
        false => None,
    };
    let truth = truth.map(|truth| evaluate::clip_to_recording(truth, &trajectory));
    let truth = truth.as_ref();
    let (steps, evaluation) = steps(&trajectory, truth);
    if let Some(fit) = evaluation.as_ref().and_then(|e| e.true_from_estimated) {
        for point in cloud.iter_mut().flatten() {
            let moved = fit.rigid.apply(point.x_in_world.map(f64::from));
            point.x_in_world = moved.map(|c| c as f32);
        }
    }
    let true_from_estimated = evaluation.as_ref().and_then(|e| e.true_from_estimated);
    let ground = Ground::read(scene, feet, true_from_estimated)?;
    let gaussians = Gaussians::read(scene)?;
    let causal_off = causal
        .as_ref()
        .zip(truth)
        .map(|(causal, truth)| evaluate::evaluate(causal, truth, &Settings::default()));

    let name = scene.path();
    let name = name
        .file_name()
        .unwrap_or(name.as_os_str())
        .to_string_lossy();
    let mut page = Page::new(&format!("Reconstruction: {name}"));
    page = judgement::add(page, &scene.manifest().provenance);
    let dark = trajectory_map::dark();
    page = page.dark(dark.iter().map(|(a, b)| (a.as_str(), b.as_str())));
    page = page.table(&facts::table(scene, &trajectory, cloud.as_deref())?);
    page = images_section(page, scene)?;
    page = page.section("Trajectory");
    page = page.text(&accuracy_note(
        adjusted.is_some(),
        truth.is_some(),
        evaluation.as_ref(),
    ));
    if let Some(evaluation) = &evaluation {
        let both = [
            Some((shown, evaluation)),
            causal_off.as_ref().map(|e| (TRAJECTORY_CAUSAL, e)),
        ];
        let rows: Vec<_> = both.into_iter().flatten().collect();
        let rows = if shown == TRAJECTORY {
            &rows[..]
        } else {
            &rows[..1]
        };
        page = page.table(&errors(rows));
    }
    // If alignment failed, the two are in different worlds.
    let fits = evaluation
        .as_ref()
        .is_some_and(|e| e.true_from_estimated.is_some());
    let true_poses = truth.filter(|_| fits).into_iter().flat_map(|t| t.poses());
    let true_way: Vec<[f64; 3]> = true_poses
        .map(|pose| pose.world_from_rig.translation_m())
        .collect();
    let drawn = trajectory_map::Map {
        steps: &steps,
        truth: &true_way,
        largest_m: max_value_m(&steps),
        caption: match truth {
            Some(_) => "distance from ground truth",
            None => "stated position sigma",
        },
    };
    page = map_section(page, &drawn);
    page = page.timeline(&spans(adjusted, causal.as_ref()), "");
    page = cloud_section(page, cloud.as_deref(), &drawn, gaussians.bytes())?;
    let rig_path: Vec<[f64; 3]> = (trajectory.poses().iter())
        .filter(|pose| pose.status != Status::Lost)
        .map(|pose| pose.world_from_rig.translation_m())
        .collect();
    page = ground.add(page, &rig_path)?;
    page = gaussians.add(page);
    page = agent_film::add(page, &scene.path())?;
    page = stages_section(page, scene)?;
    Ok(Report {
        summary: summary(evaluation.as_ref(), cloud.as_deref(), &ground),
        html: page.to_html(),
    })
}

/// All poses that are not lost, with the value that they are colored by.
fn steps(trajectory: &Trajectory, truth: Option<&Trajectory>) -> (Vec<Step>, Option<Evaluation>) {
    let settings = Settings::default();
    let evaluation = truth.map(|truth| evaluate::evaluate(trajectory, truth, &settings));
    let pairs = truth.map(|truth| associate::pairs(trajectory, truth, settings.tolerance_ns));
    let pairs = pairs.unwrap_or_default();
    let aligned = align::align(&pairs, Alignment::Se3);
    let first_ns = trajectory.poses().first().map_or(0, |p| p.time_ns);
    let mut follows = false;
    let mut steps = Vec::new();
    for pose in trajectory.poses() {
        if pose.status == Status::Lost {
            follows = false;
            continue;
        }
        let moved = aligned.map_or(pose.world_from_rig, |a| a.apply(&pose.world_from_rig));
        let value_m = match truth {
            None => pose.covariance.as_ref().map(|c| {
                let [x, y, z, ..] = c.sigmas();
                (x * x + y * y + z * z).sqrt()
            }),
            Some(_) => pairs
                .binary_search_by_key(&pose.time_ns, |p| p.time_ns)
                .ok()
                .filter(|_| aligned.is_some())
                .map(|k| (moved.translation() - pairs[k].truth.translation()).norm()),
        };
        steps.push(Step {
            time_s: (pose.time_ns - first_ns) as f64 * 1e-9,
            x_in_world: moved.translation_m(),
            value_m,
            follows,
        });
        follows = true;
    }
    (steps, evaluation)
}

fn accuracy_note(is_adjusted: bool, has_truth: bool, evaluation: Option<&Evaluation>) -> String {
    let text = match (has_truth, evaluation.and_then(|e| e.absolute.as_ref())) {
        (true, Some(_)) => {
            "Errors are distances from ground truth after the best rigid fit of the whole (SE(3))."
        }
        (true, None) => {
            "The given ground truth has too few poses in common with this trajectory to compare them."
        }
        (false, _) => {
            "No ground truth was given. Colors are the position sigma stated with the poses, against the \
             first one; the actual errors are not known."
        }
    };
    let which = match is_adjusted {
        true => "Poses are those of the bundle adjustment.",
        false => "There is no bundle adjustment yet: poses are causal.",
    };
    format!("{which} {text}")
}

fn errors(rows: &[(&str, &Evaluation)]) -> Table {
    let heads = [
        "trajectory",
        "error, RMS",
        "largest",
        "of path length",
        "rotation, RMS",
        "complete",
        "beyond 3 sigma",
    ];
    rows.iter()
        .fold(Table::new(heads), |table, (name, evaluation)| {
            let absolute = evaluation.absolute.as_ref();
            let shown =
                |value: Option<String>| Cell::number(value.unwrap_or_else(|| "-".to_owned()));
            let translation = absolute.map(|a| a.translation_m);
            let turn = absolute.and_then(|a| a.rotation_rad);
            let share = translation.filter(|_| evaluation.path_m > 0.0);
            let wrong = evaluation.consistency.as_ref();
            table.row([
                (*name).into(),
                shown(translation.map(|t| si(t.rmse, "m"))),
                shown(translation.map(|t| si(t.max, "m"))),
                shown(share.map(|t| format!("{:.3} %", 100.0 * t.rmse / evaluation.path_m))),
                shown(turn.map(|t| format!("{:.2}°", t.rmse.to_degrees()))),
                shown(Some(format!(
                    "{:.1} %",
                    100.0 * evaluation.completion.share
                ))),
                shown(wrong.map(|c| format!("{} of {}", c.silently_wrong, c.count))),
            ])
        })
}

/// The largest value along the path; 0 if there is none.
fn max_value_m(steps: &[Step]) -> f64 {
    steps.iter().filter_map(|s| s.value_m).fold(0.0, f64::max)
}

fn map_section(page: Page, drawn: &trajectory_map::Map<'_>) -> Page {
    let caption = match drawn.truth.is_empty() {
        false => "From above, aligned with ground truth; ground truth in gray below it.",
        true => "From above.",
    };
    let line = drawn
        .steps
        .iter()
        .map(|s| (s.time_s, s.value_m.map_or(f64::NAN, |v| 100.0 * v)));
    let chart = Chart::new(drawn.caption)
        .x_axis(Axis::time("time"))
        .y_axis(Axis::linear(drawn.caption, "cm").include(0.0))
        .series(Series::line("", line));
    page.drawing(|width| trajectory_map::svg(drawn, width), caption)
        .chart(&chart, 240, "")
}

/// Images of each camera, as far as they are beside the bundle.
fn images_section(page: Page, scene: &Scene) -> Result<Page, ReportError> {
    let folder = scene.path();
    let seen = camera_images::read(&folder).map_err(|source| ReportError::CameraImage {
        path: folder.join(camera_images::FILE),
        source,
    })?;
    let mut page = page.section("Camera images");
    if seen.is_empty() {
        return Ok(page.text(
            "There is no image beside the bundle; `paws-reconstruct run` with the same hand-off and --out adds them.",
        ));
    }
    page = page.text(
        "The first and the last frame, the key frame in the middle, and the least sharp of the examined key frames. \
         Sharpness is the mean difference between a pixel and its neighbours, in grey levels of 255.",
    );
    for of_camera in seen.chunk_by(|a, b| a.camera == b.camera) {
        let images: Vec<Image> = of_camera.iter().map(camera_image).collect();
        page = page.heading(&of_camera[0].camera).images(&images);
    }
    Ok(page)
}

fn camera_image(seen: &camera_images::CameraImage) -> Image {
    let caption = format!(
        "{}: {:.1} s, frame {}, {} eye; sharpness {:.1}, brightness {:.0}, {:.1} % clipped",
        seen.role,
        seen.after_s,
        seen.frame,
        seen.eye,
        seen.sharpness,
        seen.brightness,
        100.0 * seen.clipped
    );
    let name = format!(
        "{}, {}: {} eye at {:.1} s",
        seen.camera, seen.role, seen.eye, seen.after_s
    );
    Image::jpeg_base64(&seen.jpeg, &name, &caption)
}

fn spans(adjusted: Option<&Trajectory>, causal: Option<&Trajectory>) -> Timeline {
    let kind = |status: Status| match status {
        Status::Tracked => 0,
        Status::Relocalised => 1,
        Status::DeadReckoned => 2,
        Status::Lost => 3,
    };
    let first = |of: &Trajectory| of.poses().first().map(|p| p.time_ns);
    let start_ns = adjusted.or(causal).and_then(first).unwrap_or(0);
    let seconds = |ns: i64| (ns - start_ns) as f64 * 1e-9;
    let row = |timeline: Timeline, name: &str, of: &Trajectory| {
        let good = of
            .poses()
            .iter()
            .filter(|p| p.status == Status::Tracked)
            .count();
        let share = 100.0 * good as f64 / of.len().max(1) as f64;
        let spans = of.spans().into_iter().map(|span| Span {
            from: seconds(span.from_ns),
            to: seconds(span.to_ns),
            kind: kind(span.status),
        });
        timeline.row(name, &format!("{share:.1} % tracked"), spans)
    };
    let mut timeline = Timeline::new("Status of poses", Axis::time("time")).kinds([
        "tracked",
        "relocalised",
        "dead reckoned",
        "lost",
    ]);
    for (name, of) in [("offline", adjusted), ("causal", causal)] {
        if let Some(of) = of {
            timeline = row(timeline, name, of);
        }
    }
    timeline
}

fn cloud_section(
    page: Page,
    cloud: Option<&[CloudPoint]>,
    drawn: &trajectory_map::Map<'_>,
    taken_bytes: usize,
) -> Result<Page, ReportError> {
    let page = page.section("Cloud and path");
    let Some(cloud) = cloud.filter(|cloud| !cloud.is_empty()) else {
        return Ok(page.text("There is no point cloud."));
    };
    let steps = drawn.steps;
    let rig_path: Vec<[f64; 3]> = steps.iter().map(|s| s.x_in_world).collect();
    let max_value_m = drawn.largest_m.max(f64::MIN_POSITIVE);
    let dots: Vec<([f64; 3], [u8; 3])> = steps
        .iter()
        .map(|s| {
            (
                s.x_in_world,
                s.value_m.map_or(UNKNOWN, |v| ramp(v / max_value_m)),
            )
        })
        .collect();
    let shown = views::shown(cloud, &rig_path);
    let mut page = viewer_part(page, cloud, &shown, &rig_path, drawn, taken_bytes);
    let views = [
        (
            views::oblique(&shown, &rig_path),
            "from the side",
            format!(
                "From the side, up to {} m around the middle of the path, which is colored as above.",
                views::VIEW_RADIUS_M
            ),
        ),
        (
            views::above(&shown, &rig_path),
            "from above",
            "From above.".to_owned(),
        ),
    ];
    for (viewpoint, name, caption) in views {
        let Some(viewpoint) = viewpoint else { continue };
        let pixels = point_raster::draw(&shown, views::POINT_SIZE_M, &dots, &viewpoint);
        let caption = format!(
            "{caption} What is higher than {} m above the rig is left out.",
            views::MAX_HEIGHT_M
        );
        let file = png(viewpoint.size, &pixels)?;
        page = page.image(&Image::png(&file, &format!("the cloud {name}"), &caption));
    }
    Ok(page)
}

/// The view in three dimensions, and the part of the cloud that it shows. `taken_bytes` of text are
/// taken by the scene of Gaussians.
fn viewer_part(
    page: Page,
    cloud: &[CloudPoint],
    shown: &[CloudPoint],
    rig_path: &[[f64; 3]],
    drawn: &trajectory_map::Map<'_>,
    taken_bytes: usize,
) -> Page {
    let top = rig_path
        .iter()
        .map(|x| x[2])
        .fold(f64::NEG_INFINITY, f64::max);
    let viewer = viewer::viewer(&viewer::Content {
        points: cloud,
        steps: drawn.steps,
        truth: drawn.truth,
        largest_m: drawn.largest_m,
        what: drawn.caption,
        view: views::first(shown, rig_path),
        top_m: match top.is_finite() {
            true => top + views::MAX_HEIGHT_M,
            false => f64::MAX,
        },
        max_bytes: viewer::MAX_BYTES.saturating_sub(taken_bytes),
    });
    let all = cloud.len();
    let share = 100.0 * viewer.points as f64 / all as f64;
    page.text(&format!(
        "{} of {all} points ({share:.1} %) are in this view. Drag to rotate, with two fingers, shift or the right button to move; \
         pinch or turn the wheel after a click to zoom; or use the arrow keys, + and -.",
        viewer.points
    ))
    .embed(&viewer.html)
}

fn stages_section(page: Page, scene: &Scene) -> Result<Page, ReportError> {
    let folder = scene.path();
    let made = stage_timings::read(&folder).map_err(|source| ReportError::StageTimings {
        path: folder.join(stage_timings::FILE),
        source,
    })?;
    let outputs = &scene.manifest().outputs;
    let mut table = Table::new(["stage", "version", "time", "peak memory", "outputs"]);
    let mut said = Vec::new();
    for stage in stages::NAMES {
        let of_stage: Vec<_> = outputs.iter().filter(|(_, o)| o.stage == stage).collect();
        let Some((_, first)) = of_stage.first() else {
            table = table.row([
                stage.into(),
                "".into(),
                "".into(),
                "".into(),
                "nothing".into(),
            ]);
            continue;
        };
        let took = made.iter().find(|m| m.stage == stage);
        let memory = took.and_then(|m| m.peak_bytes);
        let unknown = || "not known".to_owned();
        let names: Vec<&str> = of_stage.iter().map(|(name, _)| name.as_str()).collect();
        table = table.row([
            stage.into(),
            Cell::number(first.stage_version),
            Cell::number(took.map_or_else(unknown, |m| format!("{:.1} s", m.seconds))),
            Cell::number(memory.map_or_else(unknown, |b| format!("{:.0} MB", b as f64 * 1e-6))),
            names.join(", ").into(),
        ]);
        for (name, _) in &of_stage {
            let report = pipeline::report_of(scene, name)?;
            said.extend(report.notes.into_iter().map(|note| (stage, "note", note)));
            said.extend(report.losses.into_iter().map(|loss| (stage, "lost", loss)));
        }
    }
    let mut page = page.section("Stages").table(&table);
    for (name, input) in scene.manifest().outdated() {
        page = page.text(&format!(
            "{name} is out of date: {input} was recomputed since. This output does not belong to the rest; run the later \
             stages again."
        ));
    }
    if !said.is_empty() {
        let rows = said
            .into_iter()
            .fold(Table::new(["stage", "", ""]), |table, row| {
                let (stage, kind, sentence) = row;
                table.row([stage.into(), kind.into(), sentence.into()])
            });
        page = page.table(&rows);
    }
    Ok(page)
}

fn summary(
    evaluation: Option<&Evaluation>,
    cloud: Option<&[CloudPoint]>,
    ground: &Ground<'_>,
) -> String {
    let off = match evaluation.map(|e| e.absolute.as_ref()) {
        None => "no ground truth".to_owned(),
        Some(None) => "not comparable with ground truth".to_owned(),
        Some(Some(absolute)) => format!(
            "ATE {} (root mean square), at most {}",
            si(absolute.translation_m.rmse, "m"),
            si(absolute.translation_m.max, "m")
        ),
    };
    let off = match evaluation {
        Some(e) => format!("{off}, {:.1} % complete", 100.0 * e.completion.share),
        None => off,
    };
    format!(
        "{off}, {} points{}",
        cloud.map_or(0, <[_]>::len),
        ground.summary()
    )
}
