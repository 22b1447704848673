//! Human-readable numbers.

/// Nanoseconds in a second.
const NS_PER_S: i64 = 1_000_000_000;

/// A number of bytes, as in `2.04 GB`.
pub fn bytes(n: u64) -> String {
    charts::si(n as f64, "B")
}

/// A duration, ns, as in `20.1 s`, `3 min 05 s`, `1 h 02 min`.
pub fn duration(ns: i64) -> String {
    let ns = ns.max(0);
    let s = ns.saturating_add(NS_PER_S / 2) / NS_PER_S;
    if s < 60 {
        format!("{:.1} s", ns as f64 / 1e9)
    } else if s < 3600 {
        format!("{} min {:02} s", s / 60, s % 60)
    } else {
        format!("{} h {:02} min", s / 3600, s / 60 % 60)
    }
}

/// A count with its word, as in `1 camera`, `3 cameras`.
pub fn count(n: u64, word: &str) -> String {
    format!("{n} {word}{}", if n == 1 { "" } else { "s" })
}

/// A fraction as percent, with enough digits to distinguish it from zero.
pub fn percent(part: u64, whole: u64) -> String {
    if part == 0 || whole == 0 {
        return "0 %".to_owned();
    }
    format!(
        "{} %",
        charts::significant(100.0 * part as f64 / whole as f64)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_formatted() {
        let cases = [
            (0, "0.0 s"),
            (20_140_000_000, "20.1 s"),
            (59_400_000_000, "59.4 s"),
            (59_600_000_000, "1 min 00 s"),
            (185_000_000_000, "3 min 05 s"),
            (3_725_000_000_000, "1 h 02 min"),
        ];
        for (ns, text) in cases {
            assert_eq!(duration(ns), text);
        }
        assert_eq!(percent(1, 3000), "0.0333 %");
        assert_eq!(count(1, "gap"), "1 gap");
    }
}
