//! Verdict of a hand-off, for the provenance of a bundle and for messages.

use scene_bundle::Judgement;
use scene_bundle::judgement::{Acceptance, ExceededLimit};
use session_archive::handoff::{self, HandOff, later_verdict};
use session_archive::storage::Storage;

use super::Input;

impl Input {
    /// The verdict that the session was handed over with, and its acceptance.
    pub fn judgement(&self) -> Judgement {
        let handoff = self.handoff();
        Judgement {
            verdict: handoff.verdict.to_string(),
            limits: handoff.limits.clone(),
            acceptance: handoff.acceptance.as_ref().map(acceptance),
        }
    }

    /// Warnings about the hand-off to print before it is processed, a sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Whether the session failed its validation, and was handed over in spite of it.
    pub fn is_failed(&self) -> bool {
        self.handoff().verdict == handoff::Verdict::Fail
    }
}

/// Warnings about a hand-off, among them that the session was validated again since.
pub(super) fn notes(handoff: &HandOff, storage: &dyn Storage) -> Vec<String> {
    let mut notes = handoff.notes();
    if let Some(later) = later_verdict(storage).filter(|later| *later != handoff.verdict) {
        notes.push(format!(
            "the session was handed over as {}, and a later validation has the verdict {later}; `paws show` says why, `paws handoff` \
             judges it again",
            handoff.verdict
        ));
    }
    notes
}

fn acceptance(acceptance: &handoff::Acceptance) -> Acceptance {
    let beyond = |beyond: &handoff::Beyond| ExceededLimit {
        metric: beyond.metric.clone(),
        of: beyond.of.clone(),
        verdict: beyond.verdict.to_string(),
        value: beyond.value,
        warn: beyond.warn,
        fail: beyond.fail,
        unit: beyond.unit.clone(),
        text: beyond.text.clone(),
    };
    Acceptance {
        level: acceptance.level.to_string(),
        accepted_civil_ns: acceptance.accepted.0,
        verdict: acceptance.verdict.to_string(),
        metrics: acceptance.metrics.iter().map(beyond).collect(),
        limits: acceptance.limits.clone(),
    }
}
