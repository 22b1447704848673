//! The stages `tags` and `feet` on inputs in memory, with their code.

use anyhow::{Result, anyhow};
use feet::events::Contact;
use feet::tag_tracker::{Frame, TagTracker};
use imaging::ImageView;
use reconstruction::pipeline::Findings;
use reconstruction::pipeline::stages::feet::feet;
use reconstruction::pipeline::stages::tags::{
    EyeCounts, camera, detection, report, report_repeated, rig_state, shoes,
};
use scene_bundle::outputs::feet::FootPose;
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::outputs::terrain::TerrainMesh;

use super::inputs::Inputs;

/// What the stages find.
pub(super) struct StageOutputs {
    /// Of the left and the right foot.
    pub(super) contacts: [Vec<Contact>; 2],
    /// At the poses of the trajectory, by foot.
    pub(super) poses: Vec<FootPose>,
    pub(super) losses: Vec<String>,
    pub(super) detections: usize,
}

/// Runs both stages; `ground` is the mesh of the stage `terrain`.
///
/// # Errors
/// A detection whose covariance is none.
pub(super) fn run(inputs: &Inputs, ground: &TerrainMesh) -> Result<StageOutputs> {
    let findings = Findings::default();
    let detections = detections(inputs, &findings)?;
    let found = feet(
        &inputs.rig,
        &inputs.trajectory,
        &detections,
        ground,
        &findings,
    );
    Ok(StageOutputs {
        contacts: found.contacts(),
        poses: found.poses().collect(),
        losses: findings.into_report().losses,
        detections: detections.len(),
    })
}

fn detections(inputs: &Inputs, findings: &Findings) -> Result<Vec<TagDetection>> {
    let (shoes, ids) = shoes(&inputs.rig);
    let cameras = inputs.rig.cameras.iter().map(camera).collect();
    let mut tracker = TagTracker::new(shoes, cameras, feet::Config::default());
    let mut eyes = EyeCounts::default();
    let mut seen = 0;
    let mut all = Vec::new();
    for frame in &inputs.frames {
        let time_ns = frame.time_ns + inputs.time_offset_ns;
        let mut grays = [frame.gray(0), frame.gray(1)];
        let is_black = |from_ns: i64| frame.time_ns >= from_ns;
        if inputs.right_black_from_ns.is_some_and(is_black) {
            grays[1].fill(0);
        }
        let (width, height) = (frame.width / 2, frame.height);
        let images = grays
            .each_ref()
            .map(|gray| ImageView::packed(width, height, gray).expect("whole images"));
        let mut found = tracker.add(&Frame {
            camera: 0,
            time_ns,
            images,
            exposure_s: frame.exposure.seconds,
            rig: rig_state(&inputs.trajectory, time_ns),
        });
        let tag = |seen: &feet::tag_tracker::Detection| {
            let (foot, ids) = &ids[seen.shoe];
            (*foot, ids[seen.tag])
        };
        found.sort_by_key(|own| tag(own).1);
        seen += u64::from(!found.is_empty());
        for own in &found {
            let row = detection(own, tag(own), frame.number).map_err(|error| anyhow!(error))?;
            eyes.count(own, &row);
            all.push(row);
        }
    }
    let count = inputs.frames.len() as u64;
    report(findings, &eyes, &inputs.rig.cameras, seen, count);
    report_repeated(findings, tracker.repeated_images(), count);
    Ok(all)
}
