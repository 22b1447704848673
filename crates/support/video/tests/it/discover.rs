//! Trial encodes on this machine.

use crate::elements;
use video::discover::{Load, TrialError, best_encoder, choose, trial};
use video::encoder::{Preset, known_elements};

#[test]
fn installed_encoders_pass_their_trial() {
    for element in elements() {
        // The second size has rows that need padding.
        for (width, height) in [(320, 96), (362, 94)] {
            let trial = trial(element, width, height).unwrap();
            assert_eq!(trial.element, element);
            assert_eq!(Some(trial.codec), video::encoder::element_codec(element));
            assert!(trial.frames_per_s > 0.0);
        }
    }
}

#[test]
fn what_does_not_work_says_why() {
    assert_eq!(trial("no-such-encoder", 320, 96), Err(TrialError::Missing));
    assert!(matches!(trial("x264enc", 0, 96), Err(TrialError::Size(_))));
    // Flatter than x265 can do.
    assert!(matches!(
        trial("x265enc", 8192, 16),
        Err(TrialError::Encode(_))
    ));
}

/// Those that may be chosen without being named, in order of preference.
fn candidates() -> Vec<&'static str> {
    known_elements().filter(|e| *e != "x265enc").collect()
}

#[test]
fn the_best_encoder_is_the_first_that_passes() {
    let choice = best_encoder(320, 96).unwrap();
    let order = candidates();
    let passed_over: Vec<&str> = choice
        .refused
        .iter()
        .map(|(element, _)| &**element)
        .collect();
    assert_eq!(passed_over, order[..passed_over.len()]);
    assert_eq!(choice.element, order[passed_over.len()]);
}

#[test]
fn without_a_working_encoder_every_reason_is_listed() {
    let none = best_encoder(16_386, 64).unwrap_err();
    let named: Vec<&str> = none.refused.iter().map(|(element, _)| &**element).collect();
    assert_eq!(named, candidates());
    assert!(none.to_string().contains("x264enc: "), "{none}");
}

/// Regression: the choice once depended on the duration of a trial, and changed while another
/// program ran.
#[test]
fn the_choice_is_a_function_of_what_works_and_of_the_pixel_rate() {
    let load = |rate_hz| Load {
        cameras: vec![(320, 96, rate_hz), (160, 64, rate_hz)],
        threads: 1,
    };
    let chosen = choose(&load(30.0)).unwrap();
    for rate_hz in [1e-3, 30.0, 1000.0] {
        let choice = choose(&load(rate_hz)).unwrap();
        assert_eq!(choice.element, chosen.element, "at {rate_hz} Hz");
        assert_eq!(choice.preset, load(rate_hz).preset());
    }
    assert_eq!(load(1000.0).preset(), Preset::Ultrafast);
    assert!(load(1.0).preset() > Preset::Ultrafast);
}

#[test]
fn one_encoder_serves_every_camera_of_a_session_or_none() {
    let load = Load {
        // The second is of a width that none takes.
        cameras: vec![(320, 96, 30.0), (16_386, 64, 30.0)],
        threads: 1,
    };
    assert_eq!(choose(&load).unwrap_err().refused.len(), candidates().len());
}
