//! Losses of each camera and IMU, as fractions with causes.

use std::fmt;
use std::path::Path;

use console_output::text;
use serde::Serialize;
use session_archive::manifest::Manifest;
use session_archive::verify::Report;

use crate::catalogue::newest_report;
use crate::import::ImportRecord;
use crate::validation::{Summary, Validation};

/// Loss of a camera or IMU, known since the import. The causes need a validation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct StreamLoss {
    /// The camera or IMU.
    pub(crate) name: String,
    /// Expected samples: present and missing ones.
    pub(crate) expected: u64,
    /// Samples missing, with or without a gap record.
    pub(crate) missing: u64,
    /// Missing over expected samples, from 0 to 1.
    pub(crate) share: f64,
}

impl StreamLoss {
    /// Losses of every camera and IMU in a report, by name.
    pub(crate) fn of(report: &Report) -> Vec<Self> {
        let streams = report.streams.iter().map(|(name, stream)| {
            let missing = stream.gaps.saturating_add(stream.lost);
            let expected = stream.samples.saturating_add(missing);
            Self {
                name: name.clone(),
                expected,
                missing,
                share: missing as f64 / expected.max(1) as f64,
            }
        });
        streams.collect()
    }

    /// Losses of the session in a folder, by the newest report; empty without a report.
    pub(crate) fn of_folder(folder: &Path) -> Vec<Self> {
        let validation = Validation::read(folder).ok();
        let record = ImportRecord::read(folder);
        newest_report(validation.as_ref(), record.as_ref()).map_or(Vec::new(), Self::of)
    }

    /// Whether it is a camera: names of IMUs contain a slash.
    pub(crate) fn is_camera(&self) -> bool {
        !self.name.contains('/')
    }
}

/// The loss of one camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CameraLoss {
    /// The camera.
    pub(crate) camera: String,
    /// Expected frames: present and missing ones.
    pub(crate) expected: u64,
    /// Frames missing.
    pub(crate) lost: u64,
    /// Causes with counts, the most frequent first; as in `encoder overload`, or `no record`
    /// without a gap record.
    pub(crate) causes: Vec<(String, u64)>,
}

impl CameraLoss {
    /// The loss of every camera of a session, in the order of the manifest.
    pub(crate) fn of(manifest: &Manifest, summary: &Summary) -> Vec<Self> {
        let cameras = manifest.cameras.iter().map(|camera| {
            let mut streams = summary.streams.iter();
            let stream = streams.find(|s| s.name == camera.name);
            let (present, lost) = stream.map_or((0, 0), |s| (s.samples, s.missing));
            let losses = summary.losses.iter().filter(|l| l.stream == camera.name);
            let mut causes: Vec<_> = losses.map(|l| (l.cause.clone(), l.samples)).collect();
            causes.sort_by_key(|(_, frames)| std::cmp::Reverse(*frames));
            Self {
                camera: camera.name.clone(),
                expected: present.saturating_add(lost),
                lost,
                causes,
            }
        });
        cameras.collect()
    }

    /// The causes as text; empty if nothing is missing.
    pub(crate) fn why(&self) -> String {
        let causes = self.causes.iter().filter(|(_, frames)| *frames > 0);
        let causes = causes.map(|(cause, frames)| match self.causes.len() {
            1 => cause.clone(),
            _ => format!("{cause} ({frames})"),
        });
        causes.collect::<Vec<_>>().join(", ")
    }
}

impl fmt::Display for CameraLoss {
    /// `feet: 3 of 60 frames lost (5 %): encoder overload`, or `feet: none of 60 frames lost`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { camera, lost, .. } = self;
        let frames = text::count(self.expected, "frame");
        if *lost == 0 {
            return write!(f, "{camera}: none of {frames} lost");
        }
        let share = text::percent(*lost, self.expected);
        write!(f, "{camera}: {lost} of {frames} lost ({share})")?;
        match self.why() {
            why if why.is_empty() => Ok(()),
            why => write!(f, ": {why}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use session_archive::verify::StreamReport;

    use super::*;

    fn loss(lost: u64, causes: &[(&str, u64)]) -> CameraLoss {
        let causes = causes.iter().map(|(cause, n)| ((*cause).to_owned(), *n));
        CameraLoss {
            camera: "feet".to_owned(),
            expected: 60,
            lost,
            causes: causes.collect(),
        }
    }

    #[test]
    fn loss_fraction_is_relative_to_expected_samples() {
        let mut report = Report::default();
        let stream = |samples, gaps, lost| StreamReport {
            samples,
            gaps,
            lost,
            ..StreamReport::default()
        };
        report.streams.insert("feet".to_owned(), stream(45, 14, 1));
        report
            .streams
            .insert("feet/imu".to_owned(), stream(0, 0, 0));
        let [camera, imu] = &StreamLoss::of(&report)[..] else {
            panic!("two streams: {report:?}");
        };
        assert!(camera.is_camera() && !imu.is_camera());
        assert_eq!((camera.missing, camera.expected), (15, 60));
        assert!((camera.share - 0.25).abs() < 1e-12);
        assert_eq!((imu.missing, imu.expected, imu.share), (0, 0, 0.0));
        // A folder without a session has no losses.
        let folder = tempfile::tempdir().unwrap();
        assert!(StreamLoss::of_folder(folder.path()).is_empty());
    }

    #[test]
    fn loss_text_has_fraction_and_causes() {
        let none = loss(0, &[]);
        assert_eq!(none.to_string(), "feet: none of 60 frames lost");
        let one = loss(3, &[("encoder overload", 3)]);
        let text = "feet: 3 of 60 frames lost (5 %): encoder overload";
        assert_eq!(one.to_string(), text);
        let two = loss(45, &[("encoder overload", 44), ("no record", 1)]);
        let text = "feet: 45 of 60 frames lost (75 %): encoder overload (44), no record (1)";
        assert_eq!(two.to_string(), text);
    }
}
