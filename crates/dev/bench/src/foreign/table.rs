//! The results as a page.

use std::fmt::Write as _;

use serde_json::Value;

use crate::stamp;
use crate::trajectory_errors::{HEAD, RULE, columns};

pub(super) fn table(report: &Value) -> String {
    let rendering = &report["rendering"];
    let mut text = format!(
        "# Images of a foreign renderer\n\n\
         {} stereo pairs of one walk, rendered by Mitsuba {} ({}), {} samples per pixel, {} s per image. No image is ours, none is real.\n\n\
         {}.\n\n",
        report["pairs"],
        rendering["mitsuba"].as_str().unwrap_or_default(),
        rendering["variant"].as_str().unwrap_or_default(),
        rendering["samples"],
        rendering["seconds_per_image"],
        stamp::line(&report["stamp"]),
    );
    odometry(&mut text, &report["odometry"]);
    depth(&mut text, &report["depth"]);
    calibration(&mut text, &report["calibration"]);
    text
}

fn rows(of: &Value) -> impl Iterator<Item = &Value> {
    of.as_array().into_iter().flatten()
}

fn odometry(text: &mut String, of: &Value) {
    let _ = write!(
        text,
        "## Odometry\n\n\
         NEES is over its dimensions, 1 is right; *silently wrong* are tracked poses beyond three stated sigmas.\n\n\
         | preset | | right eye, ° | poses | {HEAD} |\n|---|---|---|---|{RULE}|\n"
    );
    for row in rows(of) {
        for poses in ["causal", "adjusted"] {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {poses} | {} |",
                row["preset"].as_str().unwrap_or_default(),
                row["imu"].as_str().unwrap_or_default(),
                row["right_eye_deg"],
                columns(&row[poses]),
            );
        }
    }
}

fn depth(text: &mut String, of: &Value) {
    let race = &of["race"];
    let points: Vec<&Value> = rows(&race["points"]).collect();
    let not_beaten: Vec<&str> = rows(&race["not_beaten"])
        .filter_map(Value::as_str)
        .collect();
    let theirs = points.iter().filter(|p| p["kind"] != "ours").count();
    let _ = write!(
        text,
        "\n## Depth\n\n\
         {} pairs with true disparities; OpenCV {}, two threads. Pixels without a surface, of the glass pane, and hidden from the right eye are left out. \
         One of OpenCV's {theirs} is *beaten* if one of ours takes no longer and has a smaller bad-2 at its density: {} are{}.\n\n\
         ![bad or absent pixels over time](foreign-depth-time.svg)\n\n\
         ![bad-2 over density](foreign-depth-density.svg)\n\n\
         Of each mode the one with the smallest bad-2:\n\n\
         | matcher | ms | density | bad-1, % | bad-2, % | bad-2 or absent, % |\n|---|---|---|---|---|---|\n",
        race["frames"],
        race["opencv"].as_str().unwrap_or_default(),
        theirs - not_beaten.len(),
        match not_beaten.is_empty() {
            true => String::new(),
            false => format!(" (not: {})", not_beaten.join(", ")),
        },
    );
    let number = |value: &Value, by: f64, digits: usize| {
        let value = value.as_f64();
        value.map_or(String::new(), |v| format!("{:.digits$}", by * v))
    };
    let presets = points.iter().filter(|p| {
        ["fast", "balanced", "accurate"].contains(&p["name"].as_str().unwrap_or_default())
    });
    // Settings of a mode are not neighbors.
    let mut kinds: Vec<&Value> = Vec::new();
    for kind in points.iter().map(|p| &p["kind"]) {
        if *kind != "ours" && !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    let bad = |p: &Value| p["bad_2"].as_f64().unwrap_or(f64::INFINITY);
    let best = kinds.iter().filter_map(|kind| {
        let own = points.iter().filter(|p| p["kind"] == **kind);
        own.min_by(|a, b| bad(a).total_cmp(&bad(b)))
    });
    for point in presets.chain(best) {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} |",
            point["name"].as_str().unwrap_or_default(),
            number(&point["ms"], 1.0, 1),
            number(&point["density"], 1.0, 3),
            number(&point["bad_1"], 100.0, 2),
            number(&point["bad_2"], 100.0, 2),
            number(&point["bad_2_or_absent"], 100.0, 1),
        );
    }
    text.push_str(
        "\nErrors within two stated sigmas; quarters are of the stated sigmas, the smallest first:\n\n\
         | preset | within two sigmas, % | in each quarter, % | median sigma, px |\n|---|---|---|---|\n",
    );
    for row in rows(&of["coverage"]) {
        let quarters = rows(&row["within_by_quarter"]).map(|q| number(q, 100.0, 0));
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} |",
            row["matcher"].as_str().unwrap_or_default(),
            number(&row["within_two_sigmas"], 100.0, 1),
            quarters.collect::<Vec<_>>().join(" / "),
            number(&row["median_sigma_px"], 1.0, 3),
        );
    }
}

fn calibration(text: &mut String, of: &Value) {
    text.push_str(
        "\n## Check of the calibration\n\n\
         Nominal calibration with the right eye rotated about y.\n\n\
         | right eye, ° | parameter | decision | finding |\n|---|---|---|---|\n",
    );
    for row in rows(of) {
        for finding in rows(&row["findings"]) {
            let word = |key: &str| finding[key].as_str().unwrap_or_default().to_owned();
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} |",
                row["right_eye_deg"],
                word("parameter").replace('_', " "),
                word("status"),
                word("text"),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn each_mode_of_opencv_has_one_row() {
        let point = |name: &str, kind: &str, bad_2: f64| json!({ "name": name, "kind": kind, "bad_2": bad_2 });
        let points = [
            point("fast", "ours", 0.01),
            point("BM 5", "BM", 0.04),
            point("SGBM 5", "SGBM", 0.02),
            point("BM 9", "BM", 0.03),
            point("SGBM 9", "SGBM", 0.05),
        ];
        let mut text = String::new();
        depth(&mut text, &json!({ "race": { "points": points } }));
        let rows: Vec<&str> = text
            .lines()
            .filter_map(|line| line.strip_prefix("| "))
            .collect();
        let names: Vec<&str> = rows
            .iter()
            .filter_map(|row| row.split(" |").next())
            .collect();
        assert_eq!(names, ["matcher", "fast", "BM 9", "SGBM 5", "preset"]);
    }
}
