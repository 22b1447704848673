//! `paws rig diff`.

use anyhow::Result;
use cad_transforms::Rig;
use cad_transforms::rig::diff::{Change, Motion, diff, other_changes};
use console_output::text::count;
use console_output::{Console, Outcome};

/// Prints the changes: pose by pose, then all others as text.
pub(super) fn run(a: &Rig, b: &Rig, console: &mut Console<'_>) -> Result<Outcome> {
    for (name, rig) in [("a", a), ("b", b)] {
        console.line(format!(
            "{name}  {}, revision {}, {}: {}",
            rig.name(),
            rig.revision(),
            rig.provenance().kind.as_str(),
            rig.provenance().note
        ))?;
    }
    let changes = diff(a, b);
    let width = changes
        .iter()
        .map(|d| d.frame.as_str().len())
        .max()
        .unwrap_or(0)
        .max(5);
    console.line(format!(
        "{:width$}  {:>9} {:>9} {:>7}   {:>9} {:>9} {:>7}   in its own axes, mm",
        "frame", "mm in rig", "deg", "sigmas", "mm joint", "deg", "sigmas"
    ))?;
    let mut changed = 0;
    for change in &changes {
        let frame = change.frame.as_str();
        match &change.change {
            Change::Added => {
                changed += 1;
                console.line(format!("{frame:width$}  only in b"))?;
            }
            Change::Removed => {
                changed += 1;
                console.line(format!("{frame:width$}  only in a"))?;
            }
            Change::Moved {
                in_rig,
                in_neighbour,
            } => {
                let joint = in_neighbour.as_ref();
                changed += u64::from(in_rig.is_one() || joint.is_some_and(|(_, m)| m.is_one()));
                let joint = match in_neighbour {
                    Some((_, motion)) => figures(motion),
                    None => format!("{:>27}", "another parent"),
                };
                let [x, y, z] = in_rig.motion.translation_m().map(|v| 1e3 * v + 0.0);
                console.line(format!(
                    "{frame:width$}  {}   {joint}   [{x:+.3}, {y:+.3}, {z:+.3}]",
                    figures(in_rig)
                ))?;
            }
        }
    }
    let others = other_changes(a, b);
    for other in &others {
        console.line(other)?;
    }
    let frames = count(changed, "frame");
    let more = count(others.len() as u64, "other change");
    console.line(match (changed, others.len()) {
        (0, 0) => "nothing changed".to_owned(),
        (_, 0) => format!("{frames} changed"),
        (0, _) => format!("no frame changed, {more}"),
        _ => format!("{frames} changed, {more}"),
    })?;
    Ok(if changed == 0 && others.is_empty() {
        Outcome::Fine
    } else {
        Outcome::Loss
    })
}

/// Millimetres, degrees and sigmas.
fn figures(motion: &Motion) -> String {
    let sigmas = match motion.sigmas {
        Some(sigmas) if sigmas.is_infinite() => "fixed".to_owned(),
        Some(sigmas) => format!("{sigmas:.1}"),
        None => "-".to_owned(),
    };
    format!(
        "{:9.3} {:9.4} {sigmas:>7}",
        1e3 * motion.motion.distance_m(),
        motion.motion.angle_rad().to_degrees()
    )
}
