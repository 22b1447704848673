//! ONNX Runtime, loaded at run time.
//!
//! Contract: nothing is downloaded and the system is not searched, so that the same command uses
//! the same library. A missing, outdated or invalid library is an error. A process loads one ONNX
//! Runtime and keeps it until it ends.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ort::environment::Environment;
use ort::logging::LogLevel;

use crate::error::LearnedError;

/// Environment variable with the path of the library, used if no argument is given.
pub const RUNTIME_PATH_VARIABLE: &str = "ORT_DYLIB_PATH";

/// The runtime of this process. An ONNX Runtime environment cannot be created again after it was
/// dropped.
static LOADED: Mutex<Option<Runtime>> = Mutex::new(None);

/// Handle of the loaded ONNX Runtime.
#[derive(Clone, Debug)]
pub struct Runtime {
    library: PathBuf,
    environment: Environment,
}

impl Runtime {
    /// Loads the library at `path`, or by default the one that the environment variable
    /// [`RUNTIME_PATH_VARIABLE`] names.
    ///
    /// # Errors
    /// [`LearnedError::NoLibrary`], [`LearnedError::Library`], and [`LearnedError::OtherLibrary`]
    /// if this process has loaded another one.
    pub fn load(path: Option<&Path>) -> Result<Self, LearnedError> {
        let library = library(path, std::env::var_os(RUNTIME_PATH_VARIABLE))?;
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(there) = &*loaded {
            if there.library != library {
                return Err(LearnedError::OtherLibrary {
                    loaded: there.library.clone(),
                    requested: library,
                });
            }
            return Ok(there.clone());
        }
        let unusable = |source| LearnedError::Library {
            library: library.clone(),
            source,
        };
        // Only `init_from` reports an unusable library; every other call of ort loads a library
        // implicitly, or panics.
        let environment = ort::init_from(&library)
            .map_err(|e| unusable(Box::new(e)))?
            .with_telemetry(false)
            .build()
            .map_err(|e| unusable(Box::new(e)))?;
        // Errors are returned, and not logged as well.
        environment.set_log_level(LogLevel::Fatal);
        let runtime = Self {
            library,
            environment,
        };
        *loaded = Some(runtime.clone());
        Ok(runtime)
    }

    /// Path of the library.
    pub fn library(&self) -> &Path {
        &self.library
    }

    pub(crate) fn environment(&self) -> &Environment {
        &self.environment
    }
}

/// Absolute path of the library; ort would resolve a relative one against the folder of the program
/// first.
fn library(argument: Option<&Path>, variable: Option<OsString>) -> Result<PathBuf, LearnedError> {
    let variable = variable.filter(|v| !v.is_empty()).map(PathBuf::from);
    let (path, from) = match (argument, variable) {
        (Some(path), _) => (path.to_owned(), "the given path".to_owned()),
        (None, Some(path)) => (
            path,
            format!("the environment variable {RUNTIME_PATH_VARIABLE}"),
        ),
        (None, None) => {
            let found = format!(
                "no path was given, and the environment variable {RUNTIME_PATH_VARIABLE} is not set"
            );
            return Err(LearnedError::NoLibrary { found });
        }
    };
    match std::path::absolute(&path) {
        Ok(absolute) if absolute.is_file() => Ok(absolute),
        _ => {
            let found = format!("{from} leads to no file, {}", path.display());
            Err(LearnedError::NoLibrary { found })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn argument_has_precedence_over_the_variable() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = ["first.so", "second.so"].map(|name| folder.path().join(name));
        std::fs::write(&first, b"").unwrap();
        std::fs::write(&second, b"").unwrap();
        let variable = || Some(second.clone().into_os_string());
        assert_eq!(library(Some(&first), variable()).unwrap(), first);
        assert_eq!(library(None, variable()).unwrap(), second);
    }

    #[test]
    fn missing_library_error_names_the_source_of_the_path() {
        for variable in [None, Some(OsString::new())] {
            let error = library(None, variable).unwrap_err().to_string();
            assert!(error.contains("no path was given"), "{error}");
            assert!(error.contains(RUNTIME_PATH_VARIABLE), "{error}");
        }
        let error = library(None, Some("/nowhere/lib.so".into())).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("ORT_DYLIB_PATH leads to no file, /nowhere/lib.so")
        );
        let error = library(Some(Path::new("/nowhere/a.so")), Some("b".into())).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("the given path leads to no file, /nowhere/a.so")
        );
    }

    #[test]
    fn invalid_library_is_an_error_and_does_not_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("libonnxruntime.so");
        std::fs::write(&path, b"not a library").unwrap();
        let error = Runtime::load(Some(&path)).unwrap_err();
        assert!(matches!(error, LearnedError::Library { .. }), "{error}");
        assert!(error.to_string().ends_with("libonnxruntime.so"), "{error}");
    }
}
