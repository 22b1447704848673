//! Columns of a world as arrays.

use numpy::{Element, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulation::{EndReason, StepResult, World};

/// Numbers of a step by name, in the types of `info`. Counts are 32 bits, distances in m, angles
/// in rad.
pub(crate) fn numbers<'py>(py: Python<'py>, result: &StepResult) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    let goal = EndReason::Goal as i8;
    let is_success = result.end_reasons.iter().map(|reason| *reason == goal);
    all.set_item("end_reason", PyArray1::from_slice(py, &result.end_reasons))?;
    all.set_item("is_success", PyArray1::from_iter(py, is_success))?;
    all.set_item("blocked", PyArray1::from_slice(py, &result.blocked))?;
    all.set_item("deviation_m", PyArray1::from_slice(py, &result.deviation_m))?;
    all.set_item(
        "deviation_rad",
        PyArray1::from_slice(py, &result.deviation_rad),
    )?;
    all.set_item("support_db", PyArray1::from_slice(py, &result.support_db))?;
    all.set_item("collisions", PyArray1::from_slice(py, &result.collisions))?;
    all.set_item("clipped", PyArray1::from_slice(py, &result.clipped))?;
    all.set_item("steps", PyArray1::from_slice(py, &result.steps))?;
    all.set_item(
        "path_length_m",
        PyArray1::from_slice(py, &result.path_length_m),
    )?;
    all.set_item("remaining_m", PyArray1::from_slice(py, &result.remaining_m))?;
    all.set_item("spl", PyArray1::from_slice(py, &result.spl))?;
    all.set_item("soft_spl", PyArray1::from_slice(py, &result.soft_spl))?;
    all.set_item("frame_age_s", PyArray1::from_slice(py, &result.frame_age_s))?;
    Ok(all)
}

/// Agents by name of the quantity.
pub(crate) fn states<'py>(py: Python<'py>, world: &World) -> PyResult<Bound<'py, PyDict>> {
    let (all, states) = (PyDict::new(py), world.states());
    let sectors = (0..states.len()).map(|index| world.world_from_camera(index).0 as i64);
    all.set_item("sector", column(py, sectors))?;
    all.set_item(
        "level",
        column(py, states.iter().map(|state| state.level as i64)),
    )?;
    let triples = |values: Vec<f64>| PyArray1::from_vec(py, values).reshape([states.len(), 3]);
    let positions = states.iter().flat_map(|state| state.position_m).collect();
    all.set_item("position_m", triples(positions)?)?;
    let angles = |state: &simulation::AgentState| [state.yaw_rad, state.pitch_rad, state.roll_rad];
    all.set_item(
        "angles_rad",
        triples(states.iter().flat_map(angles).collect())?,
    )?;
    let velocities = states.iter().flat_map(|state| state.velocity).collect();
    all.set_item("velocity", triples(velocities)?)?;
    let goals = (0..states.len()).flat_map(|index| world.goal_m(index).unwrap_or([f64::NAN; 3]));
    all.set_item("goal_m", triples(goals.collect())?)?;
    all.set_item(
        "is_on_ground",
        column(py, states.iter().map(|state| state.is_on_ground)),
    )?;
    Ok(all)
}

fn column<'py, T: Element>(
    py: Python<'py>,
    values: impl Iterator<Item = T>,
) -> Bound<'py, PyArray1<T>> {
    PyArray1::from_vec(py, values.collect())
}
