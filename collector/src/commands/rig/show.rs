//! `paws rig show`: poses of the frames, as a table and as drawings.

use std::path::Path;

use anyhow::{Context, Result};
use cad_transforms::cad::export::{self, Scene};
use cad_transforms::output::{self, Existing};
use cad_transforms::rig::check::{
    FEET_CAMERA, Facts, GROUND_BELOW_RIG_M, SHOES_X_M, SHOES_Y_M, view,
};
use cad_transforms::{Frame, FramePart, Rig};
use console_output::{Console, Outcome};

/// Length of frusta in glTF, m.
const FRUSTUM_DEPTH_M: f64 = 0.5;

/// Prints the rig and, if a folder is given, writes `rig.svg`, `rig.png` and `rig.gltf` into it.
pub(super) fn run(
    rig: &Rig,
    facts: &Facts,
    out: Option<&Path>,
    existing: Existing,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    table(rig, facts, console)?;
    let Some(out) = out else {
        return Ok(Outcome::Fine);
    };
    std::fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    let sheet = rig_drawing::draw(rig, facts);
    let scene = scene(rig, facts);
    let files = [
        ("rig.svg", sheet.svg().into_bytes()),
        ("rig.png", sheet.png().context("coding rig.png")?),
        ("rig.gltf", export::gltf(rig, &scene).into_bytes()),
    ];
    // All or none: old and new drawings in one folder would mislead.
    if existing == Existing::Refuse {
        for (name, _) in &files {
            let path = out.join(name);
            if path.exists() {
                return Err(output::WriteError::Exists { path }.into());
            }
        }
    }
    for (name, bytes) in files {
        output::write(&out.join(name), &bytes, existing)?;
        console.line(format!("wrote {}", out.join(name).display()))?;
    }
    Ok(Outcome::Fine)
}

fn scene(rig: &Rig, facts: &Facts) -> Scene {
    let of_camera = |camera: &str| {
        let (_, view) = view(rig, camera, facts)?;
        Some((Frame::of_camera(camera, FramePart::Left).ok()?, view))
    };
    let ground = -GROUND_BELOW_RIG_M;
    let [back, front] = SHOES_X_M;
    let [right, left] = SHOES_Y_M;
    let corners = [[back, right], [front, right], [front, left], [back, left]];
    Scene {
        views: rig.cameras().into_iter().filter_map(of_camera).collect(),
        depth_m: FRUSTUM_DEPTH_M,
        ground_z_m: Some(ground),
        outlines: vec![(
            "shoes".to_owned(),
            corners.map(|[x, y]| [x, y, ground]).to_vec(),
        )],
    }
}

