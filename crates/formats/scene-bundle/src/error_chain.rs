//! An error and its causes in one line.

/// Error texts do not contain their causes; this joins them for a human reader.
///
/// ```
/// use std::path::Path;
///
/// use scene_bundle::{error_chain, formats::tum};
///
/// let error = tum::read(Path::new("no/such/file.txt")).unwrap_err();
/// let text = error_chain(&error);
/// assert!(text.starts_with(&error.to_string()));
/// assert!(text.contains("No such file or directory"), "{text}");
/// ```
pub fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        text.push_str(": ");
        text.push_str(&cause.to_string());
        next = cause.source();
    }
    text
}
