//! `paws rig diff`.

use anyhow::Result;
use cad_transforms::Rig;
use cad_transforms::rig::diff::{Change, Motion, diff};

use crate::console::Console;
use crate::outcome::Outcome;
use crate::text::count;

/// What is less than this is rounding, m and rad.
const ROUNDING: f64 = 1e-9;

/// Prints what changed, frame by frame.
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
                let moved = |m: &Motion| {
                    m.motion.distance_m() > ROUNDING || m.motion.angle_rad() > ROUNDING
                };
                changed += u64::from(
                    moved(in_rig) || in_neighbour.as_ref().is_some_and(|(_, m)| moved(m)),
                );
                let joint = match in_neighbour {
                    Some((_, motion)) => figures(motion),
                    None => format!("{:>27}", "hung elsewhere"),
                };
                let [x, y, z] = in_rig.motion.translation_m().map(|v| 1e3 * v + 0.0);
                console.line(format!(
                    "{frame:width$}  {}   {joint}   [{x:+.3}, {y:+.3}, {z:+.3}]",
                    figures(in_rig)
                ))?;
            }
        }
    }
    for camera in b.cameras() {
        if let (Some(was), Some(is)) = (a.serial(camera), b.serial(camera))
            && was != is
        {
            changed += 1;
            console.line(format!(
                "{camera} is another device: serial {was}, then {is}"
            ))?;
        }
    }
    console.line(match changed {
        0 => "nothing changed".to_owned(),
        n => format!("{} changed", count(n, "frame")),
    })?;
    Ok(if changed == 0 {
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
