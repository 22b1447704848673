//! Seconds as decimal text and nanoseconds as integers, exactly, both ways.

/// Number of decimals.
const DIGITS: i64 = 9;

/// Nanoseconds as seconds with nine decimals: `-1` is `-0.000000001`.
pub fn format_seconds(time_ns: i64) -> String {
    let sign = if time_ns < 0 { "-" } else { "" };
    let size = time_ns.unsigned_abs();
    format!("{sign}{}.{:09}", size / 1_000_000_000, size % 1_000_000_000)
}

/// Nanoseconds of seconds in decimal, with or without point and exponent (NumPy writes
/// `1.3050e+09`). Digits below a nanosecond are rounded to the nearest, halves away from zero.
/// `None` for what is not a decimal number or outside of i64 nanoseconds (292 years).
///
/// ```
/// use scene_bundle::formats::{format_seconds, parse_seconds};
///
/// // Beyond what a 64-bit floating-point number could hold.
/// assert_eq!(parse_seconds("1403715273.262142976"), Some(1_403_715_273_262_142_976));
/// assert_eq!(parse_seconds("1.25e+01"), Some(12_500_000_000));
/// assert_eq!(parse_seconds("12:30"), None);
/// assert_eq!(format_seconds(-1), "-0.000000001");
/// ```
pub fn parse_seconds(text: &str) -> Option<i64> {
    let (negative, digits) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let (mantissa, exponent) = match digits.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (digits, 0),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let all = || whole.bytes().chain(fraction.bytes());
    if all().next().is_none() || !all().all(|b| b.is_ascii_digit()) {
        return None;
    }
    // Number of digits that make whole nanoseconds.
    let kept = whole.len() as i64 + i64::from(exponent) + DIGITS;
    let mut size: i128 = 0;
    let mut place = 0_i64;
    for digit in all().map(|b| i128::from(b - b'0')) {
        if place < kept {
            size = size * 10 + digit;
        } else {
            if place == kept && digit >= 5 {
                size += 1;
            }
            break;
        }
        // Far beyond i64 and far from overflowing an i128.
        if size > i128::from(u64::MAX) {
            return None;
        }
        place += 1;
    }
    while place < kept && size != 0 {
        size *= 10;
        if size > i128::from(u64::MAX) {
            return None;
        }
        place += 1;
    }
    i64::try_from(if negative { -size } else { size }).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_written_and_read_exactly() {
        let cases = [
            (0, "0.000000000"),
            (1, "0.000000001"),
            (-1, "-0.000000001"),
            (1_403_715_273_262_142_976, "1403715273.262142976"),
            (-1_500_000_000, "-1.500000000"),
            (i64::MAX, "9223372036.854775807"),
            (i64::MIN, "-9223372036.854775808"),
        ];
        for (time_ns, text) in cases {
            assert_eq!(format_seconds(time_ns), text);
            assert_eq!(parse_seconds(text), Some(time_ns), "{text}");
        }
        for i in 0..20_000_u64 {
            let time_ns = i.wrapping_mul(0x9e37_79b9_7f4a_7c15) as i64;
            assert_eq!(parse_seconds(&format_seconds(time_ns)), Some(time_ns));
        }
    }

    #[test]
    fn other_notations_of_a_number_are_parsed() {
        let cases = [
            ("1305031098.6659", 1_305_031_098_665_900_000),
            // As NumPy prints the float nearest to 1305031102.175304, which is a hair off it.
            ("1.305031102175303936e+09", 1_305_031_102_175_303_936),
            ("1.037300e-01", 103_730_000),
            ("0.000000e+00", 0),
            ("0e30", 0),
            (".5", 500_000_000),
            ("5.", 5_000_000_000),
            ("+2", 2_000_000_000),
            ("0.0000000005", 1),
            ("0.0000000004999", 0),
            ("-0.0000000005", -1),
            ("5e-10", 1),
            ("5e-11", 0),
            ("0.00000000149e0", 1),
            (
                "000000000000000000000000000000000000000000000001.5",
                1_500_000_000,
            ),
        ];
        for (text, time_ns) in cases {
            assert_eq!(parse_seconds(text), Some(time_ns), "{text}");
        }
    }

    #[test]
    fn text_that_is_not_a_time_is_refused() {
        let not = [
            "",
            "-",
            ".",
            "e5",
            "1,5",
            "1.5.0",
            "nan",
            "inf",
            "0x10",
            "1e",
            "1 ",
            "--1",
            "1e999999999999",
            "9223372036.854775808",
            "-9223372036.854775809",
            "1e300",
            "99999999999999999999999999999999999999999",
        ];
        for text in not {
            assert_eq!(parse_seconds(text), None, "{text:?}");
        }
    }
}
