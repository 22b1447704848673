//! What the page says of the session's verdict.
//!
//! Contract: a session that was handed over in spite of its verdict is marked at the top, with everything that was beyond a
//! limit; a bundle that does not say with which verdict its session was handed over says that it does not.

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

/// Adds what the session was accepted in spite of; nothing where it did not have to be.
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
