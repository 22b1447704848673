//! Configurations of odometry by name: a preset, and differences from it, as in
//! `balanced frontend.max_features=40`.

use ::odometry::{Config, Preset};
use anyhow::{Context, Result, bail};
use serde_json::Value;

/// The configuration that a name stands for.
///
/// # Errors
/// Unknown name, or a value of another type.
pub(crate) fn parse(name: &str) -> Result<Config> {
    let mut words = name.split_whitespace();
    let preset = match words.next() {
        Some("fast") => Preset::Fast,
        Some("balanced") => Preset::Balanced,
        Some("accurate") => Preset::Accurate,
        other => bail!("found the preset {other:?}, expected fast, balanced or accurate"),
    };
    let mut config = serde_json::to_value(Config::preset(preset))?;
    for word in words {
        let (key, value) = word
            .split_once('=')
            .with_context(|| format!("found {word:?}, expected KEY=VALUE"))?;
        let pointer = format!("/{}", key.replace('.', "/"));
        let field = config.pointer_mut(&pointer).with_context(|| {
            format!("found {key:?}, expected a field of odometry's configuration as in backend.window_size")
        })?;
        *field = serde_json::from_str::<Value>(value)
            .with_context(|| format!("reading the value of {key}"))?;
    }
    serde_json::from_value(config).with_context(|| format!("reading {name:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_presets_with_differences() {
        let balanced = Config::preset(Preset::Balanced);
        assert_eq!(parse("balanced").expect("a preset"), balanced);
        let other = "balanced frontend.max_features=40 backend.max_iterations=9";
        let other = parse(other).expect("a name");
        assert_eq!(other.frontend.max_features, 40);
        assert_eq!(other.backend.max_iterations, 9);
        assert_eq!(other.mapping, balanced.mapping);
        for wrong in [
            "",
            "slow",
            "fast frontend.max_features",
            "fast legs=4",
            "fast frontend.max_features=x",
            "fast frontend.max_features=0.5",
        ] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
