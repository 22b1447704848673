//! Network: a model file and its ONNX Runtime session.

use std::path::{Path, PathBuf};

use ort::session::Session;
use ort::value::{DynValue, Outlet, Shape, TensorElementType, ValueType};

use crate::error::LearnedError;
use crate::input::Input;
use crate::output::Output;
use crate::runtime::Runtime;
use crate::settings::Text;

#[derive(Debug)]
pub(crate) struct Network {
    file: PathBuf,
    hash: String,
    session: Session,
    output: usize,
}

/// Maximum size of a network file, bytes: the limit of its format.
const MAX_BYTES: u64 = 2 << 30;

impl Network {
    /// Opens a network and selects `output`, or its only output.
    ///
    /// # Errors
    /// [`LearnedError::Read`], [`LearnedError::Model`], and [`LearnedError::Tensor`] if the output
    /// is ambiguous or missing.
    pub(crate) fn open(
        runtime: &Runtime,
        file: &Path,
        settings: &Text,
        output: Option<&str>,
    ) -> Result<Self, LearnedError> {
        let bytes = plain_file::read(file, MAX_BYTES).map_err(|source| LearnedError::Read {
            what: "a network",
            file: file.to_owned(),
            source,
        })?;
        // The session is created from the hashed bytes and the file is not read again, so that the
        // hash identifies what runs.
        let session = session(runtime, &bytes).map_err(|source| LearnedError::Model {
            file: file.to_owned(),
            source,
        })?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(&bytes);
        hasher.update(settings.text.as_bytes());
        let output = select(session.outputs(), output, "output", file)?;
        Ok(Self {
            file: file.to_owned(),
            hash: hasher.finalize().to_hex().to_string(),
            session,
            output,
        })
    }

    /// BLAKE3 of the network and its settings, hexadecimal.
    pub(crate) fn hash(&self) -> &str {
        &self.hash
    }

    /// The inputs, which must be `count` images.
    ///
    /// # Errors
    /// [`LearnedError::Tensor`].
    pub(crate) fn inputs(&self, count: usize) -> Result<Vec<Input>, LearnedError> {
        let inputs = self.session.inputs();
        if inputs.len() != count {
            let tensor = "the number of inputs".to_owned();
            let found = format!("{} ({})", inputs.len(), names(inputs));
            return Err(mismatch(&self.file, tensor, found, count.to_string()));
        }
        inputs.iter().map(|i| Input::new(i, &self.file)).collect()
    }

    /// Index of the input with this name.
    ///
    /// # Errors
    /// [`LearnedError::Tensor`].
    pub(crate) fn input(&self, name: &str) -> Result<usize, LearnedError> {
        select(self.session.inputs(), Some(name), "input", &self.file)
    }

    /// Type and shape of the output; -1 for unknown lengths, and an empty shape for an unknown
    /// rank.
    ///
    /// # Errors
    /// [`LearnedError::Tensor`] if the output is not a tensor.
    pub(crate) fn output(
        &self,
        expected: &str,
    ) -> Result<(TensorElementType, &Shape), LearnedError> {
        match self.outlet().dtype() {
            ValueType::Tensor { ty, shape, .. } => Ok((*ty, shape)),
            other => Err(self.wrong_output(describe(other), expected)),
        }
    }

    /// Error for an unexpected output.
    pub(crate) fn wrong_output(&self, found: String, expected: &str) -> LearnedError {
        let tensor = format!("output `{}`", self.outlet().name());
        mismatch(&self.file, tensor, found, expected.to_owned())
    }

    /// Error for an unexpected declared type or shape of the output.
    pub(crate) fn unfit(&self, expected: &str) -> LearnedError {
        self.wrong_output(describe(self.outlet().dtype()), expected)
    }

    /// # Errors
    /// [`LearnedError::Run`].
    pub(crate) fn run(
        &mut self,
        tensors: Vec<(&str, ort::Result<DynValue>)>,
    ) -> Result<Output, LearnedError> {
        let name = self.outlet().name().to_owned();
        run(&mut self.session, &name, tensors).map_err(|source| LearnedError::Run {
            file: self.file.clone(),
            source,
        })
    }

    fn outlet(&self) -> &Outlet {
        &self.session.outputs()[self.output]
    }
}

fn session(runtime: &Runtime, bytes: &[u8]) -> ort::Result<Session> {
    Session::builder(runtime.environment())?
        .with_deterministic_compute(true)?
        .commit_from_memory(bytes)
}

fn run(
    session: &mut Session,
    output: &str,
    tensors: Vec<(&str, ort::Result<DynValue>)>,
) -> ort::Result<Output> {
    let tensors = tensors
        .into_iter()
        .map(|(name, tensor)| Ok((name, tensor?)))
        .collect::<ort::Result<Vec<_>>>()?;
    let outputs = session.run(tensors)?;
    Output::new(&outputs[output])
}

/// Index of the outlet with this name, or of the only one if no name is given.
fn select(
    outlets: &[Outlet],
    name: Option<&str>,
    what: &str,
    file: &Path,
) -> Result<usize, LearnedError> {
    let index = match name {
        Some(name) => outlets.iter().position(|o| o.name() == name),
        None => (outlets.len() == 1).then_some(0),
    };
    index.ok_or_else(|| {
        let expected = match name {
            Some(name) => format!("`{name}` among them, which the settings name"),
            None => "one, or the name of one in the settings".to_owned(),
        };
        mismatch(
            file,
            format!("the list of {what}s"),
            names(outlets),
            expected,
        )
    })
}

pub(crate) fn mismatch(
    file: &Path,
    tensor: String,
    found: String,
    expected: String,
) -> LearnedError {
    LearnedError::Tensor {
        file: file.to_owned(),
        tensor,
        found,
        expected,
    }
}

fn names(outlets: &[Outlet]) -> String {
    let names: Vec<String> = outlets.iter().map(|o| format!("`{}`", o.name())).collect();
    names.join(", ")
}

/// Type and shape as text, such as `f32 of [1, 3, ?, ?]`.
pub(crate) fn describe(kind: &ValueType) -> String {
    let ValueType::Tensor { ty, shape, .. } = kind else {
        return "not a tensor".to_owned();
    };
    let lengths = shape.iter().map(|length| match length {
        -1 => "?".to_owned(),
        length => length.to_string(),
    });
    format!("{ty} of [{}]", lengths.collect::<Vec<_>>().join(", "))
}
