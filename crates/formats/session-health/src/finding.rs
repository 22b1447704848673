//! Findings: metrics compared with their limits.

use serde::{Deserialize, Deserializer, Serialize};
use session_archive::handoff::Verdict;

use crate::limits::Limits;

/// One metric of one stream with its verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The metric, as in `camera.dropped`.
    pub metric: String,
    /// The stream, pair or clock; `session` for the whole.
    pub of: String,
    /// PASS, WARN or FAIL.
    pub verdict: Verdict,
    /// Measured value, in the metric's unit; `null` in JSON if it is not finite.
    #[serde(deserialize_with = "number_or_nan")]
    pub value: f64,
    /// A value above this is a warning; `None` without a limit.
    pub warn: Option<f64>,
    /// A value above this is a failure; `None` without a limit.
    pub fail: Option<f64>,
    /// The unit: `ratio`, `ns`, `count`, `deg` or `flag`.
    pub unit: String,
    /// The whole finding as text.
    pub text: String,
}

/// Reads a number; JSON has only `null` for values that are not finite.
///
/// # Errors
/// The value is neither a number nor `null`.
pub fn number_or_nan<'a, D: Deserializer<'a>>(input: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(input)?.unwrap_or(f64::NAN))
}

/// The verdict over all findings.
pub fn overall(findings: &[Finding]) -> Verdict {
    let worst = findings.iter().map(|f| f.verdict).max();
    worst.unwrap_or(Verdict::Pass)
}

/// Findings that are not a pass, the worst first.
pub fn reasons(findings: &[Finding]) -> Vec<&Finding> {
    let mut reasons: Vec<_> = findings
        .iter()
        .filter(|f| f.verdict != Verdict::Pass)
        .collect();
    reasons.sort_by_key(|f| std::cmp::Reverse(f.verdict));
    reasons
}

/// Compares `value` with the limits of `metric` for a stream with this nominal period (ns; 0 if it
/// has none); `None` for an unknown metric.
pub fn finding(
    limits: &Limits,
    metric: &str,
    of: &str,
    value: f64,
    period_ns: f64,
    detail: &str,
) -> Option<Finding> {
    let limit = limits.of(metric)?;
    let (warn, fail) = limit.in_force(period_ns);
    // NaN is beyond every finite limit; nothing is beyond `never`.
    let beyond = |limit: f64| value > limit || (value.is_nan() && limit.is_finite());
    let verdict = if beyond(fail) {
        Verdict::Fail
    } else if beyond(warn) {
        Verdict::Warn
    } else {
        Verdict::Pass
    };
    let crossed = match verdict {
        Verdict::Warn if warn > 0.0 => format!(", limit {}", limit.unit.show(warn)),
        Verdict::Fail if fail > 0.0 => format!(", limit {}", limit.unit.show(fail)),
        _ => String::new(),
    };
    let detail = match detail {
        "" => String::new(),
        detail => format!(" ({detail})"),
    };
    let shown = limit.unit.show(value);
    Some(Finding {
        metric: metric.to_owned(),
        of: of.to_owned(),
        verdict,
        value,
        warn: warn.is_finite().then_some(warn),
        fail: fail.is_finite().then_some(fail),
        unit: limit.unit.as_str().to_owned(),
        text: format!("{of}: {}: {shown}{crossed}{detail}", limit.title),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limit_never_holds_even_for_nan() {
        let verdict_of = |limit: &str, value: f64| {
            let mut limits = Limits::default();
            limits.set(limit).unwrap();
            finding(&limits, "imu.rate", "imu", value, 0.0, "").map(|f| f.verdict)
        };
        for value in [0.0, 1e300, f64::INFINITY, f64::NAN] {
            assert_eq!(verdict_of("imu.rate=never", value), Some(Verdict::Pass));
        }
        assert_eq!(
            verdict_of("imu.rate=1,never", f64::NAN),
            Some(Verdict::Warn)
        );
        assert_eq!(verdict_of("imu.rate=1,never", 1.0), Some(Verdict::Pass));
        assert_eq!(verdict_of("imu.rate=1,2", f64::NAN), Some(Verdict::Fail));
        assert_eq!(verdict_of("imu.rate=1,2", 1.5), Some(Verdict::Warn));
    }

    #[test]
    fn finding_with_nan_round_trips() {
        let limits = Limits::default();
        let found = finding(&limits, "imu.rate", "imu", f64::NAN, 0.0, "").unwrap();
        let text = serde_json::to_string(&found).unwrap();
        let read: Finding = serde_json::from_str(&text).unwrap();
        assert!(read.value.is_nan(), "{text}");
        assert_eq!((read.verdict, &read.text), (found.verdict, &found.text));
    }
}
