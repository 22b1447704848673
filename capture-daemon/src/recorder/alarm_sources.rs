//! Sources of alarms, and the subject of an alarm from each.

use machine::ladder::Cause;

use crate::status::Concern;

/// Source of alarms about earlier recordings; they are active until the next recording begins.
pub(crate) const RECOVERY: &str = "recovery";
/// Source of alarms about lost samples.
pub(super) const LOSSES: &str = "losses";

pub(super) fn cause_name(cause: Cause) -> &'static str {
    match cause {
        Cause::Heat => "heat",
        Cause::Throttling => "throttling",
        Cause::Battery => "battery",
        Cause::Supply => "supply",
        Cause::Disk => "disk",
        Cause::Encoder => "encoder",
    }
}

/// Subject of an alarm from this source.
pub(super) fn concern_of(source: &str) -> Concern {
    match source {
        "disk" | RECOVERY => Concern::Storage,
        "battery" | "supply" => Concern::Battery,
        "heat" | "throttling" => Concern::Heat,
        _ => Concern::Stream,
    }
}
