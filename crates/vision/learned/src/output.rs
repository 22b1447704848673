//! What a network gave.

use ort::value::{DynValue, TensorElementType};

/// The numbers of an output, in the order of its shape.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Values,
}

/// What kind they are.
#[derive(Clone, Debug)]
pub(crate) enum Values {
    /// Disparities, scores.
    Float(Vec<f32>),
    /// Numbers of classes.
    Integer(Vec<i64>),
}

impl Output {
    /// Whether outputs of this type can be read.
    pub(crate) fn is_integer(kind: TensorElementType) -> bool {
        use TensorElementType::{Int32, Int64, Uint8};
        matches!(kind, Uint8 | Int32 | Int64)
    }

    /// # Errors
    /// What ONNX Runtime says of a value that is no tensor of a known type.
    pub(crate) fn new(tensor: &DynValue) -> ort::Result<Self> {
        let kind = tensor.dtype().tensor_type();
        let (shape, values) = match kind {
            Some(TensorElementType::Uint8) => {
                let (shape, values) = tensor.try_extract_tensor::<u8>()?;
                (shape, integers(values))
            }
            Some(TensorElementType::Int32) => {
                let (shape, values) = tensor.try_extract_tensor::<i32>()?;
                (shape, integers(values))
            }
            Some(TensorElementType::Int64) => {
                let (shape, values) = tensor.try_extract_tensor::<i64>()?;
                (shape, integers(values))
            }
            _ => {
                let (shape, values) = tensor.try_extract_tensor::<f32>()?;
                (shape, Values::Float(values.to_vec()))
            }
        };
        Ok(Self {
            shape: shape.iter().map(|length| *length as usize).collect(),
            values,
        })
    }
}

fn integers<T: Copy + Into<i64>>(values: &[T]) -> Values {
    Values::Integer(values.iter().map(|value| (*value).into()).collect())
}
