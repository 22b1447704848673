//! Validation of a table of stages, and selection of those that run.

use std::collections::BTreeSet;
use std::ops::Range;

use scene_bundle::layout;

use super::error::PipelineError;
use super::selection::Selection;
use super::stage::Stage;

pub(super) fn check<S: ?Sized>(
    stages: &[Box<dyn Stage<S>>],
    sources: &[&str],
) -> Result<(), PipelineError> {
    let mut known: BTreeSet<&str> = sources.iter().copied().collect();
    let mut names = BTreeSet::new();
    for stage in stages {
        let name = stage.name();
        let wrong = |what: String| Err(PipelineError::Table(format!("stage {name} {what}")));
        if !names.insert(name) {
            return wrong("is listed twice".to_owned());
        }
        if stage.outputs().is_empty() {
            return wrong("writes nothing".to_owned());
        }
        if let Some(input) = stage.inputs().iter().find(|i| !known.contains(**i)) {
            return wrong(format!("reads {input}, which no earlier stage writes"));
        }
        for output in stage.outputs() {
            if !layout::is_output_name(output) {
                return wrong(format!(
                    "writes {output:?}, which is not a valid name of an output"
                ));
            }
            if !known.insert(output) {
                return wrong(format!("writes {output}, which exists already"));
            }
        }
    }
    Ok(())
}

/// The stages from the first to the last that are to run.
pub(super) fn range<S: ?Sized>(
    stages: &[Box<dyn Stage<S>>],
    selection: &Selection,
) -> Result<Range<usize>, PipelineError> {
    let position = |name: &str| {
        let found = stages.iter().position(|s| s.name() == name);
        found.ok_or_else(|| {
            let known: Vec<&str> = stages.iter().map(|s| s.name()).collect();
            PipelineError::NoStage {
                found: name.to_owned(),
                known: known.join(", "),
            }
        })
    };
    let from = selection.from.as_deref().map_or(Ok(0), position)?;
    let to = match selection.to.as_deref() {
        Some(to) => position(to)? + 1,
        None => stages.len(),
    };
    match (selection.from.as_ref(), selection.to.as_ref()) {
        (Some(first), Some(last)) if from >= to => Err(PipelineError::Order {
            from: first.clone(),
            to: last.clone(),
        }),
        _ => Ok(from..to),
    }
}
