//! Runs with sources that fail.

use std::sync::{Arc, Mutex};

use super::*;
use crate::sources::{AnySource, Sample, Source, SourceError, SourceInfo};
use crate::status::Progress;

/// Delivers a number of samples, then fails.
struct Failing {
    inner: Box<dyn Source>,
    samples: u32,
}

impl Source for Failing {
    fn info(&self) -> &SourceInfo {
        self.inner.info()
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        self.samples = self
            .samples
            .checked_sub(1)
            .ok_or_else(|| SourceError::Unusable {
                source_name: "feet".to_owned(),
                what: "damaged".to_owned(),
            })?;
        self.inner.next_sample()
    }

    fn begin_at(&mut self, start: HostTime) {
        self.inner.begin_at(start);
    }

    fn digest(&self) -> Vec<u8> {
        self.inner.digest()
    }
}

const CAMERAS: [&str; 2] = ["feet", "left_shoulder"];

/// Records the first `cameras` cameras, of which the first one fails after five samples.
fn run(cameras: usize, virtual_time: bool) -> (RecordingSummary, String, Vec<Progress>) {
    let folder = tempfile::tempdir().expect("folder");
    let cameras = CAMERAS[..cameras].iter().map(|name| {
        format!(
            "[[camera]]\nname = {name:?}\nsource = {{ kind = \"synthetic\", width = 128, \
             height = 64, rate_hz = 20, imu_rate_hz = 0 }}\n"
        )
    });
    let text = format!(
        "disk.reserve_gb = 0\nencoder.element = \"x264enc\"\n{}",
        cameras.collect::<String>()
    );
    let config = Config::parse(&text, folder.path()).expect("configuration");
    let options = RecordOptions {
        // In real time the failure comes first, however slow the machine.
        seconds: if virtual_time { 2.0 } else { 600.0 },
        virtual_time,
        name: String::new(),
        out: folder.path().to_owned(),
    };
    let progress: Arc<Mutex<Vec<Progress>>> = Arc::default();
    let into = progress.clone();
    let finished = record_built(
        |start| {
            let mut built = build(&config, start)?;
            let AnySource::Scheduled(inner) = built.sources.remove(0) else {
                panic!("a synthetic camera has a schedule");
            };
            let failing = Box::new(Failing { inner, samples: 5 });
            built.sources.insert(0, AnySource::Scheduled(failing));
            Ok(built)
        },
        &options,
        &StopFlag::new(),
        Box::new(move |p| into.lock().expect("progress").push(p)),
    )
    .expect("recording");
    let manifest =
        std::fs::read_to_string(finished.session.join("session.json")).expect("manifest");
    let progress = progress.lock().expect("progress").clone();
    (finished, manifest, progress)
}

fn check_failed(finished: &RecordingSummary, progress: &[Progress]) {
    let error = "feet cannot be read: damaged";
    assert_eq!(finished.error.as_deref(), Some(error));
    assert!(progress.contains(&Progress::Alarm {
        text: error.to_owned(),
        active: true
    }));
    assert!(
        matches!(progress.last(), Some(Progress::Finished { error: Some(e), .. }) if e == error),
        "{progress:?}"
    );
}

#[test]
fn recording_fails_with_its_only_source() {
    for virtual_time in [false, true] {
        let (finished, manifest, progress) = run(1, virtual_time);
        check_failed(&finished, &progress);
        assert_eq!((finished.stored, finished.missing), (5, 0));
        assert!(manifest.contains("\"closed\""), "{manifest}");
        assert!(manifest.contains("\"sources ended\""), "{manifest}");
    }
}

#[test]
fn recording_continues_without_a_failed_source() {
    let (finished, manifest, progress) = run(2, true);
    check_failed(&finished, &progress);
    assert_eq!(finished.stored, 5 + 40);
    assert!(manifest.contains("\"duration\""), "{manifest}");
}

/// Codec and preset are selected once, by the pixels of all cameras together. Alone, each of these
/// would get another preset.
#[test]
fn cameras_of_different_sizes_share_one_encoder_choice() {
    let folder = tempfile::tempdir().expect("folder");
    let sizes = [(128, 64, 20), (960, 480, 30)];
    let cameras = CAMERAS.iter().zip(sizes).map(|(name, of)| {
        let (width, height, rate_hz) = of;
        format!(
            "[[camera]]\nname = {name:?}\nsource = {{ kind = \"synthetic\", width = {width}, \
             height = {height}, rate_hz = {rate_hz}, imu_rate_hz = 0 }}\n"
        )
    });
    let text = format!("disk.reserve_gb = 0\n{}", cameras.collect::<String>());
    let config = Config::parse(&text, folder.path()).expect("configuration");
    let options = RecordOptions {
        seconds: 0.5,
        virtual_time: true,
        name: String::new(),
        out: folder.path().to_owned(),
    };
    let finished = record(&config, &options, &StopFlag::new(), Box::new(|_| {}));
    let session = finished.expect("recording").session;
    let manifest = std::fs::read(session.join("session.json")).expect("manifest");
    let manifest: serde_json::Value = serde_json::from_slice(&manifest).expect("JSON");
    let cameras = manifest["cameras"].as_array().expect("cameras");
    assert_eq!(cameras.len(), 2);
    for (camera, (width, ..)) in cameras.iter().zip(sizes) {
        assert_eq!(camera["width"], width);
        for key in ["codec", "encoder"] {
            assert!(camera[key].is_string(), "{camera}");
            assert_eq!(camera[key], cameras[0][key]);
        }
    }
}
