//! Settings as JSON, with errors that name the setting.

use cad_transforms::RigidTransform;
use pyo3::PyResult;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::error::SettingError;

/// Any JSON.
///
/// # Errors
/// [`SettingError`] for another text.
pub(crate) fn json<T: DeserializeOwned>(place: &str, text: &str) -> PyResult<T> {
    serde_json::from_str(text).map_err(|error| wrong(place, &error))
}

/// The value of a setting.
///
/// # Errors
/// [`SettingError`] with its name, for a value of another type.
pub(crate) fn value<T: DeserializeOwned>(place: &str, value: Value) -> PyResult<T> {
    serde_json::from_value(value).map_err(|error| wrong(place, &error))
}

/// Settings that have a default each.
///
/// # Errors
/// [`SettingError`] with the name of the first that is unknown or of another type.
pub(crate) fn fields<T: DeserializeOwned>(place: &str, settings: Value) -> PyResult<T> {
    for (name, one) in settings.as_object().into_iter().flatten() {
        let alone = Map::from_iter([(name.clone(), one.clone())]);
        value::<T>(&format!("{place}.{name}"), Value::Object(alone))?;
    }
    value(place, settings)
}

/// A pose of a homogeneous matrix as JSON.
///
/// # Errors
/// [`SettingError`] for a matrix that is not a rotation and a translation.
pub(crate) fn pose(matrix: &[[f64; 4]; 4]) -> PyResult<String> {
    let rows = std::array::from_fn(|k| matrix[k / 4][k % 4]);
    let pose = RigidTransform::from_rows_4x4(rows)
        .map_err(|error| SettingError::new_err(format!("camera.mount: {error}")))?;
    serde_json::to_string(&pose).map_err(|error| wrong("camera.mount", &error))
}

fn wrong(place: &str, error: &serde_json::Error) -> pyo3::PyErr {
    SettingError::new_err(format!("{place}: {error}"))
}