fn table(rig: &Rig, facts: &Facts, console: &mut Console<'_>) -> Result<()> {
    let provenance = rig.provenance();
    console.line(format!(
        "rig        {}, revision {}",
        rig.name(),
        rig.revision()
    ))?;
    console.line(format!(
        "from       {}: {}",
        provenance.kind.as_str(),
        provenance.note
    ))?;
    if let Some(cad) = &provenance.cad {
        console.line(format!("CAD file   {}, blake3 {}", cad.file, cad.blake3))?;
    }
    for camera in rig.cameras() {
        let info = rig.camera_infos().iter().find(|info| info.name == camera);
        let model = info
            .and_then(|info| info.model.as_deref())
            .unwrap_or("model not stated");
        let serial = rig
            .serial(camera)
            .map_or("serial not stated".to_owned(), |s| format!("serial {s}"));
        let view = match view(rig, camera, facts) {
            Some((source, view)) => {
                let [h, v] = view.degrees();
                format!("view {h:.0} x {v:.0} deg of {source}")
            }
            None => "view not known".to_owned(),
        };
        console.line(format!("camera     {camera}: {model}, {serial}, {view}"))?;
    }
    console.line("")?;
    let names = tree(rig);
    let width = names
        .iter()
        .map(|(name, ..)| name.len())
        .max()
        .unwrap_or(0)
        .max(5);
    console.line(format!(
        "{:width$}  {:>9} {:>9} {:>9}  {:>6} {:>6}   {:>9} {:>9} {:>9}  {:>7} {:>7} {:>7}  {:>6} {:>6}",
        "", "in rig:", "", "", "view:", "", "in its", "parent:", "", "rot.", "deg", "", "sigma", ""
    ))?;
    console.line(format!(
        "{:width$}  {:>9} {:>9} {:>9}  {:>6} {:>6}   {:>9} {:>9} {:>9}  {:>7} {:>7} {:>7}  {:>6} {:>6}",
        "frame", "x mm", "y mm", "z mm", "left", "up", "x mm", "y mm", "z mm", "x", "y", "z", "mm", "deg"
    ))?;
    for (name, frame, neighbour) in &names {
        let rig_from_frame = rig.transform(&Frame::rig(), frame)?;
        let [x, y, z] = millimetres(rig_from_frame.translation_m());
        let view_angles = match frame.camera() {
            Some((_, FramePart::Left | FramePart::Right)) => {
                let [ahead, left, up] = rig_from_frame.rotate([0.0, 0.0, 1.0]);
                let side = left.atan2(ahead).to_degrees();
                let lift = up.clamp(-1.0, 1.0).asin().to_degrees();
                format!("{:6.1} {:6.1}", side + 0.0, lift + 0.0)
            }
            _ => " ".repeat(13),
        };
        let joint = match neighbour {
            None => String::new(),
            Some(neighbour) => {
                let from_frame = rig.transform(neighbour, frame)?;
                let [x, y, z] = millimetres(from_frame.translation_m());
                let sigma = match rig.covariance(neighbour, frame)? {
                    Some(covariance) => {
                        let s = covariance.sigmas();
                        let most = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
                        format!(
                            "{:6.2} {:6.2}",
                            1e3 * most(&s[..3]),
                            most(&s[3..]).to_degrees()
                        )
                    }
                    None => format!("{:>6} {:>6}", "-", "-"),
                };
                let turn = degrees(from_frame.rotation_vector());
                format!("{x:9.3} {y:9.3} {z:9.3}  {turn}  {sigma}")
            }
        };
        let line = format!("{name:width$}  {x:9.3} {y:9.3} {z:9.3}  {view_angles}   {joint}");
        console.line(line.trim_end())?;
    }
    if rig.cameras().contains(&FEET_CAMERA) {
        console.line("")?;
        console.line(format!(
            "view: degrees to the left of straight ahead, and up; sigma: the largest of its axes; ground {GROUND_BELOW_RIG_M} m below the datum"
        ))?;
    }
    Ok(())
}

/// Frames as a tree: indented name, frame, neighbour.
fn tree(rig: &Rig) -> Vec<(String, Frame, Option<Frame>)> {
    fn add(
        rig: &Rig,
        frame: &Frame,
        from: Option<&Frame>,
        depth: usize,
        lines: &mut Vec<(String, Frame, Option<Frame>)>,
    ) {
        let name = format!("{}{frame}", "  ".repeat(depth));
        lines.push((name, frame.clone(), from.cloned()));
        let mut next: Vec<Frame> = rig
            .edges()
            .iter()
            .filter_map(|edge| match (&edge.parent == frame, &edge.child == frame) {
                (true, _) => Some(edge.child.clone()),
                (_, true) => Some(edge.parent.clone()),
                _ => None,
            })
            .filter(|other| Some(other) != from)
            .collect();
        next.sort();
        for other in next {
            add(rig, &other, Some(frame), depth + 1, lines);
        }
    }
    let mut lines = Vec::new();
    add(rig, &Frame::rig(), None, 0, &mut lines);
    lines
}

fn millimetres(metres: [f64; 3]) -> [f64; 3] {
    // No sign if it rounds to zero.
    metres.map(|v| (1e6 * v).round() / 1e3 + 0.0)
}

/// A rotation vector in degrees.
pub(super) fn degrees(radians: [f64; 3]) -> String {
    let [x, y, z] = radians.map(|v| (v.to_degrees() * 1e3).round() / 1e3 + 0.0);
    format!("{x:7.2} {y:7.2} {z:7.2}")
}
