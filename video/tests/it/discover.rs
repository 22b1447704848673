//! Trial encodes on this machine.

use crate::elements;
use video::discover::{Choice, TrialError, best_encoder, best_encoder_at, trial};
use video::encoder::known_elements;

#[test]
fn installed_encoders_pass_their_trial() {
    for element in elements() {
        // The second size has rows that need padding.
        for (width, height) in [(320, 96), (362, 94)] {
            let trial = trial(element, width, height).unwrap();
            assert_eq!(trial.element, element);
            assert_eq!(Some(trial.codec), video::encoder::element_codec(element));
            assert!(trial.pictures_per_s > 0.0);
        }
    }
}

#[test]
fn what_does_not_work_says_why() {
    assert_eq!(trial("no-such-encoder", 320, 96), Err(TrialError::Missing));
    assert!(matches!(
        trial("x264enc", 321, 96),
        Err(TrialError::Size(_))
    ));
    // Flatter than x265 can do.
    assert!(matches!(
        trial("x265enc", 8192, 16),
        Err(TrialError::Encode(_))
    ));
}

#[test]
fn the_best_encoder_is_the_first_that_passes() {
    let choice = best_encoder(320, 96).unwrap();
    let order: Vec<&str> = known_elements().collect();
    let passed_over: Vec<&str> = choice
        .refused
        .iter()
        .map(|(element, _)| &**element)
        .collect();
    assert_eq!(passed_over, order[..passed_over.len()]);
    assert_eq!(choice.trial.element, order[passed_over.len()]);
}

#[test]
fn without_a_working_encoder_every_reason_is_told() {
    let none = best_encoder(161, 64).unwrap_err();
    let named: Vec<&str> = none.refused.iter().map(|(element, _)| &**element).collect();
    assert_eq!(named, known_elements().collect::<Vec<_>>());
    assert!(none.to_string().contains("x264enc: "), "{none}");
}

#[test]
fn if_all_are_too_slow_the_fastest_is_taken() {
    let Choice { trial, refused } = best_encoder_at(160, 64, 2, 1e9).unwrap();
    assert_eq!(refused.len() + 1, known_elements().count());
    for (element, reason) in refused {
        assert_ne!(element, trial.element);
        if let TrialError::Slow { found, needed } = reason {
            assert_eq!(needed, 1_000_000_000);
            assert!(f64::from(found) <= trial.pictures_per_s, "{element}");
        }
    }
}
