//! A calibration file as text, and parsing of numbers with errors that name the line.

use std::path::PathBuf;

use crate::error::CalibError;

/// The text of one file and where it came from.
pub(crate) struct Source {
    pub(crate) path: PathBuf,
    pub(crate) text: String,
}

impl Source {
    /// Lines from 1, trimmed, without a byte order mark.
    pub(crate) fn lines(&self) -> impl Iterator<Item = (usize, &str)> {
        self.text
            .trim_start_matches('\u{feff}')
            .lines()
            .enumerate()
            .map(|(i, line)| (i + 1, line.trim()))
    }

    pub(crate) fn malformed(&self, line: usize, found: &str, expected: &str) -> CalibError {
        CalibError::Malformed {
            path: self.path.clone(),
            line,
            found: if found.is_empty() {
                "nothing".to_owned()
            } else {
                format!("{found:?}")
            },
            expected: expected.to_owned(),
        }
    }

    /// The same with a description of what was found instead of a quotation.
    pub(crate) fn unexpected(&self, line: usize, found: &str, expected: &str) -> CalibError {
        CalibError::Malformed {
            path: self.path.clone(),
            line,
            found: found.to_owned(),
            expected: expected.to_owned(),
        }
    }

    pub(crate) fn missing(&self, what: &str, found: &str) -> CalibError {
        CalibError::Missing {
            path: self.path.clone(),
            what: what.to_owned(),
            found: found.to_owned(),
        }
    }

    /// A finite number with a decimal point. A decimal comma is rejected explicitly: programs that
    /// take `736,862` for 736 have destroyed calibrations before.
    pub(crate) fn number(&self, line: usize, text: &str) -> Result<f64, CalibError> {
        self.number_for(line, text, "")
    }

    /// The same, for a message with the name of the number, for example ` as cam0.fx`.
    pub(crate) fn number_for(
        &self,
        line: usize,
        text: &str,
        what: &str,
    ) -> Result<f64, CalibError> {
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => {
                let with_point = text.replacen(',', ".", 1);
                let expected = if text.contains(',') && with_point.parse::<f64>().is_ok() {
                    "a decimal point (the file was written with a decimal comma)"
                } else {
                    "a finite number"
                };
                Err(self.malformed(line, text, &format!("{expected}{what}")))
            }
        }
    }

    /// All numbers of a line, separated by blanks.
    pub(crate) fn numbers(&self, line: usize, text: &str) -> Result<Vec<f64>, CalibError> {
        text.split_ascii_whitespace()
            .map(|word| self.number(line, word))
            .collect()
    }
}

/// A number as text: the shortest that reads back to the same bits, always with a point and with a
/// signed exponent of two digits. Without these YAML 1.1 readers (PyYAML) take `1e-5` for a word.
pub(crate) fn number_text(number: f64) -> String {
    let text = format!("{number:?}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let (sign, digits) = match exponent.strip_prefix('-') {
        Some(digits) => ('-', digits),
        None => ('+', exponent),
    };
    format!("{mantissa}{point}e{sign}{digits:0>2}")
}

/// Numbers with a separator between them.
pub(crate) fn number_texts(numbers: &[f64], separator: &str) -> String {
    let words: Vec<String> = numbers.iter().map(|n| number_text(*n)).collect();
    words.join(separator)
}

/// Metres as millimetres, such that the value read divided by 1000 gives the same bits, if any
/// number does.
pub(crate) fn millimetres(metres: f64) -> String {
    let mm = metres * 1000.0;
    let near = [mm, mm.next_up(), mm.next_down()];
    let exact = near.into_iter().find(|mm| mm / 1000.0 == metres);
    number_text(exact.unwrap_or(mm))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn millimetres_divide_back() {
        for i in 1..20_000 {
            let metres = f64::from(i) * 6.3e-6 + 1e-7 / f64::from(i);
            let back = millimetres(metres).parse::<f64>().unwrap() / 1000.0;
            assert!((back - metres).abs() <= f64::EPSILON * metres);
        }
        assert_eq!(millimetres(0.0629661), "62.9661");
    }

    #[test]
    fn written_numbers_read_back() {
        assert_eq!(number_text(0.0), "0.0");
        assert_eq!(number_text(-458.654), "-458.654");
        assert_eq!(number_text(1e-5), "1.0e-05");
        assert_eq!(number_text(-1.76187114e-05), "-1.76187114e-05");
        assert_eq!(number_text(1e300), "1.0e+300");
        for bits in (0..2000_u64).map(|i| i.wrapping_mul(0x9e37_79b9_7f4a_7c15)) {
            let number = f64::from_bits(bits);
            if number.is_finite() {
                assert_eq!(number_text(number).parse::<f64>().unwrap().to_bits(), bits);
            }
        }
    }
}
