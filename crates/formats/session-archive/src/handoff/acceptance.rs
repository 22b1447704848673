//! The acceptance of a session that is worse than a PASS, given when it was handed over.

use serde::{Deserialize, Serialize};

use super::Verdict;
use crate::time::CivilTime;

/// Records that a session was handed over in spite of its verdict. It names no person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Acceptance {
    /// The worst verdict that was accepted, as in `--accept FAIL`.
    pub level: Verdict,
    /// When, as well as the host knew.
    pub accepted: CivilTime,
    /// The verdict that it was given for.
    pub verdict: Verdict,
    /// All metrics beyond a limit at that time, the worst first.
    pub metrics: Vec<Beyond>,
    /// The limits that were not those of the validator's own table, as `METRIC=WARN,FAIL`.
    pub limits: Vec<String>,
}

/// A metric that was beyond a limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beyond {
    /// The metric, as in `camera.dropped`.
    pub metric: String,
    /// The stream, pair or clock that it is about; `session` for the whole.
    pub of: String,
    /// WARN or FAIL.
    pub verdict: Verdict,
    /// The measured value in the metric's unit; `None` where it is not finite.
    pub value: Option<f64>,
    /// A value above this is a warning; `None` where there is no such limit.
    pub warn: Option<f64>,
    /// A value above this is a failure; `None` where there is no such limit.
    pub fail: Option<f64>,
    /// The unit: `ratio`, `ns`, `count`, `deg` or `flag`.
    pub unit: String,
    /// The finding as a sentence.
    pub text: String,
}

impl Acceptance {
    /// Whether it also holds for this verdict with these metrics beyond their limits: the verdict
    /// is within the level, and of every metric and stream that is now beyond a limit, as bad a
    /// verdict was accepted.
    ///
    /// ```
    /// use session_archive::handoff::{Acceptance, Beyond, Verdict};
    /// # use session_archive::time::CivilTime;
    ///
    /// let acceptance = Acceptance {
    ///     level: Verdict::Warn,
    /// #     accepted: CivilTime(0),
    ///     verdict: Verdict::Warn,
    ///     metrics: vec![Beyond {
    ///         metric: "camera.dropped".to_owned(),
    ///         of: "feet".to_owned(),
    ///         verdict: Verdict::Warn,
    /// #         value: Some(0.02),
    /// #         warn: Some(0.01),
    /// #         fail: Some(0.05),
    /// #         unit: "ratio".to_owned(),
    /// #         text: "2 % of the frames of feet are missing".to_owned(),
    ///         // and what was measured
    ///     }],
    /// #     limits: Vec::new(),
    /// };
    /// assert!(acceptance.covers(Verdict::Warn, [("camera.dropped", "feet", Verdict::Warn)]));
    /// // Another stream, or a worse verdict of the same stream, was not accepted.
    /// assert!(!acceptance.covers(Verdict::Warn, [("camera.dropped", "left_shoulder", Verdict::Warn)]));
    /// assert!(!acceptance.covers(Verdict::Warn, [("camera.dropped", "feet", Verdict::Fail)]));
    /// ```
    pub fn covers<'a>(
        &self,
        verdict: Verdict,
        beyond: impl IntoIterator<Item = (&'a str, &'a str, Verdict)>,
    ) -> bool {
        let is_known = |(metric, of, verdict): (&str, &str, Verdict)| {
            let mut known = self.metrics.iter();
            known.any(|m| m.metric == metric && m.of == of && m.verdict >= verdict)
        };
        verdict <= self.level && beyond.into_iter().all(is_known)
    }
}
