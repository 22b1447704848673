//! Explains why a verdict changed.
//!
//! Contract: if a verdict replaces a different one of the same session, it is reported with the
//! differences between the two documents: files, depth, limits, software and findings. Two
//! validations with the same verdict give no text.

use session_archive::handoff::{HandOff, Verdict};
use session_health::Finding;

use crate::validation::Validation;

/// Maximum number of findings named; the rest is counted.
const MAX_FINDINGS: usize = 6;

/// A line with the change of a session's verdict and its reasons; `None` if it did not change.
pub(crate) fn describe(old: &Validation, new: &Validation) -> Option<String> {
    if old.session_id != new.session_id || old.verdict == new.verdict {
        return None;
    }
    let mut why = Vec::new();
    if old.basis != new.basis {
        why.push("the recording's files have changed".to_owned());
    }
    match (old.deep, new.deep) {
        (false, true) => why.push("every image was decoded this time".to_owned()),
        (true, false) => {
            why.push("images were not decoded this time (--deep decodes them)".to_owned());
        }
        _ => {}
    }
    if old.limits != new.limits {
        let (old, new) = (limits(old), limits(new));
        why.push(format!("limits are {new}, before {old}"));
    }
    if old.software != new.software {
        why.push(format!("by {}, before by {}", new.software, old.software));
    }
    let differing = differing(&old.findings, &new.findings);
    let more = differing.len().saturating_sub(MAX_FINDINGS);
    why.extend(differing.into_iter().take(MAX_FINDINGS));
    if more > 0 {
        why.push(format!("{more} more"));
    }
    let why = match why.is_empty() {
        true => "the two documents show no reason".to_owned(),
        false => why.join("; "),
    };
    Some(format!(
        "verdict {} \u{2192} {} since the last validation: {why}",
        old.verdict, new.verdict
    ))
}

/// A line if the verdict of the hand-off differs from the current one; `None` if they agree.
pub(crate) fn hand_off_note(handoff: &HandOff, now: Verdict, name: &str) -> Option<String> {
    (handoff.verdict != now).then(|| {
        format!(
            "handed over as {} on {}, now {now}: that hand-off is unchanged, and `paws handoff {name}` validates it again",
            handoff.verdict, handoff.sealed
        )
    })
}

fn limits(validation: &Validation) -> String {
    match validation.limits.is_empty() {
        true => "the defaults".to_owned(),
        false => validation.limits.join(" "),
    }
}

/// Findings whose verdicts differ, the worst of the new ones first.
fn differing(old: &[Finding], new: &[Finding]) -> Vec<String> {
    let find = |findings: &[Finding], of: &Finding| {
        let mut findings = findings.iter();
        findings
            .find(|f| f.metric == of.metric && f.of == of.of)
            .map(|f| f.verdict)
    };
    let mut changed: Vec<(Verdict, String)> = Vec::new();
    for finding in new {
        let before = find(old, finding).unwrap_or(Verdict::Pass);
        if before != finding.verdict {
            let text = format!("{}, before {before}", finding.text);
            changed.push((finding.verdict, text));
        }
    }
    for finding in old.iter().filter(|f| f.verdict != Verdict::Pass) {
        if find(new, finding).is_none() {
            let text = format!(
                "not measured now, before {}: {}",
                finding.verdict, finding.text
            );
            changed.push((Verdict::Pass, text));
        }
    }
    changed.sort_by_key(|(verdict, _)| std::cmp::Reverse(*verdict));
    changed.into_iter().map(|(_, text)| text).collect()
}
