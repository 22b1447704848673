//! Settings of odometry by name: a preset, and differences from it, as in `balanced corners=40`.

use ::odometry::{Config, Preset};
use anyhow::{Context, Result, bail};

/// The settings that a name stands for.
///
/// # Errors
/// Unknown name.
pub(crate) fn parse(name: &str) -> Result<Config> {
    let mut words = name.split_whitespace();
    let preset = match words.next() {
        Some("fast") => Preset::Fast,
        Some("balanced") => Preset::Balanced,
        Some("accurate") => Preset::Accurate,
        other => bail!("found the preset {other:?}, expected fast, balanced or accurate"),
    };
    let mut settings = Config::preset(preset);
    for word in words {
        let (key, value) = word
            .split_once('=')
            .with_context(|| format!("found {word:?}, expected KEY=VALUE"))?;
        match key {
            "corners" => settings.max_features = value.parse()?,
            "frames" => settings.window_size = value.parse()?,
            "rounds" => settings.max_iterations = value.parse()?,
            "every" => settings.optimize_every_frame = value.parse()?,
            "parallax_px" => settings.keyframe_parallax_px = value.parse()?,
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
        let balanced = Config::preset(Preset::Balanced);
        assert_eq!(parse("balanced").expect("a preset"), balanced);
        let other = parse("balanced corners=40 every=true").expect("a name");
        assert_eq!((other.max_features, other.optimize_every_frame), (40, true));
        assert_eq!(other.window_size, balanced.window_size);
        for wrong in ["", "slow", "fast corners", "fast legs=4", "fast corners=x"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
