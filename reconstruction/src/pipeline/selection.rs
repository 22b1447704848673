//! Selection of stages.

/// Which stages to run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// The first stage; outputs of earlier ones are used as they are.
    pub from: Option<String>,
    /// The last.
    pub to: Option<String>,
    /// Whether stages run even if their outputs are up to date.
    pub force: bool,
}
