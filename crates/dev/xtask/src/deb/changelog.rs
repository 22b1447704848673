//! Debian's changelog out of CHANGELOG.md. Pure.

use anyhow::{Context, Result};

/// One release in CHANGELOG.md.
#[derive(Debug, PartialEq)]
struct Section<'a> {
    /// `0.1.0`, or `Unreleased`.
    name: &'a str,
    /// `2026-12-01`; none where it is not released.
    day: Option<&'a str>,
    changes: Vec<String>,
}

/// Whether the newest section is one that is not released yet: then what is packaged comes before
/// the next release.
pub(super) fn is_unreleased(markdown: &str) -> Result<bool> {
    let newest = sections(markdown);
    let newest = newest.first().context("CHANGELOG.md has no section")?;
    Ok(newest.day.is_none())
}

/// The changelog in the form of deb-changelog(5), newest first. `version` and `date` (RFC 5322) are
/// those of the newest entry; `date_of` says a released section's day in the same form.
pub(super) fn debian(
    markdown: &str,
    version: &str,
    date: &str,
    maintainer: &str,
    date_of: impl Fn(&str) -> Result<String>,
) -> Result<String> {
    let mut text = String::new();
    for (index, section) in sections(markdown).iter().enumerate() {
        let (version, date) = match section.day {
            _ if index == 0 => (version.to_owned(), date.to_owned()),
            Some(day) => (format!("{}-1", section.name), date_of(day)?),
            None => continue,
        };
        text.push_str(&format!("pawsd ({version}) unstable; urgency=medium\n\n"));
        for change in &section.changes {
            text.push_str(&wrapped(change));
        }
        text.push_str(&format!("\n -- {maintainer}  {date}\n\n"));
    }
    Ok(text.trim_end().to_owned() + "\n")
}

/// `## [NAME] - DAY` begins a section, `- ` a change, an indented line goes on with it.
fn sections(markdown: &str) -> Vec<Section<'_>> {
    let mut sections: Vec<Section<'_>> = Vec::new();
    for line in markdown.lines() {
        if let Some(heading) = line.strip_prefix("## [") {
            let (name, rest) = heading.split_once(']').unwrap_or((heading, ""));
            let day = rest.trim_start_matches([' ', '-']);
            sections.push(Section {
                name,
                day: (!day.is_empty()).then_some(day),
                changes: Vec::new(),
            });
        } else if let Some(section) = sections.last_mut() {
            if let Some(change) = line.strip_prefix("- ") {
                section.changes.push(change.to_owned());
            } else if line.starts_with("  ")
                && let Some(change) = section.changes.last_mut()
            {
                change.push(' ');
                change.push_str(line.trim());
            }
        }
    }
    sections
}

/// A change as an item of Debian's changelog, in lines of at most 80 characters where words allow
/// it.
fn wrapped(change: &str) -> String {
    let mut text = String::from("  *");
    let mut width = text.len();
    for word in change.split_whitespace() {
        let length = word.chars().count();
        if width + 1 + length > 80 {
            text.push_str("\n   ");
            width = 3;
        }
        text.push(' ');
        text.push_str(word);
        width += 1 + length;
    }
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const MARKDOWN: &str = "\
# Changelog

Words before the first section.

## [Unreleased]

### Added

- `pawsd`: records three stereo cameras and their IMUs into a session that survives a power cut. The
  cameras are simulated.
- More.

## [0.1.0] - 2026-12-01

### Fixed

- The first.
";

    fn entries(markdown: &str) -> Result<String> {
        debian(
            markdown,
            "0.2.0~1-1",
            "Sun, 22 Nov 2026 12:00:00 +0000",
            "Someone <someone@example.org>",
            |day| Ok(format!("on {day}")),
        )
    }

    #[test]
    fn every_section_becomes_an_entry() -> Result<()> {
        assert_eq!(
            entries(MARKDOWN)?,
            "\
pawsd (0.2.0~1-1) unstable; urgency=medium

  * `pawsd`: records three stereo cameras and their IMUs into a session that
    survives a power cut. The cameras are simulated.
  * More.

 -- Someone <someone@example.org>  Sun, 22 Nov 2026 12:00:00 +0000

pawsd (0.1.0-1) unstable; urgency=medium

  * The first.

 -- Someone <someone@example.org>  on 2026-12-01
"
        );
        Ok(())
    }

    #[test]
    fn only_a_section_with_a_day_is_released() -> Result<()> {
        assert!(is_unreleased(MARKDOWN)?);
        let released = MARKDOWN.replace("## [Unreleased]", "## [0.2.0] - 2026-12-24");
        assert!(!is_unreleased(&released)?);
        assert!(is_unreleased("nothing").is_err());
        Ok(())
    }

    #[test]
    fn no_line_is_longer_than_80_characters() -> Result<()> {
        let project = include_str!("../../../../../CHANGELOG.md");
        let longest = entries(project)?
            .lines()
            .map(|line| line.chars().count())
            .max();
        assert!(longest <= Some(80), "{longest:?}");
        Ok(())
    }
}
