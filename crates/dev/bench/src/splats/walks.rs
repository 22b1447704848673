//! The walks: six scenes by day, and three by night. No test and no other benchmark uses these
//! seeds.

use anyhow::{Result, bail};
use rig_sim::scene::{Kind, Lighting};

use crate::terrain::walks::{SMALL, Walk};

/// Length of a walk, s, and what is before it.
const LENGTH_S: f64 = 40.0;
const BEGIN_S: f64 = 3.0;

/// Scene, light and seed.
pub(crate) const WALKS: [(Kind, Lighting, u64); 9] = [
    (Kind::Pavement, Lighting::Day, 911),
    (Kind::Stairs, Lighting::Day, 912),
    (Kind::Trail, Lighting::Day, 913),
    (Kind::Room, Lighting::Day, 914),
    (Kind::Corridor, Lighting::Day, 915),
    (Kind::Plaza, Lighting::Day, 916),
    (Kind::Pavement, Lighting::Night, 911),
    (Kind::Room, Lighting::Night, 914),
    (Kind::Plaza, Lighting::Night, 916),
];

/// What to take of the walks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    /// Length, s.
    pub(crate) seconds: f64,
    /// Columns and rows of one eye.
    pub(crate) size: [u32; 2],
}

impl Extent {
    /// The whole walks, 672x376.
    pub(crate) const WHOLE: Self = Self {
        seconds: LENGTH_S,
        size: SMALL,
    };
}

/// Scene and light: `pavement`, `pavement-night`.
pub(crate) fn short_name(kind: Kind, light: Lighting) -> String {
    match light {
        Lighting::Day => kind.name().to_owned(),
        _ => format!("{}-{}", kind.name(), light.name()),
    }
}

/// The walks of these short names; all of them without a name.
///
/// # Errors
/// There is no such walk.
pub(crate) fn walks(names: &[String], extent: Extent) -> Result<Vec<Walk>> {
    let of = |(kind, light, seed): &(Kind, Lighting, u64)| Walk {
        kind: *kind,
        light: *light,
        seed: *seed,
        span_s: [BEGIN_S, BEGIN_S + extent.seconds],
        size: extent.size,
    };
    if names.is_empty() {
        return Ok(WALKS.iter().map(of).collect());
    }
    let mut found = Vec::new();
    for name in names {
        let is_it = |(kind, light, _): &&(Kind, Lighting, u64)| short_name(*kind, *light) == *name;
        let Some(walk) = WALKS.iter().find(is_it) else {
            let all: Vec<String> = WALKS.iter().map(|(k, l, _)| short_name(*k, *l)).collect();
            bail!(
                "there is no walk {name:?}, expected one of {}",
                all.join(", ")
            );
        };
        found.push(of(walk));
    }
    Ok(found)
}
