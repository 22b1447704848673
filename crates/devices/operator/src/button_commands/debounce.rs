//! A level counts once it has lasted; its time is that of its beginning.

use crate::button::Edge;

#[derive(Debug)]
pub(super) struct Debounce {
    period_ns: i64,
    level: bool,
    /// The other level, on trial.
    pending: Option<Edge>,
}

impl Debounce {
    /// A button that is up.
    pub(super) fn new(period_ns: i64) -> Self {
        Self {
            period_ns,
            level: false,
            pending: None,
        }
    }

    /// A raw edge.
    pub(super) fn note(&mut self, edge: Edge) {
        if edge.pressed == self.level {
            self.pending = None;
        } else if self.pending.is_none() {
            self.pending = Some(edge);
        }
    }

    /// The change that has lasted long enough by `now_ns`.
    pub(super) fn settled(&mut self, now_ns: i64) -> Option<Edge> {
        let edge = self.pending.take_if(|e| {
            let settles = e.at_ns.saturating_add(self.period_ns);
            settles <= now_ns
        })?;
        self.level = edge.pressed;
        Some(edge)
    }

    /// When the level that is on trial began.
    pub(super) fn trial(&self) -> Option<i64> {
        self.pending.map(|e| e.at_ns)
    }

    /// When it will have lasted.
    pub(super) fn deadline(&self) -> Option<i64> {
        self.pending.map(|e| e.at_ns.saturating_add(self.period_ns))
    }
}
