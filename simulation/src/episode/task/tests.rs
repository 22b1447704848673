use super::*;

#[test]
fn spl_of_hand_made_paths() {
    // Shortest path 4 m. Walked 4 m, 5 m, 8 m with success; 3 m without, half of it covered.
    for (covered, length, expected) in [
        (1.0, 4.0, 1.0),
        (1.0, 5.0, 0.8),
        (1.0, 8.0, 0.5),
        (0.0, 3.0, 0.0),
        (0.5, 3.0, 0.5),
        (0.5, 8.0, 0.25),
    ] {
        let found = weighted_by_path_length(covered, 4.0, length);
        assert!(
            (found - expected).abs() < 1e-12,
            "{covered} {length}: {found}"
        );
    }
    // The start is the goal.
    assert_eq!(weighted_by_path_length(1.0, 0.0, 0.0), 1.0);
}

#[test]
fn commands_change_at_their_interval_and_stay_in_range() {
    let config = TaskConfig::default();
    let mut last = config.command(3, 1, 0.0);
    let mut changes = 0;
    for step in 1..2000 {
        let command = config.command(3, 1, f64::from(step) * 0.1);
        changes += usize::from(command != last);
        last = command;
        assert!((config.command_m_s[0]..=config.command_m_s[1]).contains(&command[0]));
        assert!((config.command_rad_s[0]..=config.command_rad_s[1]).contains(&command[1]));
    }
    assert_eq!(changes, 49);
}

#[test]
fn ranges_that_descend_are_refused() {
    let config = TaskConfig {
        goal_distance_m: [5.0, 1.0],
        ..TaskConfig::default()
    };
    let error = config.check().unwrap_err().to_string();
    assert!(error.contains("task.goal_distance_m"), "{error}");
}
