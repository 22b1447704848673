//! A battery that runs down. The kernel's test battery says that minutes are left, whatever its
//! charge.

use anyhow::{Result, ensure};

use super::{Fault, case};
use crate::case::{Bench, Case, Report};

pub(super) const BATTERY: Case = case(
    "fault-battery",
    "the battery says that a minute is left at 50 %, then it has 4 %, where the recording ends by itself; plugged in, the next one begins",
    battery,
);

fn battery(bench: &Bench) -> Result<Report> {
    let fault = Fault {
        during: "battery discharging 50 && sleep 40 && battery discharging 4 || exit 4
            until_state armed || until_state armed || exit 3
            pawsd start 2>refused.txt && exit 2
            battery charging 30 && sleep 90
            pawsd start >/dev/null",
        ..Fault::default()
    };
    let left = fault.happen(bench)?;
    left.two_whole_sessions("the machine cannot go on")?;
    let has_event = |what: &str| {
        let mut events = left.sessions[0].events.iter();
        events.any(|(_, _, text)| text.contains(what))
    };
    ensure!(has_event("battery: 50 %"), "{:?}", left.sessions[0].events);
    let refused = left.file("refused.txt")?;
    ensure!(refused.contains("battery: 4 %"), "{refused:?}");
    left.report(
        bench,
        &["battery"],
        "warned at once, stopped cleanly at 4 %, refused until plugged in; nothing is missing"
            .into(),
    )
}
