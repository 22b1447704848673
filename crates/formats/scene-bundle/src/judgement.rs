//! Verdict on the session when it was handed over, and its acceptance in spite of that verdict.
//!
//! Contract: a copy from the hand-off. It is not hashed, and no stage depends on it: a recording
//! that is validated again keeps its outputs.

use serde::{Deserialize, Serialize};

/// The verdict that a session was handed over with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Judgement {
    /// `PASS`, `WARN` or `FAIL`.
    pub verdict: String,
    /// The limits that were not those of the validator's own table, as `METRIC=WARN,FAIL`.
    pub limits: Vec<String>,
    /// Acceptance in spite of the verdict, if there was one.
    pub acceptance: Option<Acceptance>,
}

/// Acceptance of a session in spite of its verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Acceptance {
    /// The worst verdict that was accepted.
    pub level: String,
    /// When, ns of UTC since 1970, as well as the host knew.
    pub accepted_civil_ns: i64,
    /// The verdict that it was given for.
    pub verdict: String,
    /// All metrics that exceeded a limit then, the worst first.
    pub metrics: Vec<ExceededLimit>,
    /// The limits then, as [`Judgement::limits`].
    pub limits: Vec<String>,
}

/// A metric that exceeded a limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExceededLimit {
    /// The metric, as in `camera.dropped`.
    pub metric: String,
    /// The stream, pair or clock that it concerns; `session` for the whole.
    pub of: String,
    /// `WARN` or `FAIL`.
    pub verdict: String,
    /// Measured value in the metric's unit; absent where it is not finite.
    pub value: Option<f64>,
    /// A value above this is a warning; absent if there is no such limit.
    pub warn: Option<f64>,
    /// A value above this is a failure; absent if there is no such limit.
    pub fail: Option<f64>,
    /// The unit: `ratio`, `ns`, `count`, `deg` or `flag`.
    pub unit: String,
    /// Description of the metric and its value.
    pub text: String,
}

impl Judgement {
    /// The verdict and the acceptance in a line, without its metrics. `civil` writes times.
    ///
    /// ```
    /// use scene_bundle::judgement::{Acceptance, Judgement};
    ///
    /// let judgement = Judgement {
    ///     verdict: "WARN".to_owned(),
    ///     limits: vec!["camera.dropped=0.01,0.05".to_owned()],
    ///     acceptance: Some(Acceptance {
    ///         level: "WARN".to_owned(),
    ///         accepted_civil_ns: 3,
    ///         verdict: "WARN".to_owned(),
    ///         metrics: Vec::new(),
    ///         limits: Vec::new(),
    ///     }),
    /// };
    /// assert_eq!(
    ///     judgement.in_short(|ns| format!("at {ns} ns")),
    ///     "WARN, accepted at 3 ns (--accept WARN), with limits camera.dropped=0.01,0.05"
    /// );
    /// ```
    pub fn in_short(&self, civil: impl Fn(i64) -> String) -> String {
        let mut text = self.verdict.clone();
        if let Some(acceptance) = &self.acceptance {
            let at = civil(acceptance.accepted_civil_ns);
            text.push_str(&format!(", accepted {at} (--accept {})", acceptance.level));
        }
        if !self.limits.is_empty() {
            text.push_str(&format!(", with limits {}", self.limits.join(" ")));
        }
        text
    }
}
