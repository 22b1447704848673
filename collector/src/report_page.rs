//! The HTML report: one self-contained page with verdict, reasons, contents and charts of a
//! session.

use charts::{Cell, Page, REPORT_HEIGHT as HEIGHT, Table, Verdict as Badge};
use console_output::text;
use session_archive::handoff::{HandOff, Verdict};
use session_archive::manifest::Manifest;
use session_health::{Finding, Limit, Limits, Unit, reasons};

use crate::camera_images;
use crate::condition::Condition;
use crate::ground_truth::GroundTruth;
use crate::loss::CameraLoss;
use crate::plots::{LOW, Plots};
use crate::session_validation::ValidatedSession;
use crate::validation::Validation;
use crate::verdict_change;

/// The report of a validated session.
pub fn html(validated: &ValidatedSession, limits: &Limits) -> String {
    let manifest = validated.reader.manifest();
    let validation = &validated.validation;
    let plots = Plots::new(manifest, &validated.found);
    let mut page = Page::new(&title(manifest)).verdict(badge(validation.verdict));
    page = verdict(page, validation);
    page = handed_over(page, validated);
    page = page.table(&overview(manifest, validation));
    page = page.timeline(&plots.timeline(), "");
    page = losses_and_events(page, manifest, validation);
    page = camera_images::section(page, &validated.reader, validation.summary.start.0);

    page = page.section("Cameras");
    let cameras: Vec<&str> = manifest.cameras.iter().map(|c| c.name.as_str()).collect();
    page = page.table(&matrix(validation, limits, &cameras));
    page = page.chart(&plots.frame_intervals(), HEIGHT, &plots.rhythm_caption());
    page = page.chart(&plots.frame_histogram(), HEIGHT, "");
    if manifest.cameras.len() > 1 {
        let summary = &validation.summary;
        let sets = format!(
            "{}, {} of them with a frame of every camera",
            text::count(summary.frame_sets, "frame set"),
            summary.complete_sets
        );
        page = page.chart(&plots.set_errors(), HEIGHT, &sets);
        if let Some(errors) = plots.trigger_errors() {
            page = page.chart(&errors, HEIGHT, "");
        }
    }
    page = page.chart(&plots.bitrates(), HEIGHT, "");

    if !manifest.imus.is_empty() {
        page = page.section("IMUs");
        let imus: Vec<&str> = manifest.imus.iter().map(|i| i.name.as_str()).collect();
        page = page.table(&matrix(validation, limits, &imus));
        page = page.chart(&plots.imu_intervals(), HEIGHT, "");
    }

    if let Some(truth) = GroundTruth::read(&validated.reader) {
        let stats = &validated.found.stats;
        page = page.section("Comparison with ground truth");
        page = page.text(
            "This rig was simulated, and the session contains its ground truth. No verdict depends on it.",
        );
        for note in &truth.notes {
            page = page.text(note);
        }
        page = page.table(&truth.table(manifest, stats));
        page = page.chart(&truth.time_errors(manifest, stats), HEIGHT, "");
        page = page.drawing(|width| truth.map(stats, width), "");
    }

    page = page.section("Session, rig and clocks");
    page = page.table(&others(validation, limits, manifest));
    if !validated.found.stats.clocks.is_empty() {
        page = page.chart(&plots.clock_offsets(), HEIGHT, "");
        page = page.chart(&plots.clock_sigmas(), HEIGHT, "");
    }

    if !validated.found.stats.health.is_empty() {
        page = page.section("The recorder");
        page = page.chart(&plots.health_rates(), HEIGHT, "");
        page = page.chart(&plots.health_queues(), HEIGHT, "");
        page = page.chart(&plots.health_latency(), HEIGHT, "");
        page = page.chart(&plots.health_space(), LOW, "");
        if let Some(temperature) = plots.health_temperature() {
            page = page.chart(&temperature, LOW, "");
        }
    }

    page = page.section("Limits and where they come from");
    page = page.table(&sources(limits));
    page.to_html()
}

fn badge(verdict: Verdict) -> Badge {
    match verdict {
        Verdict::Pass => Badge::Pass,
        Verdict::Warn => Badge::Warn,
        Verdict::Fail => Badge::Fail,
    }
}

