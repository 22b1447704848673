use super::*;

#[test]
fn terminations_come_first_alone_and_in_pairs() {
    let configs = [false, true].map(|terminates| EndConfig {
        left_map_terminates: terminates,
        unknown_ground_terminates: terminates,
        ..EndConfig::default()
    });
    for config in configs {
        for a in EndReason::BY_PRECEDENCE {
            assert_eq!(config.choose(|reason| reason == a), a);
            assert_eq!(EndReason::from_code(a as i8), Some(a));
            for b in EndReason::BY_PRECEDENCE {
                let chosen = config.choose(|reason| reason == a || reason == b);
                assert!(chosen == a || chosen == b);
                assert_eq!(
                    config.terminates(chosen),
                    config.terminates(a) || config.terminates(b)
                );
            }
        }
        assert_eq!(config.choose(|_| false), EndReason::None);
    }
    assert_eq!(EndReason::from_code(9), None);
}

#[test]
fn codes_from_ten_on_truncate() {
    let config = EndConfig::default();
    for reason in EndReason::BY_PRECEDENCE {
        assert_eq!(config.terminates(reason), (reason as i8) < 10);
    }
}

#[test]
fn all_reasons_are_there_by_code_with_a_name_of_their_own() {
    let codes = EndReason::ALL.map(|reason| reason as i8);
    assert!(codes.windows(2).all(|pair| pair[0] < pair[1]), "{codes:?}");
    for reason in EndReason::BY_PRECEDENCE {
        assert!(EndReason::ALL.contains(&reason));
        let same = EndReason::ALL
            .iter()
            .filter(|other| other.name() == reason.name());
        assert_eq!(same.count(), 1, "{}", reason.name());
    }
    assert_eq!(EndReason::ALL.len(), EndReason::BY_PRECEDENCE.len() + 1);
}

#[test]
fn settings_out_of_range_are_named() {
    let config = EndConfig {
        max_tilt_rad: f64::NAN,
        ..EndConfig::default()
    };
    let error = config.check().unwrap_err().to_string();
    assert!(error.contains("end.max_tilt_rad"), "{error}");
}
