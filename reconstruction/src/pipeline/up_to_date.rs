//! Whether the outputs of a stage are up to date.

use std::collections::BTreeMap;

use scene_bundle::{Manifest, Record, Scene};

use super::stage::Stage;

/// Record that the stage's outputs would have now. A missing input has no hash, so that no record
/// equals it.
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

/// Whether all outputs of a stage have this record and all their files are intact: damaged or
/// edited outputs are recomputed.
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