fn title(manifest: &Manifest) -> String {
    let time = manifest.started_civil.to_string();
    let (day, clock) = time.split_once('T').unwrap_or((&time, ""));
    let clock = clock.get(..5).unwrap_or(clock);
    match manifest.name.as_str() {
        "" => format!("Session of {day} {clock} UTC"),
        name => format!("Session \u{201c}{name}\u{201d} of {day} {clock} UTC"),
    }
}

/// The verdict and its meaning.
fn verdict(mut page: Page, validation: &Validation) -> Page {
    let reasons = reasons(&validation.findings);
    let metrics = text::count(validation.findings.len() as u64, "metric");
    if reasons.is_empty() {
        return page.text(&format!(
            "Fit for use: all of {metrics} within their limits."
        ));
    }
    let words = match validation.verdict {
        Verdict::Fail => "Not fit for use as it is",
        _ => "Usable, with warnings",
    };
    page = page.text(&format!(
        "{words}: {} of {metrics} beyond their limits.",
        reasons.len()
    ));
    for finding in reasons {
        page = page.finding(badge(finding.verdict), &finding.text);
    }
    page
}

/// The hand-off, its verdict and accepted failures.
fn handed_over(page: Page, validated: &ValidatedSession) -> Page {
    let Ok(handoff) = HandOff::read(&**validated.reader.storage()) else {
        return page;
    };
    let now = validated.validation.verdict;
    let change = verdict_change::hand_off_note(&handoff, now, &handoff.session_id);
    let notes = handoff.notes().into_iter().chain(change);
    let (sealed, verdict) = (handoff.sealed, handoff.verdict);
    let page = page.text(&format!("Handed over on {sealed} as {verdict}."));
    notes.fold(page, |page, note| {
        page.finding(badge(verdict), &format!("Hand-off: {note}"))
    })
}

fn overview(manifest: &Manifest, validation: &Validation) -> Table {
    let summary = &validation.summary;
    let mut table = Table::new::<&str>([]);
    let mut row = |name: &str, value: String| {
        table = std::mem::replace(&mut table, Table::new::<&str>([]))
            .row([Cell::from(name), Cell::from(value)]);
    };
    let length = summary.end.since(summary.start);
    row("Length", text::duration(length));
    for (i, camera) in manifest.cameras.iter().enumerate() {
        let stream = &summary.streams[i];
        let seconds = (length.max(1)) as f64 / 1e9;
        row(
            &format!("Camera {}", camera.name),
            format!(
                "{} frames of {}\u{d7}{} at {:.2} Hz, {}, {}, {}",
                stream.samples,
                camera.width,
                camera.height,
                stream.rate_hz,
                camera.codec,
                charts::si(stream.bytes as f64 * 8.0 / seconds, "bit/s"),
                camera.source,
            ),
        );
    }
    for (i, imu) in manifest.imus.iter().enumerate() {
        let stream = &summary.streams[manifest.cameras.len() + i];
        row(
            &format!("IMU {}", imu.name),
            format!(
                "{} samples at {:.2} Hz, {}",
                stream.samples, stream.rate_hz, imu.source
            ),
        );
    }
    let condition = match Condition::of(manifest.state, &validation.report) {
        Condition::Ok => "closed by the recorder, every checksum right",
        Condition::Recovered => "recovered from a damaged session, every checksum right",
        Condition::Unclosed => "cut off while it was recorded; complete up to the cut",
        Condition::Damaged | Condition::Unverified => "damaged",
    };
    let segments = text::count(validation.basis.segments.len() as u64, "segment");
    row(
        "Archive",
        format!(
            "{}, {segments}, {}, {condition}",
            text::bytes(validation.report.bytes),
            text::count(validation.report.messages, "message")
        ),
    );
    let decoded = if validation.deep {
        "; every image was decoded"
    } else {
        ""
    };
    let rig: Vec<&str> = manifest.rig.iter().map(|f| f.name.as_str()).collect();
    if !rig.is_empty() {
        row("Rig files", rig.join(", "));
    }
    row("Recorded by", manifest.software.clone());
    row("Validated by", format!("{}{decoded}", validation.software));
    row("Identifier", manifest.session_id.clone());
    table
}

