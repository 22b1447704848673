//! String literals as texts.

use std::borrow::Cow;

/// What a literal stands for, for the count of its words. The lines are those of the literal: an
/// escaped line end is a blank.
pub(crate) fn text(content: &str, raw: bool) -> Cow<'_, str> {
    if raw || !content.contains('\\') {
        return Cow::Borrowed(content);
    }
    let mut text = String::with_capacity(content.len());
    let mut rest = content.chars();
    while let Some(c) = rest.next() {
        if c != '\\' {
            text.push(c);
            continue;
        }
        match rest.next() {
            // The text goes on behind the blanks of the next line.
            Some('\n') => {
                text.push('\n');
                let behind = rest.as_str();
                let blanks = behind.len() - behind.trim_start().len();
                text.extend(behind[..blanks].chars().filter(|c| *c == '\n'));
                rest = behind[blanks..].chars();
            }
            Some('u') => {
                let (number, behind) = rest.as_str().split_once('}').unwrap_or_default();
                let number = u32::from_str_radix(number.trim_start_matches('{'), 16);
                text.push(number.ok().and_then(char::from_u32).unwrap_or(' '));
                rest = behind.chars();
            }
            Some('x') => {
                rest.nth(1);
                text.push(' ');
            }
            Some('n' | 'r' | 't' | '0') | None => text.push(' '),
            Some(escaped) => text.push(escaped),
        }
    }
    Cow::Owned(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_become_what_they_stand_for() {
        assert_eq!(text(r#"a\nb\t\"c\" \\d"#, false), "a b \"c\" \\d");
        assert_eq!(text(r"caf\u{e9} \x41b", false), "café  b");
        assert_eq!(text(r"a\nb", true), r"a\nb");
        assert_eq!(text(r"open \u{12", false), "open  ");
        assert_eq!(text("open \\", false), "open  ");
    }

    #[test]
    fn lines_of_a_literal_are_kept() {
        assert_eq!(text("a \\\n   b\nc\\\n\n d", false), "a \nb\nc\n\nd");
    }
}
