//! Faults as a TOML file.
//!
//! ```toml
//! [[fault]]
//! kind = "dropped"      # one of Kind::ALL
//! strength = 0.2        # in the kind's unit
//! from = 2.0            # s since the beginning of the walk; default 0
//! to = 4.0              # default: to the end
//! camera = "feet"       # default: all cameras
//!
//! [[fault]]
//! kind = "tag_dirt"     # of shoes and their tags
//! strength = 0.3
//! foot = "left"         # default: both
//! ```

use std::fmt::Write as _;

use serde::Deserialize;

use super::{Fault, FaultDuration, Faults, Kind, Subject};
use crate::walker::Side;

/// Error of reading a fault file: correct it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// Not TOML, an unknown key or a wrong type.
    #[error("reading the faults: {0}")]
    Syntax(String),
    /// Invalid values, one per line.
    #[error("reading the faults: {0}")]
    Values(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    fault: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    kind: String,
    strength: f64,
    #[serde(default)]
    from: f64,
    to: Option<f64>,
    camera: Option<String>,
    foot: Option<String>,
}

impl Faults {
    /// Parses a fault file. Camera names must be among `cameras`; `seed` selects the affected
    /// frames.
    ///
    /// # Errors
    /// [`FaultError`] lists all problems.
    pub fn parse(text: &str, cameras: &[&str], seed: u64) -> Result<Self, FaultError> {
        let file: File = toml::from_str(text).map_err(|e| FaultError::Syntax(e.to_string()))?;
        let mut problems = Vec::new();
        let mut list = Vec::new();
        for (i, entry) in file.fault.iter().enumerate() {
            let wrong = entry.problems(cameras);
            let numbered = wrong.iter().map(|what| format!("fault {}: {what}", i + 1));
            problems.extend(numbered);
            list.extend(entry.kind().map(|kind| Fault {
                kind,
                strength: entry.strength,
                from_s: entry.from,
                to_s: entry.to.unwrap_or(f64::INFINITY),
                camera: entry.camera.clone(),
                foot: entry.side(),
            }));
        }
        match problems.as_slice() {
            [] => Ok(Self { list, seed }),
            [only] => Err(FaultError::Values(only.clone())),
            all => {
                let listed = all.join("\n  ");
                let text = format!("{} problems\n  {listed}", all.len());
                Err(FaultError::Values(text))
            }
        }
    }

    /// The faults as TOML; [`Faults::parse`] reads it.
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        for fault in &self.list {
            let _ = writeln!(text, "[[fault]]");
            let _ = writeln!(text, "kind = {:?}", fault.kind.name());
            let _ = writeln!(text, "strength = {:?}", fault.strength);
            let _ = writeln!(text, "from = {:?}", fault.from_s);
            if fault.to_s.is_finite() {
                let _ = writeln!(text, "to = {:?}", fault.to_s);
            }
            if let Some(camera) = &fault.camera {
                let _ = writeln!(text, "camera = {camera:?}");
            }
            if let Some(side) = fault.foot {
                let _ = writeln!(text, "foot = {:?}", side.name());
            }
            text.push('\n');
        }
        text
    }
}

impl Entry {
    fn kind(&self) -> Option<Kind> {
        Kind::ALL.into_iter().find(|k| k.name() == self.kind)
    }

    fn side(&self) -> Option<Side> {
        let name = self.foot.as_deref()?;
        [Side::Left, Side::Right]
            .into_iter()
            .find(|s| s.name() == name)
    }

    /// All problems of one entry.
    fn problems(&self, cameras: &[&str]) -> Vec<String> {
        let name = &self.kind;
        let Some(kind) = self.kind() else {
            let names = Kind::ALL.map(Kind::name).join(", ");
            return vec![format!("kind is {name:?}, expected one of {names}")];
        };
        let mut problems = Vec::new();
        let (range, unit) = (kind.range(), kind.unit());
        if !range.contains(&self.strength) {
            let (found, least, most) = (self.strength, range.start(), range.end());
            problems.push(format!(
                "strength of {name} is {found}, expected {least} to {most} ({unit})"
            ));
        }
        if !(0.0..f64::INFINITY).contains(&self.from) {
            let found = self.from;
            problems.push(format!("from is {found} s, expected 0 or a later time"));
        }
        match (kind.duration(), self.to) {
            (_, None) => {}
            (FaultDuration::UntilEnd, Some(to)) if to > self.from => {}
            (FaultDuration::UntilEnd, Some(to)) => {
                let from = self.from;
                problems.push(format!("to is {to} s, expected a time after {from} s"));
            }
            (FaultDuration::Instant, Some(_)) => {
                problems.push(format!("to is given, but {name} has no end"));
            }
            (FaultDuration::ByStrength, Some(_)) => problems.push(format!(
                "to is given, but {name} lasts for its strength in seconds"
            )),
        }
        if let Some(camera) = &self.camera
            && !cameras.contains(&camera.as_str())
        {
            let known = cameras.join(", ");
            problems.push(format!("camera is {camera:?}, expected one of {known}"));
        }
        if let Some(foot) = &self.foot
            && self.side().is_none()
        {
            problems.push(format!("foot is {foot:?}, expected \"left\" or \"right\""));
        }
        let subject = kind.subject();
        if self.camera.is_some() && subject != Subject::Camera {
            problems.push(format!(
                "camera is given, but {name} does not act on a camera"
            ));
        }
        if self.foot.is_some() && subject != Subject::Foot {
            problems.push(format!("foot is given, but {name} does not act on a foot"));
        }
        problems
    }
}
