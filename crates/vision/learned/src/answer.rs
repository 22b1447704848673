//! What a network gave.

use ort::value::{DynValue, TensorElementType};

/// The numbers of an output, in the order of its shape.
#[derive(Clone, Debug)]
pub(crate) struct Answer {
    pub(crate) shape: Vec<usize>,
    pub(crate) numbers: Numbers,
}

/// What kind they are.
#[derive(Clone, Debug)]
pub(crate) enum Numbers {
    /// Disparities, scores.
    Real(Vec<f32>),
    /// Numbers of classes.
    Whole(Vec<i64>),
}

impl Answer {
    /// Whether outputs of this type can be read.
    pub(crate) fn is_whole(kind: TensorElementType) -> bool {
        use TensorElementType::{Int32, Int64, Uint8};
        matches!(kind, Uint8 | Int32 | Int64)
    }

    /// # Errors
    /// What ONNX Runtime says of a value that is no tensor of a known type.
    pub(crate) fn new(value: &DynValue) -> ort::Result<Self> {
        let kind = value.dtype().tensor_type();
        let (shape, numbers) = match kind {
            Some(TensorElementType::Uint8) => {
                let (shape, numbers) = value.try_extract_tensor::<u8>()?;
                (shape, whole(numbers))
            }
            Some(TensorElementType::Int32) => {
                let (shape, numbers) = value.try_extract_tensor::<i32>()?;
                (shape, whole(numbers))
            }
            Some(TensorElementType::Int64) => {
                let (shape, numbers) = value.try_extract_tensor::<i64>()?;
                (shape, whole(numbers))
            }
            _ => {
                let (shape, numbers) = value.try_extract_tensor::<f32>()?;
                (shape, Numbers::Real(numbers.to_vec()))
            }
        };
        Ok(Self {
            shape: shape.iter().map(|length| *length as usize).collect(),
            numbers,
        })
    }
}

fn whole<T: Copy + Into<i64>>(numbers: &[T]) -> Numbers {
    Numbers::Whole(numbers.iter().map(|number| (*number).into()).collect())
}
