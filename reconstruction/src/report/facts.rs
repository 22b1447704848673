//! The table at the head of the page: session, rig and what the bundle has.

use charts::Table;
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::rig::{RigCamera, RigModel, RigShoeTag};
use scene_bundle::outputs::{self, KEYFRAMES, RIG};
use scene_bundle::{BundleError, Scene, Trajectory};

use super::judgement;

/// The table.
pub(super) fn table(
    scene: &Scene,
    trajectory: &Trajectory,
    cloud: Option<&[CloudPoint]>,
) -> Result<Table, BundleError> {
    let provenance = &scene.manifest().provenance;
    let keyframes = match scene.has(KEYFRAMES) {
        true => Some(outputs::keyframes::read(&scene.output(KEYFRAMES)?)?.len()),
        false => None,
    };
    let none = || "none".to_owned();
    let rows = [
        ("session", provenance.session_id.clone()),
        ("verdict", judgement::in_short(provenance)),
        (
            "rig",
            format!("{}, {}", provenance.rig.name, provenance.rig.revision),
        ),
        (
            "program",
            format!("{} {}", provenance.program, provenance.program_version),
        ),
        (
            "path length",
            format!(
                "{:.1} m in {:.1} s, {} poses",
                trajectory.path_length_m(),
                trajectory.duration_ns() as f64 * 1e-9,
                trajectory.len()
            ),
        ),
        (
            "keyframes with depth",
            keyframes.map_or_else(none, |n| n.to_string()),
        ),
        ("points", cloud.map_or_else(none, |c| c.len().to_string())),
    ];
    let rig = match scene.has(RIG) {
        true => Some(outputs::rig::read(&scene.output(RIG)?)?),
        false => None,
    };
    let settings = rig
        .iter()
        .flat_map(|rig| [cameras(rig, trajectory), tags(rig)]);
    let table = Table::new(Vec::<String>::new());
    let rows = rows.into_iter().chain(settings);
    Ok(rows.fold(table, |table, (what, value)| {
        table.row([what.into(), value.into()])
    }))
}

/// Sizes of the cameras' images, and their rate.
fn cameras(rig: &RigModel, trajectory: &Trajectory) -> (&'static str, String) {
    let size = |camera: &RigCamera| {
        let (width, height) = (camera.left.width, camera.left.height);
        format!("{} {width}x{height}", camera.name)
    };
    let sizes: Vec<String> = rig.cameras.iter().map(size).collect();
    let seconds = trajectory.duration_ns() as f64 * 1e-9;
    let rate = (trajectory.len().saturating_sub(1)) as f64 / seconds;
    let rate = match rate.is_finite() {
        true => format!("; {rate:.1} sets of frames per second"),
        false => String::new(),
    };
    ("images of an eye", format!("{}{rate}", sizes.join(", ")))
}

/// Sizes of the tags on the shoes.
fn tags(rig: &RigModel) -> (&'static str, String) {
    let shoes = rig.shoes.iter();
    let sizes = shoes.flat_map(|shoe| {
        let size = |tag: &RigShoeTag| format!("{} {:.0} mm", shoe.foot.as_str(), 1e3 * tag.size_m);
        shoe.tags.iter().map(size)
    });
    let sizes: Vec<String> = sizes.collect();
    let value = match sizes.is_empty() {
        true => "none".to_owned(),
        false => sizes.join(", "),
    };
    ("tags on shoes", value)
}
