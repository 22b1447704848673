//! Results of `sim_learn` beside their goals, in a line.

use serde_json::{Value, json};

/// Success before and after a training.
pub(super) const SUCCESS: [f64; 2] = [0.10, 0.80];
/// Steps per second, and resets per step.
pub(super) const SPEED: [f64; 2] = [200_000.0, 0.01];
/// Of the return of a policy that sees over random actions, in standard deviations.
const SIGMA: f64 = 5.0;

/// Goals of a part.
pub(super) fn goals(part: &str) -> Value {
    match part {
        "speed" => json!({ "steps_per_s": SPEED[0], "resets_per_step": SPEED[1] }),
        "state" => json!({ "success_before": SUCCESS[0], "success_after": SUCCESS[1] }),
        "images" => json!({ "sigma_over_random": SIGMA, "sigma_over_blind": 0.0 }),
        _ => json!({ "finite_losses": true, "success_after": SUCCESS[1] }),
    }
}

/// A row of a part.
pub(super) fn line(part: &str, row: &Value) -> String {
    let scene = row["scene"].as_str().unwrap_or("?");
    let text = match part {
        "speed" => speed(row),
        "state" => state(row),
        "images" => images(row),
        _ => trainers(row),
    };
    format!("{scene}: {text}")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn percent(value: &Value) -> f64 {
    100.0 * number(value)
}

fn speed(row: &Value) -> String {
    format!(
        "{:.0} steps/s (goal {:.0}), {:.0} per second of processor time, {:.2} % resets (goal \
         {:.0} %), step p50 {:.2} p99 {:.2} ms",
        number(&row["steps_per_s"]),
        SPEED[0],
        number(&row["steps_per_cpu_s"]),
        percent(&row["resets_per_step"]),
        100.0 * SPEED[1],
        number(&row["step_ms"]["p50"]),
        number(&row["step_ms"]["p99"]),
    )
}

fn state(row: &Value) -> String {
    format!(
        "success on unseen goals {:.1} % before (goal below {:.0} %), {:.1} % after {} steps (goal \
         {:.0} %), SPL {:.2}, {:.1} % on goals that were held back; same seed, same curve: {}; \
         {:.0} s, {:.0} s of processor time",
        percent(&row["random"]["success"]),
        100.0 * SUCCESS[0],
        percent(&row["trained"]["success"]),
        row["steps"],
        100.0 * SUCCESS[1],
        number(&row["trained"]["spl"]),
        percent(&row["trained_held_back"]["success"]),
        row["same_seed_same_curve"],
        number(&row["times"][0]["wall_s"]),
        number(&row["times"][0]["cpu_s"]),
    )
}

fn images(row: &Value) -> String {
    let of = |name: &str| {
        format!(
            "{name} {:.1} %, return {:.2}",
            percent(&row[name]["success"]),
            number(&row[name]["return"])
        )
    };
    format!(
        "success {}; {}; {}; sees {:.1} sigma better than random (goal {SIGMA:.0}), {:.1} than \
         blind (goal above 0), after {} steps",
        of("seeing"),
        of("blind"),
        of("random"),
        number(&row["sigma_over_random"]),
        number(&row["sigma_over_blind"]),
        row["steps"],
    )
}

fn trainers(row: &Value) -> String {
    let success = |name: &str| percent(&row[name]["trained"]["success"]);
    format!(
        "success {:.1} % at random, {:.1} % by Stable-Baselines3, {:.1} % by RSL-RL after {} \
         steps; losses of RSL-RL finite: {}; warnings of check_env: {}",
        percent(&row["random"]["success"]),
        success("stable_baselines3"),
        success("rsl_rl"),
        row["steps"],
        row["rsl_rl"]["finite_losses"],
        row["stable_baselines3"]["check_env"]
            .as_array()
            .map_or(0, Vec::len),
    )
}
