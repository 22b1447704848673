//! The session's verdict on the page.
//!
//! Contract: a session that was handed over in spite of its verdict is marked at the top, with all
//! metrics that exceeded a limit; if the bundle does not contain the verdict, the page states that.

use charts::{Page, Verdict as Badge};
use scene_bundle::Provenance;
use session_archive::time::CivilTime;

/// The verdict in a line.
pub(super) fn in_short(provenance: &Provenance) -> String {
    match &provenance.judgement {
        Some(judgement) => judgement.in_short(|ns| CivilTime(ns).to_string()),
        None => "not known: the bundle does not say".to_owned(),
    }
}

/// Adds the exceeded limits of an accepted session; nothing otherwise.
pub(super) fn add(page: Page, provenance: &Provenance) -> Page {
    let judgement = provenance.judgement.as_ref();
    let Some(acceptance) = judgement.and_then(|judgement| judgement.acceptance.as_ref()) else {
        return page;
    };
    let badge = |verdict: &str| match verdict {
        "PASS" => Badge::Pass,
        "WARN" => Badge::Warn,
        _ => Badge::Fail,
    };
    let page = page.finding(
        badge(&acceptance.verdict),
        &format!(
            "The verdict on the session is {}. It was handed over in spite of that (--accept {}, {}); what is shown here \
             rests on a recording with these findings:",
            acceptance.verdict,
            acceptance.level,
            CivilTime(acceptance.accepted_civil_ns)
        ),
    );
    acceptance.metrics.iter().fold(page, |page, beyond| {
        page.finding(badge(&beyond.verdict), &beyond.text)
    })
}
