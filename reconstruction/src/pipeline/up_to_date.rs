//! Whether what a stage would make is there already.

use std::collections::BTreeMap;

use scene_bundle::{Manifest, Record, Scene};

use super::Stage;

/// How the stage's outputs would be made now. An input that is not there has no hash, so that nothing is like it.
pub(super) fn record<S: ?Sized>(
    stage: &dyn Stage<S>,
    manifest: &Manifest,
    sources: &BTreeMap<String, String>,
) -> Record {
    let hash = |name: &&str| {
        let output = manifest.outputs.get(*name).map(|o| &o.hash);
        let hash = output.or_else(|| sources.get(*name))?;
        Some(((*name).to_owned(), hash.clone()))
    };
    Record {
        stage: stage.name().to_owned(),
        stage_version: stage.version(),
        settings: stage.settings(),
        inputs: stage.inputs().iter().filter_map(hash).collect(),
    }
}

/// Whether all outputs of a stage were made so and all their files are as they were written: what a disk or a hand has changed
/// is made again.
pub(super) fn is_up_to_date<S: ?Sized>(
    stage: &dyn Stage<S>,
    scene: &Scene,
    record: &Record,
) -> bool {
    stage.outputs().iter().all(|name| {
        let made = scene.manifest().outputs.get(*name);
        made.is_some_and(|output| output.is_made_by(record)) && scene.is_whole(name)
    })
}

/// Hashes of a stage's outputs.
pub(super) fn hashes<S: ?Sized>(
    stage: &dyn Stage<S>,
    manifest: &Manifest,
) -> BTreeMap<&'static str, String> {
    let hash = |name: &&'static str| Some((*name, manifest.outputs.get(*name)?.hash.clone()));
    stage.outputs().iter().filter_map(hash).collect()
}
