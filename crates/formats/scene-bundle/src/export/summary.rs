//! What an export wrote, and what it did not.

/// Summary of an export.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Description of what was written.
    pub description: String,
    /// Content that the format cannot represent, and what was changed to fit it.
    pub notes: Vec<String>,
    /// What should have been written and was not.
    pub lost: Vec<String>,
}
