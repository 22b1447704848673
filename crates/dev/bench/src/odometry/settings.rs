//! Settings of odometry by name: a preset, and differences from it, as in `balanced corners=40`.

use ::odometry::{Preset, Settings};
use anyhow::{Context, Result, bail};

/// The settings that a name stands for.
///
/// # Errors
/// Unknown name.
pub(crate) fn parse(name: &str) -> Result<Settings> {
    let mut words = name.split_whitespace();
    let preset = match words.next() {
        Some("fast") => Preset::Fast,
        Some("balanced") => Preset::Balanced,
        Some("accurate") => Preset::Accurate,
        other => bail!("found the preset {other:?}, expected fast, balanced or accurate"),
    };
    let mut settings = Settings::preset(preset);
    for word in words {
        let (key, value) = word
            .split_once('=')
            .with_context(|| format!("found {word:?}, expected KEY=VALUE"))?;
        match key {
            "corners" => settings.corners = value.parse()?,
            "frames" => settings.frames = value.parse()?,
            "rounds" => settings.rounds = value.parse()?,
            "every" => settings.every = value.parse()?,
            "parallax_px" => settings.parallax_px = value.parse()?,
            other => {
                bail!("found {other:?}, expected corners, frames, rounds, every or parallax_px")
            }
        }
    }
    Ok(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_presets_with_differences() {
        let balanced = Settings::preset(Preset::Balanced);
        assert_eq!(parse("balanced").expect("a preset"), balanced);
        let other = parse("balanced corners=40 every=true").expect("a name");
        assert_eq!((other.corners, other.every), (40, true));
        assert_eq!(other.frames, balanced.frames);
        for wrong in ["", "slow", "fast corners", "fast legs=4", "fast corners=x"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
