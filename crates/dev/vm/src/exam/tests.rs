use super::*;

fn row(time: i64, digest: u64) -> Row {
    Row {
        time,
        sequence: time as u32,
        digest,
    }
}

fn contents(rows: &[Row]) -> Contents {
    Contents {
        messages: [(3, rows.to_vec())].into(),
        order: vec![3; rows.len()],
        ..Contents::default()
    }
}

#[test]
fn anything_else_than_a_beginning_is_found() {
    let whole = contents(&[row(1, 7), row(2, 8), row(3, 9)]);
    for good in [&[][..], &[row(1, 7)], &[row(1, 7), row(2, 8), row(3, 9)]] {
        assert!(is_beginning_of(&contents(good), &whole).is_ok());
    }
    for (bad, says) in [
        (&[row(2, 8)][..], "only the first 0"),
        (&[row(1, 7), row(3, 9)], "only the first 1"),
        (&[row(1, 7), row(2, 0)], "only the first 1"),
        (&[row(1, 7), row(2, 8), row(3, 9), row(4, 1)], "has 3"),
    ] {
        let message = is_beginning_of(&contents(bad), &whole).unwrap_err();
        assert!(message.to_string().contains(says), "{message}");
    }
}

#[test]
fn what_was_promised_must_be_there() {
    let mut whole = contents(&[row(1, 7), row(2, 8), row(3, 9)]);
    whole.messages.insert(4, vec![row(2, 1)]);
    whole.order = vec![3, 4, 3, 3];
    let left = contents(&[row(1, 7), row(2, 8)]);
    let has = |messages| has_the_first(&left, &whole, messages);
    assert!(has(1).is_ok());
    let message = has(2).unwrap_err().to_string();
    assert_eq!(message, "channel 4: 1 messages were promised, 0 are left");
    whole.order = vec![3, 3, 3, 4];
    assert!(has_the_first(&left, &whole, 2).is_ok());
    assert!(has_the_first(&left, &whole, 3).is_err());
}

#[test]
fn lost_is_what_had_been_received() {
    let sample = |time| Sample {
        arrived: time + 5,
        time,
    };
    let whole = Contents {
        samples: [("a".to_owned(), vec![sample(100), sample(200), sample(300)])].into(),
        ..Contents::default()
    };
    let lost = |kept: Option<i64>, now| {
        let newest = kept.map(|kept| ("a".to_owned(), kept));
        whole.lost(&newest.into_iter().collect(), now)["a"]
    };
    assert_eq!(lost(Some(100), 310), 200);
    assert_eq!(lost(Some(100), 304), 100);
    assert_eq!(lost(Some(300), 310), 0);
    assert_eq!(lost(None, 210), 100);
    assert_eq!(lost(None, 50), 0);
}

#[test]
fn no_session_is_fine_until_one_was_reported() {
    let archive = std::env::temp_dir().join(format!("vm-exam-{}", std::process::id()));
    fs::create_dir_all(archive.join("lost+found")).unwrap();
    let promise = |started| Promise {
        started,
        ..Promise::default()
    };
    let scratch = archive.join("scratch");
    let exam = |started| examine(&archive, None, promise(started), &scratch);
    assert_eq!(exam(false).unwrap(), ExamResult::default());
    assert!(exam(true).is_err());
    // Its folder is there, and nothing in it.
    fs::create_dir(archive.join("session")).unwrap();
    assert_eq!(exam(false).unwrap(), ExamResult::default());
    assert!(exam(true).is_err());
    fs::remove_dir_all(&archive).unwrap();
}
