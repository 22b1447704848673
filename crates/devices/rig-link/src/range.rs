//! Byte ranges of a file: the `Range` header (RFC 9110, section 14).
//!
//! One range is supported. Several ranges, other units and invalid headers count as no range, as
//! the standard allows: the whole file is sent.

/// Bytes to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ByteRange {
    /// The whole file.
    All,
    /// `first..end`, not empty and within the file.
    Part {
        /// First byte.
        first: u64,
        /// End, exclusive.
        end: u64,
    },
    /// The range does not overlap the file.
    Nothing,
}

/// The bytes that a `Range` header requests of a file of `length` bytes.
pub(crate) fn requested_range(header: Option<&str>, length: u64) -> ByteRange {
    let Some((from, to)) = header.and_then(one_range) else {
        return ByteRange::All;
    };
    let (first, end) = match (from, to) {
        (Some(first), Some(last)) if last < first => return ByteRange::All,
        (Some(first), Some(last)) => (first, last.saturating_add(1).min(length)),
        (Some(first), None) => (first, length),
        // The last `n` bytes.
        (None, Some(n)) => (length.saturating_sub(n), length),
        (None, None) => return ByteRange::All,
    };
    if first < end {
        ByteRange::Part { first, end }
    } else {
        ByteRange::Nothing
    }
}

/// The two ends of a single byte range.
fn one_range(header: &str) -> Option<(Option<u64>, Option<u64>)> {
    let (unit, range) = header.split_once('=')?;
    let (from, to) = range.trim().split_once('-')?;
    if !unit.trim().eq_ignore_ascii_case("bytes") {
        return None;
    }
    // `parse` accepts a sign, the standard does not.
    let end = |text: &str| match text {
        "" => Some(None),
        text if text.bytes().all(|b| b.is_ascii_digit()) => {
            // A number that overflows means the end of the file.
            Some(Some(text.parse().unwrap_or(u64::MAX)))
        }
        _ => None,
    };
    Some((end(from)?, end(to)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn range_headers_are_parsed() {
        let part = |first, end| ByteRange::Part { first, end };
        for (header, expected) in [
            ("bytes=0-0", part(0, 1)),
            ("bytes=5-", part(5, 10)),
            ("Bytes=5-7", part(5, 8)),
            ("bytes=-3", part(7, 10)),
            ("bytes=-30", part(0, 10)),
            ("bytes=0-99999999999999999999999", part(0, 10)),
            ("bytes=3-18446744073709551615", part(3, 10)),
            ("bytes=10-", ByteRange::Nothing),
            ("bytes=99999999999999999999999-", ByteRange::Nothing),
            ("bytes=-0", ByteRange::Nothing),
            ("bytes=7-5", ByteRange::All),
            ("bytes=-", ByteRange::All),
            ("bytes=", ByteRange::All),
            ("bytes", ByteRange::All),
            ("", ByteRange::All),
            ("bytes=0-1,3-4", ByteRange::All),
            ("bytes=+1-2", ByteRange::All),
            ("bytes=1--2", ByteRange::All),
            ("bytes=a-b", ByteRange::All),
            ("items=0-1", ByteRange::All),
            ("bytes=\u{661}-2", ByteRange::All),
        ] {
            assert_eq!(requested_range(Some(header), 10), expected, "{header}");
        }
        assert_eq!(requested_range(None, 10), ByteRange::All);
        assert_eq!(requested_range(Some("bytes=0-"), 0), ByteRange::Nothing);
    }
}
