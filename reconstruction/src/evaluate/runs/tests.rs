use super::*;
use crate::evaluate::{Absolute, Statistics};
use crate::evaluate::{Completion, Counts};

fn run(name: &str, rmse: Option<f64>, completion: f64) -> Run {
    let statistics = |rmse: f64| Statistics::of(vec![rmse]).expect("one");
    Run {
        name: name.to_owned(),
        evaluation: Evaluation {
            poses: Counts::default(),
            matched: 10,
            path_m: 20.0,
            true_from_estimated: None,
            absolute: rmse.map(|rmse| Absolute {
                translation_m: statistics(rmse),
                rotation_rad: Some(statistics(0.01)),
            }),
            relative: Vec::new(),
            completion: Completion {
                share: completion,
                truth_s: 10.0,
                gaps: Vec::new(),
            },
            consistency: None,
        },
        cost: Cost {
            seconds: Some(3.0),
            peak_bytes: None,
        },
    }
}

#[test]
fn complete_runs_have_a_mean_and_the_largest_error_is_the_worst() {
    let runs = vec![run("a", Some(0.1), 1.0), run("b", Some(0.3), 0.96)];
    let runs = Runs::new(runs, 0.95);
    assert_eq!((runs.lost, runs.worst.as_deref()), (0, Some("b")));
    let mean = runs.mean.expect("a mean");
    assert!((mean.translation_rmse_m - 0.2).abs() < 1e-15);
    assert!((mean.completion - 0.98).abs() < 1e-15);
    let table = runs.table();
    assert!(
        table.ends_with("worst: b; mean of 2: ATE 0.2000 m, rotation 0.573 deg, complete 98.0 %\n")
    );
}

#[test]
fn a_lost_run_removes_the_mean_and_is_the_worst() {
    let runs = vec![
        run("a", Some(9.0), 1.0),
        run("b", Some(0.001), 0.5),
        run("c", Some(0.002), 0.7),
        run("d", Some(0.002), 0.95),
    ];
    let runs = Runs::new(runs, 0.95);
    assert_eq!(
        (runs.lost, runs.worst.as_deref(), runs.mean),
        (2, Some("b"), None)
    );
    let table = runs.table();
    assert!(
        table.contains("b (lost)") && table.contains("c (lost)"),
        "{table}"
    );
    assert!(!table.contains("d (lost)"), "{table}");
    assert!(
        table.ends_with("worst: b; mean: none, lost 2 of 4\n"),
        "{table}"
    );
    // A run without pairs is lost, whatever its completion.
    let nothing = Runs::new(vec![run("a", None, 1.0)], 0.95);
    assert_eq!((nothing.lost, nothing.mean), (1, None));
    assert!(nothing.table().contains("lost 1 of 1"));
}

#[test]
fn rows_have_error_time_memory_and_completion() {
    let mut whole = run("walk", Some(0.0123), 0.999);
    whole.cost.peak_bytes = Some(250_000_000);
    let runs = Runs::new(vec![whole], 0.95);
    let table = runs.table();
    let lines: Vec<&str> = table.lines().collect();
    let [head, row, last] = lines[..] else {
        panic!("{table}");
    };
    for (title, cell) in [
        ("ATE m", "0.0123"),
        ("complete", "99.9 %"),
        ("time s", "3.0"),
        ("memory MB", "250"),
    ] {
        let end = head.find(title).expect("a column") + title.len();
        assert!(row[..end].ends_with(cell), "{title}\n{table}");
    }
    assert!(last.starts_with("ATE 0.0123 m"), "{table}");
}
