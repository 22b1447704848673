//! Errors of the simulators as Python exceptions.

use std::error::Error;

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use simulation::SimulationError;

create_exception!(
    paws_sim,
    SceneError,
    PyException,
    "A scene that cannot be opened or used: missing or damaged files, contradictions."
);
create_exception!(
    paws_sim,
    SettingError,
    PyValueError,
    "A setting that is unknown or out of its range."
);
create_exception!(
    paws_sim,
    ActionError,
    PyValueError,
    "An action that is not finite or has another shape; no environment moved."
);
create_exception!(
    paws_sim,
    StartError,
    PyRuntimeError,
    "No start of an episode was found, with counts of what excluded the candidates."
);
create_exception!(
    paws_sim,
    BudgetError,
    PyMemoryError,
    "The memory that is allowed is less than what is needed; the message has both in bytes."
);
create_exception!(
    paws_sim,
    StateError,
    PyRuntimeError,
    "A call out of order: before the first reset, after the end, after close, after a fork."
);
create_exception!(
    paws_sim,
    SnapshotError,
    PyValueError,
    "A snapshot that is damaged or belongs to another scene or configuration."
);

/// Adds the exceptions to the module.
pub(crate) fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("SceneError", py.get_type::<SceneError>())?;
    module.add("SettingError", py.get_type::<SettingError>())?;
    module.add("ActionError", py.get_type::<ActionError>())?;
    module.add("StartError", py.get_type::<StartError>())?;
    module.add("BudgetError", py.get_type::<BudgetError>())?;
    module.add("StateError", py.get_type::<StateError>())?;
    module.add("SnapshotError", py.get_type::<SnapshotError>())
}

/// The exception for an error, with its causes in the message.
pub(crate) fn exception(error: &SimulationError) -> PyErr {
    let mut message = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        message.push_str(": ");
        message.push_str(&inner.to_string());
        cause = inner.source();
    }
    match error {
        SimulationError::Setting { .. } => SettingError::new_err(message),
        SimulationError::Action { .. } => ActionError::new_err(message),
        SimulationError::Start { .. } => StartError::new_err(message),
        SimulationError::Budget { .. } => BudgetError::new_err(message),
        SimulationError::State(_) => StateError::new_err(message),
        SimulationError::Snapshot { .. } => SnapshotError::new_err(message),
        _ => SceneError::new_err(message),
    }
}
