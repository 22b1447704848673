//! Notes on suspicious calibrations.

use std::fmt;

/// Absent, derived or suspicious input that did not stop the reading. Show it to the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note(pub String);

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
