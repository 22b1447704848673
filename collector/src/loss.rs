//! How much of what each camera was to record is missing, as a share, and why.

use std::fmt;

use session_archive::manifest::Manifest;

use crate::text;
use crate::validation::Summary;

/// The loss of one camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraLoss {
    /// The camera.
    pub camera: String,
    /// Frames that were to be recorded: those present and those missing.
    pub expected: u64,
    /// Frames missing.
    pub lost: u64,
    /// Why, and how many each, most first; as in `encoder overload`, or `no record` where the recorder did not know of it.
    pub causes: Vec<(String, u64)>,
}

impl CameraLoss {
    /// The loss of every camera of a session, in the order of the manifest.
    pub fn of(manifest: &Manifest, summary: &Summary) -> Vec<Self> {
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

    /// Missing frames as a share of those expected, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.lost as f64 / self.expected.max(1) as f64
    }

    /// The causes in words; empty where nothing is missing.
    pub fn why(&self) -> String {
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
    fn a_loss_is_a_share_with_its_causes() {
        let none = loss(0, &[]);
        assert_eq!(none.to_string(), "feet: none of 60 frames lost");
        let one = loss(3, &[("encoder overload", 3)]);
        let text = "feet: 3 of 60 frames lost (5 %): encoder overload";
        assert_eq!(one.to_string(), text);
        let two = loss(45, &[("encoder overload", 44), ("no record", 1)]);
        let text = "feet: 45 of 60 frames lost (75 %): encoder overload (44), no record (1)";
        assert_eq!(two.to_string(), text);
        assert!((two.share() - 0.75).abs() < 1e-12);
    }
}