fn losses_and_events(mut page: Page, manifest: &Manifest, validation: &Validation) -> Page {
    let summary = &validation.summary;
    if !manifest.cameras.is_empty() {
        page = page.table(&frames_lost(manifest, validation));
    }
    if !summary.losses.is_empty() {
        let mut table = Table::new(["Stream", "Missing because of", "Samples", "Gaps"]);
        for loss in &summary.losses {
            table = table.row([
                Cell::from(loss.stream.clone()),
                Cell::from(loss.cause.clone()),
                Cell::number(loss.samples),
                Cell::number(loss.gaps),
            ]);
        }
        page = page.table(&table);
    }
    if !summary.events.is_empty() {
        let mut table = Table::new(["Time", "Event", "From", ""]);
        for event in &summary.events {
            table = table.row([
                Cell::number(format!("{:.2} s", event.after_ns as f64 / 1e9)),
                Cell::from(event.kind.clone()),
                Cell::from(event.source.clone()),
                Cell::from(event.text.clone()),
            ]);
        }
        page = page.table(&table);
        if summary.more_events > 0 {
            page = page.text(&format!("and {} more events", summary.more_events));
        }
    }
    page
}

/// Missing frames of each camera, as a fraction with causes.
fn frames_lost(manifest: &Manifest, validation: &Validation) -> Table {
    let heads = ["Camera", "Frames expected", "Lost", "Share", "Because of"];
    let losses = CameraLoss::of(manifest, &validation.summary);
    losses.iter().fold(Table::new(heads), |table, loss| {
        table.row([
            Cell::from(loss.camera.clone()),
            Cell::number(loss.expected),
            Cell::number(loss.lost),
            Cell::number(text::percent(loss.lost, loss.expected)),
            Cell::from(loss.why()),
        ])
    })
}

/// Metrics in rows, streams in columns: measured values, with the verdict of those beyond a limit.
fn matrix(validation: &Validation, limits: &Limits, streams: &[&str]) -> Table {
    let mut heads = vec!["Metric".to_owned()];
    heads.extend(streams.iter().map(|s| (*s).to_owned()));
    heads.extend(["Warns above".to_owned(), "Fails above".to_owned()]);
    let mut table = Table::new(heads);
    for limit in limits.rows() {
        let of = |stream: &&str| {
            let mut findings = validation.findings.iter();
            findings.find(|f| f.metric == limit.metric && f.of == *stream)
        };
        let findings: Vec<Option<&Finding>> = streams.iter().map(of).collect();
        let Some(example) = findings.iter().flatten().next() else {
            continue;
        };
        let mut cells = vec![Cell::from(limit.title)];
        cells.extend(
            findings
                .iter()
                .map(|f| f.map_or(Cell::from(""), |f| value(f, limit))),
        );
        cells.extend([example.warn, example.fail].map(|l| bound(l, limit)));
        table = table.row(cells);
    }
    table
}

/// Findings that do not belong to one camera or IMU.
fn others(validation: &Validation, limits: &Limits, manifest: &Manifest) -> Table {
    let mut table = Table::new(["Metric", "Of", "Measured", "Warns above", "Fails above"]);
    for finding in &validation.findings {
        let named = |name: &String| *name == finding.of;
        let cameras = manifest.cameras.iter().map(|c| &c.name);
        let mut streams = cameras.chain(manifest.imus.iter().map(|i| &i.name));
        let (false, Some(limit)) = (streams.any(named), limits.of(&finding.metric)) else {
            continue;
        };
        table = table.row([
            Cell::from(limit.title),
            Cell::from(finding.of.clone()),
            value(finding, limit),
            bound(finding.warn, limit),
            bound(finding.fail, limit),
        ]);
    }
    table
}

fn value(finding: &Finding, limit: &Limit) -> Cell {
    let value = limit.unit.show(finding.value);
    match finding.verdict {
        Verdict::Pass => Cell::number(value),
        verdict => Cell::number(format!("{verdict} {value}")),
    }
}

fn bound(limit: Option<f64>, row: &Limit) -> Cell {
    if row.unit == Unit::Flag && limit.is_some() {
        return Cell::number("if so");
    }
    Cell::number(limit.map_or("\u{2013}".to_owned(), |l| row.unit.show(l)))
}

fn sources(limits: &Limits) -> Table {
    let mut table = Table::new(["Metric", "Source"]);
    for limit in limits.rows() {
        let kind = limit.metric.split('.').next().unwrap_or_default();
        table = table.row([
            Cell::from(format!("{kind}: {}", limit.title)),
            Cell::from(limit.source.to_string()),
        ]);
    }
    table
}
