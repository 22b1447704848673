use super::*;

const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];

#[test]
fn fault_file_round_trips() {
    let text = "[[fault]]\nkind = \"dropped\"\nstrength = 0.5\nfrom = 2\nto = 4\ncamera = \"feet\"\n\n\
                [[fault]]\nkind = \"clock_step\"\nstrength = -0.25\n";
    let faults = Faults::parse(text, &CAMERAS, 7).unwrap();
    assert_eq!(faults.list.len(), 2);
    let feet = faults.of("feet");
    assert_eq!(feet.strength(Kind::Dropped, 1.9), 0.0);
    assert_eq!(feet.strength(Kind::Dropped, 2.0), 0.5);
    assert_eq!(feet.strength(Kind::Dropped, 4.0), 0.0);
    let shoulder = faults.of("left_shoulder");
    assert_eq!(shoulder.strength(Kind::Dropped, 3.0), 0.0);
    assert_eq!(feet.of_kind(Kind::ClockStep).count(), 1);
    let hits = (0..1000).filter(|&n| feet.hits(Kind::Dropped, n, 3.0));
    assert!((420..580).contains(&hits.count()));
    let again = Faults::parse(&faults.to_toml(), &CAMERAS, 7);
    assert_eq!(again.unwrap(), faults);
}

#[test]
fn invalid_fault_file_is_rejected_with_all_problems() {
    let text = "[[fault]]\nkind = \"rain\"\nstrength = 1\n\
                [[fault]]\nkind = \"dropped\"\nstrength = 1.5\nfrom = 3\nto = 2\n\
                [[fault]]\nkind = \"disconnect\"\nstrength = 1\nto = 2\ncamera = \"hat\"\n";
    let message = Faults::parse(text, &CAMERAS, 1).unwrap_err().to_string();
    for part in [
        "5 problems",
        "fault 1: kind is \"rain\", expected one of dropped, late",
        "fault 2: strength of dropped is 1.5, expected 0 to 1 (share of frames)",
        "fault 2: to is 2 s, expected a time after 3 s",
        "fault 3: to is given, but disconnect lasts",
        "fault 3: camera is \"hat\", expected one of left_shoulder, right_shoulder, feet",
    ] {
        assert!(message.contains(part), "{part:?} not in\n{message}");
    }
    let message = Faults::parse("[[fault]]\nkind = \"dropped\"\nsize = 1", &CAMERAS, 1);
    assert!(message.unwrap_err().to_string().contains("size"));
}

#[test]
fn random_schedules_are_valid() {
    let mut kinds = std::collections::BTreeSet::new();
    for seed in 0..200 {
        let faults = Faults::random(seed, &Kind::ALL, &CAMERAS, 60.0);
        assert!((1..=8).contains(&faults.list.len()));
        kinds.extend(faults.list.iter().map(|f| f.kind));
        let again = Faults::parse(&faults.to_toml(), &CAMERAS, seed);
        assert_eq!(again.unwrap(), faults);
    }
    assert_eq!(kinds.len(), Kind::ALL.len());
}
