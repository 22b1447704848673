//! ONNX Runtime, a library that is loaded while the program runs.
//!
//! Contract: nothing is downloaded and nothing is searched for in the system, so that the same command uses the same library. A
//! library that is missing, too old or something else is an error. A process has one ONNX Runtime, until its end.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ort::environment::Environment;
use ort::logging::LogLevel;

use crate::error::LearnedError;

/// Names the library where no argument does.
pub const RUNTIME_PATH_VARIABLE: &str = "ORT_DYLIB_PATH";

/// The one of this process. An environment that was dropped cannot be made again.
static LOADED: Mutex<Option<Runtime>> = Mutex::new(None);

/// ONNX Runtime, loaded.
#[derive(Clone, Debug)]
pub struct Runtime {
    library: PathBuf,
    environment: Environment,
}

impl Runtime {
    /// Loads the library at `path`, or where there is none that which the environment variable [`RUNTIME_PATH_VARIABLE`] names.
    ///
    /// # Errors
    /// [`LearnedError::NoLibrary`], [`LearnedError::Library`], and [`LearnedError::OtherLibrary`] if this process has another one.
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
        // Only `init_from` reports a library that cannot be used; every other call of ort loads one by itself, or panics.
        let environment = ort::init_from(&library)
            .map_err(|e| unusable(Box::new(e)))?
            .with_telemetry(false)
            .build()
            .map_err(|e| unusable(Box::new(e)))?;
        // What goes wrong is returned, and not printed as well.
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

/// Absolute path of the library; ort would look for a relative one beside the program first.
fn library(argument: Option<&Path>, variable: Option<OsString>) -> Result<PathBuf, LearnedError> {
    let variable = variable.filter(|v| !v.is_empty()).map(PathBuf::from);
    let (path, from) = match (argument, variable) {
        (Some(path), _) => (path.to_owned(), "the path that was given".to_owned()),
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
    fn the_argument_goes_before_the_variable() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = ["first.so", "second.so"].map(|name| folder.path().join(name));
        std::fs::write(&first, b"").unwrap();
        std::fs::write(&second, b"").unwrap();
        let variable = || Some(second.clone().into_os_string());
        assert_eq!(library(Some(&first), variable()).unwrap(), first);
        assert_eq!(library(None, variable()).unwrap(), second);
    }

    #[test]
    fn what_was_looked_for_is_told() {
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
                .contains("given leads to no file, /nowhere/a.so")
        );
    }

    #[test]
    fn what_is_no_library_is_an_error_and_no_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("libonnxruntime.so");
        std::fs::write(&path, b"not a library").unwrap();
        let error = Runtime::load(Some(&path)).unwrap_err();
        assert!(matches!(error, LearnedError::Library { .. }), "{error}");
        assert!(error.to_string().ends_with("libonnxruntime.so"), "{error}");
    }
}
